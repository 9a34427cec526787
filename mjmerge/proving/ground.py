"""A proving ground: one car many times over on a plane, driven open loop through its real actuators.

All simulations of a manoeuvre run at once on the plant that scenarios use, tyres and brakes included. What
is logged is what a test engineer's instruments would see: speeds at the rear axle, yaw rate, wheel speeds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import mujoco
import numpy as np

from mjmerge.errors import ModelError
from mjmerge.plant.mujoco import MuJoCo
from mjmerge.roster import WHEELS
from mjmerge.state import Array, Cars
from mjmerge.vehicle.actuation import BelievedCars, command
from mjmerge.world.model import World

TICK_S = 0.01


@dataclass(frozen=True)
class MotionLog:
    """What happened, (N, T) unless it says otherwise; every sample is of the state at its time.

    Attributes:
        time_s: from the start, (T,).
        x_m: rear-axle centre, along the plane's x.
        y_m: along its y.
        z_m: height of the car's frame.
        heading_rad: unwrapped.
        speed_mps: of the rear-axle centre along the car.
        lateral_mps: of the same point, to the car's left.
        yaw_rate_radps: about the vertical.
        steer_rad: angle of the wheels as one bicycle's.
        steer_command_rad: what they were told.
        spin_radps: of each wheel, (N, T, 4).
        torque_n_m: commanded of each wheel, (N, T, 4).
    """

    time_s: Array
    x_m: Array
    y_m: Array
    z_m: Array
    heading_rad: Array
    speed_mps: Array
    lateral_mps: Array
    yaw_rate_radps: Array
    steer_rad: Array
    steer_command_rad: Array
    spin_radps: Array
    torque_n_m: Array

    def between(self, begin_s: float, end_s: float) -> MotionLog:
        """The part from one time to another."""
        at = (self.time_s >= begin_s - 1e-9) & (self.time_s <= end_s + 1e-9)
        part = {f.name: getattr(self, f.name)[:, at] for f in fields(self) if f.name != "time_s"}
        return MotionLog(time_s=self.time_s[at], **part)

    def lateral_mps2(self, ahead_m: float) -> Array:
        """Lateral acceleration of the point that far ahead of the rear axle, (N, T)."""
        sideways = self.lateral_mps + ahead_m * self.yaw_rate_radps
        rate: Array = np.gradient(sideways, self.time_s, axis=1)
        return rate + self.speed_mps * self.yaw_rate_radps


Pedals = Callable[[float, Cars], tuple[Array, Array]]
"""What the driver does: of the time and the car, acceleration asked for and steering angle, (N,) each."""


def drive(
    world: World,
    driver: Pedals,
    duration_s: float,
    speed_mps: Array,
    *,
    heading_rad: Array | None = None,
    gravity_mps2: Array | None = None,
    tick_s: float = TICK_S,
    coasting: bool = False,
    threads: int = 1,
) -> MotionLog:
    """Drives a manoeuvre.

    Args:
        world: of one car, from :func:`mjmerge.world.compose.single`.
        driver: what is asked of it at every tick.
        duration_s: how long.
        speed_mps: at the start, (N,).
        heading_rad: at the start, (N,); along x by default.
        gravity_mps2: for slopes, (N, 3); straight down by default.
        tick_s: control step, a multiple of the physics step.
        coasting: whether the torques are zero whatever the driver asks, without the compensation of the
            road load.
        threads: for the physics, 0 for all cores.

    Raises:
        ModelError: it ends off its wheels, or nowhere.
    """
    runs = len(speed_mps)
    heading = np.zeros(runs) if heading_rad is None else heading_rad
    plant = MuJoCo(
        world,
        np.zeros((runs, 1, 2)),
        np.asarray(speed_mps, dtype=float)[:, None],
        substeps=round(tick_s / world.model.opt.timestep),
        threads=threads,
        heading_rad=heading[:, None],
        gravity_mps2=gravity_mps2,
    )
    believed = BelievedCars.of(world.sheets, limited=True)
    read = _Reader(plant, world)
    ticks, running = round(duration_s / tick_s), np.ones(runs, dtype=bool)
    rows: list[dict[str, Array]] = []
    for tick in range(ticks + 1):
        cars = plant.observe()
        a_mps2, steer_rad = (np.broadcast_to(x, runs)[:, None] for x in driver(tick * tick_s, cars))
        controls = command(cars, a_mps2, steer_rad, believed)
        if coasting:
            controls = replace(controls, torque_n_m=np.zeros_like(controls.torque_n_m))
        rows.append(
            read(cars)
            | {
                "steer_command_rad": controls.steer_rad[:, 0],
                "torque_n_m": controls.torque_n_m[:, 0].copy(),
            }
        )
        if tick < ticks:
            plant.step(controls, running)
    if faults := plant.faults():
        raise ModelError(
            f"the car does not survive a drive from {speed_mps[faults[0].run]:.3g} m/s: {faults[0].reason}"
        )
    columns = {name: np.stack([row[name] for row in rows], axis=1) for name in rows[0]}
    columns["heading_rad"] = np.unwrap(columns["heading_rad"], axis=1)
    return MotionLog(time_s=tick_s * np.arange(ticks + 1, dtype=np.float64), **columns)


class _Reader:
    """Copies out of a plant what a log holds."""

    def __init__(self, plant: MuJoCo, world: World) -> None:
        model, (car,) = world.model, world.cars
        self._qpos, self._qvel = plant.batch.bind("qpos"), plant.batch.bind("qvel")
        self._sensors = plant.batch.bind("sensordata")
        self._root = int(model.joint(f"{car}/free/").qposadr[0]), int(model.joint(f"{car}/free/").dofadr[0])
        self._spin = [int(model.joint(f"{car}/spin_{w}").dofadr[0]) for w in WHEELS]
        self._rear = int(model.sensor(f"{car}/rear_velocity").adr[0])
        self._wheelbase_m = model.site(f"{car}/front_axle").pos[0] - model.site(f"{car}/rear_axle").pos[0]

    def __call__(self, cars: Cars) -> dict[str, Array]:
        heading = cars.heading_rad[:, 0]
        rear_m = cars.front_m[:, 0] - self._wheelbase_m * np.stack(
            [np.cos(heading), np.sin(heading)], axis=-1
        )
        position, velocity = self._root
        return {
            "x_m": rear_m[:, 0],
            "y_m": rear_m[:, 1],
            "z_m": self._qpos[:, position + 2].copy(),
            "heading_rad": heading.copy(),
            "speed_mps": cars.speed_mps[:, 0].copy(),
            "lateral_mps": self._sensors[:, self._rear + 1].copy(),
            "yaw_rate_radps": self._qvel[:, velocity + 5].copy(),
            "steer_rad": cars.steer_rad[:, 0].copy(),
            "spin_radps": self._qvel[:, self._spin].copy(),
        }


def wheel_loads_n(world: World, settle_s: float = 3.0) -> Array:
    """Normal force of the road on each wheel of the standing car, N, (4,)."""
    plant = MuJoCo(
        world,
        np.zeros((1, 1, 2)),
        np.zeros((1, 1)),
        substeps=round(settle_s / world.model.opt.timestep),
        threads=1,
    )
    believed = BelievedCars.of(world.sheets, limited=True)
    still = np.zeros((1, 1))
    plant.step(command(plant.observe(), still, still, believed), np.ones(1, dtype=bool))
    model, data = plant.batch.get_model(0), plant.batch.get_data(0)
    mujoco.mj_forward(model, data)
    (car,), found, force = world.cars, np.zeros(len(WHEELS)), np.zeros(6)
    tyres = [model.geom(f"{car}/tyre_{w}").id for w in WHEELS]
    for i, contact in enumerate(data.contact):
        for geom in contact.geom:
            if geom in tyres:
                mujoco.mj_contactForce(model, data, i, force)
                found[tyres.index(geom)] += force[0]
    return found
