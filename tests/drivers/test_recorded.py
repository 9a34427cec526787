"""The driver that follows a record: the curve through its points, the way back to it, and what is refused."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from mjmerge.drivers import Along
from mjmerge.drivers.recorded import Recorded, curve
from mjmerge.errors import ScenarioError
from mjmerge.scenario.load import load
from mjmerge.search.calm import doing, said
from mjmerge.simulation.each import simulate_each
from mjmerge.simulation.loop import simulate

steps_s = st.lists(st.floats(0.02, 2.0), min_size=1, max_size=20)
HUNDREDTHS = np.arange(101) / 100


def points(steps):
    """Times of points that are so far apart, s."""
    return np.concatenate([[0.0], np.cumsum(steps)])


def sampled(found, times_s):
    """Way, speed and acceleration of a curve at times, (3, T)."""
    return np.array([found.at(t) for t in times_s.tolist()]).T


def record(times_s, travelled_m):
    """A record as keys of a scenario."""
    return str({"kind": "recorded", "time_s": times_s.tolist(), "travelled_m": travelled_m.tolist()})


def braking():
    """A car at 2 m/s that brakes to a stand and goes on, each 0.1 s: times, s, and the way, m."""
    t = np.arange(0, 3.05, 0.1)
    fine = np.arange(0, 3.0005, 0.001)
    v = np.interp(fine, [0.0, 0.5, 1.5, 2.0, 3.0], [2.0, 2.0, 0.0, 0.0, 1.5])
    way = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2) * 0.001])
    return t, np.interp(t, fine, way)


@given(steps_s, st.floats(0.0, 6.0))
def test_through_smooth_points_it_is_the_spline_without_a_knot_at_its_ends(steps, phase):
    t = points(np.minimum(steps, 0.5))
    x = 20 * t + np.sin(t + phase) - np.sin(phase)
    spline = CubicSpline(t, x)  # of fewer than four points a parabola, or a line
    at = np.concatenate([a + (b - a) * HUNDREDTHS[:-1] for a, b in pairwise(t)])
    for order, ours in enumerate(sampled(curve(tuple(t), tuple(x)), at)):
        assert ours == pytest.approx(spline(at, order), abs=1e-8 * 50**order)


@given(steps_s, st.data())
def test_it_goes_through_its_points_and_never_back_and_stands_where_they_do(steps, data):
    t = points(steps)
    ways = data.draw(st.lists(st.just(0.0) | st.floats(0.0, 30.0), min_size=len(steps), max_size=len(steps)))
    x = points(ways)
    found = curve(tuple(t.tolist()), tuple(x.tolist()))
    for (a, b), (low, high) in zip(pairwise(t), pairwise(x), strict=True):
        way, speed, _ = sampled(found, a + (b - a) * HUNDREDTHS)
        assert way[[0, -1]] == pytest.approx([low, high], abs=1e-9)
        assert (way >= low - 1e-9).all()
        assert (way <= high + 1e-9).all()
        assert speed.min() >= -1e-9 * (1 + np.abs(speed).max())
        if low == high:
            assert (way == low).all()
            assert (speed[:-1] == 0).all()


@given(steps_s, st.data())
def test_its_speed_does_not_jump(steps, data):
    t = points(steps)
    ways = data.draw(st.lists(st.floats(0.0, 30.0), min_size=len(steps), max_size=len(steps)))
    found = curve(tuple(t.tolist()), tuple(points(ways).tolist()))
    for at in t[1:-1].tolist():
        before, after = (found.at(at + side * 1e-9) for side in (-1, 1))
        steepest = max(abs(before[2]), abs(after[2]))
        assert abs(after[1] - before[1]) <= 1e-9 * (1 + 3 * steepest)


def test_of_a_stand_it_makes_neither_a_swing_nor_a_harder_brake():
    t, x = braking()
    way, speed, acceleration = sampled(curve(tuple(t), tuple(x)), np.arange(0, 3.0, 0.001))
    fine = np.arange(0, 3.0, 0.001)
    assert np.abs(speed - np.interp(fine, [0.0, 0.5, 1.5, 2.0, 3.0], [2.0, 2.0, 0.0, 0.0, 1.5])).max() < 0.04
    assert speed.min() == 0
    assert acceleration.min() > -1.2 * 2.0
    assert acceleration.max() < 1.2 * 1.5
    assert np.ptp(way[1600:1900]) == 0


def test_on_an_ideal_plant_the_car_is_where_the_record_was_within_a_tenth_of_a_millimetre():
    t, x = braking()
    first_mps = float(curve(tuple(t), tuple(x)).at(0.0)[1])
    changes = [
        f"drivers.vehicle_1={record(t, x)}",
        "duration_s=3",
        f"initial.vehicle_1.speed_mps={first_mps}",
    ]
    trace = simulate(load("paper", changes), "double_integrator")
    moved_m = trace.front_m[0, :, 1, 0] - trace.front_m[0, 0, 1, 0]
    assert moved_m[::10] == pytest.approx(x, abs=1e-4)
    assert trace.velocity_mps[0, :, 1, 0].min() > -1e-9
    assert np.abs(trace.u_mps2[0, :, 1, 0]).max() < 1.2 * 2.0


@pytest.mark.parametrize("hold_s", [0.01, 0.2, 1.0])
@pytest.mark.parametrize("off_m", [-0.5, 0.5])
def test_it_comes_back_to_its_record_without_reversing(off_m, hold_s):
    driver = Recorded(time_s=(0.0, 30.0), travelled_m=(0.0, 30.0))
    x, v, off = np.array([off_m]), np.array([1.0]), []
    for k in range(round(25 / hold_s)):
        u = driver.acceleration_mps2(k * hold_s, Along(x, v, np.zeros(1)), None, None, hold_s)
        x, v = x + v * hold_s + u * hold_s**2 / 2, v + u * hold_s
        off.append(float(x[0]) - (k + 1) * hold_s)
        assert v[0] > -1e-9
    assert abs(off[-1]) < 1e-3 * abs(off_m)
    assert min(np.sign(off_m) * np.array(off)) > -0.02 * abs(off_m)  # critically damped


def test_beyond_its_place_at_a_stand_it_waits_there_and_short_of_it_it_goes_on():
    driver = Recorded(time_s=(0.0, 1.0, 9.0), travelled_m=(0.0, 0.0, 0.0))
    x, h = np.array([0.1, -0.1]), 0.05
    v = np.zeros(2)
    for k in range(150):
        own = Along(x, v, np.zeros(2))
        assert driver.stands(k * h, own, h).all()
        u = driver.acceleration_mps2(k * h, own, None, None, h)
        x, v = x + v * h + u * h**2 / 2, v + u * h
    assert x[0] == 0.1
    assert x[1] == pytest.approx(0, abs=1e-3)


def test_it_starts_from_wherever_its_car_does_alone_and_among_others():
    t, x = braking()
    changes = [f"drivers.vehicle_1={record(t, x)}", "duration_s=0.4", "control_step_s=0.1"]
    apart = [load("paper", [*changes, f"initial.vehicle_1.front_m=[{at}, 0.0]"]) for at in (0.0, 0.3, 0.1)]
    together = simulate_each([(0, one) for one in apart], "double_integrator")
    for one, trace in zip(apart, together, strict=True):
        alone = simulate(one, "double_integrator")
        assert trace.front_m.tobytes() == alone.front_m.tobytes()
        moved_m = trace.front_m[0, :, 1, 0] - one.initial.vehicle_1.front_m[0]
        assert moved_m == pytest.approx(x[:5], abs=1e-3)


def test_another_size_is_the_same_run_at_that_size():
    t, x = braking()
    scenario = load("paper", [f"drivers.vehicle_1={record(t, x)}", "duration_s=3", "control_step_s=0.05"])
    scenario = scenario.settled()
    small, large = (simulate(one, "double_integrator") for one in (scenario, scenario.scaled(9.0)))
    assert large.front_m == pytest.approx(9 * small.front_m, rel=1e-9, abs=1e-9)
    assert large.scenario.drivers.vehicle_1.time_s[1] == pytest.approx(0.3)


def test_a_record_that_ends_before_the_run_is_refused_and_says_when():
    t, x = braking()
    keys = [f"drivers.vehicle_1={record(t, x)}"]
    assert load("paper", [*keys, "duration_s=3"]).duration_s == 3
    with pytest.raises(ScenarioError) as refused:
        load("paper", [*keys, "duration_s=3.01"])
    (problem,) = refused.value.problems
    assert (problem.key, problem.source) == ("duration_s", "--set duration_s=3.01")
    assert problem.message == "vehicle_1: the record ends at 3 s, and the run at 3.01 s"


def test_a_car_that_does_not_begin_as_its_record_does_is_refused():
    t, x = braking()
    keys = [f"drivers.vehicle_1={record(t, x)}", "duration_s=3"]
    load("paper", [*keys, "initial.vehicle_1.speed_mps=2.03"])
    with pytest.raises(ScenarioError) as refused:
        load("paper", [*keys, "initial.vehicle_1.speed_mps=2.06"])
    (problem,) = refused.value.problems
    assert problem.key == "initial.vehicle_1.speed_mps"
    assert "the record begins at 2" in problem.message
    assert "got 2.06 m/s" in problem.message


@pytest.mark.parametrize(
    ("time_s", "travelled_m", "key", "words"),
    [
        ([0.0], [0.0, 1.0], "time_s", "two points or more, got 1"),
        ([0.0, 1.0], [], "travelled_m", "two points or more, got 0"),
        ([0.0, 1.0, 2.0], [0.0, 2.0], "travelled_m", "as many points as time_s (3), got 2"),
        ([0.5, 40.0], [0.0, 2.0], "time_s.0", "must begin with 0, got 0.5"),
        ([0.0, 40.0], [1.0, 2.0], "travelled_m.0", "must begin with 0, got 1.0"),
        ([0.0, 4.0, 4.0], [0.0, 2.0, 3.0], "time_s.2", "after the time before it, 4.0, got 4.0"),
        ([0.0, 4.0, 40.0], [0.0, 2.0, 1.9], "travelled_m.2", "must not go back, from 2.0, got 1.9"),
        ([0.0, 4.0, 40.0], [0.0, 2.0, 1e6], "travelled_m.2", "not be faster than 1000 m/s, got 27777.7"),
        ([0.0, ".inf"], [0.0, 2.0], "time_s.1", "must be a finite number"),
        ([0.0, "x"], [0.0, 2.0], "time_s.1", "must be a number"),
    ],
)
def test_a_record_that_is_none_is_told_at_its_point(time_s, travelled_m, key, words):
    given_s = "[" + ", ".join(map(str, time_s)) + "]"
    with pytest.raises(ScenarioError) as refused:
        load(
            "paper", [f"drivers.vehicle_2={{kind: recorded, time_s: {given_s}, travelled_m: {travelled_m}}}"]
        )
    found = {p.key: p.message for p in refused.value.problems}
    assert words in found[f"drivers.vehicle_2.{key}"]


def test_what_it_does_can_be_taken_from_it_as_a_whole():
    t, x = braking()
    done = doing(load("paper", [f"drivers.vehicle_1={record(t, x)}", "duration_s=3"]), "vehicle_1")
    ((key, value),) = done.keys.items()
    assert (done.calm.kind, done.calm.speed_mps) == ("steady", 2.0)
    assert said("Vehicle 1", key, value) == "Vehicle 1 drives as recorded"
