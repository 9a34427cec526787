"""One car of a compiled world, as the checks of it read it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmerge.state import Array
from mjmerge.vehicle.datasheet import DataSheet
from mjmerge.world.checks.findings import Finding

SAME = 0.01
"""How far a length, mass, torque or resistance may be from the data sheet's, as a part of it: what
``mjmerge identify`` asks of the rolling radius, the wheelbase and the effective mass of a car that drives."""
STRAIGHT = 1e-6
"""How far axes that are to be the car's own may be off; they are written, not measured."""


@dataclass(frozen=True)
class Car:
    """One car of a compiled world, at its reference position.

    Attributes:
        model: the world.
        name: of the car in it.
        sheet: what is believed of it.
        stretched: whether its model was to get there, so that its yaw inertia is that of a plate.
    """

    model: mujoco.MjModel
    name: str
    sheet: DataSheet
    stretched: bool = False

    @cached_property
    def data(self) -> Any:
        """Positions, with every joint where the file puts it."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        return data

    def of(self, kind: str, name: str) -> Any:
        """What MuJoCo knows of a part."""
        return getattr(self.model, kind)(f"{self.name}/{name}")

    def at(self, kind: str, name: str) -> Array:
        """Where a part is, m, (3,)."""
        found: Array = getattr(self.data, kind)(f"{self.name}/{name}").xpos
        return found

    def has(self, kind: Any, name: str) -> bool:
        """Whether there is one."""
        return bool(mujoco.mj_name2id(self.model, kind, f"{self.name}/{name}") >= 0)

    @cached_property
    def bodies(self) -> NDArray[np.intp]:
        """Ids of its bodies."""
        root = self.model.body_rootid[self.of("body", "chassis").id]
        return np.flatnonzero(self.model.body_rootid == root)


def off(
    car: Car,
    kind: str,
    name: str,
    what: str,
    got: float,
    key: str,
    allowed: float,
    meant: float | None = None,
) -> Iterator[Finding]:
    """A finding if a number is not the data sheet's; ``what`` says what was measured, its unit at the end."""
    text, _, unit = what.rpartition(" ")
    unit = "" if unit == "1" else f" {unit}"
    given = getattr(car.sheet, key) if meant is None else meant
    if not abs(got - given) <= allowed:
        said = f"{key}: {getattr(car.sheet, key):g}"
        if meant is not None:
            said += f", which makes {meant:.6g}{unit}"
        yield Finding(
            kind,
            name,
            f"{text} is {got:.6g}{unit}; datasheet.yaml says {said} (within {allowed:.3g}{unit})",
        )


def shape(geom: Any) -> str:
    """What MuJoCo calls its shape, with its article."""
    name: str = mujoco.mjtGeom(int(geom.type[0])).name
    called = name.removeprefix("mjGEOM_").lower()
    return f"{'an' if called[0] in 'aeiou' else 'a'} {called}"
