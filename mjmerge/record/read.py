"""Recordings back into numbers, finished or not, through readers that share nothing with the writers of MCAP.

Nothing but the file is read. What a killed run left is read up to where it was cut off.
"""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tempfile
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import reduce
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mjmerge.document import parse
from mjmerge.errors import UnreadableError
from mjmerge.loader import load
from mjmerge.phases import ENDED, NAMES
from mjmerge.record.manifest import SCHEMA_VERSION
from mjmerge.scenario import CARS, Scenario
from mjmerge.trace import COLUMNS, Array, Stop, Trace

if TYPE_CHECKING:
    import pyarrow as pa

    from mjmerge.record.schema import Field

_MCAP_MAGIC, _RRD_MAGIC = b"\x89MCAP0\r\n", b"RRF2"
_RRD_HEADER_BYTES, _RRD_FRAME = 12, struct.Struct("<QQ")  # of the file; of a frame: its kind, its length
_RRD_END = 0
_NS_PER_S = 1_000_000_000
_RUN_FILES = ("run.mcap", "run.rrd", "run.mcap.partial", "run.rrd.partial")
Ticks = NDArray[np.int64]
Said = tuple[int, str, str]


@dataclass(frozen=True)
class Recorded:
    """One recording, as it is in its file.

    Attributes:
        path: the file.
        kind: ``mcap`` or ``rrd``.
        schema_version: of the file; ``None`` where it says none.
        finished: whether the file ends as its format wants it.
        fault: why reading ended before the end of the file; empty if it did not.
        manifest: where the run comes from, see ``record/manifest.py``.
        scenario_yaml: the scenario, resolved.
        world_xml: the composed MJCF.
        verdict: what the file claims; ``None`` where the run did not end.
        summary: likewise.
        sha256: fingerprint of every column, as the file claims.
        said: events: time in ns, level, text.
        states: changes of state: time in ns, subject, state.
        grids: ticks of every series, in the order of the file, and their times, ns.
        ticks: the ticks that every series has, (T,).
        time_ns: their times, (T,).
        columns: each column of ``COLUMNS`` and ``time_s`` at those ticks, (T, ...); what is not there is left
            out, and a file of another schema has none.
    """

    path: Path
    kind: str
    schema_version: int | None
    finished: bool
    fault: str
    manifest: Mapping[str, Any]
    scenario_yaml: str
    world_xml: str
    verdict: str | None
    summary: Mapping[str, Any] | None
    sha256: Mapping[str, str]
    said: list[Said]
    states: list[Said]
    grids: Mapping[str, tuple[Ticks, Ticks]]
    ticks: Ticks
    time_ns: Ticks
    columns: Mapping[str, Array] = field(repr=False)

    @property
    def step_s(self) -> float:
        """Simulated time between ticks, s."""
        return float(self.manifest["control_step_s"])

    @property
    def last_s(self) -> float:
        """Simulated time of the last tick, s."""
        return float(self.time_ns[-1]) / _NS_PER_S

    def scenario(self) -> Scenario:
        """The attached scenario.

        Raises:
            UnreadableError: it is damaged.
            ScenarioError: it is none that this version can run.
        """
        document = parse(self.scenario_yaml)
        if document.problems or not isinstance(document.value, dict):
            raise UnreadableError(self.path, "its scenario is damaged")
        return load(document.value).named(str(self.manifest["scenario"]))

    @property
    def texts(self) -> dict[str, str]:
        """What is in it as text, by name, as in :class:`~mjmerge.record.base.Header`."""
        return {"scenario.yaml": self.scenario_yaml, "world.xml": self.world_xml}

    def trace(self) -> Trace:
        """The run as a trace of one simulation, NaN where the file has nothing.

        Raises:
            UnreadableError: a column is missing.
            ScenarioError: the attached scenario is none that this version can run.
        """
        scenario = self.scenario()
        missing = [c.name for c in COLUMNS if c.name not in self.columns]
        if missing or not len(self.ticks):
            raise UnreadableError(self.path, f"it lacks {', '.join(missing) or 'any tick'}")
        inside = (self.ticks >= 0) & (self.ticks < scenario.ticks)
        columns: dict[str, Any] = {}
        for c in COLUMNS:
            columns[c.name] = np.full((1, scenario.ticks, *c.shape), np.nan)
            columns[c.name][0, self.ticks[inside]] = self.columns[c.name][inside]
        stops = (self.summary or {}).get("stops", ())
        return Trace(
            scenario=scenario,
            plant=str(self.manifest["plant"]),
            seeds=np.array([self.manifest["seed"]]),
            mismatch=(scenario.mismatch,),
            stops=tuple(Stop(0, s["time_s"], s["car"], s["reason"], s.get("touched", False)) for s in stops),
            continuous=bool(self.manifest["continuous"]),
            time_s=np.arange(scenario.ticks, dtype=np.float64) * scenario.control_step_s,
            **columns,
        )


