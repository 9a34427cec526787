"""A recording as recorders take it: its header, its ticks and where everything that is drawn was.

From the file alone. Where it has no pose (poses are recorded now and then, and may be cut off before the
numbers are), cars that have no bodies are drawn where the columns say. The parts of a physical car are
carried along with its front axle from where they were last, and its front wheels are steered.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmerge.errors import UnreadableError
from mjmerge.plant.kinematic import standing
from mjmerge.record.attached import compiled
from mjmerge.record.contacts import Contacts, Mark, shade
from mjmerge.record.contents import Ticks
from mjmerge.record.digest import digests
from mjmerge.record.mcap.reader import mcap_messages
from mjmerge.record.posed import PosedBlock, Posing
from mjmerge.record.read import Recorded
from mjmerge.record.recording import Header, Outcome
from mjmerge.record.rerun.reader import rrd_batches, time_ns_of
from mjmerge.record.scene import Frame, Scene, aim_m, cars_in
from mjmerge.review.claims import what_follows
from mjmerge.review.derived import cars_of
from mjmerge.roster import EGO, slot
from mjmerge.simulation.log import TickBlock
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array, Cars
from mjmerge.vehicle.actuation import ackermann
from mjmerge.verdict.judge import judge
from mjmerge.verdict.metrics import events
from mjmerge.verdict.phases import phases
from mjmerge.world.checks.parts import STEERED
from mjmerge.world.model import World

Tracks = dict[str, tuple[Ticks, Array]]
"""By frame: times, ns, (K,), and poses, x y z and then w x y z, (K, 7)."""


def header(found: Recorded) -> Header:
    """What was known of the run before it started.

    Raises:
        UnreadableError: there is no world in it, none that compiles, or one of other cars.
    """
    model = compiled(found.path, found.world_xml)
    if cars_in(model) != found.roster.cars:
        raise UnreadableError(found.path, "its world has other cars than its manifest")
    return Header(
        scenario=found.scenario(),
        scenario_yaml=found.scenario_yaml,
        plant=str(found.manifest["plant"]),
        seed=int(found.manifest["seed"]),
        model=model,
        world_xml=found.world_xml,
        versions=found.manifest["versions"],
        control_step_s=found.step_s,
        sheets=found.sheets(),
        continuous=bool(found.manifest["continuous"]),
        acceptance=found.manifest["acceptance"],
        code=found.manifest.get("code") or {},
        metrics=found.manifest.get("metrics", ()),
    )


def posed(found: Recorded, about: Header, scene: Scene) -> PosedBlock:
    """The whole run as one block, without ``qpos``.

    Args:
        found: the file as read.
        about: its header.
        scene: what is drawn.

    Raises:
        UnreadableError: there is no tick in it.
    """
    if not found.columns or not len(found.ticks):
        raise UnreadableError(found.path, "there is not a whole tick in it")
    block = TickBlock(
        ticks=found.ticks,
        time_s=found.columns["time_s"],
        columns={name: values for name, values in found.columns.items() if name != "time_s"},
        qpos=np.empty((len(found.ticks), 0)),
    )
    drawn = scene.drawn(block, about.control_step_s)
    return Posing(about, scene).at(block, drawn, *poses(found, about, scene, drawn))


def touched(found: Recorded, r_m: float) -> tuple[list[Mark], NDArray[np.int64]]:
    """Marks where bodies touched, and the colours of the discs at every tick, (T, C-1)."""
    block = TickBlock(found.ticks, found.columns["time_s"], found.columns, np.empty((len(found.ticks), 0)))
    marks, ago_s = Contacts(found.roster, found.sheets(), found.step_s).add(block)
    return marks, shade(found.columns["distance_m"], r_m, ago_s)


def outcome(found: Recorded, trace: Trace) -> Outcome:
    """What a recording ends with, from its trace."""
    (verdict,) = judge(trace)
    happened = sorted([*events(trace), *verdict.events()], key=lambda e: e.time_s)
    claims = what_follows(found, trace, verdict)
    prints = digests(found.columns, found.texts)
    return Outcome(happened, verdict.verdict, claims, phases(trace), found.explanation, prints)


def poses(found: Recorded, about: Header, scene: Scene, rows: NDArray[np.intp]) -> tuple[Array, Array]:
    """Where the frames of the scene were at some rows of the columns.

    Args:
        found: the file as read.
        about: its header.
        scene: whose frames.
        rows: which rows, (D,).

    Returns:
        Origins, m, (D, F, 3), and orientations, w x y z, (D, F, 4).
    """
    known_poses = tracks(found, scene)
    at_rest = _at_rest(about.model)
    stand = standing_poses(found, about, rows) if about.plant != "mujoco" else {}
    out = np.zeros((len(rows), len(scene.frames), 7))
    front_m, heading_rad = found.columns["front_m"], found.columns["heading_rad"]
    steered = _steered(found, about)
    for f, frame in enumerate(scene.frames):
        car = _car(frame)
        if car is None:
            out[:, f] = _mark(found, frame, rows)
            continue
        time_ns, track = known_poses.get(frame.name, (np.empty(0, np.int64), np.empty((0, 7))))
        known = np.isin(time_ns, found.time_ns)
        time_ns, track = time_ns[known], track[known]
        latest = np.searchsorted(time_ns, found.time_ns[rows], side="right") - 1
        there = latest >= 0
        then = np.searchsorted(found.time_ns, time_ns[latest[there]])
        now = (front_m[rows, car], heading_rad[rows, car])
        before = np.zeros((len(rows), 2)), np.zeros(len(rows))
        before[0][there], before[1][there] = front_m[then, car], heading_rad[then, car]
        last = np.tile(at_rest[frame.name], (len(rows), 1))
        last[there] = track[latest[there]]
        steered_rad = np.zeros(len(rows))
        if frame.name in steered:
            angle_rad = steered[frame.name]
            steered_rad = angle_rad[rows]
            steered_rad[there] -= angle_rad[then]
        carried = stand[frame.name] if stand else _carried(last, before, now, steered_rad)
        exact = there.copy()
        exact[there] = then == rows[there]
        out[:, f] = np.where(exact[:, None], last, carried)
    return out[..., :3], out[..., 3:]


def _car(frame: Frame) -> int | None:
    """Whose part a frame is; ``None`` for a mark of ours."""
    return _owner(frame.name)


def _owner(name: str) -> int | None:
    """Which car is first in a name, along the axis of cars; ``None`` for none."""
    first = name.split("/")[0]
    j = slot(first)
    return 0 if first == EGO else None if j is None else 1 + j


def _mark(found: Recorded, frame: Frame, rows: NDArray[np.intp]) -> Array:
    """Poses of front axle, target and camera, (D, 7): they follow from the columns, and do not turn."""
    out = np.zeros((len(rows), 7))
    out[:, 3] = 1.0
    kind, _, name = frame.name.partition("/")
    if kind == "axles":
        out[:, :2] = found.columns["front_m"][rows, _owner(name)]
    elif kind == "law":
        out[:, :2] = aim_m(found.columns)[rows]
    else:
        out[:, 0] = found.columns["front_m"][rows, 0, 0]
    rounded: Array = out.astype(np.float32).astype(float)
    return rounded


def _steered(found: Recorded, about: Header) -> dict[str, Array]:
    """Angles of the wheels that steer, by name, rad, (T,)."""
    wheelbase_m, track_m = (
        np.array([getattr(sheet, name) for sheet in about.sheets]) for name in ("wheelbase_m", "track_m")
    )
    angles_rad = ackermann(np.nan_to_num(found.columns["steer_rad"]), wheelbase_m, track_m)
    return {
        f"{car}/wheel_{wheel}": angles_rad[:, c, w]
        for c, car in enumerate(found.roster.cars)
        for w, wheel in enumerate(STEERED)
    }


def standing_poses(found: Recorded, about: Header, rows: NDArray[np.intp]) -> dict[str, Array]:
    """Where everything is on a plant whose cars are drawn from the columns, by frame, (D, 7)."""
    cars = cars_of(found, found.trace())
    part = Cars(**{name: values[rows] for name, values in vars(cars).items()})
    sheets = tuple(sheet.sized(1 / about.scenario.models.size) for sheet in about.sheets)
    world = World(about.model, found.world_xml, found.roster.cars, sheets, about.scenario.mismatch.tyres)
    block = TickBlock(
        found.ticks[rows],
        found.columns["time_s"][rows],
        {name: found.columns[name][rows] for name in ("front_m", "target_m")},
        standing(world, part),
    )
    scene = Scene(about.model, about.scenario.r_m)
    both = np.concatenate(scene.poses(block, np.arange(len(rows))), axis=-1)
    return {frame.name: both[:, f] for f, frame in enumerate(scene.frames)}


def _at_rest(model: mujoco.MjModel) -> dict[str, Array]:
    """Poses of all bodies seen from below their car's front axle, as the car stands, by name, (7,)."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    out = {}
    for b in range(model.nbody):
        name = model.body(b).name or f"body_{b}"
        origin = np.zeros(3)
        if _owner(name) is not None:
            origin[:2] = data.site(f"{name.split('/')[0]}/front_axle").xpos[:2]
        out[name] = np.concatenate([data.xpos[b] - origin, data.xquat[b]])
    return out


