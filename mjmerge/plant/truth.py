"""What the cars of each simulation truly are: the model of the world, changed by a mismatch.

Everything that MuJoCo has a place for is changed in a copy of the model, and ``mj_setConst`` runs again where
masses or shapes did. What then differs from the world's model becomes a field of the batch with one value per
simulation; what no mismatch touches stays shared.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import cos, sin
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS
from numpy.typing import NDArray

from mjmerge.errors import ModelError
from mjmerge.plant.tyre import Tyres
from mjmerge.roster import WHEELS
from mjmerge.scenario.mismatch import SENSING, Mismatch
from mjmerge.state import Array
from mjmerge.vehicle.actuation import ackermann
from mjmerge.vehicle.delay import asked_s, steps_late
from mjmerge.world.checks.parts import DRIVE, STEER
from mjmerge.world.model import World

_NOTHING = Mismatch()
_PHYSICS = tuple(name for name in Mismatch.model_fields if name not in SENSING)
_MASS = ("load_kg", "com_raised_m", "yaw_inertia", "wheel_radius", "suspension_stiffness")
_LEFT = np.array([w.endswith("left") for w in WHEELS])
_KINDS = ("actuator", "body", "bvh", "dof", "geom", "jnt", "pair", "qpos", "site")
_FIELDS = sorted(name for name in MODEL_FIELDS if name.startswith(_KINDS))


@dataclass(frozen=True)
class Truth:
    """The cars of N simulations; the first axis is N, or 1 where all are alike.

    Attributes:
        changed: fields of the model that differ from the world's in some simulation, (N, ...) each.
        friction: between each tyre and the road, off any patch, (N, C, 4).
        radius_m: of the wheels, (N, C, 4).
        brake_limit_n_m: of each wheel, (N, C, 4).
        mass_kg: of the cars, (N, C).
        down_mps2: gravity across the plane of the road, (N, 1).
        steer_rate: fastest steering over that of the model, (N, C).
        late_steps: physics steps by which commands reach the ego late, (N,).
        tyres: of all wheels.
    """

    changed: dict[str, Array]
    friction: Array
    radius_m: Array
    brake_limit_n_m: Array
    mass_kg: Array
    down_mps2: Array
    steer_rate: Array
    late_steps: NDArray[np.int64]
    tyres: Tyres

    @classmethod
    def of(cls, world: World, mismatch: Sequence[Mismatch] | None) -> Truth:
        """Of one mismatch per simulation; without any, the cars are those of the world.

        Raises:
            ModelError: the world was built for shorter delays, or a car lacks what is to be changed.
        """
        kinds: dict[Mismatch, int] = {}
        which = [kinds.setdefault(_physical(m), len(kinds)) for m in mismatch or ()]
        at = np.array(which if len(kinds) > 1 else [0])
        rows, differences = [], []
        data, at_wheels = mujoco.MjData(world.model), _AtWheels.of(world)
        for kind in kinds or (None,):
            model = world.model if kind is None else altered(world, kind, data)
            rows.append(_numbers(world, model, kind, at_wheels, data))
            differences.append(_differences(world.model, model))

        def stacked(name: str) -> Array:
            found: Array = np.stack([row[name] for row in rows])[at]
            return found

        changed = {
            name: np.stack([found.get(name, _field(world.model, name)) for found in differences])[at]
            for name in sorted(set().union(*differences))
        }
        tyres = {f.name: stacked(f.name) for f in fields(Tyres) if f.name != "step_s"}
        numbers: dict[str, Any] = {
            f.name: stacked(f.name) for f in fields(cls) if f.name not in ("changed", "tyres")
        }
        step_s = float(world.model.opt.timestep)
        return cls(changed=changed, tyres=Tyres(**tyres, step_s=step_s), **numbers)


def altered(world: World, mismatch: Mismatch, data: mujoco.MjData | None = None) -> mujoco.MjModel:
    """The world's model with a mismatch in it; the first car of the world is the ego.

    Args:
        world: the world.
        mismatch: what is different.
        data: room to compute in, of the world's model; by default new.

    Raises:
        ModelError: the world was built for shorter delays, or the car lacks what is to be changed.
    """
    model, m = copy.copy(world.model), mismatch
    ego = world.cars[0]
    model.pair_friction[world.pairs, :2] = _friction(m)[:, None]
    along, across = sin(m.grade_rad), cos(m.grade_rad) * sin(m.bank_rad)
    if along or across:
        down = cos(m.grade_rad) * cos(m.bank_rad)
        model.opt.gravity = np.linalg.norm(model.opt.gravity) * np.array([-along, -across, -down])
    _limit(world, model, m)
    _delay(world, model, m)
    if any(getattr(m, name) != getattr(_NOTHING, name) for name in _MASS):
        _resize_wheels(model, ego, m.wheel_radius)
        _respring(model, ego, m.suspension_stiffness)
        _reload(world, model, m)
        mujoco.mj_setConst(model, data or mujoco.MjData(model))
    return model


def _friction(m: Mismatch) -> Array:
    """Of each wheel of a car, off any patch, (4,)."""
    left = m.friction if m.left_friction is None else m.left_friction
    return np.where(_LEFT, left, m.friction)


def _limit(world: World, model: mujoco.MjModel, m: Mismatch) -> None:
    """Motors, brakes and steering that can do less or more, and a servo that is slower or askew."""
    ego, sheet = world.cars[0], world.sheets[0]
    for drive in DRIVE:
        if f"{ego}/{drive}" in world.actuator_ids:
            model.actuator(f"{ego}/{drive}").ctrlrange[:] *= m.torque_limit
    for wheel in WHEELS:
        model.actuator(f"{ego}/brake_{wheel}").forcerange[:] *= m.brake_limit
    if m.steer_limit_rad is not None:
        turned = ackermann(
            np.array([-m.steer_limit_rad, m.steer_limit_rad]),
            np.array(sheet.wheelbase_m),
            np.array(sheet.track_m),
        )
        for steer, (least, most) in zip(STEER, turned.T, strict=True):
            reach = model.actuator(f"{ego}/{steer}").ctrlrange
            reach[:] = max(reach[0], least), min(reach[1], most)
    if m.steer_lag != 1:
        for steer in STEER:
            servo = model.actuator(f"{ego}/{steer}")
            passive = model.joint(f"{ego}/{steer}").damping[0]  # which the servo's own damping adds to
            servo.gainprm[0] /= m.steer_lag**2
            servo.biasprm[1] /= m.steer_lag**2
            servo.biasprm[2] = min(passive - (passive - servo.biasprm[2]) / m.steer_lag, 0.0)
    for steer in STEER if m.steer_offset_rad else ():
        servo = model.actuator(f"{ego}/{steer}")
        servo.biasprm[0] += servo.gainprm[0] * m.steer_offset_rad


def _delay(world: World, model: mujoco.MjModel, m: Mismatch) -> None:
    """Dead time of motors and steering, see :mod:`mjmerge.vehicle.delay`; the brakes' is the plant's."""
    ego, step_s = world.cars[0], float(model.opt.timestep)
    late = int(steps_late(m.command_delay_s, step_s))
    for name, i in world.actuator_ids.items():
        if name.removeprefix(f"{ego}/") in DRIVE + STEER:
            room = int(model.actuator_history[i, 0])
            if late > room:
                raise ModelError(
                    f"the world was built for a command delay of at most {room * step_s:g} s, not "
                    f"{m.command_delay_s:g} s: build it with the mismatch of all simulations"
                )
            model.actuator_delay[i] = asked_s(late, step_s)


def _resize_wheels(model: mujoco.MjModel, car: str, ratio: float) -> None:
    for wheel in WHEELS:
        tyre = model.geom(f"{car}/tyre_{wheel}")
        tyre.size[0] *= ratio
        tyre.rbound[0] *= ratio
        model.geom_aabb[tyre.id, 3:] *= ratio


def _respring(model: mujoco.MjModel, car: str, ratio: float) -> None:
    """Other springs under the same ride height, with dampers for the same damping ratio."""
    if ratio == 1:
        return
    there = {model.joint(i).name for i in range(model.njnt)}
    for wheel in WHEELS:
        name = f"{car}/suspension_{wheel}"
        if name not in there:
            raise ModelError(f"{car} has no joint suspension_{wheel} whose stiffness a mismatch could change")
        joint = model.joint(name)
        model.jnt_stiffness[joint.id] *= ratio
        model.dof_damping[joint.dofadr[0]] *= np.sqrt(ratio)
        model.qpos_spring[joint.qposadr[0]] /= ratio


def _reload(world: World, model: mujoco.MjModel, m: Mismatch) -> None:
    """Mass, centre of mass and inertia of the chassis: its own, changed, and the load's, a point's."""
    body = model.body(f"{world.cars[0]}/chassis")
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    axes = turn.reshape(3, 3)
    own_kg, own = float(body.mass[0]), axes @ np.diag(body.inertia) @ axes.T
    own[2, 2] *= m.yaw_inertia
    at = body.ipos + np.array([0, 0, m.com_raised_m])
    load_at = world.centre_m + np.array([m.load_ahead_m, 0, m.load_above_m])
    mass = own_kg + m.load_kg
    together = (own_kg * at + m.load_kg * load_at) / mass
    inertia = own + _offset(own_kg, at - together) + _offset(m.load_kg, load_at - together)
    principal, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.linalg.det(axes)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    body.mass[0], body.inertia[:], body.ipos[:], body.iquat[:] = mass, principal, together, quat
    body.sameframe[0] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    for kind in ("geom", "site"):  # none lies in the frame of the inertia any more
        mine = getattr(model, f"{kind}_bodyid") == body.id
        same = getattr(model, f"{kind}_sameframe")
        inertia, rotated = mujoco.mjtSameFrame.mjSAMEFRAME_INERTIA, mujoco.mjtSameFrame.mjSAMEFRAME_INERTIAROT
        same[mine & ((same == inertia) | (same == rotated))] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE


def _offset(mass_kg: float, at_m: Array) -> Array:
    """What a point mass adds to the inertia about the origin, (3, 3)."""
    return mass_kg * (at_m @ at_m * np.eye(3) - np.outer(at_m, at_m))


def _physical(mismatch: Mismatch) -> Mismatch:
    """Its physics alone."""
    return Mismatch.model_construct(**{name: getattr(mismatch, name) for name in _PHYSICS})


def _field(model: mujoco.MjModel, name: str) -> Array:
    found: Array = model.opt.gravity if name == "opt.gravity" else getattr(model, name)
    return found


def _differences(world: mujoco.MjModel, model: mujoco.MjModel) -> dict[str, Array]:
    """Fields of the model that are not the world's: copies, which do not keep the model alive."""
    if model is world:
        return {}
    pairs = ((name, _field(world, name), _field(model, name)) for name in (*_FIELDS, "opt.gravity"))
    return {name: mine.copy() for name, theirs, mine in pairs if (theirs != mine).any()}