@dataclass
class _Found:
    """What a reader gathers, series by series: ticks, times and values."""

    schema_version: int | None = None
    finished: bool = False
    fault: str = ""
    manifest: dict[str, Any] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    verdict: str | None = None
    sha256: dict[str, str] = field(default_factory=dict)
    said: list[Said] = field(default_factory=list)
    states: list[Said] = field(default_factory=list)
    series: dict[str, tuple[Ticks, Ticks, Array]] = field(default_factory=dict)


def recording(path: Path) -> Path:
    """The recording meant by the path of a file or a run folder.

    Raises:
        UnreadableError: there is none.
    """
    for place in [path, Path("runs") / path]:
        if place.is_file():
            return place
        for name in _RUN_FILES:
            if (place / name).is_file():
                return place / name
    raise UnreadableError(path, "there is no recording of that name")


def read(path: Path, *, wary: bool = True) -> Recorded:
    """Reads a recording, up to its end or to where it was cut off.

    Args:
        path: the file.
        wary: whether a damaged file is to be expected. Rerun's reader can take the process down with it on
            one, so that another process tries first, which takes a second.

    Raises:
        UnreadableError: it is no recording, or nothing of the run is in it.
    """
    try:
        kind, found = _gather(path, wary)
    except (AttributeError, KeyError, ValueError, TypeError) as error:
        raise UnreadableError(path, f"what it says of the run is damaged: {error}") from error
    if "control_step_s" not in found.manifest or "scenario.yaml" not in found.texts:
        where = f": {found.fault}" if found.fault else ""
        raise UnreadableError(path, f"what the run was is not in it{where}")
    grids = {name: (ticks, time_ns) for name, (ticks, time_ns, _) in found.series.items()}
    common = reduce(np.intersect1d, (t for t, _ in grids.values())) if grids else np.empty(0, np.int64)
    times, columns = np.empty(0, np.int64), {}
    rows = {name: _rows(ticks, common) for name, (ticks, _) in grids.items()}
    if grids:
        first = next(iter(grids))
        times = grids[first][1][rows[first]]
        values = {name: series[rows[name]] for name, (_, _, series) in found.series.items()}
        columns = _split(values)
    summary = found.texts.get("summary.json")
    return Recorded(
        path=path,
        kind=kind,
        schema_version=found.schema_version,
        finished=found.finished,
        fault=found.fault,
        manifest=found.manifest,
        scenario_yaml=found.texts["scenario.yaml"],
        world_xml=found.texts.get("world.xml", ""),
        verdict=found.verdict,
        summary=None if summary is None else json.loads(summary),
        sha256=found.sha256,
        said=sorted(found.said),
        states=sorted(found.states),
        grids=grids,
        ticks=common,
        time_ns=times,
        columns=columns,
    )


