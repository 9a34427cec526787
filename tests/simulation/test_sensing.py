"""What the ego is told: each fault of sensing by itself, on a motion that is known exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjmerge import judge, load, simulate
from mjmerge.scenario.mismatch import SENSING, Mismatch
from mjmerge.simulation.sensing import Sensing, exact
from mjmerge.state import Cars
from mjmerge.vehicle.delay import Age, Past

H = 0.01
A, V = 0.4, 2.0  # all cars: x = x_0 + V t + A t^2/2, on a line


def cars_at(t, runs=1, heading=0.0):
    front = np.zeros((runs, 3, 2))
    front[..., 0] = np.array([-1.0, 0.0, -2.5]) + V * t + A * t * t / 2
    front[:, 0, 1] = 1.4
    velocity = np.zeros((runs, 3, 2))
    velocity[..., 0] = V + A * t
    whole = np.full((runs, 3), heading)
    return Cars(front, velocity, whole, velocity[..., 0], whole * 0 + 0.1, whole * 0, np.zeros((runs, 3)))


def told(ticks, *mismatches, seeds=None, heading=0.0):
    """What the ego is told at every tick: positions, velocities, (T, N, 3, 2), and u_1, (T, N, 2)."""
    runs = len(mismatches)
    sense = Sensing(mismatches, seeds or list(range(runs)), H, 2)
    p, v, u = [], [], []
    for k in range(ticks):
        u_1 = np.full((runs, 2), [1.0 + k, 0.0])
        seen, u_1 = sense(cars_at(k * H, runs, heading), u_1)
        p.append(seen.front_m)
        v.append(seen.velocity_mps)
        u.append(u_1)
    return np.array(p), np.array(v), np.array(u)


def truth(ticks):
    return told(ticks, Mismatch())


@given(st.floats(0, 2), st.floats(-0.3, 0.3))
@settings(max_examples=20)
def test_no_physical_mismatch_keeps_the_ego_from_the_truth(friction, bank):
    mismatch = Mismatch(friction=max(friction, 0.01), bank_rad=bank, load_kg=1.0, command_delay_s=0.1)
    assert exact(mismatch)
    cars, u_1 = cars_at(0.3), np.ones((1, 2))
    assert Sensing([mismatch], [0], H, 2)(cars, u_1) == (cars, u_1)  # the very same objects


FAULTS = {
    "sensing_delay_s": 0.03,
    "position_noise_m": 0.01,
    "velocity_noise_mps": 0.01,
    "heading_noise_rad": 0.01,
    "steer_noise_rad": 0.01,
    "neighbour_position_noise_m": 0.01,
    "neighbour_velocity_noise_mps": 0.01,
    "neighbour_position_bias_m": 0.05,
    "neighbour_reference_m": 0.1,
    "neighbour_dropout": 0.5,
    "neighbour_velocity_window_s": 0.05,
    "leader_acceleration": "unknown",
    "leader_acceleration_delay_s": 0.05,
}


def test_every_fault_of_sensing_is_tested():
    assert set(FAULTS) == set(SENSING)
    assert not any(exact(Mismatch(**{name: value})) for name, value in FAULTS.items())


@pytest.mark.parametrize("delay_s", [0.01, 0.04, 0.2])
def test_a_delay_of_whole_ticks_tells_what_was_then_bit_for_bit(delay_s):
    p, v, _ = told(40, Mismatch(sensing_delay_s=delay_s))
    p_0, v_0, _ = truth(40)
    late = round(delay_s / H)
    assert np.array_equal(p[late:], p_0[:-late])
    assert np.array_equal(v[late:], v_0[:-late])
    assert np.array_equal(p[:late], np.repeat(p_0[:1], late, axis=0))  # before the start nothing moved


def test_a_delay_between_ticks_is_interpolated():
    _, v, _ = told(40, Mismatch(sensing_delay_s=0.025))
    assert v[10:, 0, 0, 0] == pytest.approx(V + A * (np.arange(10, 40) * H - 0.025))


@pytest.mark.parametrize(
    ("name", "of", "cars"),
    [
        ("position_noise_m", 0, [0]),
        ("velocity_noise_mps", 1, [0]),
        ("neighbour_position_noise_m", 0, [1, 2]),
        ("neighbour_velocity_noise_mps", 1, [1, 2]),
    ],
)
def test_noise_has_its_deviation_and_touches_nothing_else(name, of, cars):
    seen, real = told(2000, Mismatch(**{name: 0.05})), truth(2000)
    for what in (0, 1):
        error = seen[what] - real[what]
        for car in range(3):
            if what == of and car in cars:  # 2000 samples: 5 deviations of their deviation are 8 %
                assert error[:, 0, car].std(axis=0) == pytest.approx(0.05, rel=0.08)
                assert np.abs(error[:, 0, car].mean(axis=0)).max() < 5 * 0.05 / np.sqrt(2000)
            else:
                assert (error[:, :, car] == 0).all()


def test_noise_is_new_at_every_tick_and_in_every_component():
    error = (told(2000, Mismatch(neighbour_position_noise_m=1.0))[0] - truth(2000)[0])[:, 0, 1:].reshape(
        2000, 4
    )
    assert np.abs(np.corrcoef(error.T) - np.eye(4)).max() < 0.12
    assert np.abs(np.mean(error[1:] * error[:-1], axis=0)).max() < 0.12


def test_a_bias_moves_the_neighbours_along_the_road():
    error = told(5, Mismatch(neighbour_position_bias_m=0.3))[0] - truth(5)[0]
    assert error[:, 0, 1:] == pytest.approx(np.broadcast_to([0.3, 0.0], (5, 2, 2)))
    assert (error[:, 0, 0] == 0).all()


def test_another_reference_point_lies_behind_the_axle_along_the_neighbours_heading():
    mismatch = Mismatch(neighbour_reference_m=0.4)
    error = told(3, mismatch, heading=0.3)[0] - truth(3)[0]
    assert error[:, 0, 1:] == pytest.approx(
        np.broadcast_to([-0.4 * np.cos(0.3), -0.4 * np.sin(0.3)], (3, 2, 2))
    )


def test_a_neighbour_that_is_not_seen_goes_on_at_its_last_velocity():
    p, v, _ = told(500, Mismatch(neighbour_dropout=0.5))
    real_p, real_v, _ = truth(500)
    seen = v[:, 0, 1:, 0] == real_v[:, 0, 1:, 0]
    assert seen[1:].mean() == pytest.approx(0.5, abs=0.1)
    for car in (1, 2):
        for k in np.flatnonzero(~seen[:, car - 1]):
            assert v[k, 0, car, 0] == v[k - 1, 0, car, 0]
            assert p[k, 0, car, 0] == pytest.approx(p[k - 1, 0, car, 0] + H * v[k - 1, 0, car, 0])
    assert (p[:, 0, 0] == real_p[:, 0, 0]).all()


@pytest.mark.parametrize("window_s", [0.01, 0.05, 0.1])
def test_a_velocity_from_positions_is_the_mean_over_its_window(window_s):
    """For a constant acceleration that is the velocity half a window ago."""
    _, v, _ = told(60, Mismatch(neighbour_velocity_window_s=window_s))
    t = np.arange(20, 60) * H
    assert v[20:, 0, 1, 0] == pytest.approx(V + A * (t - window_s / 2))
    assert v[20:, 0, 0, 0] == pytest.approx(V + A * t)


def test_differences_of_noisy_positions_are_as_noisy_as_the_window_is_short():
    """sqrt(2) sigma / window."""
    mismatch = Mismatch(neighbour_position_noise_m=0.01, neighbour_velocity_window_s=0.1)
    error = told(3000, mismatch)[1][20:, 0, 2, 1]
    assert error.std() == pytest.approx(np.sqrt(2) * 0.01 / 0.1, rel=0.15)


def test_the_leaders_acceleration_is_told_late_or_not_at_all():
    _, _, u = told(30, Mismatch(leader_acceleration_delay_s=0.05), Mismatch(leader_acceleration="unknown"))
    assert np.array_equal(u[5:, 0, 0], np.arange(1.0, 26.0))
    assert (u[:, 1] == 0).all()


mixes = st.fixed_dictionaries({}, optional={n: st.just(v) for n, v in FAULTS.items()}).map(
    lambda f: Mismatch(**f)
)


@given(st.lists(mixes, min_size=2, max_size=4), st.integers(0, 5))
@settings(max_examples=25)
def test_a_simulation_is_told_the_same_alone_as_among_others(mismatches, seed):
    seeds = list(range(seed, seed + len(mismatches)))
    among = told(30, *mismatches, seeds=seeds)
    for i, mismatch in enumerate(mismatches):
        alone = told(30, mismatch, seeds=[seeds[i]])
        for a, b in zip(alone, among, strict=True):
            assert np.array_equal(a[:, 0], b[:, i])


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=30), st.floats(0, 0.2))
def test_the_past_is_what_was_pushed(values, age_s):
    past = Past(np.array([values[0]]), 0.2, H)
    for value in values[1:]:
        past.push(np.array([value]))
    history = np.array([values[0]] * 25 + values)
    ticks = np.arange(len(history)) - (len(history) - 1)
    assert past.ago(Age.of(np.array([age_s]), H))[0] == pytest.approx(
        np.interp(-age_s / H, ticks, history), abs=1e-9
    )


@pytest.mark.parametrize("plant", ["double_integrator", "bicycle", "mujoco"])
def test_the_truth_is_recorded_and_what_was_told_beside_it(plant):
    scenario = load("charge", ["duration_s=1", "mismatch.neighbour_position_bias_m=0.2"])
    trace = simulate(scenario, plant)
    r = scenario.law.r_m
    apart = np.linalg.norm(trace.front_m[0, :, :1] - trace.front_m[0, :, 1:], axis=-1) - r
    assert trace.distance_m[0] == pytest.approx(apart, abs=1e-12)
    shifted = trace.front_m[0].copy()
    shifted[:, 1:, 0] += 0.2
    apart = np.linalg.norm(shifted[:, :1] - shifted[:, 1:], axis=-1) - r
    assert trace.sensed_distance_m[0] == pytest.approx(apart, abs=1e-12)
    assert "distances known" in [b.hypothesis for b in judge(trace)[0].breaches]


def test_a_measurement_that_is_late_is_a_delay_of_the_loop():
    scenario = load("charge", ["duration_s=0.5", "mismatch.sensing_delay_s=0.4"])
    near = judge(simulate(scenario, "double_integrator"))[0]
    assert "delay small against d" not in [b.hypothesis for b in near.breaches]  # 2 k_o tau/pi = 0.25 m
    scenario = load("charge", ["duration_s=6", "mismatch.sensing_delay_s=0.4"])
    assert "delay small against d" in [
        b.hypothesis for b in judge(simulate(scenario, "double_integrator"))[0].breaches
    ]


@pytest.mark.parametrize("row", [0, 1])
def test_who_is_told_the_truth_is_told_all_of_it_also_among_others(row):
    """Down to the sign of a zero, which adding a noise of none would lose."""
    mismatches = [Mismatch(position_noise_m=0.01)] * 2
    mismatches[row] = Mismatch()
    sense, rng = Sensing(mismatches, [1, 2], H, 2), np.random.default_rng(2)

    def zeros_and_ones(shape):
        return np.copysign(rng.integers(0, 2, shape), rng.normal(size=shape))

    for _ in range(30):
        cars = Cars(*(zeros_and_ones(a.shape) for a in vars(cars_at(0, runs=2)).values()))
        u_1 = zeros_and_ones((2, 2))
        seen, told_u_1 = sense(cars, u_1)
        for name, true in vars(cars).items():
            assert getattr(seen, name)[row].tobytes() == true[row].tobytes(), name
        assert told_u_1[row].tobytes() == u_1[row].tobytes()
