"""A run's bits do not depend on its company: run i of any batch is run i alone."""

import numpy as np
import pytest

from mjmerge.plant import PLANTS
from mjmerge.scenario.axis import ranges
from mjmerge.scenario.effect import acting
from mjmerge.scenario.levels import LEVELS
from mjmerge.scenario.load import load
from mjmerge.scenario.mismatch import SENSING, Mismatch
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import COLUMNS

PHYSICS_STEP_S = 0.002
STANDS = ("initial.vehicle_1.speed_mps=0", "drivers.vehicle_1.speed_mps=0")
SCENARIOS = (
    ("charge", ()),
    ("paper", ()),
    ("flips", ()),
    ("blocked", ()),
    ("highway", ()),
    ("van_behind", ()),
    ("wet", ()),
    ("charge", STANDS),
    ("blocked", (*STANDS, "initial.ego.speed_mps=0")),
)
"""What the batches are of: every kind of driver, both sizes, and cars that stand."""
CHOICES = {name: found["enum"] for name, found in ranges(Mismatch).items() if "enum" in found}
SPREAD = {
    axis: (min(values), max(values))
    for axis, levels in LEVELS["rc"].items()
    if axis not in CHOICES and (values := [level[axis] for level in levels])
} | {
    "friction": (0.2, 1.2),
    "left_friction": (0.2, 1.2),
    "patch_friction": (0.1, 1.0),
    "patch_start_m": (-2.0, 20.0),
    "patch_length_m": (0.0, 10.0),
    "grade_rad": (-0.1, 0.1),
    "bank_rad": (-0.05, 0.05),
    "side_wind_n": (-3.0, 3.0),
    "load_kg": (0.0, 2.0),
    "load_ahead_m": (-0.1, 0.1),
    "load_above_m": (0.0, 0.1),
    "com_raised_m": (0.0, 0.02),
    "yaw_inertia": (0.8, 1.3),
    "wheel_radius": (0.9, 1.1),
    "front_stiffness": (0.5, 2.0),
    "rear_stiffness": (0.7, 2.0),
    "suspension_stiffness": (0.5, 2.0),
    "torque_limit": (0.3, 2.0),
    "brake_limit": (0.3, 2.0),
    "steer_limit_rad": (0.05, 0.4),
    "steer_rate_limit": (0.3, 2.0),
    "steer_lag": (0.5, 8.0),
    "steer_offset_rad": (-0.1, 0.1),
    "drive_lag_s": (0.0, 0.2),
    "position_noise_m": (0.0, 0.01),
    "velocity_noise_mps": (0.0, 0.02),
    "heading_noise_rad": (0.0, 0.01),
    "steer_noise_rad": (0.0, 0.01),
    "neighbour_position_noise_m": (0.0, 0.01),
    "neighbour_velocity_noise_mps": (0.0, 0.02),
    "neighbour_position_bias_m": (-0.05, 0.05),
    "neighbour_reference_m": (0.0, 0.2),
    "neighbour_dropout": (0.0, 0.5),
}
"""Where each number is drawn from: its levels, or wider."""
DELAYS = ("command_delay_s", "sensing_delay_s", "neighbour_velocity_window_s", "leader_acceleration_delay_s")


def delay(rng):
    """None, whole control steps, whole physics steps, parts of them, less than one, or any."""
    tick, step = 0.01, PHYSICS_STEP_S
    return float(
        rng.choice(
            [
                0.0,
                rng.integers(1, 25) * tick,
                rng.integers(1, 125) * step,
                (rng.integers(1, 125) + 0.5) * step,
                rng.uniform(0.0, step),
                rng.uniform(0.0, 0.25),
            ]
        )
    )


def mixed(rng, scenario, plant):
    """Nothing, one thing, a few or all that a plant has different; commands are late more often than not."""
    names = [*Mismatch.model_fields]
    count = rng.choice([0, 1, 4, len(names)], p=[0.15, 0.25, 0.45, 0.15])
    drawn = {str(name) for name in rng.choice(names, count, replace=False)}
    if count and rng.random() < 0.6:
        drawn.add("command_delay_s")
    values = {}
    for name in sorted(drawn):
        if name in DELAYS:
            values[name] = delay(rng)
        else:
            values[name] = str(rng.choice(CHOICES[name])) if name in CHOICES else rng.uniform(*SPREAD[name])
    return acting(scenario.model_copy(update={"mismatch": Mismatch(**values)}), plant).mismatch


def cases(rng, scenario, plant, most):
    """Seed and mismatch of two runs or more, few more often than many."""
    count = int(2 * ((most + 0.99) / 2) ** rng.random())
    return [(int(rng.integers(1000)), mixed(rng, scenario, plant)) for _ in range(count)]


def bits(trace, run=0):
    stops = [(s.time_s, s.car, s.reason, s.touched) for s in trace.stops if s.run == run]
    return {c.name: getattr(trace, c.name)[run].tobytes() for c in COLUMNS} | {"stops": stops}


def assert_alone(scenario, plant, batch, threads):
    """Every run of a batch against the same run by itself, in a world of its own, bit for bit."""
    together = simulate(scenario, plant, cases=batch, threads=threads)
    for i, case in enumerate(batch):
        alone, among = bits(simulate(scenario, plant, cases=[case], threads=1)), bits(together, i)
        wrong = [name for name, value in alone.items() if value != among[name]]
        assert not wrong, f"{scenario.name} on {plant}: run {i} of {len(batch)}, {case}: {wrong}"


def test_what_is_drawn_below_leaves_no_axis_out():
    assert {*SPREAD, *CHOICES} == set(Mismatch.model_fields)
    assert set(DELAYS) - set(SENSING) == {"command_delay_s"}


def pytest_generate_tests(metafunc):
    """The long version: 200 batches of physical cars, and as many without bodies, of three plants."""
    if "batch" in metafunc.fixturenames:
        count = 67 if "plant" in metafunc.fixturenames else 200
        metafunc.parametrize("batch", range(count if metafunc.config.getoption("--long") else 3))


@pytest.mark.parametrize("plant", [p for p in PLANTS if p != "mujoco"])
def test_a_run_without_bodies_is_the_run_alone(plant, batch, long):
    rng = np.random.default_rng([batch, 1])
    duration_s, most = (12, 64) if long else (3, 6)
    name, keys = SCENARIOS[rng.integers(len(SCENARIOS))]
    scenario = load(name, [*keys, f"duration_s={duration_s}"])
    assert_alone(scenario, plant, cases(rng, scenario, plant, most), 1)


@pytest.mark.parametrize(
    ("name", "delays_s"), [("charge", [0.1, 0.155, 0.164, 0.2]), ("paper", [0.164, 0.165, 0.0, 0.0005])]
)
def test_a_dead_time_is_the_same_beside_any_other(name, delays_s, long):
    scenario = load(name, [] if long else ["duration_s=2"])
    assert_alone(scenario, "mujoco", [(0, Mismatch(command_delay_s=d)) for d in delays_s], 2)


def test_a_physical_run_is_the_run_alone(batch, long):
    rng = np.random.default_rng([batch, 2])
    duration_s, most = (12, 64) if long else (1.5, 4)
    name, keys = SCENARIOS[rng.integers(len(SCENARIOS))]
    scenario = load(name, [*keys, f"duration_s={duration_s}", f"physics_step_s={PHYSICS_STEP_S}"])
    assert_alone(scenario, "mujoco", cases(rng, scenario, "mujoco", most), 2)
