"""What is in a Rerun recording, finished or not, read with Rerun's own reader.

That reader can take the process down with it on a file that is damaged, or never come back: another process
may try first.
"""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.config.bounds import patience_s
from mjmerge.record import content
from mjmerge.record.content import ContentError
from mjmerge.record.contents import Found, Ticks
from mjmerge.record.manifest import EXPLANATION, SCHEMA_VERSIONS
from mjmerge.record.mcap.file import TooLargeError
from mjmerge.record.rerun.file import whole_frames
from mjmerge.state import NS_PER_S, Array
from mjmerge.verdict.phases import ENDED, NAMES

if TYPE_CHECKING:
    import pyarrow as pa

_PATIENCE_S, _BYTES_PER_S = 6.0, 10e6
"""What Rerun's reader gets for a file, and how fast it is at least; it needs a tenth of that."""
_MEMORY_BYTES = 4 * 2**30
"""Address space of the process that tries first; Rerun reserves much and uses little."""
_ODD = (ValueError, TypeError, KeyError, IndexError, AttributeError)  # Arrow's are among them
_NOT_OURS = "holds something else than a recording has there"
_LEVELS = {"INFO": "info", "WARN": "warning", "ERROR": "error"}
_ATTEMPT = """
import contextlib, resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]),) * 2)
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
from rerun_bindings import ChunkInternal, RrdReaderInternal
table, stream = ChunkInternal.to_record_batch, RrdReaderInternal.stream
with contextlib.suppress(Exception):
    for chunk in stream(RrdReaderInternal(sys.argv[1]), store=None):
        table(chunk)
"""
"""What ``rerun.chunk`` does with a file, without the rest of Rerun: that takes half a second to import."""


def survives(path: Path) -> bool:
    """Whether Rerun's reader gets through in time, or at least gives up in an orderly way.

    Raises:
        TooLargeError: a frame would unpack to more than may be.
    """
    waits_s = patience_s(_PATIENCE_S + path.stat().st_size / _BYTES_PER_S)
    with whole_frames(path) as (whole, *_):
        command = [sys.executable, "-c", _ATTEMPT, str(whole), str(_MEMORY_BYTES)]
        try:
            done = subprocess.run(command, capture_output=True, check=False, timeout=waits_s)
        except subprocess.TimeoutExpired:
            return False
        return done.returncode == 0


def _batches(path: Path, found: Found) -> Iterator[tuple[str, pa.RecordBatch]]:
    """Entity path and data of every chunk, up to the first that cannot be read."""
    import rerun.chunk as rc

    with whole_frames(path) as (whole, found.finished, found.fault), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a missing footer
        try:
            reader = rc.RrdReader(whole)
            stores = len(reader.recordings())
            if stores != 1:
                found.flaws.append(f"{stores} recordings in one file")
            for chunk in reader.stream():
                yield chunk.entity_path, chunk.to_record_batch()
        except TooLargeError:
            raise
        except Exception as error:  # whatever the bytes of a damaged file lead to
            found.finished = False
            found.fault = "Rerun's reader gives up" + (f": {_line(error)}" if _line(error) else "")


def _line(error: Exception) -> str:
    """The first line of an error, without the path of a copy."""
    first = (str(error).splitlines() or [""])[0]
    return "" if "whole.rrd" in first else first[:200]


def rrd_batches(path: Path) -> Iterator[tuple[str, pa.RecordBatch]]:
    """Entity path and data of every chunk, as far as the file can be read."""
    return _batches(path, Found())