def _carried(pose: Array, before: tuple[Array, Array], now: tuple[Array, Array], steered_rad: Array) -> Array:
    """Poses moved as their front axles moved, from position and heading to position and heading, (D, 7).

    What is steered in between turns by so much more, rad, (D,).
    """
    turn = now[1] - before[1]
    c, s = np.cos(turn), np.sin(turn)
    x, y = (pose[:, :2] - before[0]).T
    out = pose.copy()
    out[:, 0], out[:, 1] = now[0][:, 0] + c * x - s * y, now[0][:, 1] + s * x + c * y
    c, s = np.cos((turn + steered_rad) / 2), np.sin((turn + steered_rad) / 2)
    qw, qx, qy, qz = pose[:, 3:].T
    out[:, 3:] = np.stack([c * qw - s * qz, c * qx - s * qy, c * qy + s * qx, c * qz + s * qw], axis=1)
    return out


def tracks(found: Recorded, scene: Scene) -> Tracks:
    """The poses that are in the file, by frame."""
    there = _mcap_tracks(found) if found.kind == "mcap" else _rrd_tracks(found, scene)
    parts: dict[str, list[tuple[Ticks, Array]]] = defaultdict(list)
    for name, time_ns, values in there:
        parts[name].append((time_ns, values))
    whole = {}
    for name, some in parts.items():
        time_ns = np.concatenate([t for t, _ in some])
        order = np.argsort(time_ns, kind="stable")
        whole[name] = time_ns[order], np.concatenate([v for _, v in some])[order]
    return whole