def read_mcap(path: Path) -> dict[str, Array]:
    """Columns of an MCAP recording by name, (T, ...), and ``time_s``, (T,)."""
    return dict(read(path, wary=False).columns)


def read_rrd(path: Path) -> dict[str, Array]:
    """Columns of a Rerun recording by name, (T, ...), and ``time_s``, (T,)."""
    return dict(read(path, wary=False).columns)


def _gather(path: Path, wary: bool) -> tuple[str, _Found]:
    """What kind of file it is, and what is in it."""
    try:
        with path.open("rb") as file:
            magic = file.read(8)
    except OSError as error:
        raise UnreadableError(path, error.strerror or str(error)) from error
    if magic == _MCAP_MAGIC:
        return "mcap", _gather_mcap(path)
    if magic.startswith(_RRD_MAGIC):
        if wary and not _survives(path):
            raise UnreadableError(path, "it is damaged: Rerun's reader breaks down on it")
        return "rrd", _gather_rrd(path)
    raise UnreadableError(path, "it is neither a Rerun nor an MCAP recording")


def _rows(ticks: Ticks, wanted: Ticks) -> NDArray[np.intp]:
    """Where in ``ticks`` each wanted one is first."""
    order = np.argsort(ticks, kind="stable")
    rows: NDArray[np.intp] = order[np.searchsorted(ticks[order], wanted)]
    return rows


# MCAP


def _mcap_records(path: Path, found: _Found) -> Iterator[Any]:
    """Records up to the end, or to the first that cannot be read."""
    from mcap.exceptions import EndOfFile
    from mcap.records import Footer
    from mcap.stream_reader import StreamReader

    with path.open("rb") as file:
        size = path.stat().st_size  # no record is larger: a length that was overwritten asks for no memory
        try:
            for record in StreamReader(file, validate_crcs=True, record_size_limit=size).records:
                found.finished |= isinstance(record, Footer)
                yield record
        except EndOfFile:
            found.finished, found.fault = False, "it ends within a record"
        except Exception as error:  # whatever the bytes of a damaged file lead to
            found.finished = False
            found.fault = str(error) or type(error).__name__


def mcap_messages(path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """Time, ns, and content of every message of a topic, as far as the file can be read."""
    from mcap.records import Channel, Message, Schema
    from mcap_protobuf.decoder import DecoderFactory

    decoders, schemas, decode = DecoderFactory(), {}, {}
    for record in _mcap_records(path, _Found()):
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel() if record.topic == topic:
                decode[record.id] = decoders.decoder_for(
                    record.message_encoding, schemas.get(record.schema_id)
                )
            case Message() if decode.get(record.channel_id):
                yield record.log_time, decode[record.channel_id](record.data)


def _gather_mcap(path: Path) -> _Found:
    from mcap.records import Attachment, Channel, Message, Metadata, Schema
    from mcap_protobuf.decoder import DecoderFactory

    from mjmerge.record import schema

    messages = {schema.LAW_TOPIC: schema.LAW_MESSAGE}
    messages |= {schema.car_topic(car): schema.CAR_MESSAGE for car in CARS}
    numbers = {topic: attrgetter(*_leaves(schema.MESSAGES[name])) for topic, name in messages.items()}
    found, decoders = _Found(), DecoderFactory()
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, Callable[[bytes], Any]]] = {}
    rows: dict[str, tuple[list[int], list[Any]]] = defaultdict(lambda: ([], []))
    for record in _mcap_records(path, found):
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel():
                decode = decoders.decoder_for(record.message_encoding, schemas.get(record.schema_id))
                if decode is not None:
                    channels[record.id] = record.topic, decode
            case Attachment():
                found.texts[record.name] = record.data.decode()
            case Metadata(name="mjmerge"):
                found.schema_version = int(record.metadata["schema_version"])
            case Metadata(name="outcome"):
                found.verdict = record.metadata["verdict"]
            case Metadata(name="sha256"):
                found.sha256 = record.metadata
            case Message() if record.channel_id in channels and found.schema_version == SCHEMA_VERSION:
                topic, decode = channels[record.channel_id]
                if topic in numbers:
                    try:
                        values = numbers[topic](decode(record.data))
                    except Exception as error:
                        found.fault = f"{topic}: {error}"
                        continue
                    rows[topic][0].append(record.log_time)
                    rows[topic][1].append(values)
                elif topic == "/log":
                    log = decode(record.data)
                    level = type(log).Level.Name(log.level).lower()
                    text = f"{log.name}: {log.message}" if log.name else log.message
                    found.said.append((record.log_time, level, text))
                elif topic == "/phases":
                    log = decode(record.data)
                    found.states.append((record.log_time, log.name, log.message))
    found.manifest = json.loads(found.texts.get("manifest.json", "{}"))
    step_ns = found.manifest.get("control_step_s", 1.0) * _NS_PER_S
    for topic, (times, lines) in rows.items():
        time_ns = np.array(times, np.int64)
        ticks = np.rint(time_ns / step_ns).astype(np.int64)
        found.series[topic] = ticks, time_ns, np.array(lines, np.float64)
    if found.series and len(found.series) < len(messages):
        found.series.clear()  # cut off within the first tick
    return found


