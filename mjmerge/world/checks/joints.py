"""Whether a car's wheels spin, steer and spring as the plant takes them to."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from mjmerge.roster import WHEELS
from mjmerge.world.checks.car import SAME, Car
from mjmerge.world.checks.findings import Finding
from mjmerge.world.checks.parts import STEERED

SPIN_TILT = 0.9962
"""Least cosine between a wheel's axle and the car's y: 5 degrees of camber and toe together."""
STEER_TILT = 0.9659
"""Least cosine between a steering axis and the vertical: 15 degrees of caster and inclination together."""
STANDS = 0.05
"""How far a car may sink or rise into its springs before it stands, as a part of the radius of its wheels."""
SLIDE = mujoco.mjtJoint.mjJNT_SLIDE
TURNS = 0.5
"""Cosine between a joint and the vertical above which it steers."""


def findings(car: Car) -> Iterator[Finding]:
    """Everything that is wrong with a car's joints."""
    yield from _wheels(car)
    yield from _suspension(car)


def _wheels(car: Car) -> Iterator[Finding]:
    """Wheels spin about y and steer about z, on bodies of their own, and do nothing else."""
    model, data = car.model, car.data
    for wheel in WHEELS:
        body = car.of("body", f"wheel_{wheel}")
        moves = [("spin", 1, SPIN_TILT, body.id)]
        if wheel in STEERED:
            moves.append(("steer", 2, STEER_TILT, int(body.parentid[0])))
        for what, axis, least, on in moves:
            name = f"{what}_{wheel}"
            joint = car.of("joint", name)
            turns = data.xaxis[joint.id][axis]
            if joint.type[0] != mujoco.mjtJoint.mjJNT_HINGE or not turns > least:
                flipped = "; it turns the other way" if turns < -least else ""
                yield Finding(
                    "joint", name, f"joint {name} is expected to be a hinge about {'xyz'[axis]}{flipped}"
                )
            if what == "steer" and joint.bodyid[0] == body.id:
                yield Finding(
                    "joint",
                    name,
                    f"joint {name} is on wheel_{wheel} itself; expected on a body of its own between the "
                    f"chassis and wheel_{wheel} (a hub): a wheel that spins takes its steering axis along",
                )
            elif joint.bodyid[0] != on:
                where = model.body(on).name.split("/")[-1]
                yield Finding("joint", name, f"joint {name} is expected on the body {where}")
            yield from _free(car, name, joint)
        axle, tyre = data.xanchor[car.of("joint", f"spin_{wheel}").id], car.at("geom", f"tyre_{wheel}")
        if not np.hypot(*(axle - tyre)[[0, 2]]) <= SAME * car.sheet.wheel_radius_m:
            yield Finding(
                "joint", f"spin_{wheel}", f"joint spin_{wheel} does not go through the middle of tyre_{wheel}"
            )
        yield from _on_the_way(car, wheel)


def _free(car: Car, name: str, joint: Any) -> Iterator[Finding]:
    """A wheel turns and steers by its actuators alone, from zero."""
    if car.model.qpos0[joint.qposadr[0]] != 0:
        yield Finding("joint", name, f"joint {name} has a ref; expected 0, straight ahead; remove it")
    if car.model.jnt_actfrclimited[joint.id]:
        yield Finding(
            "joint", name, f"joint {name} has an actuatorfrcrange; limit its actuators instead, and remove it"
        )
    servo, rolling = "its servo alone holds a wheel", "rolling_resistance says how hard a car rolls"
    why = (
        {"stiffness": servo, "frictionloss": servo}
        if name.startswith("steer")
        else {"stiffness": rolling, "frictionloss": rolling, "damping": rolling}
    )
    for key, reason in why.items():
        if np.any(getattr(joint, key)):
            yield Finding("joint", name, f"joint {name} has a {key}; remove it: {reason}")
    if name.startswith("spin") and joint.limited[0]:
        yield Finding("joint", name, f"joint {name} has a range; remove it, a wheel turns for ever")


def _on_the_way(car: Car, wheel: str) -> Iterator[Finding]:
    """Between the chassis and a wheel there is no further joint but those that go up and down."""
    model, body = car.model, car.of("body", f"wheel_{wheel}").id
    chassis = car.of("body", "chassis").id
    while body not in (chassis, 0):
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            name = model.joint(joint).name.removeprefix(f"{car.name}/")
            known = name == f"spin_{wheel}" or (wheel in STEERED and name == f"steer_{wheel}")
            up = abs(car.data.xaxis[joint][2])
            slides = model.jnt_type[joint] == SLIDE
            if not known and not (slides and up > STEER_TILT):
                steers = "only the front wheels steer" if not slides and up > TURNS else "it cannot be driven"
                yield Finding(
                    "joint",
                    name,
                    f"joint {name} is between the chassis and wheel_{wheel}: {steers}; expected a spin "
                    "joint, a steer joint in front, and slide joints along z for a suspension",
                )
        body = int(model.body_parentid[body])
    if body == 0:
        yield Finding("body", f"wheel_{wheel}", f"wheel_{wheel} is not on the chassis, or on what is")


def _slides(car: Car, wheel: str) -> list[int]:
    """Ids of the slide joints between the chassis and a wheel."""
    model, body, found = car.model, car.of("body", f"wheel_{wheel}").id, []
    chassis = car.of("body", "chassis").id
    while body not in (chassis, 0):
        first = model.body_jntadr[body]
        found += [j for j in range(first, first + model.body_jntnum[body]) if model.jnt_type[j] == SLIDE]
        body = int(model.body_parentid[body])
    return found


def _suspension(car: Car) -> Iterator[Finding]:
    """All wheels are sprung or none, and the car stands where its file puts it."""
    model = car.model
    slides = {wheel: _slides(car, wheel) for wheel in WHEELS}
    if not any(slides.values()):
        return
    for wheel, joints in slides.items():
        if not joints:
            yield Finding("body", f"wheel_{wheel}", f"wheel_{wheel} has no suspension, and others have one")
    for name, joint in ((car.model.joint(j).name, j) for some in slides.values() for j in some):
        low, high = model.jnt_range[joint]
        if model.jnt_limited[joint] and not low < model.qpos0[model.jnt_qposadr[joint]] < high:
            own = name.removeprefix(f"{car.name}/")
            yield Finding(
                "joint", own, f"the range of joint {own} is {low:g} to {high:g} m; expected around 0"
            )
    joints = [joint for some in slides.values() for joint in some]
    at = model.jnt_qposadr[joints]
    stiffness = model.jnt_stiffness[joints]
    carried_n = float(stiffness @ (model.qpos0[at] - model.qpos_spring[at]))
    below = sum(model.body_subtreemass[body] for body in {int(model.jnt_bodyid[j]) for j in joints})
    weight_n = float(model.body_mass[car.bodies].sum() - below) * np.linalg.norm(model.opt.gravity)
    allowed = STANDS * car.sheet.wheel_radius_m
    sinks_m = (weight_n - carried_n) / stiffness.sum() if stiffness.sum() else np.inf
    if not abs(sinks_m) <= allowed:
        yield Finding(
            "joint",
            model.joint(joints[0]).name.removeprefix(f"{car.name}/"),
            f"the springs push with {carried_n:.6g} N where the file puts them, and what stands on them "
            f"weighs {weight_n:.6g} N: the car sinks by {sinks_m:.4g} m (allowed: {allowed:.3g} m); give "
            "each the springref -m g/k of what it carries",
        )
