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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mjmerge import phases
from mjmerge.errors import OutputError, RecordingError
from mjmerge.metrics import Event
from mjmerge.record import arrow, layout, plots, report, schema
from mjmerge.record.arrow import Template
from mjmerge.record.base import WHOLE, Header, Outcome, PosedBlock, join, nanoseconds
from mjmerge.record.manifest import CONVENTIONS, SCHEMA_VERSION, git_revision, manifest
from mjmerge.record.plots import Plot
from mjmerge.record.scene import DISC_RGBA, Scene, Shape, closeness
from mjmerge.scenario import CARS
from mjmerge.trace import BLOCK_S, Array

APPLICATION = "mjmerge_run"
"""Of the layout: an open viewer keeps the first layout it saw under a name."""
Still = list[tuple[str, rr.AsComponents]]
"""Entities and what never changes of them."""
_LEVELS = {"info": "INFO", "warning": "WARN", "error": "ERROR"}
_PATIENCE_S = 30.0
"""For writing to disk; without a limit, a write that failed would be waited for for ever."""
_HEADER_BYTES, _MESSAGE, _END = 12, struct.Struct("<QQ"), 0
"""Of an .rrd: its header; of a message: its kind and its length; the kind of the end mark."""
_NO_QPOS = np.empty((0, 0))
_DRAW_S = 5.0
"""What is drawn follows the numbers to disk with this delay: it can be made of them again."""
CHUNK_TICKS = 4096
"""Ticks that a finished file keeps together."""
_ARROW_R = 0.5
"""Length of an arrow for 1 m/s^2, in safety margins."""
_TRAIL_R, _ARROW_RADIUS_R = 0.015, 0.035


class RerunRecorder:
    """Writes a Rerun recording: a journal during the run, and a tidy file in its place at the end."""

    def __init__(self, path: Path, header: Header, scene: Scene) -> None:
        """Args: the file; what is known of the run; what to draw."""
        self._path, self._header = path, header
        self._teller = partial(Teller, header=header, scene=scene, still=still_life(header, scene))
        self._blueprint = layout.blueprint(header.scenario, scene.paint)
        self._posed: list[PosedBlock] = []
        self._drawn = 0
        stream = rr.RecordingStream(APPLICATION, send_properties=False)
        self._journal = Journal(path, stream)
        stream.send_blueprint(self._blueprint, make_active=False)
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
        stream = rr.RecordingStream(APPLICATION, send_properties=False)
        stream.save(path, default_blueprint=self._blueprint)
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
        """All there is, in few parts."""
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
        self._near = np.full(len(CARS) - 1, -1)
        self._plots = plots.everything(header.scenario, scene.paint)
        self._describe()
        for entity, what in still:
            stream.log(entity, what, static=True)

    def _describe(self) -> None:
        """Says where the run comes from."""
        h = self._header
        name = f"{h.scenario.name} · {h.plant} · seed {h.seed}"
        self._stream.send_recording_name(name)
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
        if not len(posed.drawn):
            return
        times = times_of(posed.time_ns[posed.drawn])
        columns = {name: values[posed.drawn] for name, values in posed.block.columns.items()}
        send_frames(self._stream, self._scene, posed, layout.entity)
        near = closeness(columns["distance_m"], self._scene.r_m)
        send_discs(self._stream, self._scene, posed.time_ns[posed.drawn], near, self._near)
        self._near = near[-1]
        self._trails(times, columns["front_m"])
        send_arrows(self._stream, self._scene, times, columns)

    def _trails(self, times: list[rr.TimeColumn], front_m: Array) -> None:
        """Sends each tick's bit of the front axles' paths; the view shows the last few seconds of them."""
        last = front_m[:1] if self._last_m is None else self._last_m
        path = np.zeros((len(front_m) + 1, len(CARS), 3))
        path[..., :2] = np.concatenate([last, front_m])
        path[..., 2] = [_TRAIL_R * self._scene.r_m * height for height in (3, 2, 1)]  # the ego's on top
        self._last_m = front_m[-1:]
        bits = np.stack([path[:-1], path[1:]], axis=2)
        self._send("/world/trails", times, _STRIP.fill(bits))

    def end(self, outcome: Outcome) -> None:
        """Adds the events, the phases, the verdict and the summary."""
        events = outcome.events or [Event(0.0, "info", "", "nothing to report")]  # the view wants an entity
        at = nanoseconds([e.time_s for e in events])
        rows = rr.TextLog.columns(
            text=[f"{e.car}: {e.text}" if e.car else e.text for e in events],
            level=[_LEVELS[e.level] for e in events],
        )
        self._send("/events", times_of(at), rows)
        said = [(int(nanoseconds(p.time_s)), p.subject, p.state) for p in outcome.phases]
        send_states(self._stream, said)
        about: dict[str, Any] = {
            "verdict": outcome.verdict,
            "summary": json.dumps(outcome.summary),
            "sha256": json.dumps(dict(outcome.digests)),
        }
        self._stream.send_property("outcome", rr.AnyValues(**about))
        self._text("/run/report", report.finished(self._header, outcome), rr.MediaType.MARKDOWN)

    def flush(self, patience_s: float = _PATIENCE_S) -> None:
        """Puts all that was told where it goes."""
        self._stream.flush(timeout_sec=patience_s)

    def close(self) -> None:
        """Completes the stream with what it has."""
        self.flush()
        self._stream.disconnect()

    def _send(self, entity: str, times: list[rr.TimeColumn], columns: Any) -> None:
        self._stream.send_columns(entity, times, columns)

    def _text(self, entity: str, text: str, media_type: rr.MediaType) -> None:
        self._stream.log(entity, rr.TextDocument(text, media_type=media_type), static=True)


