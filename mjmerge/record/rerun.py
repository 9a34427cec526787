"""``run.rrd``: the view. Opens in the Rerun viewer with the layout of ``layout.py``.

Entities: ``/law/...`` and ``/cars/...`` hold every column bit for bit as scalars, ``/world/...`` what is
drawn, ``/events`` the log, ``/phases/...`` and ``/hypotheses/...`` states as they change, ``/run/...`` where
it comes from and how it ended. Times: ``sim_time``, ``step``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mjmerge import phases
from mjmerge.metrics import Event
from mjmerge.phases import Phase
from mjmerge.record import layout, report
from mjmerge.record.base import Header, Outcome, PosedBlock, nanoseconds
from mjmerge.record.manifest import CONVENTIONS, SCHEMA_VERSION, git_revision, manifest
from mjmerge.record.scene import Scene, Shape
from mjmerge.scenario import CARS
from mjmerge.trace import COLUMNS, NEIGHBOURS, Array, Column

APPLICATION = "mjmerge_run"
"""Of the layout: an open viewer keeps the first layout it saw under a name."""
TIME_ENTITY = "/law/time_s"
"""Simulated time exactly as simulated; the timeline holds the nearest nanosecond."""
_LEVELS = {"info": "INFO", "warning": "WARN", "error": "ERROR"}
_PATIENCE_S = 30.0
"""For writing to disk; without a limit, a write that failed would be waited for for ever."""
_TRAIL_M = 0.006


def series(column: Column) -> Iterator[tuple[str, tuple[slice | int, ...]]]:
    """Where a column is: entity path and index into (tick, ...), one entity per last component.

    The first axis stays together as the lines of one plot (all cars, both neighbours), a second one is spread
    over entities (``/cars/front_m/y``), so that a plot can show the lateral positions alone.
    """
    root = "/cars" if column.axes[:1] == (CARS,) else "/law"
    rest = column.axes[1:]
    for index in product(*(range(len(axis)) for axis in rest)):
        parts = [axis[i] for axis, i in zip(rest, index, strict=True)]
        yield "/".join([root, column.name, *parts]), (slice(None),) * min(2, 1 + len(column.axes)) + index


def labels(column: Column) -> list[str]:
    """Names of the lines of a column's plot."""
    if not column.axes:
        return [column.symbol]
    if column.axes[0] == NEIGHBOURS:
        return [column.symbol.replace("_j", f"_{j}") for j in (1, 2)]
    if column.axes[0] == CARS:
        return [car.replace("_", " ") for car in CARS]
    return [f"{column.symbol} {part}".replace("_vehicle", " vehicle") for part in column.axes[0]]


