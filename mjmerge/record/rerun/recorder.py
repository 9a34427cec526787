"""``run.rrd``: the view. Opens in the Rerun viewer with the layout of ``layout.py``.

Entities: ``/law`` and ``/car/<car>`` hold a message per tick with every column bit for bit, under the names
that they have in the MCAP; ``/world/...`` is what is drawn, ``/level/...`` what plots are read against,
``/events`` the log, ``/phases/...`` and ``/hypotheses/...`` states as they change, ``/run/...`` where it
comes from and how it ended. The only time is simulated: ``sim_time``.
"""

from __future__ import annotations

import json
import shutil
import struct
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from mjmerge.config.acts import BODIES
from mjmerge.errors import OutputError, RecordingError
from mjmerge.outputs import WHOLE
from mjmerge.record import plots, report
from mjmerge.record.manifest import CONVENTIONS, SCHEMA_VERSION, manifest
from mjmerge.record.posed import PosedBlock, join
from mjmerge.record.recording import Header, Outcome
from mjmerge.record.rerun import layout
from mjmerge.record.rerun.draw import (
    send_arrows,
    send_discs,
    send_frames,
    send_levels,
    send_numbers,
    send_trails,
    still_life,
)
from mjmerge.record.rerun.happened import (
    Still,
    send_events,
    send_marks,
    send_no_contact,
    send_states,
    states_of,
    times_of,
)
from mjmerge.record.rerun.stream import new_stream, save, send_layout
from mjmerge.record.scene import Scene
from mjmerge.simulation.log import BLOCK_S
from mjmerge.state import Array
from mjmerge.versions import git_revision

APPLICATION = "mjmerge_run"
"""Of the layout: an open viewer keeps the first layout it saw under a name."""
_PATIENCE_S = 30.0
"""For writing to disk; without a limit, a write that failed would be waited for for ever."""
_HEADER_BYTES, _MESSAGE, _END = 12, struct.Struct("<QQ"), 0
"""Of an .rrd: its header; of a message: its kind and its length; the kind of the end mark."""
_NO_QPOS = np.empty((0, 0))
_DRAW_S = 60.0
"""What is drawn follows the numbers to disk with this delay: it can be made of them again."""
CHUNK_TICKS = 4096
"""Ticks that a finished file keeps together."""


class RerunRecorder:
    """Writes a Rerun recording: a journal during the run, and a tidy file in its place at the end."""

    def __init__(self, path: Path, header: Header, scene: Scene) -> None:
        """Args: the file; what is known of the run; what to draw."""
        self._path, self._header = path, header
        self._teller = partial(Teller, header=header, scene=scene, still=still_life(header, scene))
        self._blueprint = layout.blueprint(header.scenario, scene.paint, header.plant)
        self._posed: list[PosedBlock] = []
        self._drawn = 0
        stream = new_stream(APPLICATION)
        self._journal = Journal(path, stream)
        send_layout(stream, self._blueprint)
        self._told = self._teller(stream)
        self._journal.flush()

    def write(self, posed: PosedBlock) -> None:
        """Adds consecutive ticks, and puts them on disk."""
        self._posed.append(replace(posed, block=replace(posed.block, qpos=_NO_QPOS)))
        self._told.numbers(posed)
        if (len(self._posed) - self._drawn) * BLOCK_S >= _DRAW_S:
            self._draw()
        self._journal.flush()

    def _draw(self) -> None:
        """Adds what is drawn of the ticks that it has not been added of."""
        if self._drawn < len(self._posed):
            self._told.draw(join(self._posed[self._drawn :]))
            self._drawn = len(self._posed)

    def close(self, outcome: Outcome) -> None:
        """Writes the file anew, with the events, the phases, the verdict and the summary."""
        path = self._path.with_name(self._path.name + WHOLE)
        if shutil.disk_usage(path.parent).free < 2 * self._path.stat().st_size:
            raise OutputError(f"the disk of {path.parent} is full")  # Rerun would wait for space for ever
        stream = new_stream(APPLICATION)
        save(stream, path, self._blueprint)
        whole = self._teller(stream)
        for posed in self._chunks():
            whole.numbers(posed)
            whole.draw(posed)
        whole.end(outcome)
        whole.close()
        self._journal.close()
        if path.is_file():
            path.replace(self._path)

    def _chunks(self) -> list[PosedBlock]:
        """All blocks so far, joined to few."""
        chunks: list[list[PosedBlock]] = []
        room = 0
        for posed in self._posed:
            if len(posed.time_ns) > room:
                chunks.append([])
                room = CHUNK_TICKS
            chunks[-1].append(posed)
            room -= len(posed.time_ns)
        return [join(parts) for parts in chunks]

    def abort(self) -> None:
        """Completes the journal with what it has."""
        try:
            self._draw()
            self._journal.flush()
        finally:
            self._journal.close()


