"""One MJCF world from a scenario: a road and its cars, composed with ``dm_control.mjcf``.

This is the only module that knows dm_control, and the only one that knows what a car's MJCF must hold.
The compiled model is checked: options that a composition can silently lose, and every name that the plant
and the recorders rely on.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from math import ceil
from pathlib import Path

import mujoco
import numpy as np

from mjmerge import share
from mjmerge.datasheet import DataSheet
from mjmerge.errors import ModelError, nearest
from mjmerge.loader import data_sheet
from mjmerge.scenario import CARS, Scenario
from mjmerge.state import PAIRS, Array

with warnings.catch_warnings():  # dm_control looks for a window on import, and warns where there is none
    warnings.filterwarnings("ignore", module="glfw")
    from dm_control import mjcf

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
"""Order of every wheel axis."""
STEERED = WHEELS[:2]
DRIVE = tuple(f"drive_{w}" for w in WHEELS)
BRAKE = tuple(f"brake_{w}" for w in WHEELS)
STEER = tuple(f"steer_{w}" for w in STEERED)
SPIN_LIMIT = "spin_limit_radps"
"""Custom number of every car: the wheel speed beyond which its motors give no torque."""
SENSORS = {
    "front_position": 3,
    "front_velocity": 3,
    "forward_axis": 3,
    "up_axis": 3,
    "rear_velocity": 3,
    "steer_left": 1,
    "steer_right": 1,
}
"""Sensors every car has, with their sizes."""

_PAINT = {
    "ego": (0.16, 0.62, 0.33, 1),
    "vehicle_1": (0.17, 0.38, 0.75, 1),
    "vehicle_2": (0.85, 0.45, 0.13, 1),
}
"""Body colour by role; the paper draws the ego green and its neighbours blue."""
_CLEARANCE_CUTOFF_M = 100.0
_MARKING_M, _MARKING_EVERY_M = 0.4, 1.2


@dataclass(frozen=True)
class World:
    """A compiled world.

    Attributes:
        model: the compiled MuJoCo model.
        xml: the composed MJCF it was compiled from.
        sheets: data sheet of each car, in the order of ``CARS``.
    """

    model: mujoco.MjModel
    xml: str
    sheets: tuple[DataSheet, ...] = field(repr=False)

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
        for c, car in enumerate(CARS):
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

    def qvel(self, speed_mps: Array) -> Array:
        """Generalised velocities of cars that roll straight along the road, (M, nv); speeds (M, C)."""
        m = self.model
        qvel = np.zeros((len(speed_mps), m.nv))
        for c, car in enumerate(CARS):
            qvel[:, m.joint(f"{car}/free/").dofadr[0]] = speed_mps[:, c]
            for wheel in WHEELS:
                radius = m.geom(f"{car}/tyre_{wheel}").size[0]
                qvel[:, m.joint(f"{car}/spin_{wheel}").dofadr[0]] = speed_mps[:, c] / radius
        return qvel


def build(scenario: Scenario) -> World:
    """Composes and compiles the world of a scenario.

    Raises:
        ModelError: a car model lacks something, or the composition lost an option.
    """
    root = mjcf.RootElement(model="mjmerge")
    root.compiler.angle = "radian"
    root.compiler.autolimits = True
    root.option.timestep = scenario.physics_step_s
    root.option.integrator = "implicitfast"
    root.option.cone = "elliptic"
    root.option.impratio = 10
    root.option.flag.autoreset = "disable"  # an unstable run stops; it does not start again at t = 0
    root.statistic.extent = 4.0
    root.statistic.center = (0.0, 0.0, 0.2)
    root.visual.headlight.ambient = (0.35, 0.35, 0.35)
    _add_road(root, scenario)

    sheets = []
    for car in CARS:
        name = getattr(scenario.models, car)
        sheets.append(data_sheet(name))
        _add_car(root, car, share.model_folder(name), scenario)
    for a, b in PAIRS:
        root.sensor.add(
            "distance",
            name=f"clearance_{CARS[a]}_{CARS[b]}",
            geom1=f"{CARS[a]}/hull",
            geom2=f"{CARS[b]}/hull",
            cutoff=_CLEARANCE_CUTOFF_M,
        )

    xml = root.to_xml_string()
    try:
        model = mujoco.MjModel.from_xml_string(xml, root.get_assets())
    except ValueError as error:
        raise ModelError(f"the composed world does not compile: {error}") from error
    _check_model(model, scenario)
    return World(model, xml, tuple(sheets))


def _add_road(root: mjcf.RootElement, scenario: Scenario) -> None:
    """A plane and the markings of the lanes that the cars start in, one lane more to each side."""
    lanes = [getattr(scenario.initial, car).front_m[1] for car in CARS]
    width = scenario.road.lane_width_m
    low, high = min(lanes) - width / 2, max(lanes) + width / 2
    speeds = [getattr(scenario.initial, car).speed_mps for car in CARS]
    starts = [getattr(scenario.initial, car).front_m[0] for car in CARS]
    begin = min(starts) - 5.0
    end = max(starts) + 10.0 + 1.5 * max(max(speeds), 0.0) * scenario.duration_s

    ground = root.worldbody
    ground.add("light", name="sun", pos=(0, -4, 8), dir=(0, 0.4, -1), type="directional", castshadow=True)
    grey = (0.32, 0.33, 0.35, 1)
    ground.add("geom", name="road", type="plane", size=(0, 0, 1), rgba=grey, contype=0, conaffinity=1)

    def line(name: str, x: float, y: float, length: float) -> None:
        ground.add(
            "geom",
            name=name,
            type="box",
            size=(length / 2, 0.02, 0.0005),
            pos=(x, y, 0.0005),
            rgba=(0.93, 0.93, 0.9, 1),
            contype=0,
            conaffinity=0,
            group=2,
        )

    for name, y in (("edge_right", low), ("edge_left", high)):
        line(name, (begin + end) / 2, y, end - begin)
    if high - low > 1.5 * width:  # two lanes: dashes between them
        for i in range(ceil((end - begin) / _MARKING_EVERY_M)):
            line(f"dash_{i}", begin + (i + 0.5) * _MARKING_EVERY_M, (low + high) / 2, _MARKING_M)


def _add_car(root: mjcf.RootElement, car: str, folder: Path, scenario: Scenario) -> None:
    """Attaches a car under its role's name, paints it, frees it, and lets its tyres touch the road."""
    model = _load_car(folder)
    model.model = car
    model.find("material", "paint").rgba = _PAINT[car]
    frame = root.attach(model)
    frame.add("freejoint", name="free")

    grip = scenario.mismatch.friction
    for wheel in WHEELS:
        root.contact.add(
            "pair",
            name=f"{car}_road_{wheel}",
            geom1="road",
            geom2=model.find("geom", f"tyre_{wheel}"),
            condim=3,
            friction=(grip, grip, 0.005, 1e-4, 1e-4),
            solref=(0.01, 1.0),
        )
    delay_s = scenario.mismatch.command_delay_s
    if car == "ego" and delay_s > 0:
        for name in DRIVE + BRAKE + STEER:
            actuator = model.find("actuator", name)
            actuator.delay = delay_s
            actuator.nsample = ceil(delay_s / scenario.physics_step_s - 1e-9)


