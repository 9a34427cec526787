"""IDM and MOBIL as published, against scalar ones written apart, and what they do with the paper's merges."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pydantic import ValidationError

from mjmerge import judge, load, simulate
from mjmerge.drivers.base import Along
from mjmerge.drivers.idm import Idm
from mjmerge.errors import ScenarioError
from mjmerge.law import Sensed
from mjmerge.law.idm_mobil import IdmMobil
from mjmerge.verdict.metrics import lateral_error_m, merged_at_s

H = 0.01
POLITE = IdmMobil(politeness=0.4, bias_mps2=1.0, exponent=3.0, time_gap_s=0.3)
COARSE = ["law.kind=idm_mobil", "control_step_s=0.02"]
TIGHT = [*COARSE, "law.time_gap_s=0.17", "law.standstill_gap_m=0.2"]
FULL = [
    "law.kind=idm_mobil", "law.desired_speed_mps=30.0", "law.lateral_bandwidth_radps=0.38",
]  # fmt: skip


def seen(ego, *others, u_1=(0.0, 0.0)) -> Sensed:
    """One simulation: x, y, v_x and v_y of each car."""
    cars = np.array([ego, *others], float)
    return Sensed(cars[:1, :2], cars[:1, 2:], cars[None, 1:, :2], cars[None, 1:, 2:], np.array([u_1]))


def rows(s: Sensed, which: slice) -> Sensed:
    return Sensed(**{name: values[which] for name, values in vars(s).items()})


def joined(several: list[Sensed]) -> Sensed:
    return Sensed(**{name: np.concatenate([getattr(s, name) for s in several]) for name in vars(several[0])})


def driven(law: IdmMobil, ego, others, end_s: float, h: float = H):
    """Motion of the ego, (T, 4), and the decisions, among neighbours that keep their velocities."""
    memory, cars, path, made = law.start(1, {}), np.array([ego, *others], float), [], []
    for _ in range(round(end_s / h)):
        one = law.decide(seen(cars[0], *cars[1:]), memory, h)
        memory = one.after
        path.append(cars[0].copy())
        made.append(one)
        cars[:, :2] += h * cars[:, 2:]
        cars[0, :2] += h * h / 2 * one.u[0]
        cars[0, 2:] += h * one.u[0]
    return np.array(path), made


# oracles, a car at a time


def idm(law: IdmMobil, v: float, s: float, v_l: float) -> float:
    v = max(v, 0.0)
    a, b = law.max_acceleration_mps2, law.comfortable_deceleration_mps2
    s_star = law.standstill_gap_m
    s_star += max(0.0, v * law.time_gap_s + v * (v - v_l) / (2 * sqrt(a * b)))
    free = a * (1 - (v / law.desired_speed_mps) ** law.exponent)
    if s == inf:
        return free
    return free - a * (s_star / s) ** 2 if s > 0 else -inf


def bounded(law: IdmMobil, *args: float) -> float:
    return max(idm(law, *args), -law.limit_mps2)


def mobil(law: IdmMobil, cars: list, lane_now: float, lane_then: float, bias: float) -> tuple[float, float]:
    """Advantage and a~_n of a change, from x, y, v of the ego and the others."""
    (x, _, v), *others = cars

    def around(y: float):
        there = [c for c in others if abs(c[1] - y) < law.r_m]
        ahead = min((c for c in there if c[0] > x), default=None)
        behind = max((c for c in there if c[0] <= x), default=None)
        return ahead, behind

    def acc(car, front) -> float:
        if car is None:
            return 0.0
        return bounded(law, car[2], inf, 0.0) if front is None else bounded(
            law, car[2], front[0] - car[0] - law.r_m, front[2]
        )  # fmt: skip

    ego = (x, None, v)
    (front, o), (new_front, n) = around(lane_now), around(lane_then)
    gain = acc(ego, new_front) - acc(ego, front)
    gain += law.politeness * (acc(n, ego) - acc(n, new_front) + acc(o, front) - acc(o, ego))
    a_n = acc(n, ego) if n is not None else law.max_acceleration_mps2
    return gain + bias, a_n


speed = st.floats(0, 8)
place = st.floats(-6, 6).map(lambda x_m: round(x_m, 6))  # apart, or level: not by a rounding error
car = st.tuples(place, st.sampled_from([0.0, 0.1, 1.4, 1.5, 4.0]), speed)


@given(st.floats(0.1, 8), st.floats(0.05, 30), speed)
def test_it_accelerates_as_idm_says_and_as_the_driver_of_that_name(v, s, v_l):
    law = POLITE.model_copy(update={"stop_gain_per_s": 1e9})
    expected = bounded(law, v, s, v_l)
    ahead = (s + law.r_m, 0.0, v_l, 0.0)
    made = law.decide(seen((0, 0, v, 0), ahead), {**law.start(1, {}), "lane": np.ones(1)}, 1e-9)
    assert made.signals["lane"] == 1 or expected < -law.threshold_mps2  # the other lane is the same one
    assert made.u[0, 0] == pytest.approx(expected, abs=1e-9)
    names = (
        "desired_speed_mps", "time_gap_s", "standstill_gap_m", "max_acceleration_mps2",
        "comfortable_deceleration_mps2", "exponent", "limit_mps2",
    )  # fmt: skip
    driver = Idm(**{name: getattr(law, name) for name in names}, stop_gain_per_s=1e12)
    own, front = (Along(np.array([x]), np.array([u]), np.zeros(1)) for x, u in ((0.0, v), (s, v_l)))
    assert driver.acceleration_mps2(0.0, own, front, None) == pytest.approx(expected, abs=1e-9)


@given(car, st.lists(car, min_size=1, max_size=5), st.booleans())
def test_it_changes_lane_where_mobil_says(ego, others, merges):
    places = [ego[0], *(x for x, _, _ in others)]
    assume(len(set(places)) == len(places))  # nobody is ahead of whom it is level with
    law, own = POLITE, 1.5
    leaders = others[0][1]
    now, then = (leaders, own) if merges else (own, leaders)
    wish = law.bias_mps2 if others[0][0] > ego[0] else 0.0
    gain, a_n = mobil(law, [ego, *others], now, then, -wish if merges else wish)
    s = seen((ego[0], ego[1], ego[2], 0), *((x, y, v, 0) for x, y, v in others))
    memory = {**law.start(1, {}), "own_lane_m": np.array([own]), "lane": np.array([float(merges)])}
    made = law.decide(s, memory, H)
    assert made.signals["incentive_mps2"] == pytest.approx(gain, abs=1e-9)
    assert made.signals["new_follower_mps2"] == pytest.approx(a_n, abs=1e-9)
    changes = a_n >= -law.safe_braking_mps2 and gain > law.threshold_mps2
    assert made.signals["lane"] == (merges != changes)


# what follows from it


def test_on_a_free_road_it_reaches_the_desired_speed_and_stays():
    law = IdmMobil(desired_speed_mps=5.0)
    path, made = driven(law, (0, 0, 2, 0), [(100, 5, 6, 0)], 20, 0.05)
    assert np.all(np.diff(path[:, 2]) >= 0)
    assert path[-1, 2] == pytest.approx(5.0, abs=1e-3)
    assert made[0].u[0, 0] == pytest.approx(3 * (1 - 0.4**4), abs=1e-3)  # less what IDM feels of 100 m


@pytest.mark.parametrize("h", [0.02, 0.1])
def test_behind_a_standing_leader_it_comes_to_a_stand_short_of_it_and_never_reverses(h):
    law = IdmMobil()
    path, made = driven(law, (-12, 0, 3, 0), [(0, 0, 0, 0)], 20, h)
    assert path[:, 2].min() > -1e-9
    assert path[-1, 2] == pytest.approx(0, abs=1e-4)
    gap = -path[:, 0] - law.r_m
    assert gap.min() > 0.8 * law.standstill_gap_m
    assert all(one.signals["within_limit"] == 1 for one in made)


def test_behind_a_leader_it_keeps_the_equilibrium_gap():
    law = IdmMobil()
    h, end_s = 0.05, 40
    path, _ = driven(law, (-4, 0, 2, 0), [(0, 0, 2, 0)], end_s, h)
    gap = 2 * (end_s - h) - path[-1, 0] - law.r_m
    wanted = law.standstill_gap_m + 2 * law.time_gap_s
    assert gap == pytest.approx(wanted / sqrt(1 - (2 / law.desired_speed_mps) ** 4), abs=1e-3)


def test_it_falls_back_softly_where_the_leader_is_behind_it_and_changes_lane_behind_that():
    law = IdmMobil()
    path, made = driven(law, (1.0, 1.5, 2, 0), [(0, 0, 2, 0)], 20, 0.02)
    assert min(one.u[0, 0] for one in made) >= -law.comfortable_deceleration_mps2
    assert path[-1, 0] < 2 * 20 - law.r_m
    assert abs(path[-1, 1]) < 0.01


def test_across_the_road_it_is_critically_damped_about_the_lane_that_it_chose():
    law = IdmMobil()
    path, made = driven(law, (-4, 1.5, 2, 0), [(0, 0, 2, 0)], 10)
    assert all(one.signals["lane"] == 1 for one in made)
    t, w = H * np.arange(len(path)), law.lateral_bandwidth_radps
    assert path[:, 1] == pytest.approx(1.5 * (1 + w * t) * np.exp(-w * t), abs=0.02)
    assert path[:, 1].min() > 0


def test_a_change_that_its_new_follower_would_have_to_brake_for_waits_until_that_has_gone():
    law = IdmMobil()
    close, far = ((0, 0, 2, 0), (-4, 0, 5, 0)), ((0, 0, 2, 0), (-9, 0, 2, 0))
    for others, changes in ((close, 0), (far, 1)):
        made = law.decide(seen((-2, 1.5, 2, 0), *others), law.start(1, {}), H)
        assert made.signals["lane"] == changes
        assert (made.signals["new_follower_mps2"] >= -law.safe_braking_mps2) == changes


def test_without_its_guard_it_drives_as_on_a_free_road_and_every_change_is_safe():
    law = IdmMobil().unguarded()
    assert law.unguarded() is law
    made = law.decide(seen((-0.5, 1.5, 2, 0), (0, 0, 2, 0), (-0.7, 0, 2, 0)), law.start(1, {}), H)
    assert made.signals["lane"] == 1
    assert not made.signals["u_c_mps2"].any()
    assert made.u[0, 0] == pytest.approx(3 * (1 - (2 / 9.49) ** 4))


def test_a_follower_that_does_not_brake_as_idm_would_breaks_the_hypothesis_and_one_that_does_not():
    law = IdmMobil()

    def yields(brakes: bool) -> float:
        memory, x_n, v_n = law.start(1, {}), -1.5, 2.0
        for k in range(5):
            s = seen((2 * H * k, 0, 2, 0), (9, 0, 2, 0), (x_n, 0, v_n, 0))
            made = law.decide(s, memory, H)
            asked, memory = bounded(law, v_n, 2 * H * k - x_n - law.r_m, 2.0), made.after
            assert asked < 0
            x_n, v_n = x_n + H * v_n, v_n + H * asked * brakes
        return made.signals["follower_yields"][0, 1]

    assert (yields(True), yields(False)) == (1, 0)


# many at once


def some(runs: int, neighbours: int, seed: int = 0) -> Sensed:
    rng = np.random.default_rng(seed)
    lanes = rng.choice([0.0, 1.5], (runs, neighbours, 1))
    p_j = np.concatenate([rng.uniform(-5, 5, (runs, neighbours, 1)), lanes], axis=2)
    v, v_j = rng.uniform(0, 5, (runs, 2)), rng.uniform(0, 5, (runs, neighbours, 2))
    return Sensed(np.tile([0.0, 1.5], (runs, 1)), v, p_j, v_j, np.zeros((runs, 2)))


@pytest.mark.parametrize("neighbours", [1, 2, 5])
def test_rows_of_a_batch_are_what_each_is_alone_and_u_is_the_sum_of_its_parts(neighbours):
    s = some(40, neighbours)
    memory = POLITE.start(40, {})
    for _ in range(3):
        made = POLITE.decide(s, memory, H)
        assert made.u.tobytes() == (made.signals["u_n_mps2"] + made.signals["u_c_mps2"]).tobytes()
        for k in range(40):
            row = slice(k, k + 1)
            own = {name: values[row] for name, values in memory.items()}
            before = {name: values.copy() for name, values in own.items()}
            alone = POLITE.decide(rows(s, row), own, H)
            assert all(own[name].tobytes() == before[name].tobytes() for name in own)
            for a, b in ((alone.signals, made.signals), (alone.after, made.after)):
                assert all(a[name].tobytes() == b[name][row].tobytes() for name in a)
            assert alone.u.tobytes() == made.u[row].tobytes()
        memory = made.after
    assert 0 < made.signals["lane"].sum() < 40


def test_who_is_in_a_third_lane_changes_nothing():
    s = some(30, 3)
    rng = np.random.default_rng(1)
    others = np.concatenate([rng.uniform(-5, 5, (30, 2, 1)), np.full((30, 2, 1), 4.0)], axis=2)
    more = Sensed(s.p, s.v, np.concatenate([s.p_j, others], 1), np.concatenate([s.v_j, others], 1), s.u_1)
    a, b = (POLITE.decide(x, POLITE.start(30, {}), H) for x in (s, more))
    assert a.u.tobytes() == b.u.tobytes()


@given(st.integers(0, 1000), st.floats(0.1, 20))
def test_it_is_similar_at_another_size(seed, size):
    """Lengths times s, times and speeds times its root: the same accelerations."""
    s, root = some(5, 3, seed), sqrt(size)
    keys = {name: getattr(POLITE, name) for name in type(POLITE).model_fields}
    powers = {
        "r_m": 2, "standstill_gap_m": 2, "desired_speed_mps": 1, "time_gap_s": 1,
        "lateral_bandwidth_radps": -1, "stop_gain_per_s": -1,
    }  # fmt: skip
    other = IdmMobil(**keys | {name: keys[name] * root**power for name, power in powers.items()})
    large = Sensed(s.p * size, s.v * root, s.p_j * size, s.v_j * root, s.u_1)
    a, b = POLITE.decide(s, POLITE.start(5, {}), H), other.decide(large, other.start(5, {}), H * root)
    assert b.u == pytest.approx(a.u, abs=1e-9)
    assert np.array_equal(a.signals["lane"], b.signals["lane"])


# the paper's merges


def test_with_the_published_numbers_the_gap_of_the_paper_is_too_small_and_with_shorter_ones_it_merges():
    published = simulate(load("paper", COARSE), "double_integrator")
    assert not published.signals["lane"].any()
    assert np.isnan(merged_at_s(published)).all()
    assert published.min_distance_m.min() > 0.8
    tight = simulate(load("paper", TIGHT), "double_integrator")
    assert tight.signals["lane"][0, -1] == 1
    assert 13 < merged_at_s(tight)[0] < 20  # once Vehicle 2 makes room
    assert tight.min_distance_m.min() > 0.45
    (verdict,) = judge(tight)
    assert (verdict.verdict, verdict.needed) == ("held", True)


def test_it_runs_the_same_ten_times_as_large():
    small = simulate(load("paper", [*TIGHT, "duration_s=16"]), "double_integrator")
    large = simulate(small.scenario.scaled(10.0), "double_integrator")
    assert small.signals["lane"].any()
    assert np.allclose(large.front_m, 10 * small.front_m, rtol=0, atol=1e-9 * np.abs(large.front_m).max())
    assert np.array_equal(large.signals["lane"], small.signals["lane"])


def test_on_the_highway_the_published_ones_let_vehicle_2_pass_and_shorter_ones_merge_between():
    def between(trace) -> bool:
        x = trace.front_m[0, -1, :, 0]
        return bool(x[2] < x[0] < x[1] and abs(lateral_error_m(trace)[0, -1]) < 0.5)

    full = [*FULL, "control_step_s=0.05", "physics_step_s=0.005"]
    published = load("highway", [*full, "law.time_gap_s=1.5", "law.standstill_gap_m=5.0", "duration_s=20"])
    trace = simulate(published, "double_integrator")
    assert not between(trace)
    assert trace.front_m[0, -1, 0, 0] < trace.front_m[0, -1, 2, 0]
    shorter = simulate(load("highway", [*full, "law.time_gap_s=0.1", "law.standstill_gap_m=1.0"]),
                       "double_integrator")  # fmt: skip
    assert between(shorter)
    assert shorter.min_distance_m.min() > 3


def test_who_charges_does_not_yield_and_that_is_what_its_collision_is_put_down_to():
    (verdict,) = judge(simulate(load("charge", TIGHT), "double_integrator"))
    assert (verdict.verdict, verdict.matters.hypothesis) == ("assumption broken", "follower yields")


# keys


def test_braking_that_is_more_than_the_limit_is_refused_and_politeness_beyond_one():
    with pytest.raises(ScenarioError, match=r"law.limit_mps2: .*safe_braking_mps2"):
        load("paper", ["law.kind=idm_mobil", "law.safe_braking_mps2=7.0"])
    with pytest.raises(ValidationError):
        IdmMobil(politeness=1.1)