def _leaves(fields: tuple[Field, ...]) -> list[str]:
    """Dotted names of all doubles of a message, in the order of its fields."""
    return [f"{f.name}.{part}" if part else f.name for f in fields for part in f.parts or ("",)]


def _split(series: Mapping[str, Array]) -> dict[str, Array]:
    """Columns from the numbers of each topic, which are in the order of its message."""
    from mjmerge.record import schema

    law = series[schema.LAW_TOPIC]
    cars = np.stack([series[schema.car_topic(car)] for car in CARS], axis=1)
    columns = {"time_s": law[:, 0]}
    for values, declared, leading in ((law, schema.LAW_COLUMNS, 0), (cars, schema.CAR_COLUMNS, 1)):
        at = 1
        for c in declared:
            size = int(np.prod(c.shape[leading:]))
            columns[c.name] = values[..., at : at + size].reshape(len(values), *c.shape)
            at += size
    return columns


# Rerun


@contextmanager
def whole_frames(path: Path) -> Iterator[tuple[Path, bool, str]]:
    """A Rerun recording without the frame it was cut off in; Rerun itself refuses such a file.

    Yields:
        The file, or a temporary copy up to its last whole frame; whether it is finished; what is wrong.
    """
    size, at, kind = path.stat().st_size, _RRD_HEADER_BYTES, -1
    with path.open("rb") as file:
        while at + _RRD_FRAME.size <= size:
            file.seek(at)
            kind, length = _RRD_FRAME.unpack(file.read(_RRD_FRAME.size))
            if at + _RRD_FRAME.size + length > size or kind == _RRD_END:
                break
            at += _RRD_FRAME.size + length
        finished = kind == _RRD_END and at + _RRD_FRAME.size < size and _has_footer(path)
        if finished or at == size:
            yield path, finished, "" if finished else "it ends without a footer"
            return
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / "whole.rrd"
            file.seek(0)
            with copy.open("wb") as out:
                left = at
                while part := file.read(min(left, 2**20)):
                    out.write(part)
                    left -= len(part)
            yield copy, False, f"it ends within a frame, {size - at} bytes after the last whole one"


def _has_footer(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-32, 2)
        return b"RRF2FOOT" in file.read()


def _survives(path: Path) -> bool:
    """Whether Rerun's reader gets through, or at least gives up in an orderly way."""
    attempt = """
import contextlib, sys, rerun.chunk as rc
with contextlib.suppress(Exception):
    for chunk in rc.RrdReader(sys.argv[1]).stream():
        chunk.to_record_batch()
"""
    with whole_frames(path) as (whole, *_):
        command = [sys.executable, "-c", attempt, str(whole)]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0