def _mcap_tracks(found: Recorded) -> Iterator[tuple[str, Ticks, Array]]:
    rows: Mapping[str, tuple[list[int], list[Any]]] = defaultdict(lambda: ([], []))
    for time_ns, message in mcap_messages(found.path, "/tf"):
        for t in message.transforms:
            p, q = t.translation, t.rotation
            rows[t.child_frame_id][0].append(time_ns)
            rows[t.child_frame_id][1].append((p.x, p.y, p.z, q.w, q.x, q.y, q.z))
    for name, (times, values) in rows.items():
        yield name, np.array(times, np.int64), np.array(values, np.float64)


def _rrd_tracks(found: Recorded, scene: Scene) -> Iterator[tuple[str, Ticks, Array]]:
    from mjmerge.record.rerun import layout

    names = {layout.entity(frame.name): frame.name for frame in scene.frames}
    wanted = ("Transform3D:translation", "Transform3D:quaternion")
    for entity, batch in rrd_batches(found.path):
        if entity in names and {"sim_time", *wanted} <= set(batch.schema.names):
            pos, quat = (batch[name].flatten().flatten().to_numpy(zero_copy_only=False) for name in wanted)
            time_ns = time_ns_of(batch)
            values = np.concatenate([pos.reshape(-1, 3), np.roll(quat.reshape(-1, 4), 1, axis=1)], axis=1)
            yield names[entity], time_ns, values.astype(np.float64)