class RerunRecorder:
    """Writes a Rerun recording."""

    def __init__(self, path: Path, header: Header, scene: Scene) -> None:
        """Args: the file; what is known of the run; what to draw."""
        rr.set_strict_mode(True)  # otherwise data that does not fit is dropped with a warning
        self._header = header
        self._scene = scene
        self._last_m: Array | None = None
        self._stream = rr.RecordingStream(APPLICATION, send_properties=False)
        self._stream.save(path, default_blueprint=layout.blueprint(header.scenario))
        self._describe()
        self._draw()

    def _describe(self) -> None:
        """Provenance, and the names and colours of all lines."""
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
        self._text("/run/scenario", h.scenario_yaml, rr.MediaType.TEXT)
        self._text("/run/world", h.world_xml, rr.MediaType.TEXT)
        for column in COLUMNS:
            names = labels(column)
            for entity, _ in series(column):
                style = rr.SeriesLines(names=names, colors=self._colors(column), widths=[1.5] * len(names))
                self._stream.log(entity, style, static=True)
        for entity, names, _ in self._references():
            colors = layout.REFERENCE_COLORS[: len(names)]
            style = rr.SeriesLines(names=names, colors=colors, widths=[1.0] * len(names))
            self._stream.log(entity, style, static=True)

    def _references(self) -> list[tuple[str, list[str], list[float]]]:
        """Constant lines that plots are read against: entity, names, values."""
        scenario = self._header.scenario
        floor = scenario.expect.min_distance_m.at_least
        return [
            ("/reference/distance_m", ["contact", "floor"], [0.0, floor]),
            ("/reference/gap_m", ["2 r"], [2 * scenario.law.r_m]),
        ]

    def _colors(self, column: Column) -> list[list[int]]:
        """Of a column's lines: the cars' own, where it is about cars."""
        paint = {car: (255 * rgba).round().astype(int).tolist() for car, rgba in self._scene.paint.items()}
        first = column.axes[0] if column.axes else ()
        if first and set(first) <= set(CARS):
            return [paint[car] for car in first]
        return layout.COLORS.get(column.name, layout.LINE_COLORS[: max(1, len(first))])

    def _draw(self) -> None:
        """What is drawn, once; it moves with its frame."""
        self._stream.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._draw_shapes("/world/road", self._scene.fixed)
        for frame in self._scene.frames:
            entity = layout.entity(frame.name)
            self._draw_shapes(entity, frame.shapes)
            if frame.label:
                at = [(0.0, 0.0, self._scene.label_m)]
                label = rr.Points3D(at, labels=[frame.label], radii=0, colors=[(240, 240, 240)])
                self._stream.log(f"{entity}/label", label, static=True)
        for car, rgba in self._scene.paint.items():
            style = rr.LineStrips3D.from_fields(colors=[rgba], radii=[_TRAIL_M])
            self._stream.log(f"/world/trails/{car}", style, static=True)

    def _draw_shapes(self, entity: str, shapes: tuple[Shape, ...]) -> None:
        """One child entity per kind of shape: kinds share the components that place them."""
        for kind in ("box", "ellipsoid", "cylinder", "capsule"):
            some = [s for s in shapes if s.kind == kind]
            if some:
                self._stream.log(f"{entity}/{kind}", _archetype(kind, some), static=True)
        for i, mesh in enumerate(s for s in shapes if s.kind == "mesh"):
            placed = rr.Transform3D(
                translation=mesh.pos_m, quaternion=rr.Quaternion(xyzw=np.roll(mesh.quat, -1))
            )
            drawn = rr.Mesh3D(
                vertex_positions=mesh.vertices_m, triangle_indices=mesh.triangles, albedo_factor=mesh.rgba
            )
            self._stream.log(f"{entity}/mesh_{i}", placed, drawn, static=True)

    def write(self, posed: PosedBlock) -> None:
        """Adds consecutive ticks, and puts them on disk."""
        block = posed.block
        count = len(block.ticks)
        times = _times(posed.time_ns, block.ticks)
        self._scalars(TIME_ENTITY, times, block.time_s[:, None])
        for column in COLUMNS:
            values = block.columns[column.name]
            for entity, index in series(column):
                self._scalars(entity, times, values[index].reshape(count, -1))
        ends = [0, -1]
        for entity, _, constants in self._references():
            self._scalars(entity, _times(posed.time_ns[ends], block.ticks[ends]), np.tile(constants, (2, 1)))
        for f, frame in enumerate(self._scene.frames):
            quat = np.roll(posed.quat[:, f], -1, axis=-1)  # x y z w
            placed = rr.Transform3D.columns(translation=posed.pos_m[:, f], quaternion=quat)
            self._stream.send_columns(layout.entity(frame.name), times, placed)
        self._trails(times, block.columns["front_m"])
        self._stream.flush(timeout_sec=_PATIENCE_S)

    def _scalars(self, entity: str, times: list[rr.TimeColumn], values: Array) -> None:
        """Sends (B, n) numbers as n lines."""
        lengths = np.full(len(values), values.shape[1])
        columns = rr.Scalars.columns(scalars=values.ravel()).partition(lengths)
        self._stream.send_columns(entity, times, columns)

    def _trails(self, times: list[rr.TimeColumn], front_m: Array) -> None:
        """Sends each tick's bit of the front axles' paths; the view shows the last few seconds of them."""
        last = front_m[:1] if self._last_m is None else self._last_m
        path = np.zeros((len(front_m) + 1, len(CARS), 3), np.float32)
        path[..., :2] = np.concatenate([last, front_m])
        path[..., 2] = [_TRAIL_M * height for height in (3, 2, 1)]  # the ego's on top
        self._last_m = front_m[-1:]
        for c, car in enumerate(CARS):
            bits = np.stack([path[:-1, c], path[1:, c]], axis=1)
            self._stream.send_columns(f"/world/trails/{car}", times, rr.LineStrips3D.columns(strips=bits))

    def close(self, outcome: Outcome) -> None:
        """Adds the events, the phases, the verdict and the summary, and completes the file."""
        events = outcome.events or [Event(0.0, "info", "", "nothing to report")]  # the view wants an entity
        at = nanoseconds([e.time_s for e in events])
        ticks = np.rint(at / (self._header.control_step_s * 1e9)).astype(np.int64)
        rows = rr.TextLog.columns(
            text=[f"{e.car}: {e.text}" if e.car else e.text for e in events],
            level=[_LEVELS[e.level] for e in events],
        )
        self._stream.send_columns("/events", _times(at, ticks), rows)
        self._states(outcome.phases)
        about: dict[str, Any] = {
            "verdict": outcome.verdict,
            "summary": json.dumps(outcome.summary),
            "sha256": json.dumps(dict(outcome.digests)),
        }
        self._stream.send_property("outcome", rr.AnyValues(**about))
        self._text("/run/report", report.finished(self._header, outcome), rr.MediaType.MARKDOWN)
        self.abort()

    def _states(self, found: Sequence[Phase]) -> None:
        """Sends each subject's changes of state, and how the states are called and coloured."""
        for subject, names in phases.NAMES.items():
            entity = layout.phase_entity(subject)
            style = rr.StateConfiguration(values=list(names), colors=layout.state_colors(subject))
            self._stream.log(entity, style, static=True)
            mine = [p for p in found if p.subject == subject]
            if mine:
                at = nanoseconds([p.time_s for p in mine])
                ticks = np.rint(at / (self._header.control_step_s * 1e9)).astype(np.int64)
                rows = rr.StateChange.columns(
                    state=["" if p.state == phases.ENDED else p.state for p in mine]
                )
                self._stream.send_columns(entity, _times(at, ticks), rows)

    def abort(self) -> None:
        """Completes the file with what it has."""
        self._stream.flush(timeout_sec=_PATIENCE_S)
        self._stream.disconnect()

    def _text(self, entity: str, text: str, media_type: rr.MediaType) -> None:
        self._stream.log(entity, rr.TextDocument(text, media_type=media_type), static=True)


def _times(time_ns: NDArray[np.int64], ticks: NDArray[np.int64]) -> list[rr.TimeColumn]:
    """Both timelines."""
    return [
        rr.TimeColumn("sim_time", duration=time_ns.astype("timedelta64[ns]")),
        rr.TimeColumn("step", sequence=ticks),
    ]


def _archetype(kind: str, shapes: list[Shape]) -> rr.AsComponents:
    """Shapes of one kind as one batch."""
    size = np.array([s.half_size_m for s in shapes])
    centers = np.array([s.pos_m for s in shapes])
    quaternions = np.roll([s.quat for s in shapes], -1, axis=-1)  # x y z w
    colors = np.array([s.rgba for s in shapes])
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
