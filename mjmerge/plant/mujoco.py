"""Physical cars: N simulations of one MJCF world on ``mujoco.batch``."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from mjmerge.actuation import bicycle_angle
from mjmerge.plant.base import Fault
from mjmerge.plant.kinematic import start
from mjmerge.scenario import CARS, Scenario
from mjmerge.state import PAIRS, Array, Cars, Controls, Mask
from mjmerge.world import BRAKE, DRIVE, SENSORS, SPIN_LIMIT, STEER, WHEELS, World

_CRAWL_MPS = 0.02  # below this speed there is nothing to brake: torque against it starts the car backwards
_LOCKED_RADPS = 1.0  # a brake's full torque is reached from this wheel speed on
_TILTED = 0.5  # cosine of the tilt beyond which a car is off its wheels: 60 degrees


class MuJoCo:
    """Reads the world through its sensors, writes it through its actuators."""

    limited = True

    def __init__(self, world: World, scenario: Scenario, runs: int, threads: int) -> None:
        model = world.model
        self._batch = Batch(model, nsim=runs, nthread=threads)
        self._substeps = scenario.substeps
        self._sensors = self._batch.bind("sensordata")
        self._ctrl = self._batch.bind("ctrl")
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._errors: dict[int, str] = {}

        def adr(name: str) -> int:
            return int(model.sensor(name).adr[0])

        # every sensor read, in the order read: all cars' first sensor, all cars' second, ..., clearances
        self._order = np.array(
            [adr(f"{car}/{name}") + i for name, n in SENSORS.items() for car in CARS for i in range(n)]
            + [adr(f"clearance_{CARS[a]}_{CARS[b]}") for a, b in PAIRS]
        )
        self._steer_at = np.array([[model.actuator(f"{car}/{n}").id for n in STEER] for car in CARS])
        self._drive_at = np.array([[model.actuator(f"{car}/{n}").id for n in DRIVE] for car in CARS])
        self._brake_at = np.array([[model.actuator(f"{car}/{n}").id for n in BRAKE] for car in CARS])
        self._spin_at = np.array([[model.joint(f"{car}/spin_{w}").dofadr[0] for w in WHEELS] for car in CARS])
        limits = [model.numeric(f"{car}/{SPIN_LIMIT}").data[0] for car in CARS]
        self._spin_limit_radps = np.array(limits)[:, None]
        # geometry of its own cars, to turn two wheel angles into one: what a steering sensor reports
        self._wheelbase_m = np.array([s.wheelbase_m for s in world.sheets])
        self._track_m = np.array([s.track_m for s in world.sheets])
        self._steer_command = np.zeros((runs, len(CARS)))

        front_m, speed_mps = start(scenario, runs)
        still = np.zeros_like(speed_mps)
        self._qpos[:] = world.qpos(front_m, still, np.stack([still, still], axis=-1), still)
        self._qvel[:] = world.qvel(speed_mps)
        self._batch.forward()
        self._sense()

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
        at = 0
        for name, size in SENSORS.items():
            end = at + len(CARS) * size
            self._now[name] = values[:, at:end].reshape(-1, len(CARS), size)
            at = end
        self._clearance = values[:, at:]

    def step(self, controls: Controls, running: Mask) -> None:
        """See :meth:`Plant.step`."""
        self._ctrl[:, self._steer_at] = controls.wheel_steer_rad
        self._drive(controls.torque_n_m)
        self._steer_command = controls.steer_rad
        ids = None if running.all() else np.flatnonzero(running)
        try:
            self._batch.step(ids, self._substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)
        except SimulationError as error:
            self._errors = {int(i): self._batch.error(int(i)) for i in error.ids}
        self._sense()

    def _drive(self, torque_n_m: Array) -> None:
        """Torque along the car's motion goes to the motors; against it to the brakes, which only resist.

        A brake is a damper whose coefficient gives that torque at the wheel's present speed, so that a wheel
        that locks stays locked instead of spinning backwards.
        """
        speed = self._now["rear_velocity"][..., :1]
        braking = (torque_n_m * speed < 0) & (np.abs(speed) > _CRAWL_MPS)
        spin = np.abs(self._qvel[:, self._spin_at])
        driving = ~braking & (spin < self._spin_limit_radps)
        self._ctrl[:, self._drive_at] = np.where(driving, torque_n_m, 0.0)
        brake = np.abs(torque_n_m) / np.maximum(spin, _LOCKED_RADPS)
        self._ctrl[:, self._brake_at] = np.where(braking, brake, 0.0)

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


def make(scenario: Scenario, world: World | None, runs: int, threads: int) -> MuJoCo:
    """At t = 0; see :func:`mjmerge.plant.make`."""
    assert world is not None, "the mujoco plant stands in a world"
    return MuJoCo(world, scenario, runs, threads)
