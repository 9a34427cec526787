"""What the proving ground drives: each function is one manoeuvre, all its variants at once.

Speeds and times scale with the car as sqrt(g L) and sqrt(L/g), L the wheelbase.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjmerge.proving.ground import MotionLog, drive
from mjmerge.state import G_MPS2, Array, Cars
from mjmerge.vehicle.datasheet import DataSheet
from mjmerge.world.model import World

SPEEDS = np.array([0.97, 1.5, 2.3, 3.2, 4.4, 5.83])
"""Of the steady turns, as parts of sqrt(g L): 5 to 30 m/s for a wheelbase of 2.7 m."""
TURNS_G = np.array([0.1, 0.3])
"""Lateral accelerations of the steady turns."""
STEPS_G = np.array([-0.1, -0.05, 0.0, 0.05, 0.1])
"""Accelerations asked for by torque."""

_MOST_STEER_RAD = 0.1  # in a steady turn: beyond it two tracks are no longer one
_SETTLED = 5.0  # of the slowest time constants, before a turn counts as steady
_KNEE = 1.5  # a ramp goes this far beyond the angle at which the tyres should saturate


@dataclass(frozen=True)
class Scale:
    """Units that a car's manoeuvres scale with.

    Attributes:
        speed_mps: sqrt(g L).
        time_s: sqrt(L/g).
    """

    speed_mps: float
    time_s: float

    @classmethod
    def of(cls, sheet: DataSheet) -> Scale:
        """Those of a wheelbase."""
        return cls(float(np.sqrt(G_MPS2 * sheet.wheelbase_m)), float(np.sqrt(sheet.wheelbase_m / G_MPS2)))


def understeer_rad_s2_per_m(sheet: DataSheet) -> float:
    """K of the data sheet, W_f/(C_f g) - W_r/(C_r g)."""
    front, rear = compliance_rad(sheet)
    return (front - rear) / G_MPS2


def creep(world: World) -> MotionLog:
    """Parked with its brakes on, for 12 s: on the flat, and up, down and across a slope of 10 %."""
    tilt = np.arctan(0.1)
    down = G_MPS2 * np.cos(tilt)
    along = G_MPS2 * np.sin(tilt)
    gravity = np.array([[0, 0, -G_MPS2], [-along, 0, -down], [along, 0, -down], [0, along, -down]])
    return drive(world, _parked, 12.0, np.zeros(4), gravity_mps2=gravity)


def coast(world: World) -> MotionLog:
    """Rolling freely from two speeds."""
    scale = Scale.of(world.sheets[0])
    fast = np.array([5.8, 2.0]) * scale.speed_mps
    return drive(world, _parked, 20 * scale.time_s, fast, coasting=True)


def torque_steps(world: World) -> MotionLog:
    """Accelerations of 0, +-0.05 and +-0.1 g asked for from the same speed."""
    scale, asked = Scale.of(world.sheets[0]), STEPS_G * G_MPS2

    def driver(time_s: float, cars: Cars) -> tuple[Array, Array]:
        del cars
        return asked * (time_s >= 4 * scale.time_s), np.zeros(len(asked))

    return drive(world, driver, 10 * scale.time_s, np.full(len(asked), 2 * scale.speed_mps))


def turn(world: World, speed_mps: Array, steer_rad: Array, duration_s: float) -> MotionLog:
    """Steering angles held at held speeds, (N,) each."""

    def driver(time_s: float, cars: Cars) -> tuple[Array, Array]:
        del time_s
        return hold(world, cars, speed_mps), steer_rad

    return drive(world, driver, duration_s, speed_mps)


def hold(world: World, cars: Cars, speed_mps: Array) -> Array:
    """Acceleration that a driver asks for to keep a speed, (N,)."""
    return (speed_mps - cars.speed_mps[:, 0]) / (2 * Scale.of(world.sheets[0]).time_s)


def steady_turns(
    world: World, speeds_mps: Array | None = None, turns_g: Array = TURNS_G, side: float = 1.0
) -> MotionLog:
    """Steady turns at every speed and lateral acceleration, those without room to steer left gentler."""
    sheet = world.sheets[0]
    speeds = SPEEDS * Scale.of(sheet).speed_mps if speeds_mps is None else speeds_mps
    v, a = (x.ravel() for x in np.meshgrid(speeds, turns_g * G_MPS2, indexing="ij"))
    steer = np.arctan(sheet.wheelbase_m * a / v**2) + understeer_rad_s2_per_m(sheet) * a
    gentler = min(_MOST_STEER_RAD, 0.6 * sheet.steer_limit_rad) / steer
    # one lateral acceleration of a speed stays half or a third of another when both are gentler
    least = gentler.reshape(len(speeds), -1).min(axis=1, keepdims=True)
    steer = steer * np.minimum(np.broadcast_to(least, (len(speeds), len(turns_g))).ravel(), 1.0)
    settled = settling_s(sheet, float(speeds.max()))
    return turn(world, v, side * steer, 1.1 * settled).between(settled, np.inf)


def brake(world: World, speeds: Array | None = None) -> MotionLog:
    """Straight ahead, then braking as hard as the car can until it stands."""
    scale = Scale.of(world.sheets[0])
    speed = (np.array([2.0, 4.0]) if speeds is None else speeds) * scale.speed_mps

    def driver(time_s: float, cars: Cars) -> tuple[Array, Array]:
        del time_s, cars
        return np.full(len(speed), -3 * G_MPS2), np.zeros(len(speed))

    return drive(world, driver, float(2.0 * speed.max() / G_MPS2 / friction(world)), speed)


def steer_ramp(world: World, side: float = 1.0) -> MotionLog:
    """The steering turned slowly beyond the grip, off the throttle but for the road load."""
    sheet = world.sheets[0]
    scale, mu = Scale.of(sheet), friction(world)
    speed = np.array([5.0, 6.0]) * scale.speed_mps * np.sqrt(mu)
    most = np.arctan(sheet.wheelbase_m * mu * G_MPS2 / speed**2) + 2 * mu * compliance_rad(sheet)[0]
    most = np.minimum(_KNEE * most, 0.95 * sheet.steer_limit_rad)
    rising_s = 30 * scale.time_s

    def driver(time_s: float, cars: Cars) -> tuple[Array, Array]:
        del cars
        return np.zeros(len(speed)), side * most * min(time_s / rising_s, 1.0)

    return drive(world, driver, rising_s, speed)


def steer_step(world: World, tick_s: float = 0.002) -> MotionLog:
    """A small and the largest step of the steering while rolling slowly."""
    sheet = world.sheets[0]
    small = 0.05 * sheet.steer_rate_limit_radps * sheet.steer_lag_s
    steps = np.array([small, 0.9 * sheet.steer_limit_rad])

    def driver(time_s: float, cars: Cars) -> tuple[Array, Array]:
        del time_s, cars
        return np.zeros(2), steps

    slow = np.full(2, 0.5 * Scale.of(sheet).speed_mps)
    duration = 8 * sheet.steer_lag_s + steps[1] / sheet.steer_rate_limit_radps
    return drive(world, driver, duration, slow, tick_s=tick_s)


def compliance_rad(sheet: DataSheet) -> tuple[float, float]:
    """W/C of each axle, rad: the slip angle at 1 g; zero for tyres that do not slip."""
    given = sheet.cornering_stiffness_n_per_rad
    if given is None:
        return 0.0, 0.0
    weight, behind = sheet.mass_kg * G_MPS2, sheet.com_behind_front_axle_m / sheet.wheelbase_m
    return weight * (1 - behind) / given.front, weight * behind / given.rear


def settling_s(sheet: DataSheet, speed_mps: float) -> float:
    """Long enough for the slowest mode of a single-track model at that speed."""
    front, rear = compliance_rad(sheet)
    return _SETTLED * (Scale.of(sheet).time_s + speed_mps * max(front, rear) / G_MPS2)


def friction(world: World) -> float:
    """Mu of the road."""
    return float(world.model.pair_friction[0, 0])


def _parked(time_s: float, cars: Cars) -> tuple[Array, Array]:
    del time_s
    still = np.zeros(len(cars.speed_mps))
    return still, still
