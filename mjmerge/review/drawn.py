"""Whether what viewers show is what the columns say: poses, bodies, shapes, colours, texts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjmerge.errors import UnreadableError
from mjmerge.record.contents import Ticks
from mjmerge.record.read import Recorded
from mjmerge.record.recording import Header
from mjmerge.record.scene import DRAWN_EVERY_S, Scene
from mjmerge.review.check import Check, checked
from mjmerge.review.poses import Tracks, header, poses, standing_poses, tracks
from mjmerge.review.shown import shown
from mjmerge.roster import Roster
from mjmerge.simulation.log import TickBlock
from mjmerge.simulation.trace import Trace
from mjmerge.state import NS_PER_S, Array, norm
from mjmerge.vehicle.actuation import bicycle_angle
from mjmerge.world.checks.parts import STEERED

_ROUNDED, _PLACED_M = 2e-7, 2e-6
"""Poses are float32: off by this part, and by so much near the origin."""
_TURNED = 2e-6
_TRAVELS = 0.75
"""How far a wheel may be from where it is at rest, over its radius."""
_STEERED_RAD = 0.01
_CLEAR_M, _BETWEEN_M = 5e-4, 0.01
"""What clearances may be off where poses are recorded, and between; beside a part of how the cars move."""
_BETWEEN = 0.1
_ROCKS = 0.05
"""Part of a wheelbase that clearances may be off where a chassis is carried on as it last stood; once there
was a hit, it may lie in any way."""
_MOVES_MPS = 1e-3
_NUDGE_M = 1e-9
"""By which bodies are moved apart where their distance is asked again."""


@dataclass(frozen=True)
class _Drawn:
    """What the checks of a drawing look at."""

    found: Recorded
    trace: Trace
    about: Header
    scene: Scene
    tracks: Tracks
    rows: Ticks
    """Rows of the columns that are drawn."""


def drawn(found: Recorded, trace: Trace) -> Iterator[Check]:
    """Poses, clearances and contacts, and all else that is shown.

    Args:
        found: the file as read.
        trace: the run in it.
    """
    try:
        about = header(found)
        scene = Scene(about.model, about.scenario.r_m)
    except (UnreadableError, KeyError) as error:
        yield Check("world", False, str(error).replace(f"cannot read {found.path}: ", ""))
        return
    block = TickBlock(found.ticks, found.columns["time_s"], found.columns, np.empty((len(found.ticks), 0)))
    rows = scene.drawn(block, found.step_s)
    there = _Drawn(found, trace, about, scene, _compared(found, scene, rows), rows)
    try:
        yield _poses(there)
        if trace.plant == "mujoco":
            yield _bodies(there)
    except KeyError as error:
        yield Check("world", False, f"its world lacks {error.args[0]}")
        return
    yield from shown(found, about, scene)


def _compared(found: Recorded, scene: Scene, rows: Ticks) -> Tracks:
    """The poses in the file that the numbers are compared with.

    Of a run that was cut off, numbers and poses end where they happen to: only what there is of both.
    """
    there = tracks(found, scene)
    if found.verdict is not None:
        return there
    nothing = np.empty(0, np.int64), np.empty((0, 7))
    last_ns = found.time_ns[rows[-1]] if len(rows) else -1
    whole = {frame.name: nothing for frame in scene.frames} | there
    return {
        name: (times[times <= last_ns], track[times <= last_ns]) for name, (times, track) in whole.items()
    }


def _poses(there: _Drawn) -> Check:
    """Every frame is where the columns say, whenever it is drawn."""
    found, wrong = there.found, []
    time_ns = found.time_ns[there.rows]
    for name in sorted(there.tracks.keys() ^ {frame.name for frame in there.scene.frames}):
        wrong.append(
            f"{name} is drawn, and not in the world" if name in there.tracks else f"no poses of {name}"
        )
    late = found.verdict is None  # cut off: poses may end before the numbers do
    drawn_times = 0
    for frame in there.scene.frames:
        times, _ = there.tracks.get(frame.name, (time_ns, None))
        drawn_times = max(drawn_times, len(times))
        if not (np.array_equal(times, time_ns[: len(times)]) and (late or len(times) == len(time_ns))):
            wrong.append(f"{frame.name} has poses at other times than {len(time_ns)} ticks of the run")
    if wrong:
        return checked("poses", wrong, "")
    if not drawn_times:
        return Check("poses", None, "not checked: nothing of this is drawn yet")
    ideal = there.trace.plant != "mujoco"
    expected = standing_poses(found, there.about, there.rows) if ideal else _columns(there)
    for name, pose in expected.items():
        times, track = there.tracks[name]
        wrong += _apart(name, track, pose[: len(times)], times / NS_PER_S)
    if not ideal:
        wrong += _mechanism(there)
    says = f"{len(there.scene.frames)} things at {drawn_times} times, where positions and headings say"
    return checked("poses", wrong, says)


def _apart(name: str, track: Array, pose: Array, time_s: Any) -> list[str]:
    """Where a frame is not where it should be; NaN in ``pose`` is not asked."""
    far_m = np.nanmax(np.abs(track[:, :3] - pose[:, :3]) - _ROUNDED * np.abs(pose[:, :3]), axis=1, initial=-1)
    aligned = 1 - np.abs(np.sum(track[:, 3:] * pose[:, 3:], axis=1))
    unit = np.abs(np.sum(track[:, 3:] ** 2, axis=1) - 1)
    bad = (far_m > _PLACED_M) | (aligned > _TURNED) | ~(unit < _TURNED) | np.isnan(track).any(axis=1)
    if not bad.any():
        return []
    worst = float(np.max(np.where(bad, far_m, 0)))
    return [
        f"{name} is drawn elsewhere at {bad.sum()} times, first at {time_s[bad][0]:.2f} s, by {worst:.3g} m"
    ]


def _columns(there: _Drawn) -> dict[str, Array]:
    """Where the marks are, which follow from the columns."""
    cars = there.found.roster.cars
    marks = [frame for frame in there.scene.frames if frame.name.split("/")[0] not in cars]
    pos_m, quat = poses(there.found, there.about, there.scene.showing((), marks), there.rows)
    both = np.concatenate([pos_m, quat], axis=-1)
    return {frame.name: both[:, f] for f, frame in enumerate(marks)}


def _mechanism(there: _Drawn) -> list[str]:
    """Where a physical car is drawn as no such car stands: chassis, wheels, steering."""
    model, found, wrong = there.about.model, there.found, []
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for c, car in enumerate(found.roster.cars):
        chassis = f"{car}/chassis"
        times, body = there.tracks[chassis]
        rows, time_s = there.rows[: len(times)], times / NS_PER_S
        turn = _matrices(body[:, 3:])
        axle = body[:, :3] + turn @ model.site(f"{car}/front_axle").pos
        front_m, heading = found.columns["front_m"][rows, c], found.columns["heading_rad"][rows, c]
        away = norm(axle[:, :2] - front_m) - 1e-6 * np.abs(front_m).max(axis=1)
        yaw = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
        off = np.abs(np.angle(np.exp(1j * (yaw - heading))))
        wrong += _odd(f"{car}'s chassis is not over its front axle", away > 1e-5, time_s)
        wrong += _odd(f"{car}'s chassis does not have its heading", off > 1e-5, time_s)
        base, at_rest = data.body(chassis), {}
        for frame in there.scene.frames:
            if frame.name.startswith(f"{car}/") and frame.name != chassis:
                rest = data.body(frame.name)
                at_rest[frame.name] = base.xmat.reshape(3, 3).T @ (rest.xpos - base.xpos)
        angles = {}
        for name, rest_m in at_rest.items():
            _, part = there.tracks[name]
            count = min(len(part), len(body))
            seen = np.einsum("kji,kj->ki", turn[:count], part[:count, :3] - body[:count, :3])
            radius = there.about.sheets[c].wheel_radius_m
            far = np.linalg.norm(seen - rest_m, axis=1) > _TRAVELS * radius
            wrong += _odd(f"{name} is not on its car", far, time_s)
            relative = np.einsum("kji,kjl->kil", turn[:count], _matrices(part[:count, 3:]))
            angles[name] = np.arctan2(-relative[:, 0, 1], relative[:, 1, 1])
        wheels = [f"{car}/wheel_{wheel}" for wheel in STEERED]
        if all(wheel in angles for wheel in wheels):
            sheet = there.about.sheets[c]
            count = min(len(angles[wheel]) for wheel in wheels)
            both = np.stack([angles[wheel][:count] for wheel in wheels], axis=-1)
            steer = bicycle_angle(both, np.array(sheet.wheelbase_m), np.array(sheet.track_m))
            told = found.columns["steer_rad"][rows[: len(steer)], c]
            wrong += _odd(
                f"{car}'s wheels are not steered as it says", np.abs(steer - told) > _STEERED_RAD, time_s
            )
    return wrong


def _odd(what: str, bad: Any, time_s: Any) -> list[str]:
    """Says when something is so, if ever."""
    if not bad.any():
        return []
    return [f"{what} at {int(bad.sum())} times, first at {time_s[: len(bad)][bad][0]:.2f} s"]


def _matrices(quat: Array) -> Array:
    """Rotation matrices of quaternions w x y z, (K, 4) -> (K, 3, 3)."""
    out = np.empty((len(quat), 9))
    for k, q in enumerate(quat):
        mujoco.mju_quat2Mat(out[k], q)
    return out.reshape(-1, 3, 3)


def _bodies(there: _Drawn) -> Check:
    """Clearances follow from where the bodies are, and bodies that hit each other are at each other."""
    found, model, h = there.found, there.about.model, there.found.step_s
    c = found.columns
    rows = np.arange(len(found.ticks))
    cars, pairs, pair_names = found.roster.cars, found.roster.pairs, found.roster.pair_names
    chassis = [f"{car}/chassis" for car in cars]
    frames = {frame.name: frame for frame in there.scene.frames}
    if not all(name in frames and len(there.tracks[name][0]) for name in chassis):
        return Check("bodies", None, "not checked: no chassis is drawn")
    carried = np.stack([_carried(there, c) for c in range(len(cars))], axis=-1)
    picked = there.scene.showing((), [frames[name] for name in chassis])
    pos_m, quat = poses(found, there.about, picked, rows)
    distance_m = _distances(model, found.roster, pos_m, quat)
    recorded = c["clearance_m"]
    odd = np.flatnonzero((np.abs(distance_m - recorded) > _CLEAR_M).any(axis=1))
    if odd.size:  # between faces that are parallel to the last bit MuJoCo's distance can be any
        apart_m = pos_m[odd] + _NUDGE_M * np.arange(len(cars))[:, None]
        again_m = _distances(model, found.roster, apart_m, quat[odd])
        closer = np.abs(again_m - recorded[odd]) < np.abs(distance_m[odd] - recorded[odd])
        distance_m[odd] = np.where(closer, again_m, distance_m[odd])
    speed = norm(c["velocity_mps"])
    moving = np.stack([speed[:, a] + speed[:, b] for a, b in pairs], axis=-1)
    exact = np.zeros(len(rows), bool)
    exact[there.rows] = True
    bound = np.where(exact[:, None], _CLEAR_M, _BETWEEN_M + _BETWEEN * h * moving)
    long_m = [sheet.wheelbase_m for sheet in there.about.sheets]
    hit = np.logical_or.accumulate((c["contact_impulse_n_s"] > 0).any(axis=1))
    rocks_m = np.where(hit, np.inf, _ROCKS * max(long_m))[:, None]
    anyhow = np.stack([carried[:, a] | carried[:, b] for a, b in pairs], axis=-1)
    bound = np.where(anyhow, _BETWEEN_M + _BETWEEN * h * moving + rocks_m, bound)
    wrong = []
    names = dict(zip(pair_names, range(len(pair_names)), strict=True))
    impulse, impact = c["contact_impulse_n_s"], c["contact_speed_mps"]
    for name, i in names.items():
        with np.errstate(invalid="ignore"):
            off = np.abs(distance_m[:, i] - recorded[:, i])
            off = np.where((distance_m[:, i] < 0) & (recorded[:, i] <= 0), 0.0, off)
            bad = ~(off <= bound[:, i])
        time_s = found.ticks * h
        wrong += _odd(f"clearance_m of {name} is not that of the bodies", bad, time_s)
        near = np.minimum(recorded[1:, i], recorded[:-1, i]) <= 0.01 + h * (moving[1:, i] + moving[:-1, i])
        struck = (impulse[1:, i] > 0) & ~near
        wrong += _odd(f"{name} hit each other from afar", struck, time_s[1:])
        inside = np.maximum(recorded[1:, i], recorded[:-1, i]) < -_CLEAR_M
        touched = np.convolve(impulse[:, i] > 0, np.ones(5), "same")[1:] > 0
        wrong += _odd(f"{name} are inside each other without contact", inside & ~touched, time_s[1:])
        odd = (impulse[:, i] > 0) != (impact[:, i] > 0)
        fast = impact[1:, i] > 2 * (moving[1:, i] + moving[:-1, i]) + 1.0
        wrong += _odd(f"contact_speed_mps of {name} is not that of a contact", odd, time_s)
        wrong += _odd(f"contact_speed_mps of {name} is faster than the cars", fast, time_s[1:])
        wrong += _odd(f"contacts of {name} are negative or missing", ~(impulse[:, i] >= 0), time_s)
    return checked("bodies", wrong, "clearances from poses and hulls; contacts where bodies meet")


def _carried(there: _Drawn, car: int) -> Any:
    """Where no pose of a car's chassis was recorded after the last one, (T,).

    In a file that ends early there is none; in one that was made whole it keeps its height to the last bit
    while the car moves, which no car does by itself.
    """
    times, track = there.tracks[f"{there.found.roster.cars[car]}/chassis"]
    now_ns = there.found.time_ns
    level = np.flatnonzero(track[:, 2] != track[-1, 2])
    since_ns = times[level[-1] + 1 if level.size else 0]
    after = now_ns > since_ns
    speed = norm(there.found.columns["velocity_mps"][:, car])
    if not (after.any() and speed[after].max() > _MOVES_MPS):
        since_ns = times[-1]
    lasts = now_ns[-1] >= since_ns + NS_PER_S * DRAWN_EVERY_S  # otherwise its next pose is not due yet
    return (now_ns > since_ns) & lasts


def _distances(model: mujoco.MjModel, who: Roster, pos_m: Array, quat: Array) -> Array:
    """Distances of the hulls, pair by pair, (T, P), from poses of the chassis, (T, C, 3) and (T, C, 4)."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hulls = [model.geom(f"{car}/hull").id for car in who.cars]
    homes = []
    for car, hull in zip(who.cars, hulls, strict=True):
        base = data.body(f"{car}/chassis")
        turn = base.xmat.reshape(3, 3)
        place = turn.T @ (data.geom_xpos[hull] - base.xpos)
        homes.append((place.copy(), turn.T @ data.geom_xmat[hull].reshape(3, 3)))
    out = np.empty((len(pos_m), len(who.pairs)))
    turn = np.empty(9)
    for k in range(len(pos_m)):
        for c, (hull, (place, facing)) in enumerate(zip(hulls, homes, strict=True)):
            mujoco.mju_quat2Mat(turn, quat[k, c])
            matrix = turn.reshape(3, 3)
            data.geom_xpos[hull] = pos_m[k, c] + matrix @ place
            data.geom_xmat[hull] = (matrix @ facing).ravel()
        for i, (a, b) in enumerate(who.pairs):
            out[k, i] = mujoco.mj_geomDistance(model, data, hulls[a], hulls[b], 100.0, None)
    return out
