"""The contract: each verdict and each hypothesis on the smallest trace that shows it."""

import numpy as np
import pytest

from mjmerge.contract import BROKEN, HELD, HYPOTHESES, INCOMPLETE, REFUTED, VACUOUS, challenged, judge
from mjmerge.loader import data_sheet
from mjmerge.trace import Stop

T = 60


@pytest.fixture
def calm(make_trace):
    """A merge in which every hypothesis holds and nothing happens; columns can be replaced."""

    def build(**given):
        runs = given.get("runs", 1)
        front = np.zeros((runs, T, 3, 2))
        front[:, :, 0] = [-1.2, 1.4]
        front[:, :, 2, 0] = -3.0
        front[..., 0] += 2.0 * 0.01 * np.arange(T)[:, None]
        velocity = np.zeros((runs, T, 3, 2))
        velocity[..., 0] = 2.0
        still = {
            "distance_m": 0.9,
            "distance_rate_mps": 0.0,
            "gap_rate_mps": 0.0,
            "opinion": 0.1,
            "clearance_m": 0.5,
            "gap_m": 2.4,
            "front_m": front,
            "velocity_mps": velocity,
            "speed_mps": 2.0,
            "u_mps2": 0.0,
            "steer_rad": 0.0,
            "torque_clipped_n_m": 0.0,
            "steer_clipped_rad": 0.0,
        }
        return make_trace(ticks=T, **(still | given))

    return build


def distance(*d_1, runs=1):
    """d_1 as given from the first tick on, holding its last value; d_2 = 0.9."""
    d = np.full((runs, T, 2), 0.9)
    d[:, : len(d_1), 0] = d_1
    d[:, len(d_1) :, 0] = d_1[-1]
    return d


def dipping(to, tick=30):
    """d_1 from 0.9 down to a value over the ticks before ``tick``, and back up."""
    d = np.full(T, 0.9)
    d[tick - 10 : tick + 1] = np.linspace(0.9, to, 11)
    d[tick : tick + 11] = np.linspace(to, 0.9, 11)
    return distance(*d)


def broken(trace):
    return {name for name, monitor in HYPOTHESES.items() if monitor(trace).any()}


def test_a_calm_trace_breaks_no_hypothesis(calm):
    assert broken(calm()) == set()


def test_every_monitor_marks_ticks_of_simulations(calm):
    for name, monitor in HYPOTHESES.items():
        mask = monitor(calm(runs=2))
        assert (mask.shape, mask.dtype) == ((2, T), bool), name


def test_switching_the_barrier_off_breaks_exactly_that(calm):
    assert broken(calm(overrides=["law.k_o=0"])) == {"barrier is on"}


def at_start(value, other, *shape):
    """A column with one value in the first tick and another from then on."""
    column = np.full((1, T, *shape), other)
    column[:, 0] = value
    return column


@pytest.mark.parametrize("d", [0.0, -0.1])
def test_a_start_inside_a_margin_is_no_safe_start(calm, d):
    assert broken(calm(distance_m=at_start(d, 0.9, 2))) == {"safe start"}
    assert only(calm(distance_m=at_start(d, 0.9, 2))).verdict == BROKEN


def test_a_start_at_an_unbounded_relative_rate_breaks_exactly_that(calm):
    assert broken(calm(distance_rate_mps=at_start(-np.inf, 0.0, 2))) == {"bounded start"}
    assert broken(calm(distance_rate_mps=at_start(-1e3, np.inf, 2))) == set()  # later is another question


def test_an_opinion_of_zero_at_the_start_breaks_exactly_that(calm):
    assert broken(calm(opinion=at_start(0.0, 0.1))) == {"opinion starts positive"}
    assert broken(calm(opinion=at_start(1e-300, 0.0))) == set()


