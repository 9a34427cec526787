"""Columns and scenes as Rerun's data, and where in a recording they go.

The stream is the caller's: a run's, a comparison's or that of the view of an MCAP. ``send_...`` sends what
changes, ``still_...`` is what never does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mjmerge.config.acts import BODIES
from mjmerge.record import plots
from mjmerge.record.contacts import DISC_RGBA
from mjmerge.record.plots import Plot
from mjmerge.record.posed import PosedBlock
from mjmerge.record.recording import Header
from mjmerge.record.rerun import arrow, layout
from mjmerge.record.rerun.arrow import Template
from mjmerge.record.rerun.happened import Still, still_contact, still_states, times_of
from mjmerge.record.scene import Scene, Shape
from mjmerge.state import Array

_ARROW_R = 0.5
"""Length of an arrow for 1 m/s^2, in safety margins."""
_TRAIL_R, _ARROW_RADIUS_R = 0.015, 0.035
_POINT = [[0.0, 0.0, 0.0]]
_SCALARS = Template(rr.Scalars.columns(scalars=[0.0]))
_TRANSFORM = Template(rr.Transform3D.columns(translation=_POINT, quaternion=[[0.0, 0.0, 0.0, 1.0]]))
_STRIP = Template(rr.LineStrips3D.columns(strips=[[*_POINT, *_POINT]]))
_ARROW = Template(rr.Arrows3D.columns(vectors=_POINT))
_CYLINDER_COLOR = Template(rr.Cylinders3D.columns(colors=[0]))
_DISC_RGBA32 = np.round(255 * DISC_RGBA).astype(np.uint32) @ np.array([2**24, 2**16, 2**8, 1], np.uint32)
"""The colours of discs as Rerun packs them."""


def send_numbers(stream: rr.RecordingStream, posed: PosedBlock, root: str = "") -> None:
    """Sends every column at consecutive ticks.

    Args:
        stream: where to.
        posed: the ticks.
        root: where the topics go.
    """
    times = times_of(posed.time_ns)
    for topic, message in posed.wire.kinds.items():
        numbers: Any = arrow.structs(posed.wire, message, posed.rows[topic])
        stream.send_columns(root + topic, times, numbers)


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
    shades: NDArray[np.int64],
    before: NDArray[np.int64],
    timeline: str = layout.SIM_TIME,
    entity: Callable[[str], str] = layout.entity,
) -> None:
    """Sends the colours of the discs where they change.

    Args:
        stream: where to.
        scene: whose discs.
        time_ns: times, ns, (D,).
        shades: their colours then, see :func:`~mjmerge.record.contacts.shade`, (D, C-1).
        before: what they were before, (C-1,).
        timeline: of the times.
        entity: where a frame's is.
    """
    for frame in scene.frames:
        j = frame.neighbour
        if j is None:
            continue
        changes = np.flatnonzero(np.diff(shades[:, j], prepend=before[j]))
        if len(changes):
            colors: Any = _CYLINDER_COLOR.fill(_DISC_RGBA32[shades[changes, j]][:, None])
            stream.send_columns(
                f"{entity(frame.name)}/cylinder", times_of(time_ns[changes], timeline), colors
            )


def send_trails(
    stream: rr.RecordingStream, scene: Scene, times: list[rr.TimeColumn], front_m: Array, last_m: Array
) -> None:
    """Sends each tick's bit of the front axles' paths; the view shows the last few seconds of them.

    Args:
        stream: where to.
        scene: whose paths.
        times: times, (B,).
        front_m: where the front axles are then, (B, C, 2).
        last_m: where they were before, (1, C, 2).
    """
    cars = front_m.shape[1]
    path = np.zeros((len(front_m) + 1, cars, 3))
    path[..., :2] = np.concatenate([last_m, front_m])
    path[..., 2] = [_TRAIL_R * scene.r_m * height for height in range(cars, 0, -1)]  # the ego's on top
    bits: Any = _STRIP.fill(np.stack([path[:-1], path[1:]], axis=2))
    stream.send_columns("/world/trails", times, bits)


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


def still_life(header: Header, scene: Scene) -> Still:
    """All that never changes: texts, what is drawn in its frame, names and colours."""
    r_m = scene.r_m
    still: Still = [("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP), *still_frames(scene, layout.entity)]
    for name, text in (("scenario", header.scenario_yaml), ("world", header.world_xml)):
        still.append((f"/run/{name}", rr.TextDocument(text, media_type=rr.MediaType.TEXT)))
    colors = [scene.paint[car] for car in scene.cars]
    still.append(("/world/trails", rr.LineStrips3D.from_fields(colors=colors, radii=[_TRAIL_R * r_m])))
    levels = still_levels(plots.everything(header.scenario, scene.paint, header.plant))
    scenario = header.scenario
    contact = still_contact(scenario.roster) if header.plant in BODIES else []
    return [*still, *still_arrows(scene), *still_states(scenario), *contact, *levels]


def still_frames(scene: Scene, entity: Callable[[str], str], *, hollow: bool = False) -> Still:
    """What is fixed to the frames of a scene, and the road.

    Args:
        scene: the scene.
        entity: where a frame's is.
        hollow: whether of the discs only the edges are drawn.
    """
    still = still_shapes(entity("road/"), scene.fixed)
    for frame in scene.frames:
        disc = frame.neighbour is not None
        still += still_shapes(entity(frame.name), frame.shapes, colored=not disc, hollow=disc and hollow)
        if frame.label:
            at = [(0.0, 0.0, scene.label_m)]
            label = rr.Points3D(at, labels=[frame.label], radii=0, colors=[(240, 240, 240)])
            still.append((f"{entity(frame.name)}/label", label))
    return still


def still_shapes(
    entity: str, shapes: tuple[Shape, ...], *, colored: bool = True, hollow: bool = False
) -> Still:
    """One child entity per kind of shape: kinds share the components that place them.

    A colour that is to change must not be among what never does: Rerun would show that one only.
    """
    still: Still = []
    for kind in ("box", "ellipsoid", "cylinder", "capsule"):
        some = [s for s in shapes if s.kind == kind]
        if some:
            still.append((f"{entity}/{kind}", _archetype(kind, some, colored, hollow)))
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


def _archetype(kind: str, shapes: list[Shape], colored: bool, hollow: bool) -> rr.AsComponents:
    """Shapes of one kind as one batch."""
    size = np.array([s.half_size_m for s in shapes])
    centers = np.array([s.pos_m for s in shapes])
    quaternions = np.roll([s.quat for s in shapes], -1, axis=-1)  # x y z w
    colors = np.array([s.rgba for s in shapes]) if colored else None
    fill = rr.components.FillMode.MajorWireframe if hollow else rr.components.FillMode.Solid
    match kind:
        case "box":
            return rr.Boxes3D(
                half_sizes=size, centers=centers, quaternions=quaternions, colors=colors, fill_mode=fill
            )
        case "ellipsoid":
            return rr.Ellipsoids3D(
                half_sizes=size, centers=centers, quaternions=quaternions, colors=colors, fill_mode=fill
            )
        case "cylinder":
            return rr.Cylinders3D(
                lengths=2 * size[:, 2],
                radii=size[:, 0],
                centers=centers,
                quaternions=quaternions,
                colors=colors,
                fill_mode=fill,
            )
        case _:  # a capsule starts at its translation and goes up
            bottoms = [s.pos_m - s.half_size_m[2] * s.axis for s in shapes]
            return rr.Capsules3D(
                lengths=2 * size[:, 2],
                radii=size[:, 0],
                translations=bottoms,
                quaternions=quaternions,
                colors=colors,
                fill_mode=fill,
            )