class Journal:
    """What a stream is told, appended to a file: without a footer, readable at any time.

    Rerun's own writer never comes back from a disk that is full; here that is an ordinary ``OSError``.
    """

    def __init__(self, path: Path, stream: rr.RecordingStream) -> None:
        """Args: the file, which must not exist; the stream, which has not been told anything."""
        if not rr.is_enabled(stream):
            raise RecordingError("nothing was written: RERUN=off in the environment")
        self._bytes = rr.binary_stream(stream)
        self._file = path.open("xb")

    def flush(self) -> None:
        """Puts what was told since on disk."""
        data = self._bytes.read(flush_timeout_sec=_PATIENCE_S) or b""
        self._file.write(data[_HEADER_BYTES if self._file.tell() else 0 : _end_of_messages(data)])
        self._file.flush()

    def close(self) -> None:
        """Completes the file with what it has."""
        self._file.close()


def _end_of_messages(data: bytes) -> int:
    """Where the end mark is of what Rerun gives out: a header, messages, that mark, a footer."""
    at = _HEADER_BYTES
    while at + _MESSAGE.size <= len(data):
        kind, length = _MESSAGE.unpack_from(data, at)
        if kind == _END:
            break
        at += _MESSAGE.size + length
    return at


class Teller:
    """Tells a Rerun stream, which goes to a file or a viewer, about one run."""

    def __init__(self, stream: rr.RecordingStream, header: Header, scene: Scene, still: Still) -> None:
        """Args: where it goes; what is known of the run; what to draw; what never changes of that."""
        rr.set_strict_mode(True)  # otherwise data that does not fit is dropped with a warning
        self._stream, self._header, self._scene = stream, header, scene
        self._last_m: Array | None = None
        self._shades = np.full(len(header.scenario.roster.neighbours), -1)
        self._plots = plots.everything(header.scenario, scene.paint, header.plant)
        self._describe()
        for entity, what in still:
            stream.log(entity, what, static=True)

    def _describe(self) -> None:
        """Says where the run comes from."""
        h = self._header
        self._stream.send_recording_name("; ".join(h.ran))
        about: dict[str, Any] = {
            "schema_version": SCHEMA_VERSION,
            "scenario": h.scenario.name,
            "plant": h.plant,
            "seed": h.seed,
            "continuous": h.continuous,
            "versions": json.dumps(dict(h.versions)),
            "git_revision": git_revision() or "unknown",
            "conventions": json.dumps(CONVENTIONS),
            "manifest": json.dumps(manifest(h)),
        }
        self._stream.send_property("run", rr.AnyValues(**about))
        self._text("/run/report", report.unfinished(h), rr.MediaType.MARKDOWN)

    def numbers(self, posed: PosedBlock) -> None:
        """Adds every column at consecutive ticks."""
        send_numbers(self._stream, posed)

    def draw(self, posed: PosedBlock) -> None:
        """Adds what is drawn of consecutive ticks, and what plots are read against."""
        send_levels(self._stream, self._plots, posed.time_ns[[0, -1]])
        if posed.block.ticks[0] == 0 and self._header.plant in BODIES:
            send_no_contact(self._stream, 0)
        send_marks(self._stream, self._scene, posed.marks)
        if not len(posed.drawn):
            return
        times = times_of(posed.time_ns[posed.drawn])
        columns = {name: values[posed.drawn] for name, values in posed.block.columns.items()}
        send_frames(self._stream, self._scene, posed, layout.entity)
        send_discs(self._stream, self._scene, posed.time_ns[posed.drawn], posed.shades, self._shades)
        self._shades = posed.shades[-1]
        front_m = columns["front_m"]
        last_m = front_m[:1] if self._last_m is None else self._last_m
        send_trails(self._stream, self._scene, times, front_m, last_m)
        self._last_m = front_m[-1:]
        send_arrows(self._stream, self._scene, times, columns)

    def end(self, outcome: Outcome) -> None:
        """Adds the events, the phases, the verdict and the summary."""
        send_events(self._stream, outcome)
        send_states(self._stream, states_of(outcome))
        about: dict[str, Any] = {
            "verdict": outcome.verdict,
            "summary": json.dumps(outcome.summary),
            "sha256": json.dumps(dict(outcome.digests)),
        }
        if outcome.explanation is not None:
            about["explanation"] = json.dumps(outcome.explanation)
        self._stream.send_property("outcome", rr.AnyValues(**about))
        self._text("/run/report", report.finished(self._header, outcome), rr.MediaType.MARKDOWN)

    def flush(self, patience_s: float = _PATIENCE_S) -> None:
        """Puts all that was told where it goes."""
        self._stream.flush(timeout_sec=patience_s)

    def close(self) -> None:
        """Completes the stream with what it has."""
        self.flush()
        self._stream.disconnect()

    def _text(self, entity: str, text: str, media_type: rr.MediaType) -> None:
        self._stream.log(entity, rr.TextDocument(text, media_type=media_type), static=True)