def test_a_neighbour_no_road_car_could_follow_breaks_assumption_1(calm):
    velocity = np.full((1, T, 3, 2), [2.0, 0.0])
    velocity[0, 20:, 2, 0] = 8.0  # 6 m/s within 0.1 s
    assert broken(calm(velocity_mps=velocity)) == {"neighbours bounded"}
    velocity[0, 20:, 2, 0] = 6.0
    assert broken(calm(velocity_mps=velocity)) == set()
    velocity[0, :, 2, 0] = 101.0
    assert broken(calm(velocity_mps=velocity)) == {"neighbours bounded"}


def test_a_collision_is_no_unbounded_neighbour(calm):
    """What the impact does to its speed must not be the excuse for the impact."""
    velocity = np.full((1, T, 3, 2), [2.0, 0.0])
    velocity[0, 20:, 2, 0] = 9.0
    verdict = only(calm(velocity_mps=velocity, clearance_m=touching(20)))
    assert [b.hypothesis for b in verdict.breaches] == ["margin covers the bodies"]


def test_what_a_driver_asks_of_a_car_that_cannot_give_it_is_bounded_motion(calm):
    u = np.zeros((1, T, 3, 2))
    u[0, 20:, 2, 0] = 200.0
    assert broken(calm(u_mps2=u)) == set()


@pytest.mark.parametrize(
    ("plant", "limit"), [("mujoco", data_sheet("rc").steer_limit_rad), ("bicycle", np.pi / 2)]
)
def test_steering_at_its_limit_breaks_exactly_that(calm, plant, limit):
    """A car's is in its data sheet; the bicycle equations end at pi/2."""
    steer = np.zeros((1, T, 3))
    steer[0, 20, 0] = -0.999 * limit
    steer[0, 30, 1] = 2.0  # a neighbour's
    assert broken(calm(plant=plant, steer_rad=steer)) == set()
    steer[0, 20, 0] = -limit
    assert broken(calm(plant=plant, steer_rad=steer)) == {"steering within limit"}


def test_in_continuous_time_no_hold_is_too_long(calm):
    near = calm(distance_m=dipping(0.004), continuous=True, plant="double_integrator")
    assert broken(near) == set()


def test_in_continuous_time_the_ego_moves_as_commanded_by_the_equations(calm):
    u = np.zeros((1, T, 3, 2))
    u[0, 20:35, 0, 1] = 2.0
    assert broken(calm(u_mps2=u, continuous=True, plant="bicycle")) == set()


def test_a_run_that_ended_because_a_distance_reached_zero_is_unsafe(calm):
    d = dipping(0.2, tick=20)
    d[0, 40:] = np.nan
    verdict = only(calm(distance_m=d, continuous=True, stops=[Stop(0, 0.4, "ego", "d_2", touched=True)]))
    assert (verdict.verdict, verdict.unsafe_at_s) == (REFUTED, 0.4)
    assert not verdict.floor_held


def between(x=-1.2, y=0.1):
    front = np.zeros((1, T, 3, 2))
    front[:, :, 0] = [x, y]
    front[:, :, 2, 0] = -3.0
    return front


def test_neighbours_that_squeeze_the_ego_between_them_break_assumption_1(calm):
    assert broken(calm(front_m=between(), gap_m=0.5)) == {"neighbours leave 2r"}
    assert broken(calm(front_m=between(), gap_m=0.61)) == set()


@pytest.mark.parametrize(
    "front", [between(y=1.4), between(x=0.5), between(x=-3.5)], ids=["beside", "ahead", "behind"]
)
def test_neighbours_may_do_as_they_please_while_the_ego_is_not_between_them(calm, front):
    assert broken(calm(front_m=front, gap_m=0.5)) == set()


@pytest.mark.parametrize("speed", [0.05, 0.0, -0.05])
def test_an_ego_that_hardly_rolls_breaks_exactly_that(calm, speed):
    v = np.full((1, T, 3), 2.0)
    v[0, 20, 0] = speed
    assert broken(calm(speed_mps=v)) == {"ego rolls"}
    v[0, 20, 0], v[0, 20, 1] = -0.2, 0.0  # reversing rolls; and a neighbour is not the ego
    assert broken(calm(speed_mps=v)) == set()


