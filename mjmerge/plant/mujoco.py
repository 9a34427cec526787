"""Physical cars: N simulations of one MJCF world on ``mujoco.batch``."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from math import ceil

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from mjmerge.plant.base import Fault
from mjmerge.plant.contacts import Contacts
from mjmerge.plant.hold import STILL, Brakes, Bristles, Holding
from mjmerge.plant.kinematic import mismatches, start
from mjmerge.plant.lag import Lag
from mjmerge.plant.patch import Patch
from mjmerge.plant.truth import Truth
from mjmerge.roster import WHEELS
from mjmerge.scenario.mismatch import Mismatch, column
from mjmerge.scenario.schema import Scenario
from mjmerge.state import Array, Cars, Controls, Mask, limit
from mjmerge.vehicle.actuation import AIR_KG_PER_M3, CRAWL_MPS, ROLLS_MPS, bicycle_angle
from mjmerge.vehicle.delay import Age, Past, asked_s
from mjmerge.world.checks.parts import BRAKE, DRIVE, RESISTANCE, SENSORS, STEER
from mjmerge.world.model import World

_LOCKED_RADPS = 1.0  # a brake's full torque is reached from this wheel speed on
_SETTLED_S = 5.0  # after which a car on its springs is at rest
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
        mismatch: Sequence[Mismatch] | None = None,
        gravity_mps2: Array | None = None,
    ) -> None:
        """At t = 0, with the cars rolling straight ahead; those without speed have stood for a while.

        Args:
            world: the compiled world of C cars.
            front_m: front-axle centres, m, (N, C, 2).
            speed_mps: speeds, m/s, (N, C).
            substeps: physics steps per control step.
            threads: threads for the physics, 0 for all cores.
            heading_rad: headings, rad, (N, C); along the road by default.
            mismatch: what is different in each simulation, N of them; by default all are as the world is.
            gravity_mps2: in the frame of the road, (N, 3); by default what the mismatch says.

        Raises:
            ModelError: the world was built for shorter delays, or a car lacks what is to be changed.
        """
        model, cars = world.model, world.cars
        runs = len(front_m)
        truth = Truth.of(world, mismatch)
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

        # every sensor read, in the order read: the first car's, the second's, ..., clearances
        self._order = np.array(
            [adr(f"{car}/{name}") + i for car in cars for name, n in SENSORS.items() for i in range(n)]
            + [adr(f"clearance_{a}_{b}") for a, b in combinations(cars, 2)]
        )

        ends = np.cumsum([*SENSORS.values()]).tolist()
        self._each = ends[-1]
        self._sensor_at = {
            name: slice(end - n, end) for (name, n), end in zip(SENSORS.items(), ends, strict=True)
        }

        def actuators(names: Sequence[str]) -> NDArray[np.intp]:
            return np.array([[model.actuator(f"{car}/{n}").id for n in names] for car in cars])

        there = {model.actuator(i).name: i for i in range(model.nu)}
        motors = [(c, w, f"{car}/{n}") for c, car in enumerate(cars) for w, n in enumerate(DRIVE)]
        car, wheel, motor_at = np.array([(c, w, there[name]) for c, w, name in motors if name in there]).T
        # every actuator, in the order written
        parts = (actuators(STEER), actuators(BRAKE), actuators([RESISTANCE]), motor_at)
        self._commands_at = np.concatenate([part.ravel() for part in parts])
        self._wheel_steer = np.zeros((runs, len(cars), len(STEER)))
        spin_at = model.jnt_dofadr[world.ids("joint", "spin_{}")]

        self._spin_limit_radps = world.number("spin_limit_radps")[:, None]
        self._driven_at = len(WHEELS) * car + wheel
        driven = np.bincount(car, minlength=len(cars))
        self._motor_limit_w = (world.number("power_limit_w") / driven)[:, None]
        rate = truth.steer_rate * world.number("steer_rate_limit_radps")
        self._most_turn_rad = rate[..., None] * self._step_s
        self._mass_kg, self._radius_m = truth.mass_kg, truth.radius_m
        self._rolling_n = world.number("rolling_resistance") * (truth.mass_kg * truth.down_mps2)
        self._drag_n_per_mps2 = AIR_KG_PER_M3 / 2 * world.number("drag_area_m2")

        # geometry of its own cars, to turn two wheel angles into one: what a steering sensor reports
        self._wheelbase_m = np.array([s.wheelbase_m for s in world.sheets])
        self._track_m = np.array([s.track_m for s in world.sheets])
        self._steer_command = np.zeros((runs, len(cars)))

        still = np.zeros_like(speed_mps)
        heading = still if heading_rad is None else heading_rad
        self._qpos[:] = world.qpos(front_m, heading, np.stack([still, still], axis=-1), still)
        self._qvel[:] = world.qvel(speed_mps, heading)
        self._qvel[:, spin_at] = speed_mps[..., None] / self._radius_m
        height_at = np.array([model.joint(f"{car}/free/").qposadr[0] + 2 for car in cars])
        own_m = model.geom_size[world.ids("geom", "tyre_{}"), 0]
        self._qpos[:, height_at] += (self._radius_m - own_m)[..., 0]
        for name, values in truth.changed.items():
            field = self.batch.expand(name)
            field[:] = values[:, : field.shape[1]]  # of bvh_aabb a batch has the bodies', not the meshes'
        self._tyres, self._friction, self._off_patch = truth.tyres, truth.friction, truth.friction
        yaw_at = np.array([model.joint(f"{car}/free/").dofadr[0] + 5 for car in cars])
        self._turning = np.concatenate([yaw_at, spin_at.ravel()])
        self._wheels_m = world.wheels_m()
        self._wind_n = np.zeros((runs, len(cars), 2))
        self._patch: Patch | None = None
        self._pair_friction: Array | None = None
        self._lag: Lag | None = None
        self._late: Past | None = None
        self._holding = Holding(truth.mass_kg, speed_mps)
        self._held = self._holding.held
        if mismatch is not None:
            self._mismatched(mismatch)
        if truth.late_steps.any():
            self._delay_brakes(np.broadcast_to(truth.late_steps, runs))
        pairs = world.pairs
        self._impedance = self.batch.expand("pair_solimp")
        self._damping = self.batch.expand("pair_solreffriction")
        self._pairs = slice(int(pairs[0, 0]), int(pairs[-1, -1]) + 1)
        assert np.array_equal(pairs.ravel(), np.arange(self._pairs.start, self._pairs.stop))
        self._contacts = Contacts(world, self.batch, substeps)
        self._gravity = self.batch.expand("opt.gravity")
        if gravity_mps2 is not None:
            self._gravity[:] = gravity_mps2
        self._brakes = Brakes(world, self.batch, truth.brake_limit_n_m)
        self._bristles = Bristles(world, self.batch, truth.tyres, self._radius_m)
        if self._held.any():
            self._settle(world, front_m)
        self.batch.forward()
        self._sense()
        self._grip()

    def _settle(self, world: World, front_m: Array) -> None:
        """Gives the cars that stand the posture that they come to on their springs, with their brakes on.

        Nothing else is changed: all cars stand for a while, and what moves is then put back as it was.
        """
        stands, runs = self._held, np.flatnonzero(self._held.any(axis=1))
        before = self.batch.state.copy()
        self._held = np.ones_like(stands)
        self._brakes(self._held, self._brakes.none)
        self._qvel[:] = 0.0
        self.batch.forward()
        for _ in range(ceil(_SETTLED_S / self._step_s)):
            self._sense()
            self._grip()
            try:
                self.batch.step(runs, self._substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)
            except SimulationError:
                break  # which it will find again by itself
        self.batch.forward()
        self._sense()
        after, at = self._qpos.copy(), self._now["front_position"][..., :2].copy()
        self.batch.state[:] = before
        self._held = stands
        for c, car in enumerate(self._cars):
            mine = world.posture(car)
            self._qpos[:, mine] = np.where(stands[:, c, None], after[:, mine], self._qpos[:, mine])
            root = mine[:2]
            moved = after[:, root] - at[:, c] + front_m[:, c]
            self._qpos[:, root] = np.where(stands[:, c, None], moved, self._qpos[:, root])
        self._brakes(stands, self._brakes.none)

    def _mismatched(self, mismatch: Sequence[Mismatch]) -> None:
        """What a mismatch changes outside the model; none of it where no simulation has it."""
        wind_n = column(mismatch, "side_wind_n")
        if wind_n.any():
            chassis = self.batch.model.body(f"{self._cars[0]}/chassis").id
            self.batch.bind("xfrc_applied")[:, chassis, 1] = self._wind_n[:, 0, 1] = wind_n
        if any(m.patch_friction is not None for m in mismatch):
            self._patch = Patch.of(mismatch)
        lag_s = column(mismatch, "drive_lag_s")
        if lag_s.any():
            self._lag = Lag(lag_s, self._step_s, len(WHEELS))

    def _delay_brakes(self, late_steps: NDArray[np.int64]) -> None:
        """Brakes as late as everything else, by so many physics steps, (N,).

        Whole ticks are delayed here, as torque, because a brake's damping goes with the speed that the wheel
        has then. The steps that remain are MuJoCo's, as all of motors and steering are.
        """
        model = self.batch.model
        ticks, steps = np.divmod(late_steps, self._substeps)
        first = np.zeros((len(ticks), len(WHEELS) + 1))
        first[:, -1] = self._held[:, 0]  # who stands at first, holds until told otherwise
        delay_s = ticks * self._step_s
        self._late, self._late_by = Past(first, float(delay_s.max()), self._step_s), Age(ticks, None)
        if steps.any():
            brakes = [model.actuator(f"{self._cars[0]}/{name}").id for name in BRAKE]
            self.batch.expand("actuator_delay")[:, brakes] = asked_s(steps, model.opt.timestep)[:, None]

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
        cars, each = len(self._cars), self._each
        values = self._sensors.take(self._order, axis=1)
        of_cars = values[:, : cars * each].reshape(-1, cars, each)
        self._now = {name: of_cars[..., at] for name, at in self._sensor_at.items()}
        self._clearance = values[:, cars * each :]
        qvel = self._qvel.take(self._turning, axis=1)
        self._yaw_rate, self._spin = qvel[:, :cars], qvel[:, cars:].reshape(-1, cars, len(WHEELS))

    def _grip(self) -> None:
        """Sets every tyre's contact for the speed of its wheel over the road."""
        now, (x_m, y_m) = self._now, self._wheels_m
        v, yaw_rate = now["rear_velocity"], self._yaw_rate[..., None]
        ahead, across = v[..., :1] - yaw_rate * y_m, v[..., 1:2] + yaw_rate * x_m
        angle = np.zeros(ahead.shape)
        angle[..., 0], angle[..., 1] = now["steer_left"][..., 0], now["steer_right"][..., 0]
        cos, sin = np.cos(angle), np.sin(angle)
        rim = self._spin * self._radius_m
        slip = np.hypot(ahead * cos + across * sin - rim, across * cos - ahead * sin)
        if self._patch is not None:
            axis, front_m = now["forward_axis"], now["front_position"]
            along_m = front_m[..., :1] + (x_m - x_m[:, :1]) * axis[..., :1] - y_m * axis[..., 1:2]
            friction = self._patch.friction(along_m, self._off_patch)
            self._rub(friction)
            self._friction = friction
        d, damping = self._tyres.contact(np.hypot(ahead, across), slip, self._friction)
        still = self._held
        if stands := bool(still.any()):
            still = still & (np.abs(v[..., 0]) <= CRAWL_MPS)
            d = np.where(still[..., None], np.minimum(d, STILL), d)
        self._impedance[:, self._pairs, :2] = d.reshape(len(d), -1, 1)
        self._damping[:, self._pairs, 1] = -damping.reshape(len(d), -1)
        if self._bristles.bent or stands:
            pull = self._mass_kg[..., None] * self._gravity[:, None, :2] + self._wind_n
            left = self._bristles(still, pull, self._friction)
            self._rub(left)

    def _rub(self, friction: Array) -> None:
        """Sets mu of every tyre, (N, C, 4)."""
        if self._pair_friction is None:
            self._pair_friction = self.batch.expand("pair_friction")
        self._pair_friction[:, self._pairs, :2] = friction.reshape(len(friction), -1, 1)

    def step(self, controls: Controls, running: Mask) -> None:
        """See :meth:`Plant.step`."""
        turn = limit(controls.wheel_steer_rad - self._wheel_steer, self._most_turn_rad)
        self._wheel_steer = self._wheel_steer + turn
        commands = self._wheel_steer, *self._drive(controls.torque_n_m)
        flat = [part.reshape(len(self._ctrl), -1) for part in commands]
        self._ctrl[:, self._commands_at] = np.concatenate(flat, axis=1)
        self._steer_command = controls.steer_rad
        self._grip()
        ids = None if running.all() else np.flatnonzero(running)
        self._contacts.before(self._now, self._yaw_rate)
        try:
            self.batch.step(ids, self._substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)
        except SimulationError as error:
            self._errors = {int(i): self.batch.error(int(i)) for i in error.ids}
        self._sense()
        self._contacts.after()

    def _drive(self, torque_n_m: Array) -> tuple[Array, Array, Array]:
        """Of brakes, (N, C, 4), resistance, (N, C), and the M motors, (N, M): what is told them.

        Torque along the car's motion goes to the motors; against it to the brakes, which only resist. A car
        that stands holds its brakes unless it is asked to go, see :mod:`mjmerge.plant.hold`.

        A brake is a damper whose coefficient gives that torque at the wheel's present speed, so that a wheel
        that locks stays locked instead of spinning backwards. Torques lag and brakes are late before that;
        motors are late in MuJoCo.
        """
        v = self._now["rear_velocity"][..., 0]
        speed = np.abs(v)
        braking = (torque_n_m * v[..., None] < 0) & (speed > CRAWL_MPS)[..., None]
        spin = np.abs(self._spin)
        rolling_radps = np.maximum(spin, _LOCKED_RADPS)
        driving = ~braking & (spin < self._spin_limit_radps)
        torque = limit(torque_n_m, self._motor_limit_w / rolling_radps)
        drive, brake = np.where(driving, torque, 0.0), np.where(braking, np.abs(torque_n_m), 0.0)
        if self._lag is not None:
            drive[:, 0], brake[:, 0] = self._lag(drive[:, 0], brake[:, 0])
        forward = self._now["forward_axis"]
        slope = self._gravity[:, :1] * forward[..., 0] + self._gravity[:, 1:2] * forward[..., 1]
        resistance = self._drag_n_per_mps2 * v * speed + self._rolling_n * limit(v / ROLLS_MPS, 1.0)
        push = (drive - np.sign(v)[..., None] * brake).sum(axis=-1) / self._radius_m[..., 0]
        push -= np.where(speed > CRAWL_MPS, resistance, 0.0)  # what it takes to go on
        held = self._holding(v, push, slope)
        if self._late is not None:
            self._late.push(np.concatenate([brake[:, 0], held[:, :1]], axis=1))
            late = self._late.ago(self._late_by)
            brake[:, 0], held = late[:, :-1], held.copy()
            held[:, 0] = late[:, -1] > 0.5
        self._held = held
        slow = held[..., None] | (speed[..., None] < _LOCKED_RADPS * self._radius_m)
        self._brakes(held, np.where(slow, brake, 0.0))
        damping = np.where(slow, 0.0, brake / rolling_radps)
        return damping, -resistance, drive.reshape(len(drive), -1).take(self._driven_at, axis=1)

    def contacts(self) -> tuple[Array, Array]:
        """See :meth:`Plant.contacts`."""
        return self._contacts()

    def faults(self) -> list[Fault]:
        """See :meth:`Plant.faults`."""
        up = self._now["up_axis"][..., 2]
        if not self._errors and up.min() > _TILTED:  # no NaN either
            return []
        found = [Fault(run, 0, f"MuJoCo: {message}") for run, message in self._errors.items()]
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


def make(scenarios: Sequence[Scenario], world: World | None, threads: int) -> MuJoCo:
    """At t = 0; see :func:`mjmerge.plant.make`."""
    assert world is not None, "the mujoco plant stands in a world"
    (front_m, speed_mps), mismatch = start(scenarios), mismatches(scenarios)
    substeps = scenarios[0].substeps
    return MuJoCo(world, front_m, speed_mps, substeps=substeps, threads=threads, mismatch=mismatch)