def _batches(path: Path, found: _Found) -> Iterator[tuple[str, pa.RecordBatch]]:
    """Entity path and data of every chunk, up to the first that cannot be read."""
    import rerun.chunk as rc

    with whole_frames(path) as (whole, found.finished, found.fault), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a missing footer
        try:
            for chunk in rc.RrdReader(whole).stream():
                yield chunk.entity_path, chunk.to_record_batch()
        except Exception as error:  # whatever the bytes of a damaged file lead to
            found.finished = False
            found.fault = str(error) or type(error).__name__


def rrd_batches(path: Path) -> Iterator[tuple[str, pa.RecordBatch]]:
    """Entity path and data of every chunk, as far as the file can be read."""
    return _batches(path, _Found())


def _gather_rrd(path: Path) -> _Found:
    from mjmerge.record import arrow, layout, schema

    messages = {schema.LAW_TOPIC: arrow.component(schema.LAW_MESSAGE)}
    messages |= {schema.car_topic(car): arrow.component(schema.CAR_MESSAGE) for car in CARS}
    subjects = {layout.phase_entity(subject): subject for subject in NAMES}
    texts = {"/run/scenario": "scenario.yaml", "/run/world": "world.xml"}
    levels = {"INFO": "info", "WARN": "warning", "ERROR": "error"}
    found = _Found()
    parts: dict[str, list[tuple[Ticks, Array]]] = defaultdict(list)

    def one(batch: pa.RecordBatch, name: str) -> Any:
        return batch[name][0].as_py()[0]

    for entity, batch in _batches(path, found):
        names = set(batch.schema.names)
        if entity in messages and messages[entity] in names:
            try:
                parts[entity].append((time_ns_of(batch), arrow.numbers(batch[messages[entity]])))
            except ValueError as error:
                found.fault = f"{entity}: {error}"
        elif entity.endswith(schema.LAW_TOPIC):
            found.fault = "it shows several runs side by side; take their own recordings"
        elif entity in texts and "TextDocument:text" in names:
            found.texts[texts[entity]] = one(batch, "TextDocument:text")
        elif entity == "/__properties/run" and "manifest" in names:
            found.schema_version = int(one(batch, "schema_version"))
            found.manifest = json.loads(one(batch, "manifest"))
        elif entity == "/__properties/outcome" and "verdict" in names:
            found.verdict = one(batch, "verdict")
            found.texts["summary.json"] = one(batch, "summary")
            found.sha256 = json.loads(one(batch, "sha256"))
        elif entity == "/events" and "TextLog:text" in names:
            rows = zip(time_ns_of(batch), batch["TextLog:level"], batch["TextLog:text"], strict=True)
            found.said += [(int(t), levels[level.as_py()[0]], text.as_py()[0]) for t, level, text in rows]
        elif entity in subjects and "StateChange:state" in names:
            changes = zip(time_ns_of(batch), batch["StateChange:state"], strict=True)
            found.states += [(int(t), subjects[entity], s.as_py()[0] or ENDED) for t, s in changes]
    step_ns = found.manifest.get("control_step_s", 1.0) * _NS_PER_S
    if found.schema_version == SCHEMA_VERSION and messages.keys() <= parts.keys():
        for entity in messages:  # otherwise cut off within the first block
            time_ns = np.concatenate([part[0] for part in parts[entity]])
            numbers = np.concatenate([part[1] for part in parts[entity]])
            order = np.argsort(time_ns, kind="stable")  # chunks come in any order
            ticks = np.rint(time_ns / step_ns).astype(np.int64)
            found.series[entity] = ticks[order], time_ns[order], numbers[order]
    return found


def time_ns_of(batch: pa.RecordBatch) -> Ticks:
    """Simulated time of each row, ns."""
    times: Ticks = batch["sim_time"].to_numpy(zero_copy_only=False).astype("timedelta64[ns]").astype(np.int64)
    return times