@pytest.mark.parametrize("column", ["torque_clipped_n_m", "steer_clipped_rad"])
def test_clipping_the_ego_breaks_exactly_that(calm, column):
    clipped = np.zeros((1, T, 3))
    clipped[0, 20, 1] = 0.1
    assert broken(calm(**{column: clipped})) == set()
    clipped[0, 20, 0] = -0.1
    assert broken(calm(**{column: clipped})) == {"command within limits"}


def test_an_ego_that_does_not_follow_its_command_breaks_exactly_that(calm):
    u = np.zeros((1, T, 3, 2))
    u[0, 20:35, 0, 1] = 2.0  # 0.2 m/s over 0.1 s, and the velocity stays
    assert broken(calm(u_mps2=u)) == {"ego moves as commanded"}
    moving = np.zeros((1, T, 3, 2))
    moving[0, :, 0, 1] = np.concatenate([[0], np.cumsum(u[0, :-1, 0, 1] * 0.01)])
    assert broken(calm(u_mps2=u, velocity_mps=moving)) == set()


def test_a_hold_too_long_for_the_distance_breaks_exactly_that(calm):
    """k_o h/2 = 5 mm."""
    assert broken(calm(distance_m=dipping(0.004))) == {"hold small against d"}
    assert broken(calm(distance_m=dipping(0.006))) == set()


def test_a_delay_too_long_for_the_distance_breaks_exactly_that_and_only_where_there_is_one(calm):
    """2 k_o tau/pi = 64 mm at 100 ms, on every plant; in continuous time there is no delay."""
    delay = ["mismatch.command_delay_s=0.1"]
    assert broken(calm(distance_m=dipping(0.06), overrides=delay)) == {"delay small against d"}
    assert broken(calm(distance_m=dipping(0.07), overrides=delay)) == set()
    assert broken(calm(distance_m=dipping(0.06))) == set()
    assert broken(calm(distance_m=dipping(0.06), overrides=delay, plant="bicycle")) == {
        "delay small against d"
    }
    assert broken(calm(distance_m=dipping(0.06), overrides=delay, plant="bicycle", continuous=True)) == set()


def only(trace):
    (verdict,) = judge(trace)
    return verdict


def test_safe_and_challenged_is_held(calm):
    verdict = only(calm(distance_m=dipping(0.2)))
    assert (verdict.verdict, verdict.unsafe_at_s, verdict.breaches) == (HELD, None, ())
    assert verdict.floor_held


@pytest.mark.parametrize("d", [[0.9], [0.9, 0.5], [0.4, 0.3], [2.0, 0.7]])
def test_safe_and_never_challenged_is_vacuous(calm, d):
    verdict = only(calm(distance_m=distance(*d)))
    assert verdict.verdict == VACUOUS
    assert verdict.floor_held


def test_coming_close_by_receding_first_is_a_challenge_and_opening_up_is_none(calm):
    assert challenged(calm(distance_m=distance(0.4, 0.9, 0.4)))[0]
    assert not challenged(calm(distance_m=distance(0.2, 0.9)))[0]


def test_unsafe_after_a_hypothesis_broke_names_which_and_when(calm):
    v = np.full((1, T, 3), 2.0)
    v[0, 20:, 0] = 0.05
    verdict = only(calm(distance_m=distance(*[0.9] * 30, -0.1), speed_mps=v))
    assert verdict.verdict == BROKEN
    assert verdict.unsafe_at_s == pytest.approx(0.3)
    assert (verdict.breaches[0].hypothesis, verdict.breaches[0].time_s) == ("ego rolls", pytest.approx(0.2))
    assert "'ego rolls' broke at 0.20 s" in verdict.reason
    assert not verdict.floor_held


def touching(tick):
    clearance = np.full((1, T, 3), 0.5)
    clearance[0, tick, 1] = -0.01
    return clearance


