"""All that a recording shows beside its numbers: written again from them, and compared."""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mjmerge.errors import MjmergeError
from mjmerge.record import schema
from mjmerge.record.manifest import DRAWING
from mjmerge.record.mcap.reader import mcap_drawn
from mjmerge.record.read import Recorded
from mjmerge.record.recording import Header, Outcome
from mjmerge.record.rerun import layout
from mjmerge.record.rerun.reader import rrd_batches
from mjmerge.record.scene import Scene
from mjmerge.review.check import Check, checked
from mjmerge.review.poses import posed
from mjmerge.state import NS_PER_S
from mjmerge.verdict.metrics import Event
from mjmerge.verdict.phases import Phase
from mjmerge.versions import versions

_DRAWS = ("mjmerge", "rerun-sdk", "foxglove-sdk", "mujoco")
"""Packages of whose versions it depends how something is drawn."""
_RELATIVE, _ABSOLUTE = 1e-6, 1e-7  # shapes are float32, and meshes are placed by an eigenvalue problem
Contents = dict[str, list[Any]]
"""What is shown, by topic or entity and component: one entry per time."""


def shown(found: Recorded, about: Header, scene: Scene) -> Iterator[Check]:
    """Shapes, colours, labels, arrows, trails and texts, against those that the numbers give.

    Args:
        found: the file as read.
        about: its header.
        scene: what is drawn.
    """
    if found.verdict is None or found.summary is None or not found.finished:
        yield Check("drawing", None, "not checked: it is completed when a run ends")
        return
    try:
        with tempfile.TemporaryDirectory() as folder:
            again = Path(folder) / f"run.{found.kind}"
            _write(found, about, scene, again)
            ours, theirs = contents(again, found.kind), contents(found.path, found.kind)
    except (MjmergeError, OSError, ValueError, KeyError, TypeError) as error:
        yield Check("drawing", False, f"cannot be drawn: {error}")
        return
    wrong = [f"{name} is not drawn" for name in sorted(ours.keys() - theirs.keys())]
    wrong += [f"{name} is drawn, and no part of a run" for name in sorted(theirs.keys() - ours.keys())]
    wrong += [
        f"{name} is drawn otherwise"
        for name in sorted(ours.keys() & theirs.keys())
        if not alike(ours[name], theirs[name])
    ]
    made, here = found.manifest["versions"], versions()
    other = found.manifest.get("drawing") != DRAWING
    if wrong and (other or any(made.get(name) != here.get(name) for name in _DRAWS)):
        yield Check("drawing", None, f"other versions draw otherwise: {wrong[0]}")
        return
    yield checked("drawing", wrong, f"{len(ours)} parts, as the numbers say")


def _write(found: Recorded, about: Header, scene: Scene, path: Path) -> None:
    """The recording again, from its numbers and poses."""
    events = [
        Event(at / NS_PER_S, _level(level), *_said(text))
        for at, level, text in found.said
        if text != _NOTHING
    ]
    phases = [Phase(subject, at / NS_PER_S, state) for at, subject, state in found.states]
    end = Outcome(events, found.verdict or "", found.summary or {}, phases, found.explanation, found.sha256)
    block = posed(found, about, scene)
    if found.kind == "mcap":
        from mjmerge.record.mcap.recorder import McapRecorder

        recorder = McapRecorder(path, about, scene)
        recorder.write(block)
        recorder.close(end)
        return
    from mjmerge.record.rerun.draw import still_life
    from mjmerge.record.rerun.recorder import APPLICATION, Teller
    from mjmerge.record.rerun.stream import new_stream

    stream = new_stream(APPLICATION)
    stream.save(path)
    teller = Teller(stream, about, scene, still_life(about, scene))
    teller.draw(block)
    teller.end(end)
    teller.close()


_NOTHING = "nothing to report"


def _level(level: str) -> Any:
    return level if level in ("info", "warning", "error") else "info"


def _said(text: str) -> tuple[str, str]:
    """Car and words of an event."""
    car, colon, words = text.partition(": ")
    return (car, words) if colon else ("", text)


def contents(path: Path, kind: str) -> Contents:
    """What is drawn in a recording of a kind, ``mcap`` or ``rrd``."""
    return _mcap(path) if kind == "mcap" else _rrd(path)


def _mcap(path: Path) -> Contents:
    """What is drawn in an MCAP."""
    rows: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    for topic, at, message in mcap_drawn(path):
        rows[topic].append((at, _plain(message)))
    return {topic: sorted(some, key=_order) for topic, some in rows.items()}


def _order(row: tuple[int, Any]) -> tuple[int, str]:
    """By time; what is of one time, in any order that is always the same."""
    return row[0], str(row[1])[:200]


def _plain(message: Any) -> Any:
    """A protobuf message as nested tuples."""
    out = []
    for field, value in message.ListFields():
        if field.message_type is None:
            plain: Any = tuple(value) if field.is_repeated else value
        elif field.is_repeated:
            plain = tuple(_plain(one) for one in value)
        else:
            plain = _plain(value)
        out.append((field.name, plain))
    return tuple(out)


def _rrd(path: Path) -> Contents:
    """What is drawn in a Rerun recording: but for the numbers, poses and what it says of itself."""
    rows: dict[str, list[tuple[int, Any]]] = defaultdict(list)
    for entity, batch in rrd_batches(path):
        if schema.message_of(entity) or entity.startswith("/__properties"):
            continue
        names = [n for n in batch.schema.names if n not in ("rerun.controls.RowId", layout.SIM_TIME)]
        if layout.SIM_TIME in batch.schema.names:
            times = batch[layout.SIM_TIME].to_numpy(zero_copy_only=False).astype("timedelta64[ns]")
            at = times.astype(np.int64).tolist()
        else:
            at = [-1] * batch.num_rows
        for name in names:
            if name.startswith("Transform3D:"):
                continue
            rows[f"{entity} {name}"] += zip(at, batch[name].to_pylist(), strict=True)
    found: Contents = {}
    for name, some in rows.items():
        if some[0][0] < 0:
            some = some[-1:]  # of what never changes, the last is shown
        if name.startswith("/level/"):  # a constant, said once per part of the file
            some = [(0, value) for value in dict.fromkeys(map(str, (value for _, value in some)))]
        if name.startswith("/run/report "):  # events of one time are in no order
            some = [(0, sorted(str(value).split("\\n"))) for _, value in some]
        found[name] = sorted(some, key=_order)
    return found


def alike(ours: Any, theirs: Any) -> bool:
    """Whether two contents are equal, numbers to the last digits of float32."""
    if isinstance(ours, float) and isinstance(theirs, float):
        if ours == theirs or (ours != ours and theirs != theirs):
            return True
        return abs(ours - theirs) <= _ABSOLUTE + _RELATIVE * abs(ours)
    if isinstance(ours, list | tuple) and isinstance(theirs, list | tuple):
        if len(ours) != len(theirs):
            return False
        return all(map(alike, ours, theirs))
    return bool(type(ours) is type(theirs) and ours == theirs)
