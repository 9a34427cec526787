"""What is in a Rerun recording, finished or not, read with Rerun's own reader.

That reader refuses a file that was cut off, and can take the process down with it on one that is damaged:
here it gets whole frames only, and another process may try first.
"""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tempfile
import warnings
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.phases import ENDED, NAMES
from mjmerge.record.found import NS_PER_S, Found, Ticks
from mjmerge.record.manifest import SCHEMA_VERSION
from mjmerge.scenario import CARS
from mjmerge.trace import Array

if TYPE_CHECKING:
    import pyarrow as pa

_HEADER_BYTES, _FRAME = 12, struct.Struct("<QQ")  # of the file; of a frame: its kind, its length
_END = 0


@contextmanager
def whole_frames(path: Path) -> Iterator[tuple[Path, bool, str]]:
    """A Rerun recording without the frame it was cut off in; Rerun itself refuses such a file.

    Yields:
        The file, or a temporary copy up to its last whole frame; whether it is finished; what is wrong.
    """
    size, at, kind = path.stat().st_size, _HEADER_BYTES, -1
    with path.open("rb") as file:
        while at + _FRAME.size <= size:
            file.seek(at)
            kind, length = _FRAME.unpack(file.read(_FRAME.size))
            if at + _FRAME.size + length > size or kind == _END:
                break
            at += _FRAME.size + length
        finished = kind == _END and at + _FRAME.size < size and _has_footer(path)
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


def survives(path: Path) -> bool:
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


def _batches(path: Path, found: Found) -> Iterator[tuple[str, pa.RecordBatch]]:
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
    return _batches(path, Found())


def gather_rrd(path: Path) -> Found:
    """What is in a Rerun recording, as far as it can be read."""
    from mjmerge.record import arrow, layout, schema

    messages = {schema.LAW_TOPIC: arrow.component(schema.LAW_MESSAGE)}
    messages |= {schema.car_topic(car): arrow.component(schema.CAR_MESSAGE) for car in CARS}
    subjects = {layout.phase_entity(subject): subject for subject in NAMES}
    texts = {"/run/scenario": "scenario.yaml", "/run/world": "world.xml"}
    levels = {"INFO": "info", "WARN": "warning", "ERROR": "error"}
    found = Found()
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
    step_ns = found.manifest.get("control_step_s", 1.0) * NS_PER_S
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