def test_bodies_that_touch_outside_the_margin_say_that_it_is_too_small_for_them(calm):
    """The theorem keeps front axles apart; what that is worth for bodies is an assumption."""
    verdict = only(calm(clearance_m=touching(20)))
    assert (verdict.verdict, verdict.unsafe_at_s) == (BROKEN, pytest.approx(0.2))
    assert verdict.breaches[0].hypothesis == "margin covers the bodies"
    inside = distance(*[0.9] * 20, -0.1)[..., ::-1]  # of the car that is touched
    assert only(calm(clearance_m=touching(20), distance_m=inside)).verdict == REFUTED


def test_unsafe_with_every_hypothesis_true_is_refuted(calm):
    verdict = only(calm(distance_m=distance(*[0.9] * 20, -0.1)))
    assert (verdict.verdict, verdict.unsafe_at_s) == (REFUTED, pytest.approx(0.2))
    assert not verdict.floor_held


def test_a_hypothesis_that_breaks_only_afterwards_is_no_excuse(calm):
    v = np.full((1, T, 3), 2.0)
    v[0, 25:, 0] = 0.05
    verdict = only(calm(distance_m=distance(*[0.9] * 20, -0.1), speed_mps=v))
    assert verdict.verdict == REFUTED
    assert [b.hypothesis for b in verdict.breaches] == ["ego rolls"]


def test_a_jump_through_the_margin_with_every_hypothesis_true_is_refuted(calm):
    """Being inside the margin must not count as the excuse for having got there."""
    assert only(calm(distance_m=distance(*[0.9] * 30, -0.1))).verdict == REFUTED


def test_neighbours_that_touch_each_other_are_not_the_egos_fault(calm):
    clearance = np.full((1, T, 3), 0.5)
    clearance[0, 20, 2] = -0.01
    assert only(calm(clearance_m=clearance)).verdict == VACUOUS


def test_a_run_that_ended_early_and_safe_is_incomplete_and_no_pass(calm):
    d = dipping(0.2, tick=20)
    d[0, 40:] = np.nan
    verdict = only(calm(distance_m=d, stops=[Stop(0, 0.4, "ego", "it is off its wheels")]))
    assert verdict.verdict == INCOMPLETE
    assert not verdict.floor_held


def test_a_run_that_ended_early_after_it_was_unsafe_is_judged_by_that(calm):
    d = distance(*[0.9] * 30, -0.1)
    d[0, 40:] = np.nan
    verdict = only(calm(distance_m=d, overrides=["law.k_o=0"], stops=[Stop(0, 0.4, "ego", "gone")]))
    assert verdict.verdict == BROKEN


@pytest.mark.parametrize("missing", [slice(None), slice(30, 31)], ids=["all of it", "one tick"])
def test_missing_distances_are_never_a_pass(calm, missing):
    d = dipping(0.2)
    d[0, missing] = np.nan
    verdict = only(calm(distance_m=d))
    assert verdict.verdict == INCOMPLETE
    assert not verdict.floor_held


def test_a_plant_without_bodies_is_judged_by_its_distances(calm):
    assert only(calm(distance_m=dipping(0.2), clearance_m=np.nan)).verdict == HELD


@pytest.mark.parametrize(("floor", "held"), [(0.19, True), (0.2, True), (0.21, False)])
def test_the_floor_is_the_least_that_is_allowed(calm, floor, held):
    trace = calm(distance_m=dipping(0.2), overrides=[f"expect.min_distance_m.at_least={floor}"])
    assert only(trace).floor_held is held
    assert only(trace).verdict == HELD


def test_no_floor_excuses_touching(calm):
    trace = calm(clearance_m=touching(20), overrides=["expect.min_distance_m.at_least=-5"])
    assert not only(trace).floor_held


def test_simulations_are_judged_each_on_its_own(calm):
    d = np.full((3, T, 2), 0.9)
    d[0] = dipping(0.2)[0]
    d[1, 20:, 0] = -0.1
    trace = calm(runs=3, distance_m=d, stops=[Stop(2, 0.4, "ego", "gone")])
    assert [v.verdict for v in judge(trace)] == [HELD, REFUTED, INCOMPLETE]
    assert [v.run for v in judge(trace)] == [0, 1, 2]