def send_numbers(stream: rr.RecordingStream, posed: PosedBlock, root: str = "") -> None:
    """Sends every column at consecutive ticks; ``root`` is where the topics go."""
    times = times_of(posed.time_ns)
    law: Any = arrow.structs(schema.LAW_MESSAGE, schema.law_rows(posed.block))
    stream.send_columns(root + schema.LAW_TOPIC, times, law)
    for car in CARS:
        state: Any = arrow.structs(schema.CAR_MESSAGE, schema.car_rows(posed.block, car))
        stream.send_columns(root + schema.car_topic(car), times, state)


def send_levels(
    stream: rr.RecordingStream,
    which: Sequence[Plot],
    time_ns: NDArray[np.int64],
    timeline: str = layout.SIM_TIME,
) -> None:
    """Sends what plots are read against, at some times."""
    times = times_of(time_ns, timeline)
    for entity, level in plots.levels(which).items():
        scalars: Any = _SCALARS.fill(np.full((len(time_ns), 1), level.value))
        stream.send_columns(entity, times, scalars)


def still_levels(which: Sequence[Plot]) -> Still:
    """How what plots are read against is called and coloured."""
    return [
        (entity, rr.SeriesLines(names=level.label, colors=[level.color], widths=[1.0]))
        for entity, level in plots.levels(which).items()
    ]


def send_frames(
    stream: rr.RecordingStream, scene: Scene, posed: PosedBlock, entity: Callable[[str], str]
) -> None:
    """Sends where the frames of a scene were; ``entity`` is where a frame's is."""
    times, quat = times_of(posed.time_ns[posed.drawn]), np.roll(posed.quat, -1, axis=-1)  # x y z w
    for f, frame in enumerate(scene.frames):
        placed: Any = _TRANSFORM.fill(posed.pos_m[:, f, None], quat[:, f, None])
        stream.send_columns(entity(frame.name), times, placed)