def gather_rrd(path: Path) -> Found:
    """What is in a Rerun recording, as far as it can be read.

    Raises:
        ContentError: what it says of itself cannot be.
        TooLargeError: a frame would unpack to more than may be.
    """
    from mjmerge.record import schema
    from mjmerge.record.rerun import arrow, layout

    subjects = {layout.phase_entity(subject): subject for subject in NAMES}
    texts = {"/run/scenario": "scenario.yaml", "/run/world": "world.xml"}
    found = Found()
    parts: dict[str, list[tuple[Ticks, pa.Array]]] = defaultdict(list)
    for entity, batch in _batches(path, found):
        names = set(batch.schema.names)
        message = schema.message_of(entity)
        try:
            if message and (component := arrow.component_in(names, message)):
                parts[entity].append((time_ns_of(batch), batch[component]))
            elif entity.endswith(schema.LAW_TOPIC):
                found.flaws.append("it shows several runs side by side; take their own recordings")
            elif entity in texts and "TextDocument:text" in names:
                _once(found, found.texts, texts[entity], _one(batch, "TextDocument:text"))
            elif entity == "/__properties/run" and "manifest" in names:
                found.schema_version = content.version_of(str(_one(batch, "schema_version")))
                _once(found, found.texts, "manifest.json", _one(batch, "manifest"))
                said = {name: _one(batch, name) for name in ("scenario", "plant", "seed", "continuous")}
                repeated = {n: content.json_of(_one(batch, n), n) for n in ("versions", "conventions")}
                found.properties["run"] = said | repeated
            elif entity == "/__properties/outcome" and "verdict" in names:
                _once(found, found.texts, "summary.json", _one(batch, "summary"))
                if "explanation" in names:
                    _once(found, found.texts, EXPLANATION, _one(batch, "explanation"))
                found.verdict = str(_one(batch, "verdict"))
                found.sha256 = content.texts_of(content.json_of(_one(batch, "sha256"), "sha256"), "sha256")
            elif entity == "/events" and "TextLog:text" in names:
                rows = zip(time_ns_of(batch), batch["TextLog:level"], batch["TextLog:text"], strict=True)
                found.said += [(int(t), _LEVELS[n.as_py()[0]], text.as_py()[0]) for t, n, text in rows]
            elif (subject := subjects.get(entity) or layout.own_hypothesis(entity)) and (
                "StateChange:state" in names
            ):
                changes = zip(time_ns_of(batch), batch["StateChange:state"], strict=True)
                found.states += [(int(t), subject, s.as_py()[0] or ENDED) for t, s in changes]
        except ContentError:
            raise
        except _ODD:
            found.flaws.append(f"{entity} {_NOT_OURS}")
    if "manifest.json" in found.texts:
        found.manifest = content.manifest_of(found.texts["manifest.json"])
    _number(found, parts)
    return found


def _number(found: Found, parts: dict[str, list[tuple[Ticks, pa.Array]]]) -> None:
    """Puts the parts of each series together."""
    from mjmerge.record import schema
    from mjmerge.record.rerun import arrow

    if found.schema_version not in SCHEMA_VERSIONS:
        return
    wire = schema.Wire.of(found.manifest)
    step_ns = found.manifest.get("control_step_s", 1.0) * NS_PER_S
    for entity, raw in parts.items():
        if schema.message_of(entity) not in wire.messages:
            found.flaws.append(f"{entity} in it, and the run has none")
            continue
        some: list[tuple[Ticks, Array]] = []
        for times, values in raw:
            try:
                some.append((times, arrow.numbers(wire, values, schema.message_of(entity) or "")))
            except _ODD:
                found.flaws.append(f"{entity} {_NOT_OURS}")
        if not some:
            continue
        time_ns = np.concatenate([part[0] for part in some])
        numbers = np.concatenate([part[1] for part in some])
        order = np.argsort(time_ns, kind="stable")  # chunks come in any order
        ticks = np.rint(time_ns / step_ns).astype(np.int64)
        found.series[entity] = ticks[order], time_ns[order], numbers[order]
    found.complete()


def _one(batch: pa.RecordBatch, name: str) -> Any:
    """The one value of a column that has one.

    Raises:
        ContentError: it has none.
    """
    try:
        value = batch[name][0].as_py()[0]
    except (TypeError, IndexError, KeyError, ValueError) as error:
        raise ContentError(f"its {name} is missing") from error
    if isinstance(value, str) and len(value) > content.LARGEST_TEXT_BYTES:
        raise ContentError(f"its {name} is longer than {content.LARGEST_TEXT_BYTES // 2**20} MiB")
    return value


def _once(found: Found, texts: dict[str, str], name: str, value: Any) -> None:
    """Takes a text that may be there once."""
    if name in texts:
        found.flaws.append(f"{name} is in it several times")
    if not isinstance(value, str):
        raise ContentError(f"its {name} is no text")
    texts.setdefault(name, value)


def time_ns_of(batch: pa.RecordBatch) -> Ticks:
    """Simulated time of each row, ns."""
    times: Ticks = batch["sim_time"].to_numpy(zero_copy_only=False).astype("timedelta64[ns]").astype(np.int64)
    return times
