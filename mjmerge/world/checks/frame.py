"""Whether a compiled car is what the plant takes it to be: its axes, wheels and contacts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from mjmerge.roster import WHEELS
from mjmerge.world.checks.car import SAME, STRAIGHT, Car, off, shape
from mjmerge.world.checks.findings import Finding
from mjmerge.world.checks.parts import SITES

_HULL_CONTACT: dict[str, Any] = {
    "condim": 3,
    "priority": 0,
    "margin": 0,
    "gap": 0,
    "solmix": 1,
    "solref": (0.02, 1),
    "solimp": (0.9, 0.95, 0.001, 0.5, 2),
}
"""MuJoCo's defaults: a hull with others would change what happens to the other car too."""


def findings(car: Car) -> Iterator[Finding]:
    """Everything that is wrong with a car's parts."""
    yield from _frame(car)
    yield from _wheels(car)
    yield from _contacts(car)


def _frame(car: Car) -> Iterator[Finding]:
    """The car's own axes: x forward, y left, z up, the origin on the road in the middle of the car."""
    chassis = car.of("body", "chassis")
    if car.at("site", "front_axle")[0] <= car.at("site", "rear_axle")[0]:
        yield Finding(
            "site", "front_axle", "the site front_axle is not ahead of rear_axle; expected x forward"
        )
    if np.abs(chassis.pos[:2]).max() > STRAIGHT or np.abs(chassis.quat - (1, 0, 0, 0)).max() > STRAIGHT:
        yield Finding(
            "body",
            "chassis",
            f"the chassis stands at {_plain(chassis.pos)}, turned by quat {_plain(chassis.quat)}; expected "
            "at x = y = 0 and not turned: the world places it",
        )
    for name in SITES:
        site = car.of("site", name)
        if site.bodyid[0] != chassis.id:
            yield Finding("site", name, f"the site {name} is expected on the body chassis")
        elif np.abs(car.data.site(f"{car.name}/{name}").xmat - np.eye(3).ravel()).max() > STRAIGHT:
            yield Finding("site", name, f"the site {name} is turned; expected x forward, y left, z up")
        if abs(site.pos[1]) > SAME * car.sheet.width_m:
            yield Finding(
                "site",
                name,
                f"the site {name} is {site.pos[1]:.6g} m beside the middle of the car; expected y = 0",
            )


def _wheels(car: Car) -> Iterator[Finding]:
    sheet, length = car.sheet, SAME * car.sheet.wheelbase_m
    for wheel in WHEELS:
        name = f"tyre_{wheel}"
        tyre, body, at = car.of("geom", name), car.of("body", f"wheel_{wheel}"), car.at("geom", name)
        if tyre.type[0] != mujoco.mjtGeom.mjGEOM_SPHERE:
            yield Finding(
                "geom",
                name,
                f"{name} is {shape(tyre)}, not a sphere; expected a sphere of the wheel's radius, because "
                "other shapes touch the road twice and scrub (a picture of the wheel may have any shape)",
            )
        if tyre.bodyid[0] != body.id:
            yield Finding("geom", name, f"{name} is not on the body wheel_{wheel}")
        side = 1 if wheel.endswith("left") else -1
        if not side * at[1] > 0:
            yield Finding("geom", name, f"{name} is on the wrong side; expected y to the left")
        else:
            yield from off(
                car,
                "geom",
                name,
                f"the distance of {name} from the middle of the car m",
                abs(at[1]),
                "track_m",
                SAME * sheet.track_m / 2,
                sheet.track_m / 2,
            )
        axle = f"{wheel.partition('_')[0]}_axle"
        ahead = at[0] - car.at("site", axle)[0]
        if not abs(ahead) <= length:
            yield Finding(
                "geom",
                name,
                f"{name} is {ahead:.6g} m ahead of the site {axle}; expected 0 (within {length:.3g} m)",
            )
        radius = SAME * sheet.wheel_radius_m
        yield from off(car, "geom", name, f"the radius of {name} m", tyre.size[0], "wheel_radius_m", radius)
        yield from off(
            car, "geom", name, f"the height of the middle of {name} m", at[2], "wheel_radius_m", radius
        )


def _contacts(car: Car) -> Iterator[Finding]:
    """Nothing of a car touches anything but its hull, and its tyres by the world's pairs."""
    model = car.model
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, car.bodies)):
        name = model.geom(geom).name.removeprefix(f"{car.name}/")
        own = "a geom without a name" if "unnamed_" in name else f"the geom {name}"
        on = model.body(model.geom_bodyid[geom]).name.removeprefix(f"{car.name}/")
        touches = int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])
        meant = (1, 1) if name == "hull" else (0, 0)
        if touches != meant:
            yield Finding(
                "geom",
                name,
                f'{own} on the body {on} has contype="{touches[0]}" conaffinity="{touches[1]}"; expected '
                f"{meant[0]} and {meant[1]}: only the hull touches other cars, and the world lets the tyres "
                "touch the road",
            )
    hull = car.of("geom", "hull")
    for key, value in _HULL_CONTACT.items():
        given = getattr(hull, key)
        if not np.array_equal(np.ravel(given), np.ravel(value)):
            yield Finding(
                "geom",
                "hull",
                f"{key} of the hull is {_plain(given)}; expected MuJoCo's {_plain(value)}, because it would "
                "change what happens to the other car; remove it",
            )
    for wheel in WHEELS:
        for key in ("margin", "gap"):
            if getattr(car.of("geom", f"tyre_{wheel}"), key)[0]:
                yield Finding(
                    "geom",
                    f"tyre_{wheel}",
                    f"{key} of tyre_{wheel} is not 0; remove it: the world sets its contact",
                )


def _plain(values: Any) -> str:
    return " ".join(f"{v:g}" for v in np.ravel(values))