def send_discs(
    stream: rr.RecordingStream,
    scene: Scene,
    time_ns: NDArray[np.int64],
    near: NDArray[np.int64],
    before: NDArray[np.int64],
    timeline: str = layout.SIM_TIME,
) -> None:
    """Sends the colours of the discs where they change.

    Args:
        stream: where to.
        scene: whose discs.
        time_ns: times, ns, (D,).
        near: how close the ego is then, see ``closeness``, (D, 2).
        before: how close it was before, (2,).
        timeline: of the times.
    """
    for frame in scene.frames:
        j = frame.neighbour
        if j is None:
            continue
        changes = np.flatnonzero(np.diff(near[:, j], prepend=before[j]))
        if len(changes):
            colors: Any = _CYLINDER_COLOR.fill(_rgba32(DISC_RGBA[near[changes, j]])[:, None])
            stream.send_columns(
                f"{layout.entity(frame.name)}/cylinder", times_of(time_ns[changes], timeline), colors
            )


def send_arrows(
    stream: rr.RecordingStream, scene: Scene, times: list[rr.TimeColumn], columns: Mapping[str, Array]
) -> None:
    """Sends the parts of the ego's command, at its front axle, above its roof."""
    u_mps2 = {"u_n": columns["u_n_mps2"], "u_c": columns["u_c_mps2"], "u": columns["u_mps2"][:, 0]}
    for name, u in u_mps2.items():
        vectors = np.zeros((len(u), 1, 3))
        vectors[:, 0, :2] = np.nan_to_num(u * (_ARROW_R * scene.r_m), posinf=0, neginf=0)
        told: Any = _ARROW.fill(vectors)
        stream.send_columns(_arrow_entity(name), times, told)


def send_states(
    stream: rr.RecordingStream, changes: Sequence[tuple[int, str, str]], timeline: str = layout.SIM_TIME
) -> None:
    """Sends changes of state: time in ns, subject, state."""
    for subject in phases.NAMES:
        mine = [(at, state) for at, about, state in changes if about == subject]
        if mine:
            at = np.array([at for at, _ in mine], np.int64)
            states = rr.StateChange.columns(state=["" if s == phases.ENDED else s for _, s in mine])
            stream.send_columns(layout.phase_entity(subject), times_of(at, timeline), states)


def still_states() -> Still:
    """How states are called and coloured."""
    return [
        (
            layout.phase_entity(subject),
            rr.StateConfiguration(values=list(names), colors=layout.state_colors(subject)),
        )
        for subject, names in phases.NAMES.items()
    ]


def still_arrows(scene: Scene) -> Still:
    """How the parts of the ego's command look."""
    return [
        (
            _arrow_entity(name),
            rr.Arrows3D.from_fields(
                origins=[(0, 0, scene.label_m)],
                colors=[color],
                radii=[_ARROW_RADIUS_R * scene.r_m],
                labels=[name],
                show_labels=False,
            ),
        )
        for name, color in plots.COMMANDS.items()
    ]


_POINT = [[0.0, 0.0, 0.0]]
_SCALARS = Template(rr.Scalars.columns(scalars=[0.0]))
_TRANSFORM = Template(rr.Transform3D.columns(translation=_POINT, quaternion=[[0.0, 0.0, 0.0, 1.0]]))
_STRIP = Template(rr.LineStrips3D.columns(strips=[[*_POINT, *_POINT]]))
_ARROW = Template(rr.Arrows3D.columns(vectors=_POINT))
_CYLINDER_COLOR = Template(rr.Cylinders3D.columns(colors=[0]))


def times_of(time_ns: NDArray[np.int64], timeline: str = layout.SIM_TIME) -> list[rr.TimeColumn]:
    """Times, ns, (B,), as Rerun wants them."""
    return [rr.TimeColumn(timeline, duration=time_ns.astype("timedelta64[ns]"))]


def _rgba32(rgba: Array) -> NDArray[np.uint32]:
    """Colours (N, 4), 0 to 1, as Rerun packs them, (N,)."""
    parts = np.round(255 * rgba).astype(np.uint32)
    packed: NDArray[np.uint32] = parts @ np.array([2**24, 2**16, 2**8, 1], np.uint32)
    return packed


