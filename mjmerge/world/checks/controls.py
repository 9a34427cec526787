"""Whether a car's actuators and sensors do what their names say, within the limits of its data sheet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from mjmerge.roster import WHEELS
from mjmerge.vehicle.actuation import ackermann
from mjmerge.world.checks.car import SAME, Car, off
from mjmerge.world.checks.findings import Finding
from mjmerge.world.checks.parts import BRAKE, DRIVE, DRIVEN, SENSORS, STEER, STEERED

Kind = mujoco.mjtObj
NONE = mujoco.mjtDyn.mjDYN_NONE
_FOLLOWS = [int(d) for d in (NONE, mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)]
_SENSED = {
    "front_position": ("framepos", Kind.mjOBJ_SITE, "front_axle"),
    "front_velocity": ("framelinvel", Kind.mjOBJ_SITE, "front_axle"),
    "forward_axis": ("framexaxis", Kind.mjOBJ_XBODY, "chassis"),
    "up_axis": ("framezaxis", Kind.mjOBJ_XBODY, "chassis"),
    "rear_velocity": ("velocimeter", Kind.mjOBJ_SITE, "rear_axle"),
    "steer_left": ("jointpos", Kind.mjOBJ_JOINT, "steer_front_left"),
    "steer_right": ("jointpos", Kind.mjOBJ_JOINT, "steer_front_right"),
}


def findings(car: Car) -> Iterator[Finding]:
    """Everything that is wrong with a car's actuators and sensors."""
    yield from _actuators(car)
    yield from _sensors(car)


def _actuators(car: Car) -> Iterator[Finding]:
    sheet, model = car.sheet, car.model
    for i, wheel in enumerate(WHEELS):
        for what, on in (("drive", "spin"), ("brake", "spin"), ("steer", "steer")):
            name = f"{what}_{wheel}"
            if not car.has(Kind.mjOBJ_ACTUATOR, name):
                continue
            actuator = car.of("actuator", name)
            target = model.joint(int(actuator.trnid[0])).name.removeprefix(f"{car.name}/")
            joint = f"{on}_{wheel}"
            if actuator.trntype[0] != mujoco.mjtTrn.mjTRN_JOINT or target != joint:
                yield Finding("actuator", name, f"actuator {name} acts on {target}; expected {joint}")
            if actuator.gear[0] != 1:
                yield Finding(
                    "actuator",
                    name,
                    f"actuator {name} has a gear of {actuator.gear[0]:g}; expected 1: limits are "
                    "those at the wheel",
                )
        yield from _brake(car, i)
        if i in DRIVEN[sheet.drive]:
            yield from _motor(car, DRIVE[i])
    for name in STEER:
        yield from _servo(car, name)
    yield from _resistance(car)


def _brake(car: Car, wheel: int) -> Iterator[Finding]:
    name, sheet = BRAKE[wheel], car.sheet
    brake = car.of("actuator", name)
    share = sheet.brake_front_share if wheel < len(STEERED) else 1 - sheet.brake_front_share
    most = sheet.brake_torque_limit_n_m * share / 2
    ends = np.abs(brake.forcerange) if brake.forcelimited[0] else np.full(2, np.inf)
    got = float(ends[np.argmax(np.abs(ends - most))])  # of both directions, the one that is further off
    if not abs(got - most) <= SAME * most:
        yield Finding(
            "actuator",
            name,
            f"the largest torque of {name} is {got:.6g} N·m; datasheet.yaml says "
            f"brake_torque_limit_n_m: {sheet.brake_torque_limit_n_m:g} and brake_front_share: "
            f"{sheet.brake_front_share:g}, which makes {most:.6g} N·m (within {SAME * most:.3g} N·m)",
        )
    damps = np.allclose(brake.gainprm[:3], (0, 0, -1)) and not np.any(brake.biasprm)
    if not damps or brake.dyntype[0] != NONE:
        yield Finding("actuator", name, f'actuator {name} is not a <damper> with kv="1"')
    if brake.ctrllimited[0] and not brake.ctrlrange[0] <= 0 <= most <= brake.ctrlrange[1]:
        yield Finding(
            "actuator",
            name,
            f"the ctrlrange of {name} is {brake.ctrlrange[0]:g} to {brake.ctrlrange[1]:g} N·m·s/rad; "
            f"expected 0 to {most:.6g} or more, with which it locks a wheel",
        )


