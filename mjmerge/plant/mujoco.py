"""Physical cars: N simulations of one MJCF world on ``mujoco.batch``."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from mjmerge.actuation import AIR_KG_PER_M3, CRAWL_MPS, ROLLS_MPS, bicycle_angle
from mjmerge.mismatch import Mismatch
from mjmerge.plant.base import Fault
from mjmerge.plant.kinematic import start
from mjmerge.plant.tyre import Tyres
from mjmerge.scenario import Scenario
from mjmerge.state import Array, Cars, Controls, Mask, limit
from mjmerge.world import BRAKE, DRIVE, RESISTANCE, SENSORS, STEER, WHEELS, World

_LOCKED_RADPS = 1.0  # a brake's full torque is reached from this wheel speed on
_HELD_RADPS = 0.001  # the same of brakes that hold a car that stands
_HELD_MPS2 = 0.01  # an acceleration that a car at rest does not start for
_TILTED = 0.5  # cosine of the tilt beyond which a car is off its wheels: 60 degrees


class MuJoCo:
    """Reads the world through its sensors, writes it through its actuators, and keeps its tyres at its speed.

    Attributes:
        batch: the simulations.
    """

    limited = True

    def __init__(
        self,
        world: World,
        front_m: Array,
        speed_mps: Array,
        *,
        substeps: int,
        threads: int = 0,
        heading_rad: Array | None = None,
    ) -> None:
        """At t = 0, with the cars rolling straight ahead.

        Args:
            world: the compiled world of C cars.
            front_m: front-axle centres, m, (N, C, 2).
            speed_mps: speeds, m/s, (N, C).
            substeps: physics steps per control step.
            threads: threads for the physics, 0 for all cores.
            heading_rad: headings, rad, (N, C); along the road by default.
        """
        model, cars = world.model, world.cars
        runs = len(front_m)
        self.batch = Batch(model, nsim=runs, nthread=threads)
        self._cars, self._substeps = cars, substeps
        self._step_s = substeps * model.opt.timestep
        self._sensors = self.batch.bind("sensordata")
        self._ctrl = self.batch.bind("ctrl")
        self._qpos = self.batch.bind("qpos")
        self._qvel = self.batch.bind("qvel")
        self._errors: dict[int, str] = {}

        def adr(name: str) -> int:
            return int(model.sensor(name).adr[0])

        # every sensor read, in the order read: all cars' first sensor, all cars' second, ..., clearances
        self._order = np.array(
            [adr(f"{car}/{name}") + i for name, n in SENSORS.items() for car in cars for i in range(n)]
            + [adr(f"clearance_{a}_{b}") for a, b in combinations(cars, 2)]
        )

        def actuators(names: Sequence[str]) -> NDArray[np.intp]:
            return np.array([[model.actuator(f"{car}/{n}").id for n in names] for car in cars])

        self._steer_at, self._brake_at = actuators(STEER), actuators(BRAKE)
        self._resistance_at = actuators([RESISTANCE])[:, 0]
        there = {model.actuator(i).name: i for i in range(model.nu)}
        motors = [(c, w, f"{car}/{n}") for c, car in enumerate(cars) for w, n in enumerate(DRIVE)]
        self._motors = np.array([(c, w, there[name]) for c, w, name in motors if name in there]).T
        self._spin_at = np.array([[model.joint(f"{car}/spin_{w}").dofadr[0] for w in WHEELS] for car in cars])

        self._spin_limit_radps = world.number("spin_limit_radps")[:, None]
        driven = np.bincount(self._motors[0], minlength=len(cars))
        self._motor_limit_w = (world.number("power_limit_w") / driven)[:, None]
        self._most_turn_rad = world.number("steer_rate_limit_radps")[:, None] * self._step_s
        weight_n = world.axle_mass_kg().sum(axis=1) * -model.opt.gravity[2]
        self._brake_limit_n_m = model.actuator_forcerange[self._brake_at, 1]
        self._radius_m = np.array([[model.geom(f"{car}/tyre_{w}").size[0] for w in WHEELS] for car in cars])
        self._unmoved_n_m = _HELD_MPS2 * world.axle_mass_kg().sum(axis=1) * self._radius_m[:, 0]
        self._rolling_n = world.number("rolling_resistance") * weight_n
        self._drag_n_per_mps2 = AIR_KG_PER_M3 / 2 * world.number("drag_area_m2")

        # geometry of its own cars, to turn two wheel angles into one: what a steering sensor reports
        self._wheelbase_m = np.array([s.wheelbase_m for s in world.sheets])
        self._track_m = np.array([s.track_m for s in world.sheets])
        self._steer_command = np.zeros((runs, len(cars)))

        still = np.zeros_like(speed_mps)
        heading = still if heading_rad is None else heading_rad
        self._qpos[:] = world.qpos(front_m, heading, np.stack([still, still], axis=-1), still)
        self._qvel[:] = world.qvel(speed_mps, heading)
        self._tyres = Tyres.of(world)
        self._yaw_at = np.array([model.joint(f"{car}/free/").dofadr[0] + 5 for car in cars])
        self._wheels_m = world.wheels_m()
        pairs = np.array([[model.pair(f"{car}_road_{w}").id for w in WHEELS] for car in cars])
        self._impedance = self.batch.expand("pair_solimp")
        self._damping = self.batch.expand("pair_solreffriction")
        self._pairs = slice(int(pairs[0, 0]), int(pairs[-1, -1]) + 1)
        assert np.array_equal(pairs.ravel(), np.arange(self._pairs.start, self._pairs.stop))
        self.batch.forward()
        self._sense()
        self._grip()

    def observe(self) -> Cars:
        """See :meth:`Plant.observe`."""
        now = self._now
        forward = now["forward_axis"]
        steer = np.concatenate([now["steer_left"], now["steer_right"]], axis=-1)
        return Cars(
            front_m=now["front_position"][..., :2],
            velocity_mps=now["front_velocity"][..., :2],
            heading_rad=np.arctan2(forward[..., 1], forward[..., 0]),
            speed_mps=now["rear_velocity"][..., 0],
            steer_rad=bicycle_angle(steer, self._wheelbase_m, self._track_m),
            steer_command_rad=self._steer_command,
            clearance_m=self._clearance,
        )

    def _sense(self) -> None:
        """Reads all sensors: by name, (N, C, size), and the clearances, (N, P)."""
        values: Array = np.take(self._sensors, self._order, axis=1)
        self._now: dict[str, Array] = {}
        at, cars = 0, len(self._cars)
        for name, size in SENSORS.items():
            end = at + cars * size
            self._now[name] = values[:, at:end].reshape(-1, cars, size)
            at = end
        self._clearance = values[:, at:]

    def _grip(self) -> None:
        """Sets every tyre's contact for the speed of its wheel over the road."""
        now, (x_m, y_m) = self._now, self._wheels_m
        v, yaw_rate = now["rear_velocity"], self._qvel[:, self._yaw_at][..., None]
        ahead, across = v[..., :1] - yaw_rate * y_m, v[..., 1:2] + yaw_rate * x_m
        angle = np.zeros_like(ahead)
        angle[..., 0], angle[..., 1] = now["steer_left"][..., 0], now["steer_right"][..., 0]
        cos, sin = np.cos(angle), np.sin(angle)
        rim = self._qvel[:, self._spin_at] * self._radius_m
        slip = np.hypot(ahead * cos + across * sin - rim, across * cos - ahead * sin)
        d, damping = self._tyres.contact(np.hypot(ahead, across), slip)
        self._impedance[:, self._pairs, :2] = d.reshape(len(d), -1, 1)
        self._damping[:, self._pairs, 1] = -damping.reshape(len(d), -1)

    def step(self, controls: Controls, running: Mask) -> None:
        """See :meth:`Plant.step`."""
        told = self._ctrl[:, self._steer_at]
        self._ctrl[:, self._steer_at] = told + limit(controls.wheel_steer_rad - told, self._most_turn_rad)
        self._drive(controls.torque_n_m)
        self._steer_command = controls.steer_rad
        self._grip()
        ids = None if running.all() else np.flatnonzero(running)
        try:
            self.batch.step(ids, self._substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)
        except SimulationError as error:
            self._errors = {int(i): self.batch.error(int(i)) for i in error.ids}
        self._sense()

    def _drive(self, torque_n_m: Array) -> None:
        """Torque along the car's motion goes to the motors; against it to the brakes, which only resist.

        A car that stands and is asked for next to nothing holds its brakes.

        A brake is a damper whose coefficient gives that torque at the wheel's present speed, so that a wheel
        that locks stays locked instead of spinning backwards.
        """
        v = self._now["rear_velocity"][..., 0]
        speed = v[..., None]
        braking = (torque_n_m * speed < 0) & (np.abs(speed) > CRAWL_MPS)
        spin = np.abs(self._qvel[:, self._spin_at])
        driving = ~braking & (spin < self._spin_limit_radps)
        torque = limit(torque_n_m, self._motor_limit_w / np.maximum(spin, _LOCKED_RADPS))
        car, wheel, at = self._motors
        self._ctrl[:, at] = np.where(driving, torque, 0.0)[:, car, wheel]
        brake = np.where(braking, np.abs(torque_n_m) / np.maximum(spin, _LOCKED_RADPS), 0.0)
        held = (np.abs(v) <= CRAWL_MPS) & (np.abs(torque_n_m.sum(axis=-1)) < self._unmoved_n_m)
        hold = self._brake_limit_n_m / np.maximum(spin, _HELD_RADPS)
        self._ctrl[:, self._brake_at] = np.where(held[..., None], hold, brake)
        rolling = self._rolling_n * limit(v / ROLLS_MPS, 1.0)
        self._ctrl[:, self._resistance_at] = -(self._drag_n_per_mps2 * v * np.abs(v) + rolling)

    def faults(self) -> list[Fault]:
        """See :meth:`Plant.faults`."""
        found = [Fault(run, 0, f"MuJoCo: {message}") for run, message in self._errors.items()]
        up = self._now["up_axis"][..., 2]
        off = ~(up > _TILTED)  # true for NaN
        for run in np.flatnonzero(off.any(axis=1)):
            car = int(np.argmax(off[run]))
            fine = np.isfinite(up[run, car])
            found.append(Fault(int(run), car, "it is off its wheels" if fine else "its state is not finite"))
        return found

    def qpos(self) -> Array:
        """See :meth:`Plant.qpos`."""
        qpos: Array = self._qpos
        return qpos


def make(scenario: Scenario, world: World | None, mismatch: Sequence[Mismatch], threads: int) -> MuJoCo:
    """At t = 0; see :func:`mjmerge.plant.make`."""
    assert world is not None, "the mujoco plant stands in a world"
    front_m, speed_mps = start(scenario, len(mismatch))
    return MuJoCo(world, front_m, speed_mps, substeps=scenario.substeps, threads=threads)