def still_life(header: Header, scene: Scene) -> Still:
    """All that never changes: texts, what is drawn in its frame, names and colours."""
    r_m = scene.r_m
    still: Still = [("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP), *still_frames(scene, layout.entity)]
    for name, text in (("scenario", header.scenario_yaml), ("world", header.world_xml)):
        still.append((f"/run/{name}", rr.TextDocument(text, media_type=rr.MediaType.TEXT)))
    colors = [scene.paint[car] for car in CARS]
    still.append(("/world/trails", rr.LineStrips3D.from_fields(colors=colors, radii=[_TRAIL_R * r_m])))
    levels = still_levels(plots.everything(header.scenario, scene.paint))
    return [*still, *still_arrows(scene), *still_states(), *levels]


def still_frames(scene: Scene, entity: Callable[[str], str], colored: bool = False) -> Still:
    """What is fixed to the frames of a scene, and the road.

    Args:
        scene: the scene.
        entity: where a frame's is.
        colored: whether the discs are, too, once and for all.
    """
    still = still_shapes(entity("road/"), scene.fixed)
    for frame in scene.frames:
        changes = frame.neighbour is not None and not colored
        still += still_shapes(entity(frame.name), frame.shapes, colored=not changes)
        if frame.label:
            at = [(0.0, 0.0, scene.label_m)]
            label = rr.Points3D(at, labels=[frame.label], radii=0, colors=[(240, 240, 240)])
            still.append((f"{entity(frame.name)}/label", label))
    return still


def still_shapes(entity: str, shapes: tuple[Shape, ...], colored: bool = True) -> Still:
    """One child entity per kind of shape: kinds share the components that place them.

    A colour that is to change must not be among what never does: Rerun would show that one only.
    """
    still: Still = []
    for kind in ("box", "ellipsoid", "cylinder", "capsule"):
        some = [s for s in shapes if s.kind == kind]
        if some:
            still.append((f"{entity}/{kind}", _archetype(kind, some, colored)))
    for i, mesh in enumerate(s for s in shapes if s.kind == "mesh"):
        placed = rr.InstancePoses3D(translations=[mesh.pos_m], quaternions=[np.roll(mesh.quat, -1)])
        drawn = rr.Mesh3D(
            vertex_positions=mesh.vertices_m, triangle_indices=mesh.triangles, albedo_factor=mesh.rgba
        )
        still += [(f"{entity}/mesh_{i}", placed), (f"{entity}/mesh_{i}", drawn)]
    return still


def _arrow_entity(name: str) -> str:
    """Of a part of the ego's command: at its front axle."""
    return f"{layout.entity('axles/ego')}/{name}"


def _archetype(kind: str, shapes: list[Shape], colored: bool) -> rr.AsComponents:
    """Shapes of one kind as one batch."""
    size = np.array([s.half_size_m for s in shapes])
    centers = np.array([s.pos_m for s in shapes])
    quaternions = np.roll([s.quat for s in shapes], -1, axis=-1)  # x y z w
    colors = np.array([s.rgba for s in shapes]) if colored else None
    solid = rr.components.FillMode.Solid
    match kind:
        case "box":
            return rr.Boxes3D(
                half_sizes=size, centers=centers, quaternions=quaternions, colors=colors, fill_mode=solid
            )
        case "ellipsoid":
            return rr.Ellipsoids3D(
                half_sizes=size, centers=centers, quaternions=quaternions, colors=colors, fill_mode=solid
            )
        case "cylinder":
            return rr.Cylinders3D(
                lengths=2 * size[:, 2],
                radii=size[:, 0],
                centers=centers,
                quaternions=quaternions,
                colors=colors,
                fill_mode=solid,
            )
        case _:  # a capsule starts at its translation and goes up
            bottoms = [s.pos_m - s.half_size_m[2] * s.axis for s in shapes]
            return rr.Capsules3D(
                lengths=2 * size[:, 2],
                radii=size[:, 0],
                translations=bottoms,
                quaternions=quaternions,
                colors=colors,
                fill_mode=solid,
            )
