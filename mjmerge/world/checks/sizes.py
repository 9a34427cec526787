"""Whether a car is as long, as heavy and as strong as its data sheet says.

Every verdict rests on it: clearances are read from the hulls; the law and the actuation believe the sheet.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from mjmerge.roster import WHEELS
from mjmerge.world.checks.car import SAME, STRAIGHT, Car, off, shape
from mjmerge.world.checks.findings import Finding

SAME_INERTIA = 0.05
"""The same as SAME, of the yaw inertia, which is estimated more often than it is measured."""
SAME_INERTIA_STRETCHED = 0.15
"""And of a car that was stretched: its mass lies otherwise than a plate's."""
_UNITS = {
    "power_limit_w": "W",
    "steer_rate_limit_radps": "rad/s",
    "drag_area_m2": "m²",
    "rolling_resistance": "1",
}


def findings(car: Car) -> Iterator[Finding]:
    """Everything of a car that is not as its data sheet says."""
    yield from _sizes(car)
    yield from _masses(car)
    yield from _numbers(car)


def _sizes(car: Car) -> Iterator[Finding]:
    """The hull and the axles, which clearances and distances are read from."""
    sheet, hull, at = car.sheet, car.of("geom", "hull"), car.at("geom", "hull")
    front, rear = car.at("site", "front_axle"), car.at("site", "rear_axle")
    yield from off(
        car,
        "site",
        "front_axle",
        "the distance between the sites front_axle and rear_axle m",
        front[0] - rear[0],
        "wheelbase_m",
        SAME * sheet.wheelbase_m,
    )
    off_axes = np.abs(car.data.geom(f"{car.name}/hull").xmat - np.eye(3).ravel()).max() > STRAIGHT
    turned = ", turned" if off_axes else ""
    on_chassis = hull.bodyid[0] == car.of("body", "chassis").id
    if hull.type[0] != mujoco.mjtGeom.mjGEOM_BOX or off_axes or not on_chassis:
        where = "" if on_chassis else ", and not on the chassis"
        yield Finding(
            "geom",
            "hull",
            f"the hull is {shape(hull)}{turned}{where}; expected a box on the chassis, along its axes: "
            "clearances are read from it (a picture of the body may have any shape)",
        )
        return
    length, width = SAME * sheet.length_m, SAME * sheet.width_m
    yield from off(car, "geom", "hull", "the length of the hull m", 2 * hull.size[0], "length_m", length)
    yield from off(car, "geom", "hull", "the width of the hull m", 2 * hull.size[1], "width_m", width)
    nose = at[0] + hull.size[0] - front[0]
    yield from off(
        car, "geom", "hull", "the hull's nose ahead of the front axle m", nose, "front_overhang_m", length
    )
    if not abs(at[1]) <= width:
        yield Finding(
            "geom",
            "hull",
            f"the middle of the hull is at y = {at[1]:.6g} m; expected 0 (within {width:.3g} m)",
        )
    low, high = at[2] - hull.size[2], at[2] + hull.size[2]
    if not 0 < low < 2 * sheet.wheel_radius_m or not high > sheet.com_height_m:
        yield Finding(
            "geom",
            "hull",
            f"the hull reaches from {low:.6g} to {high:.6g} m above the road; expected from between the road "
            f"and the top of the wheels, {2 * sheet.wheel_radius_m:g} m, to above com_height_m, "
            f"{sheet.com_height_m:g} m, so that it meets other cars and not the road",
        )


def _masses(car: Car) -> Iterator[Finding]:
    sheet, model = car.sheet, car.model
    mass = model.body_mass[car.bodies]
    total = float(mass.sum())
    at = car.data.xipos[car.bodies]
    centre = mass @ at / total
    chassis = ("body", "chassis")
    yield from off(car, *chassis, "the mass of all bodies kg", total, "mass_kg", SAME * sheet.mass_kg)
    near = SAME * sheet.wheelbase_m
    behind = car.at("site", "front_axle")[0] - centre[0]
    yield from off(
        car, *chassis, "the centre of mass behind the front axle m", behind, "com_behind_front_axle_m", near
    )
    yield from off(car, *chassis, "the height of the centre of mass m", centre[2], "com_height_m", near)
    if not abs(centre[1]) <= SAME * sheet.width_m:
        yield Finding(*chassis, f"the centre of mass is {centre[1]:.6g} m beside the middle; expected 0")
    yaw = 0.0
    for body, kg, where in zip(car.bodies, mass, at, strict=True):
        axes = car.data.ximat[body].reshape(3, 3)
        own = axes @ np.diag(model.body_inertia[body]) @ axes.T
        yaw += float(own[2, 2] + kg * np.square((where - centre)[:2]).sum())
    inertia = (SAME_INERTIA_STRETCHED if car.stretched else SAME_INERTIA) * sheet.yaw_inertia_kg_m2
    yield from off(car, *chassis, "the yaw inertia kg·m²", yaw, "yaw_inertia_kg_m2", inertia)
    spinning = sum(model.dof_M0[car.of("joint", f"spin_{w}").dofadr[0]] for w in WHEELS)
    rotating = float(spinning) / sheet.wheel_radius_m**2
    text = "the inertia of all wheels and motors over the square of wheel_radius_m kg"
    yield from off(car, *chassis, text, rotating, "rotating_mass_kg", SAME * sheet.effective_mass_kg)
    for wheel in WHEELS:
        body = car.of("body", f"wheel_{wheel}")
        if not np.hypot(*(body.ipos)[[0, 2]]) <= SAME * sheet.wheel_radius_m:
            yield Finding(
                "body",
                f"wheel_{wheel}",
                f"wheel_{wheel} is out of balance: its centre of mass is off its axle",
            )


def _numbers(car: Car) -> Iterator[Finding]:
    sheet = car.sheet
    for name in _UNITS:
        got, given = float(car.of("numeric", name).data[0]), getattr(sheet, name)
        yield from off(car, "numeric", name, f"the number {name} {_UNITS[name]}", got, name, SAME * given)
    if not car.of("numeric", "spin_limit_radps").data[0] > 0:
        yield Finding(
            "numeric", "spin_limit_radps", "the number spin_limit_radps is 0: the motors would never turn"
        )
    if sheet.cornering_stiffness_n_per_rad is None:
        return
    name = "cornering_stiffness_n_per_rad"
    for axle, got in zip(("front", "rear"), car.of("numeric", name).data, strict=True):
        given = getattr(sheet.cornering_stiffness_n_per_rad, axle)
        if not abs(got - given) <= SAME * given:
            yield Finding(
                "numeric",
                name,
                f"the number {name} is {got:.6g} N/rad for the {axle} axle; datasheet.yaml says "
                f"{name}: {axle}: {given:g} (within {SAME * given:.3g} N/rad)",
            )