def _load_car(folder: Path) -> mjcf.RootElement:
    """A car's MJCF, checked for everything that is asked of it by name.

    Raises:
        ModelError: it does not parse, or something is missing; all that is missing is named.
    """
    file = folder / f"{folder.name}.xml"
    try:
        model = mjcf.from_path(str(file))
    except (OSError, ValueError, KeyError, AttributeError, SyntaxError) as error:  # lxml's is a SyntaxError
        raise ModelError(f"{file}: {error}") from error
    wanted = (
        [("body", "chassis"), ("geom", "hull"), ("material", "paint"), ("numeric", SPIN_LIMIT)]
        + [("site", f"{axle}_axle") for axle in ("front", "rear")]
        + [("geom", f"tyre_{w}") for w in WHEELS]
        + [("joint", f"spin_{w}") for w in WHEELS]
        + [("joint", f"steer_{w}") for w in STEERED]
        + [("actuator", name) for name in DRIVE + BRAKE + STEER]
        + [("sensor", name) for name in SENSORS]
    )
    problems = []
    for kind, name in wanted:
        if model.find(kind, name) is None:
            have = [e.name for e in model.find_all(kind) if e.name]
            problems.append(f"{file}: no {kind} called {name!r}; {nearest(name, have)}")
    if problems:
        raise ModelError("\n".join(problems))
    return model


def _check_model(model: mujoco.MjModel, scenario: Scenario) -> None:
    """Raises ModelError where the compiled model is not what was composed."""
    wanted = {
        "timestep": scenario.physics_step_s,
        "integrator": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
        "cone": mujoco.mjtCone.mjCONE_ELLIPTIC,
        "impratio": 10.0,
    }
    for name, value in wanted.items():
        if getattr(model.opt, name) != value:
            raise ModelError(f"the compiled world's option {name} is {getattr(model.opt, name)}, not {value}")
    for car in CARS:
        for wheel in WHEELS:
            tyre = model.geom(f"{car}/tyre_{wheel}")
            if tyre.type[0] != mujoco.mjtGeom.mjGEOM_SPHERE:
                raise ModelError(
                    f"{car}: tyre_{wheel} is not a sphere; other shapes touch the road twice and scrub"
                )