class _AtWheels(NamedTuple):
    """Ids of what each car has at each wheel, (C, 4) each, and of the ego's steering."""

    tyre: NDArray[np.intp]
    brake: NDArray[np.intp]
    spin: NDArray[np.intp]
    wheel: NDArray[np.intp]
    steering: int

    @classmethod
    def of(cls, world: World) -> _AtWheels:
        return cls(
            tyre=world.ids("geom", "tyre_{}"),
            brake=world.ids("actuator", "brake_{}"),
            spin=world.ids("joint", "spin_{}"),
            wheel=world.ids("body", "wheel_{}"),
            steering=world.actuator_ids[f"{world.cars[0]}/{STEER[0]}"],
        )


def _numbers(
    world: World, model: mujoco.MjModel, mismatch: Mismatch | None, at: _AtWheels, data: mujoco.MjData
) -> dict[str, Array]:
    """What the plant and the tyres need to know of a model, without its simulations' axis."""
    m, cars = mismatch or _NOTHING, len(world.cars)
    stiffness = world.cornering_stiffness_n_per_rad()
    if mismatch is not None:
        stiffness = np.where(m.tyres == "slip", world.number("cornering_stiffness_n_per_rad"), np.inf)
        stiffness[0] *= m.front_stiffness, m.rear_stiffness
    on_axle = world.axle_mass_kg(model, data)
    radius = model.geom_size[at.tyre, 0]
    on_wheel = np.repeat(on_axle / 2, 2, axis=1)
    steer_rate = np.ones(cars)
    steer_rate[0] = m.steer_rate_limit
    return {
        "friction": model.pair_friction[world.pairs, 0],
        "radius_m": radius,
        "brake_limit_n_m": model.actuator_forcerange[at.brake, 1],
        "mass_kg": on_axle.sum(axis=1),
        "down_mps2": -model.opt.gravity[2:],
        "steer_rate": steer_rate,
        "late_steps": steps_late(model.actuator_delay[at.steering], float(model.opt.timestep)),
        "stiffness_n_per_rad": np.repeat(stiffness / 2, 2, axis=1),
        "wheel_mass_kg": on_wheel,
        "spin_mass_kg": model.dof_M0[model.jnt_dofadr[at.spin]] / np.square(radius),
        "invweight_per_kg": model.body_invweight0[at.wheel, 0],
        "load_n": on_wheel * np.linalg.norm(model.opt.gravity),
    }