def _resistance(car: Car) -> Iterator[Finding]:
    back = car.of("actuator", "resistance")
    site = car.of("site", "centre").id
    if (
        not _plainly(back)
        or back.trntype[0] != mujoco.mjtTrn.mjTRN_SITE
        or tuple(back.trnid) != (site, -1)
        or not np.array_equal(back.gear, (1, 0, 0, 0, 0, 0))
        or back.ctrllimited[0]
        or back.forcelimited[0]
    ):
        yield Finding(
            "actuator",
            "resistance",
            'actuator resistance is expected to be <general site="centre" gear="1 0 0 0 0 0"/>: it pushes '
            "the car back with the force that it is told",
        )


def _plainly(actuator: Any) -> bool:
    """Whether its force is what it is told."""
    fixed = actuator.gaintype[0] == mujoco.mjtGain.mjGAIN_FIXED and actuator.gainprm[0] == 1
    alone = actuator.biastype[0] == mujoco.mjtBias.mjBIAS_NONE
    return bool(fixed and alone and actuator.dyntype[0] == NONE)


def _motor(car: Car, name: str) -> Iterator[Finding]:
    motor, most = car.of("actuator", name), car.sheet.torque_limit_n_m
    if not _plainly(motor):
        yield Finding(
            "actuator", name, f"actuator {name} is not a <motor>: its torque is not what it is told"
        )
    least, largest = motor.ctrlrange if motor.ctrllimited[0] else (-np.inf, np.inf)
    if motor.forcelimited[0]:
        least, largest = max(least, motor.forcerange[0]), min(largest, motor.forcerange[1])
    for what, got in (("forwards", largest), ("backwards", -least)):
        text = f"the largest torque of {name} {what} N·m"
        yield from off(car, "actuator", name, text, got, "torque_limit_n_m", SAME * most)


def _servo(car: Car, name: str) -> Iterator[Finding]:
    servo, sheet = car.of("actuator", name), car.sheet
    fixed = servo.gaintype[0] == mujoco.mjtGain.mjGAIN_FIXED and servo.gainprm[0] > 0
    fixed = fixed and int(servo.dyntype[0]) in _FOLLOWS
    if not fixed or servo.biasprm[0] != 0 or not np.isclose(servo.biasprm[1], -servo.gainprm[0]):
        yield Finding(
            "actuator", name, f"actuator {name} is not a <position> servo: it does not go where it is told"
        )
    turned = np.abs(
        ackermann(np.array(sheet.steer_limit_rad), np.array(sheet.wheelbase_m), np.array(sheet.track_m))
    )
    most = float(turned.max())
    joint = car.of("joint", name)
    for what, limited, ends in (
        (f"the ctrlrange of {name}", servo.ctrllimited[0], servo.ctrlrange),
        (f"the range of the joint {name}", joint.limited[0], joint.range),
        (f"the actrange of {name}", car.model.actuator_actlimited[servo.id], servo.actrange),
    ):
        reach = min(-ends[0], ends[1]) if limited else np.inf
        if reach < (1 - SAME) * most:
            yield Finding(
                "actuator",
                name,
                f"{what} reaches {reach:.4g} rad to one side; datasheet.yaml says steer_limit_rad: "
                f"{sheet.steer_limit_rad:g}, for which the inner wheel turns {most:.4g} rad",
            )


def _sensors(car: Car) -> Iterator[Finding]:
    model = car.model
    for name in SENSORS:
        what, kind, of = _SENSED[name]
        sensor = car.of("sensor", name)
        meant = getattr(mujoco.mjtSensor, f"mjSENS_{what.upper()}")
        there = mujoco.mj_name2id(model, kind, f"{car.name}/{of}")
        alone = sensor.refid[0] == -1 and sensor.reftype[0] == Kind.mjOBJ_UNKNOWN
        if (sensor.type[0], sensor.objtype[0], sensor.objid[0]) != (meant, kind, there) or not alone:
            objtype = {Kind.mjOBJ_SITE: "site", Kind.mjOBJ_XBODY: "xbody", Kind.mjOBJ_JOINT: "joint"}[kind]
            yield Finding(
                "sensor",
                name,
                f"sensor {name} is expected to be a {what} of the {objtype} {of}, and of no other frame",
            )
