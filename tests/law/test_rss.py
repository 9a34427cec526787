"""RSS as published, against a scalar one written apart, its guarantee, and what it does with the merges."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjmerge import judge, load, simulate
from mjmerge.errors import ScenarioError
from mjmerge.law import Sensed
from mjmerge.law.nominal import Nominal
from mjmerge.law.rss import Rss
from mjmerge.verdict.metrics import merged_at_s

H = 0.01
LAW = Rss(r_rho_m=-1.2, response_time_s=0.055)
RSS = ["law.kind=rss", "control_step_s=0.02"]
QUICK = [*RSS, "law.response_time_s=0.05"]
TOWARDS = {"k_p": 30.0, "k_v": 1.0}


def seen(ego, *others, u_1=(0.0, 0.0)) -> Sensed:
    """One simulation: x, y, v_x and v_y of each car."""
    cars = np.array([ego, *others], float)
    return Sensed(cars[:1, :2], cars[:1, 2:], cars[None, 1:, :2], cars[None, 1:, 2:], np.array([u_1]))


def some(runs: int, neighbours: int, seed: int = 0) -> Sensed:
    rng = np.random.default_rng(seed)
    p, p_j = rng.uniform(-0.5, 0.5, (runs, 2)), rng.uniform(-2, 2, (runs, neighbours, 2))
    v, v_j = rng.uniform(-0.4, 0.4, (runs, 2)), rng.uniform(-0.4, 0.4, (runs, neighbours, 2))
    road = np.array([2.0, 0.0])
    return Sensed(p, v + road, p_j, v_j + road, rng.uniform(-1, 1, (runs, 2)))


def rows(s: Sensed, which: slice) -> Sensed:
    return Sensed(**{name: values[which] for name, values in vars(s).items()})


def moved(s: Sensed, h: float, u, u_j) -> Sensed:
    """All cars a tick later under accelerations that are held."""
    return Sensed(
        s.p + h * s.v + h * h / 2 * u,
        s.v + h * u,
        s.p_j + h * s.v_j + h * h / 2 * u_j,
        s.v_j + h * u_j,
        s.u_1,
    )


# an oracle, a neighbour at a time


def goes(v: float, accelerates: float, rho: float, brakes: float) -> float:
    """How far one goes that accelerates for rho and then brakes to a stand, by the speed at its ends."""
    late = v + accelerates * rho
    return (v + late) / 2 * rho + late / 2 * (abs(late) / brakes)


def along(law: Rss, v_r: float, v_f: float) -> float:
    rear = goes(max(v_r, 0), law.max_acceleration_mps2, law.response_time_s, law.min_braking_mps2)
    return max(rear - goes(max(v_f, 0), 0, 0, law.max_braking_mps2), 0)


def across(law: Rss, v: float, v_j: float) -> float:
    """Of speeds towards each other."""
    a, rho, b = law.lateral_acceleration_mps2, law.response_time_s, law.lateral_braking_mps2
    return law.lateral_margin_m + max(goes(v, a, rho, b) + goes(v_j, a, rho, b), 0)


class Pair:
    """The ego and one neighbour, and what was safe at the last time without danger."""

    def __init__(self) -> None:
        self.t_b, self.was = 0.0, (True, True)

    def limits(self, law: Rss, t: float, h: float, ego, other):
        """Most u_x, most u_y and least u_y that the proper response leaves."""
        (x, y, vx, vy), (xj, yj, wx, wy) = ego, other
        left = 1 if yj >= y else -1
        d_x = along(law, wx, vx) if x > xj else along(law, vx, wx)
        safe = abs(x - xj) - law.r_m >= d_x, abs(y - yj) - law.r_m >= across(law, left * vy, -left * wy)
        if any(safe):
            self.t_b, self.was = t, safe
            return law.max_acceleration_mps2, np.inf, -np.inf
        most_x, most_y, least_y = law.max_acceleration_mps2, np.inf, -np.inf
        if t + h > self.t_b + law.response_time_s + 1e-9:
            if self.was[0] and x <= xj:
                most_x = min(most_x, max(-law.min_braking_mps2, -vx / h))
            if self.was[1] and left > 0:
                most_y = max(-law.lateral_braking_mps2, -vy / h)
            if self.was[1] and left < 0:
                least_y = min(law.lateral_braking_mps2, -vy / h)
        return most_x, most_y, least_y


def oracle(law: Rss, pairs: list[Pair], t: float, h: float, s: Sensed) -> list[float]:
    ego = (*s.p[0], *s.v[0])
    found = [
        pair.limits(law, t, h, ego, (*p, *v)) for pair, p, v in zip(pairs, s.p_j[0], s.v_j[0], strict=True)
    ]
    u_n, _ = law.nominal(s)
    a = law.lateral_acceleration_mps2
    u_x = max(min(u_n[0, 0], *(one[0] for one in found), np.inf), -law.max_braking_mps2)
    u_y = min(max(u_n[0, 1], -a), a)
    return [u_x, max(min(u_y, *(one[1] for one in found), np.inf), *(one[2] for one in found), -np.inf)]


@given(st.integers(0, 10_000), st.integers(1, 4))
def test_it_commands_what_the_definitions_say_tick_by_tick(seed, neighbours):
    law, s = LAW, some(1, neighbours, seed)
    rng = np.random.default_rng(seed)
    memory, pairs = law.start(1, {}), [Pair() for _ in range(neighbours)]
    for k in range(25):
        made = law.decide(s, memory, H)
        assert made.u[0] == pytest.approx(oracle(law, pairs, k * H, H, s), abs=1e-9)
        s = moved(s, H, made.u, rng.uniform(-4, 4, s.v_j.shape))
        memory = made.after


@given(*[st.floats(0, 30)] * 2, st.floats(0.01, 2), st.floats(0, 5), st.floats(2, 9), st.floats(1, 2))
def test_the_safe_distance_along_the_road_is_that_of_the_paper(v_r, v_f, rho, a, b, more):
    keys = {"max_acceleration_mps2": a, "min_braking_mps2": b, "max_braking_mps2": b * more}
    law = Rss(r_rho_m=-1.2, response_time_s=rho, **keys)
    printed = v_r * rho + a * rho**2 / 2 + (v_r + rho * a) ** 2 / (2 * b) - v_f**2 / (2 * b * more)
    for ego, other in (((0, 0, v_r, 0), (9, 0, v_f, 0)), ((9, 0, v_f, 0), (0, 0, v_r, 0))):
        found = law.safe_along_m(seen(ego, other))
        assert found == pytest.approx(max(printed, 0), abs=1e-9)
        assert found == pytest.approx(along(law, v_r, v_f), abs=1e-9)


@given(st.floats(0, 5), st.floats(0, 5))
def test_the_safe_distance_across_the_road_is_that_of_the_paper_for_cars_that_approach(v_1, v_2):
    law = LAW
    rho, a, b = law.response_time_s, law.lateral_acceleration_mps2, law.lateral_braking_mps2
    w_1, w_2 = v_1 + rho * a, -v_2 - rho * a
    left = (v_1 + w_1) / 2 * rho + w_1**2 / (2 * b)
    printed = law.lateral_margin_m + max(left - ((-v_2 + w_2) / 2 * rho - w_2**2 / (2 * b)), 0)
    for left_is_ego in (1, -1):  # to the left is +y; the paper's speeds point to the right
        ego, other = (0, left_is_ego, 0, -left_is_ego * v_1), (0, 0, 0, left_is_ego * v_2)
        assert law.safe_across_m(seen(ego, other)) == pytest.approx(printed, abs=1e-9)


def test_cars_that_leave_each_other_need_mu_alone_and_opposite_ways_add_up():
    assert LAW.safe_across_m(seen((0, 0, 2, -1), (0, 2, 2, 1))) == LAW.lateral_margin_m
    assert LAW.safe_across_m(seen((0, 0, 2, 1), (0, 2, 2, 1)))[0] == pytest.approx(
        across(LAW, 1, -1)
    )  # a common drift costs nothing but the response


# its guarantee


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.sampled_from([0.055, 0.3]), st.sampled_from([0.01, 0.05]))
def test_a_rear_car_never_hits_one_that_brakes_as_it_may(seed, rho, h):
    """The tracking pulls it into the front car, which accelerates and brakes at random within its bounds.

    A command that is held to a stand brakes softer than b_min in its last tick: b_min h^2/8 are lost.
    """
    runs, rng = 40, np.random.default_rng(seed)
    law = Rss(r_rho_m=1.0, response_time_s=rho, **TOWARDS)
    v, v_f = rng.uniform(0, 3, (2, runs))
    gap = along_all(law, v, v_f) + rng.uniform(0, 0.5, runs)
    s = Sensed(
        np.zeros((runs, 2)), as_x(v), as_x(gap + law.r_m)[:, None], as_x(v_f)[:, None], np.zeros((runs, 2))
    )
    memory, least, brakes = law.start(runs, {}), np.inf, 0.0
    for k in range(round(4 / h)):
        if k % round(0.25 / h) == 0:
            a = rng.choice([-law.max_braking_mps2, 0.0, 3.5], runs)
        made = law.decide(s, memory, h)
        front = np.maximum(a, -s.v_j[:, 0, 0] / h)  # it does not reverse
        s, memory = moved(s, h, made.u, as_x(front)[:, None]), made.after
        least = min(least, float((s.p_j[:, 0, 0] - s.p[:, 0]).min()) - law.r_m)
        brakes = max(brakes, float(-made.u[:, 0].min()))
        assert (made.signals["others_within_bounds"] == 1).all()
        assert (made.signals["responds_in_time"] == 1).all()
    assert least >= -law.min_braking_mps2 * h * h / 8
    assert brakes > law.min_braking_mps2 / 2


def along_all(law: Rss, v_r, v_f):
    return np.array([along(law, *pair) for pair in zip(v_r, v_f, strict=True)])


def as_x(values):
    return np.stack([values, np.zeros_like(values)], axis=-1)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.05]))
def test_a_car_beside_it_is_never_reached_while_that_does_what_it_owes(seed, h):
    """The tracking pulls it across the road into one that swerves, and brakes when it must."""
    runs, rng = 40, np.random.default_rng(seed)
    law = Rss(r_rho_m=-0.1, response_time_s=0.1, **TOWARDS)
    b_lat, a_lat = law.lateral_braking_mps2, law.lateral_acceleration_mps2
    y = law.r_m + rng.uniform(0.1, 1.0, runs)
    s = Sensed(
        np.zeros((runs, 2)),
        np.tile([2.0, 0.0], (runs, 1)),
        np.stack([np.full(runs, 0.1), y], axis=-1)[:, None],
        np.tile([2.0, 0.0], (runs, 1, 1)),
        np.zeros((runs, 2)),
    )
    memory, least = law.start(runs, {}), np.inf
    for k in range(round(4 / h)):
        if k % round(0.3 / h) == 0:
            a = rng.uniform(-a_lat, a_lat, runs)
        made = law.decide(s, memory, h)
        if k == 0:
            assert (made.signals["begins_safe"] == 1).all()
        owes = (made.signals["danger"][:, 0] > 0) & (made.after["since_s"][:, 0] > law.response_time_s + 1e-9)
        v_j = s.v_j[:, 0, 1]
        stops = np.where(v_j < 0, np.minimum(b_lat, -v_j / h), np.maximum(a, -v_j / h))
        u_j = np.stack([made.u[:, 0], np.where(owes, stops, a)], axis=-1)[:, None]
        s, memory = moved(s, h, made.u, u_j), made.after
        least = min(least, float((s.p_j[:, 0, 1] - s.p[:, 1]).min()) - law.r_m)
        assert (made.signals["others_respond"] == 1).all()
    assert 0 < least < 0.1


def test_behind_a_standing_leader_it_comes_to_a_stand():
    law = Rss(r_rho_m=1.0, **TOWARDS)
    s, memory = seen((-6, 0, 2, 0), (0, 0, 0, 0)), law.start(1, {})
    for _ in range(600):
        made = law.decide(s, memory, H)
        s, memory = moved(s, H, made.u, np.zeros_like(s.v_j)), made.after
    assert -1e-9 < -s.p[0, 0] - law.r_m < 0.5
    assert abs(s.v[0, 0]) < 0.2


# limits


def test_where_nobody_is_near_it_is_the_tracking_within_its_bounds_and_with_wide_ones_the_tracking():
    s = some(50, 3)
    far = Sensed(s.p, s.v, s.p_j + np.array([200.0, 50.0]), s.v_j, s.u_1)
    made = LAW.decide(far, LAW.start(50, {}), H)
    u_n = made.signals["u_n_mps2"]
    bounded = np.clip(u_n, [-LAW.max_braking_mps2, -0.2], [LAW.max_acceleration_mps2, 0.2])
    assert made.u == pytest.approx(bounded, abs=1e-12)
    wide = {"max_braking_mps2": 1e3, "max_acceleration_mps2": 1e3, "lateral_acceleration_mps2": 1e3}
    law = LAW.model_copy(update={**wide, "response_time_s": 1e-3, "lateral_braking_mps2": 1e4})
    made = law.decide(far, law.start(50, {}), 1e-4)
    assert made.u.tobytes() == made.signals["u_n_mps2"].tobytes()


def test_without_its_responses_it_is_the_nominal_law():
    off = LAW.unguarded()
    assert off.unguarded() is off
    s = some(20, 3)
    nominal = Nominal(r_rho_m=-1.2).decide(s, {}, H)
    assert off.decide(s, off.start(20, {}), H).u.tobytes() == nominal.u.tobytes()


@pytest.mark.parametrize(
    ("before", "after", "danger"),
    [
        ((0.7, 0.0), (0.65, 0.0), 1),  # it was apart along the road, in one lane
        ((0.3, 0.9), (0.3, 0.605), 2),  # across it, beside each other
        ((0.8, 0.8), (0.605, 0.605), 3),  # both
    ],
)
def test_the_response_is_to_the_distance_that_was_lost_last(before, after, danger):
    law = LAW.model_copy(update={"response_time_s": 0.005, "max_acceleration_mps2": 0.1, "k_p": 0.0})
    law = law.model_copy(update={"min_braking_mps2": 8.0, "k_v": 0.0})
    memory = law.decide(seen((0, 0, 2, 0.01), (*before, 2, 0)), law.start(1, {}), H).after
    made = law.decide(seen((0, 0, 2.0, 0.01), (*after, 1.5, 0)), memory, H)
    assert made.signals["danger"] == danger
    assert made.u[0] == pytest.approx([-8.0 if danger & 1 else 0.0, -0.8 if danger & 2 else 0.0])


def test_between_two_it_gives_way_to_neither_and_stops_crossing():
    law = LAW.model_copy(update={"response_time_s": 0.005})
    between = seen((0, 0, 2, 0.3), (0, 0.62, 2, 0), (0, -0.62, 2, 0))
    memory = law.start(1, {})
    made = law.decide(between, memory, H)
    assert made.u[0, 1] == pytest.approx(-0.8)
    resting = seen((0, 0, 2, 0), (0, 0.605, 2, 0), (0, -0.605, 2, 0))
    assert law.decide(resting, memory, H).u[0, 1] == 0


# hypotheses


def test_who_does_not_respond_has_not_until_the_danger_is_over():
    law = LAW.model_copy(update={"response_time_s": 0.02})
    memory, danger, respond = law.start(1, {}), [], []
    x = -0.985
    for v in [2.1] * 10 + [2.1 - 0.06 * k for k in range(1, 20)]:  # at last harder than b_min, and too late
        made = law.decide(seen((2 * H * len(danger), 0, 2, 0), (9, 0, 2, 0), (x, 0, v, 0)), memory, H)
        memory, x = made.after, x + H * v
        danger.append(made.signals["danger"][0, 1] > 0)
        respond.append(made.signals["others_respond"][0, 1])
    first, late, over = danger.index(True), respond.index(0), len(danger) - danger[::-1].index(True)
    assert 0 < first < late < over < len(danger)
    assert late - first >= 0.02 / H
    assert respond == [1] * late + [0] * (over - late) + [1] * (len(danger) - over)


def test_who_brakes_harder_than_b_max_is_out_of_bounds_and_a_short_response_time_is_told():
    law, memory = LAW, LAW.start(1, {})
    for v, within in ((2.0, 1), (1.93, 1), (1.84, 0)):
        made = law.decide(seen((0, 0, 2, 0), (9, 0, v, 0)), memory, H)
        assert made.signals["others_within_bounds"][0, 0] == within
        memory = made.after
    assert made.signals["responds_in_time"] == 1
    assert law.decide(seen((0, 0, 2, 0), (9, 0, 2, 0)), memory, 0.06).signals["responds_in_time"] == 0


def test_a_beginning_in_danger_is_told_once():
    s, memory = seen((0, 0, 2, 0), (0.7, 0, 1, 0)), LAW.start(1, {})
    first = LAW.decide(s, memory, H)
    again = LAW.decide(s, first.after, H)
    assert (first.signals["begins_safe"], again.signals["begins_safe"]) == (0, 1)


# many at once


@pytest.mark.parametrize("neighbours", [1, 2, 5])
def test_rows_of_a_batch_are_what_each_is_alone_and_u_is_the_sum_of_its_parts(neighbours):
    s, memory = some(40, neighbours), LAW.start(40, {})
    for _ in range(8):
        made = LAW.decide(s, memory, H)
        assert made.u.tobytes() == (made.signals["u_n_mps2"] + made.signals["u_c_mps2"]).tobytes()
        for k in range(0, 40, 3):
            row = slice(k, k + 1)
            own = {name: values[row] for name, values in memory.items()}
            before = {name: values.copy() for name, values in own.items()}
            alone = LAW.decide(rows(s, row), own, H)
            assert all(own[name].tobytes() == before[name].tobytes() for name in own)
            for a, b in ((alone.signals, made.signals), (alone.after, made.after)):
                assert all(a[name].tobytes() == b[name][row].tobytes() for name in a)
            assert alone.u.tobytes() == made.u[row].tobytes()
        s, memory = moved(s, H, made.u, np.zeros_like(s.v_j)), made.after
    assert made.signals["danger"].any()


def test_who_is_far_away_changes_nothing():
    s, memory = some(30, 2), LAW.start(30, {})
    away = np.full((30, 2, 2), 60.0)
    more = Sensed(s.p, s.v, np.concatenate([s.p_j, away], 1), np.concatenate([s.v_j, away * 0], 1), s.u_1)
    assert LAW.decide(more, memory, H).u.tobytes() == LAW.decide(s, memory, H).u.tobytes()


@given(st.integers(0, 1000))
def test_a_mirrored_road_gets_the_mirrored_command(seed):
    s, m = some(10, 3, seed), np.array([1.0, -1.0])
    mirrored = Sensed(s.p * m, s.v * m, s.p_j * m, s.v_j * m, s.u_1 * m)
    law = LAW.model_copy(update={"response_time_s": 0.005})
    a, b = (law.decide(x, law.start(10, {}), H).u for x in (s, mirrored))
    assert np.array_equal(a * m, b)


# the paper's merges


def test_with_the_published_constants_the_papers_gap_is_too_small_and_with_a_shorter_response_it_merges():
    published = simulate(load("paper", RSS), "double_integrator")
    assert np.isnan(merged_at_s(published)).all()
    assert published.signals["safe_along_m"].min() > 1.114 / 2  # half of what the gap leaves beyond 2 r
    quick = simulate(load("paper", QUICK), "double_integrator")
    assert 18 < merged_at_s(quick)[0] < 25
    for trace in (published, quick):
        (verdict,) = judge(trace)
        assert (verdict.verdict, verdict.needed, verdict.breaches) == ("held", True, ())


def test_it_runs_the_same_ten_times_as_large():
    small = simulate(load("paper", [*QUICK, "duration_s=20"]), "double_integrator")
    large = simulate(small.scenario.scaled(10.0), "double_integrator")
    assert small.signals["danger"].any()
    assert np.allclose(large.front_m, 10 * small.front_m, rtol=0, atol=1e-9 * np.abs(large.front_m).max())
    assert np.array_equal(large.signals["danger"], small.signals["danger"])


def test_on_the_highway_the_published_ones_wait_and_shorter_ones_merge():
    steps = ["law.kind=rss", "law.lateral_margin_m=0.1", "control_step_s=0.05", "physics_step_s=0.005"]
    waits = simulate(load("highway", [*steps, "law.response_time_s=1.0"]), "double_integrator")
    assert np.isnan(merged_at_s(waits)).all()
    keys = ["law.response_time_s=0.12", "law.max_acceleration_mps2=1.0", "law.min_braking_mps2=8.0"]
    merges = simulate(load("highway", [*steps, *keys]), "double_integrator")
    assert 50 < merged_at_s(merges)[0] < 90
    assert min(waits.min_distance_m.min(), merges.min_distance_m.min()) > 0.8


def test_who_charges_is_out_of_bounds_and_does_not_respond_and_that_is_what_it_is_put_down_to():
    (verdict,) = judge(simulate(load("charge", QUICK), "double_integrator"))
    assert verdict.verdict == "assumption broken"
    assert [breach.hypothesis for breach in verdict.breaches] == ["others within bounds", "others respond"]


# keys


def test_a_front_car_that_brakes_softer_than_a_rear_one_must_is_refused():
    with pytest.raises(ScenarioError, match=r"law.max_braking_mps2: .*min_braking_mps2"):
        load("paper", ["law.kind=rss", "law.min_braking_mps2=9.0"])


def test_it_is_similar_at_another_size():
    s, size = some(50, 3), 7.0
    root = sqrt(size)
    law = Rss(
        r_rho_m=-1.2 * size,
        r_m=0.6 * size,
        response_time_s=LAW.response_time_s * root,
        lateral_margin_m=LAW.lateral_margin_m * size,
        k_p=0.7 / size,
        k_v=2.0 / root,
    )
    large = Sensed(s.p * size, s.v * root, s.p_j * size, s.v_j * root, s.u_1)
    memories = LAW.start(50, {}), law.start(50, {})
    for _ in range(8):
        a, b = LAW.decide(s, memories[0], H), law.decide(large, memories[1], H * root)
        assert b.u == pytest.approx(a.u, abs=1e-9)
        memories = a.after, b.after
