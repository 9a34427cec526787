"""Delays of a car: in every physics step, all actuators of the ego do what they were told a dead time ago."""

import numpy as np
import pytest

from mjmerge.plant.mujoco import MuJoCo
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.vehicle.actuation import BelievedCars, command
from mjmerge.vehicle.delay import steps_late
from mjmerge.world.checks.parts import BRAKE, DRIVE, STEER
from mjmerge.world.compose import single

STEP_S, SUBSTEPS = 0.001, 10
LOCKED_RADPS = 1.0  # below this wheel speed a brake is a plain damper
LONGEST_S = 0.237


class Watched(MuJoCo):
    """A plant that notes, for the ego, what it was told per tick, and what its actuators did per step."""

    def __init__(self, world, mismatch):
        runs = len(mismatch)
        super().__init__(
            world, np.zeros((runs, 1, 2)), np.full((runs, 1), 3.0), substeps=SUBSTEPS, mismatch=mismatch
        )
        model = world.model
        self._at = {
            kind: [model.actuator(f"ego/{name}").id for name in names]
            for kind, names in {"drive": DRIVE, "steer": STEER, "brake": BRAKE}.items()
        }
        self._spin_at = [model.jnt_dofadr[j] for j in world.ids("joint", "spin_{}")[0]]
        self._fields = {n: self.batch.bind(f"actuator_{n}") for n in ("force", "length", "velocity")}
        self._all, self.batch.step = self.batch.step, self._one_by_one
        self.ctrl, self.spin, self.did = [], [], []

    def _one_by_one(self, ids, nstep, stage):
        self.ctrl.append(self.batch.bind("ctrl").copy())
        self.spin.append(np.abs(self.batch.bind("qvel")[:, self._spin_at]))
        for _ in range(nstep):
            self._all(ids, 1)
            self.did.append({name: field.copy() for name, field in self._fields.items()})
        self.batch.forward(ids, stage)

    def told(self, kind):
        """What was written for each tick, (T, N, actuators)."""
        return np.array(self.ctrl)[..., self._at[kind]]

    def done(self, kind, name):
        """Force, length or velocity of each physics step, (K, N, actuators)."""
        return np.array([step[name] for step in self.did])[..., self._at[kind]]


def ago(told, steps):
    """The oracle: of what was told per tick, what was in force that many physics steps before, (K, ...)."""
    per_step = np.repeat(told, SUBSTEPS, axis=0)
    return np.concatenate([np.zeros_like(per_step[:1])] * steps + [per_step])[: len(per_step)]


@pytest.fixture(scope="module")
def watched(request):
    """Random pedals and steering for seconds, on cars that differ in their dead times alone."""
    ticks = 1500 if request.config.getoption("--long") else 220
    rng = np.random.default_rng(8)
    whole, parts = rng.integers(1, 237, 3) * STEP_S, rng.uniform(0, 0.237, 3)
    delays_s = np.array([0.0, 0.0004, 0.01, 0.1, 0.155, 0.164, LONGEST_S, *whole, *parts])
    world = single("rc", delays_s={"ego": LONGEST_S}, physics_step_s=STEP_S)
    plant = Watched(world, [Mismatch(command_delay_s=d) for d in delays_s])
    believed, everyone = BelievedCars.of(world.sheets, limited=True), np.ones(len(delays_s), dtype=bool)
    torques = []
    for _ in range(ticks):
        cars = plant.observe()
        a = rng.normal(size=1) + 2 * (3.0 - cars.speed_mps)
        controls = command(cars, a, np.full_like(a, rng.uniform(-0.05, 0.05)), believed)
        torques.append(controls.torque_n_m[:, 0])
        plant.step(controls, everyone)
    assert not plant.faults()
    return plant, delays_s, np.array(torques)


def test_motors_give_the_torque_of_a_dead_time_ago(watched):
    plant, delays_s, _ = watched
    force, told = plant.done("drive", "force"), plant.told("drive")
    for i, late in enumerate(steps_late(delays_s, STEP_S).tolist()):
        assert np.array_equal(force[:, i], ago(told[:, i], late)), delays_s[i]
        assert np.count_nonzero(force[:, i]) > len(force) / 4


def test_servos_turn_to_the_angle_of_a_dead_time_ago(watched):
    plant, delays_s, _ = watched
    model, told = plant.batch.model, plant.told("steer")
    servos = [model.actuator(f"ego/{name}") for name in STEER]
    gain, bias, most = (
        np.array([getattr(s, n) for s in servos]) for n in ("gainprm", "biasprm", "forcerange")
    )
    force, length, speed = (plant.done("steer", name) for name in ("force", "length", "velocity"))
    free = np.abs(force) < 0.999 * most[:, 1]
    angle = (force - bias[:, 1] * length - bias[:, 2] * speed) / gain[:, 0]
    for i, late in enumerate(steps_late(delays_s, STEP_S).tolist()):
        expected = ago(told[:, i], late)
        assert angle[:, i][free[:, i]] == pytest.approx(expected[free[:, i]], abs=1e-9), delays_s[i]
        assert free[:, i].mean() > 0.5


def test_brakes_give_the_torque_of_a_dead_time_ago(watched):
    """That torque, over the wheel's speed at the tick whose coefficient is in force, times its speed now."""
    plant, delays_s, torques = watched
    force, speed = (plant.done("brake", name) for name in ("force", "velocity"))
    spin = np.maximum(np.array(plant.spin), LOCKED_RADPS)
    braked = np.where(torques < 0, -torques, 0.0)
    for i, late in enumerate(steps_late(delays_s, STEP_S).tolist()):
        coefficient = -force[:, i] / speed[:, i]
        then = np.maximum(ago(spin[:, i], late % SUBSTEPS), LOCKED_RADPS)
        expected = ago(braked[:, i], late)
        assert coefficient * then == pytest.approx(expected, rel=1e-9, abs=1e-12), delays_s[i]
        assert np.count_nonzero(expected) > expected.size / 8
