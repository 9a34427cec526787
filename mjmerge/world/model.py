"""A compiled world, and what is read from it and written to it by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmerge.roster import WHEELS
from mjmerge.scenario.mismatch import Tyre
from mjmerge.state import Array
from mjmerge.vehicle.datasheet import DataSheet
from mjmerge.world.checks.parts import NUMBERS, STEERED

IMPRATIO = 0.012
"""Of the world: low, so that the road stays hard under a tyre that slips; see ``mjmerge.plant.tyre``."""


LONGEST_STEP_S = 0.002
"""Of the physics, with tyres that slip; at 0.004 s a car's path is wrong by metres."""


HARDEST = 0.9999
"""MuJoCo's largest impedance: that of the tyres of a car that stands."""


def moving(xml: str) -> mujoco.MjModel:
    """A world of that MJCF without what is only drawn.

    That is nine geoms in ten, which MuJoCo would place anew in every step: one takes 4 to 10 % less without
    them, and has the same bits.
    """
    spec = mujoco.MjSpec.from_string(xml)
    spec.compiler.discardvisual = True
    return spec.compile()


@dataclass(frozen=True)
class World:
    """A compiled world.

    Attributes:
        model: what moves, compiled: nothing that is only drawn is in it.
        xml: the composed MJCF, with everything in it.
        cars: names of the cars.
        sheets: data sheet of each.
        tyres: whether they slip.
    """

    model: mujoco.MjModel
    xml: str
    cars: tuple[str, ...]
    sheets: tuple[DataSheet, ...] = field(repr=False)
    tyres: Tyre

    @cached_property
    def drawn(self) -> mujoco.MjModel:
        """The same world with all that is only drawn: paint, lamps, the lines of the road."""
        return mujoco.MjModel.from_xml_string(self.xml)

    def number(self, name: str) -> Array:
        """One of :data:`NUMBERS` of each car, (C,) or (C, 2)."""
        values = np.array([self.model.numeric(f"{car}/{name}").data for car in self.cars])
        return values[:, 0] if NUMBERS[name] == 1 else values

    def cornering_stiffness_n_per_rad(self) -> Array:
        """Of each car's front and rear axle, (C, 2); infinite where the tyres do not slip."""
        stiffness = self.number("cornering_stiffness_n_per_rad")
        return np.where(self.tyres == "slip", stiffness, np.inf)

    @cached_property
    def actuator_ids(self) -> dict[str, int]:
        """Of all actuators, by name, in their order."""
        return {self.model.actuator(i).name: i for i in range(self.model.nu)}

    def ids(self, kind: str, name: str) -> NDArray[np.intp]:
        """Ids of what each car has at each wheel: ``ids("geom", "tyre_{}")`` is (C, 4)."""
        found = getattr(self.model, kind)
        return np.array([[found(f"{car}/{name.format(w)}").id for w in WHEELS] for car in self.cars])

    @cached_property
    def pairs(self) -> NDArray[np.intp]:
        """Ids of the contacts of the wheels with the road, (C, 4)."""
        return np.array([[self.model.pair(f"{car}_road_{w}").id for w in WHEELS] for car in self.cars])

    @cached_property
    def centre_m(self) -> Array:
        """The first car's centre of mass in the frame of its chassis, m, (3,)."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        chassis = self.model.body(f"{self.cars[0]}/chassis").id
        centre: Array = data.subtree_com[chassis] - data.xpos[chassis]
        return centre

    def posture(self, car: str) -> NDArray[np.intp]:
        """Where a car's generalised positions are, but for the angles of its wheels; x and y come first."""
        m = self.model
        joints = [m.joint(j) for j in range(m.njnt)]
        mine = [j for j in joints if j.name.startswith(f"{car}/") and not j.name.startswith(f"{car}/spin_")]
        return np.concatenate([j.qposadr[0] + np.arange(len(j.qpos0)) for j in mine])

    def axle_mass_kg(self, model: mujoco.MjModel | None = None, data: mujoco.MjData | None = None) -> Array:
        """What stands on each car's front and rear axle, (C, 2); of another model of the same cars.

        Args:
            model: by default its own.
            data: room to compute in, of any of these models; by default new, which takes its time to make.
        """
        model = model or self.model
        data = data or mujoco.MjData(model)
        mujoco.mj_resetData(model, data)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        found = []
        for car in self.cars:
            chassis = model.body(f"{car}/chassis")
            front, rear = (data.site(f"{car}/{axle}_axle").xpos[0] for axle in ("front", "rear"))
            share = (data.subtree_com[chassis.id][0] - rear) / (front - rear)
            found.append(chassis.subtreemass[0] * np.array([share, 1 - share]))
        return np.array(found)

    def wheels_m(self) -> tuple[Array, Array]:
        """Where the wheels are, ahead of the rear axle and left of the middle, each (C, 4)."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        wheels = np.array([[data.geom(f"{car}/tyre_{w}").xpos for w in WHEELS] for car in self.cars])
        rear = np.array([data.site(f"{car}/rear_axle").xpos for car in self.cars])
        at = wheels - rear[:, None]
        return at[..., 0], at[..., 1]

    def qpos(self, front_m: Array, heading_rad: Array, wheel_steer_rad: Array, spin_rad: Array) -> Array:
        """Generalised positions with the cars standing on their wheels, (M, nq).

        Args:
            front_m: front-axle centres, m, (M, C, 2).
            heading_rad: headings, rad, (M, C).
            wheel_steer_rad: angles of the steered wheels, rad, (M, C, 2).
            spin_rad: angle all wheels of a car have turned by, rad, (M, C).
        """
        m = self.model
        qpos = np.tile(m.qpos0, (len(front_m), 1))
        for c, car in enumerate(self.cars):
            root = m.joint(f"{car}/free/").qposadr[0]
            front = m.site(f"{car}/front_axle").pos[0]
            cos, sin = np.cos(heading_rad[:, c]), np.sin(heading_rad[:, c])
            qpos[:, root] = front_m[:, c, 0] - front * cos
            qpos[:, root + 1] = front_m[:, c, 1] - front * sin
            qpos[:, root + 3] = np.cos(heading_rad[:, c] / 2)
            qpos[:, root + 6] = np.sin(heading_rad[:, c] / 2)
            for i, wheel in enumerate(STEERED):
                qpos[:, m.joint(f"{car}/steer_{wheel}").qposadr[0]] = wheel_steer_rad[:, c, i]
            for wheel in WHEELS:
                qpos[:, m.joint(f"{car}/spin_{wheel}").qposadr[0]] = spin_rad[:, c]
        return qpos

    def qvel(self, speed_mps: Array, heading_rad: Array | float = 0.0) -> Array:
        """Generalised velocities of cars that roll straight ahead, (M, nv); speeds and headings (M, C)."""
        m = self.model
        qvel = np.zeros((len(speed_mps), m.nv))
        heading = np.broadcast_to(heading_rad, speed_mps.shape)
        for c, car in enumerate(self.cars):
            root = m.joint(f"{car}/free/").dofadr[0]
            qvel[:, root] = speed_mps[:, c] * np.cos(heading[:, c])
            qvel[:, root + 1] = speed_mps[:, c] * np.sin(heading[:, c])
            for wheel in WHEELS:
                radius = m.geom(f"{car}/tyre_{wheel}").size[0]
                qvel[:, m.joint(f"{car}/spin_{wheel}").dofadr[0]] = speed_mps[:, c] / radius
        return qvel
