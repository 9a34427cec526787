"""Each verdict and each hypothesis on the smallest trace that shows it."""

import numpy as np
import pytest

from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.load import load
from mjmerge.simulation.trace import Stop
from mjmerge.verdict.hypotheses import HYPOTHESES, asked
from mjmerge.verdict.hypotheses import broken as marks
from mjmerge.verdict.judge import BROKEN, HELD, INCOMPLETE, REFUTED, UNRESOLVED, VACUOUS, judge

T = 60
AWAY = np.array([-1.2, 1.4]) / np.hypot(1.2, 1.4)
"""From Vehicle 1 to the ego in a calm trace."""


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
            "contact_impulse_n_s": 0.0,
            "gap_m": 2.4,
            "front_m": front,
            "velocity_mps": velocity,
            "speed_mps": 2.0,
            "u_mps2": 0.0,
            "steer_rad": 0.0,
            "torque_clipped_n_m": 0.0,
            "steer_clipped_rad": 0.0,
        }
        told = {"sensed_distance_m": "distance_m", "sensed_distance_rate_mps": "distance_rate_mps"}
        told = {seen: given[truth] for seen, truth in told.items() if truth in given}
        known = {"sensed_distance_m": 0.9, "sensed_distance_rate_mps": 0.0, "u_c_mps2": 0.0} | told
        return make_trace(ticks=T, **(known | still | given))

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


def slowed(to, sign=-1.0):
    """The columns of a run that dips to a distance from Vehicle 1, slowed by a barrier all the way."""
    d = dipping(to)
    rate = np.gradient(d, 0.01, axis=1)
    return {"distance_m": d, "distance_rate_mps": rate, "u_c_mps2": sign * rate[..., :1] * AWAY}


def only(trace, without=(-0.2, 0.9)):
    """The verdict on the one run of a trace, which without the barrier would come so close."""
    (verdict,) = judge(trace, np.array([without]))
    return verdict


OF_PAPER = {name for name, one in HYPOTHESES.items() if one.of(load("paper").law)}


def broken(trace):
    return {name for name, mask in marks(trace).items() if mask.any()}


def test_a_calm_trace_breaks_no_hypothesis(calm):
    assert broken(calm()) == set()


def test_every_monitor_marks_ticks_of_simulations(calm):
    found = marks(calm(runs=2))
    assert found.keys() == OF_PAPER  # mujoco has everything
    for name, mask in found.items():
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
    assert broken(calm(distance_rate_mps=at_start(np.inf, 0.0, 2))) == {"bounded start"}
    assert broken(calm(distance_rate_mps=at_start(1e3, np.inf, 2))) == set()  # later is another question


def test_an_opinion_of_zero_at_the_start_breaks_exactly_that(calm):
    assert broken(calm(opinion=at_start(0.0, 0.1))) == {"opinion is positive"}
    assert broken(calm(opinion=1e-300)) == set()


def test_an_opinion_that_underflows_to_zero_breaks_it_too_for_the_theorem_starts_anew_from_there(calm):
    assert broken(calm(opinion=at_start(1e-300, 0.0))) == {"opinion is positive"}


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
    crossing = Stop(0, 0.4, "ego", "d_2 goes through 0", touched=True, crossing=True)
    verdict = only(calm(distance_m=d, continuous=True, plant="bicycle", stops=[crossing]))
    assert (verdict.verdict, verdict.unsafe_at_s) == (REFUTED, 0.4)
    assert not verdict.floor_held


def test_a_run_that_ended_because_a_distance_cannot_be_told_from_zero_is_unresolved(calm):
    d = dipping(0.2, tick=20)
    d[0, 40:] = np.nan
    fading = Stop(0, 0.4, "ego", "d_2 is below 1.8e-07 m", touched=True)
    verdict = only(calm(distance_m=d, continuous=True, plant="bicycle", stops=[fading]))
    assert (verdict.verdict, verdict.unsafe_at_s, verdict.floor_held) == (UNRESOLVED, None, False)
    assert "1.8e-07 m" in verdict.reason
    v = np.full((1, T, 3), 2.0)
    v[0, 25:, 0] = 0.05
    excused = only(calm(distance_m=d, continuous=True, plant="bicycle", stops=[fading], speed_mps=v))
    assert (excused.verdict, excused.matters.hypothesis) == (BROKEN, "ego rolls")


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


@pytest.mark.parametrize(
    ("plant", "stands"), [("double_integrator", 0.0731), ("bicycle", 0.2054), ("mujoco", 0.2054)]
)
def test_a_delay_too_long_for_the_loop_at_that_distance_breaks_exactly_that(calm, plant, stands):
    """At 100 ms; under the bicycle inverse the same loop stands far less."""
    delay = ["mismatch.command_delay_s=0.1"]
    near, far = (calm(distance_m=dipping(stands * k), overrides=delay, plant=plant) for k in (0.97, 1.03))
    assert broken(near) == {"delay small against d"}
    assert broken(far) == set()
    assert broken(calm(distance_m=dipping(0.06), plant=plant)) == set()


def test_in_continuous_time_there_is_no_delay(calm):
    late = calm(
        distance_m=dipping(0.06),
        overrides=["mismatch.command_delay_s=0.1"],
        plant="bicycle",
        continuous=True,
    )
    assert "delay small against d" not in asked(late)
    assert broken(late) == set()


@pytest.mark.parametrize("without", [(-0.01, 0.9), (0.9, 0.0), (0.139, 0.9), (0.9, 0.13)])
def test_safe_and_unsafe_or_much_closer_without_the_barrier_is_held(calm, without):
    verdict = only(calm(**slowed(0.2)), without)
    assert (verdict.verdict, verdict.unsafe_at_s, verdict.breaches) == (HELD, None, ())
    assert (verdict.needed, verdict.without_barrier_m) == (True, min(without))
    assert f"{min(without):.3f} m" in verdict.reason
    assert verdict.floor_held


@pytest.mark.parametrize("without", [(0.141, 0.9), (0.9, 0.3), (0.9, 0.9)])
def test_safe_and_hardly_closer_without_the_barrier_is_vacuous_however_close_it_came(calm, without):
    verdict = only(calm(**slowed(0.2)), without)
    assert (verdict.verdict, verdict.needed) == (VACUOUS, False)
    assert verdict.floor_held


def test_where_nothing_comes_within_r_even_without_the_barrier_it_was_not_needed(calm):
    assert only(calm(), without=(0.61, 0.9)).verdict == VACUOUS


def test_a_run_whose_barrier_is_off_is_never_held(calm):
    verdict = only(calm(**slowed(0.2), overrides=["law.k_o=0"]))
    assert (verdict.verdict, verdict.needed) == (VACUOUS, False)
    assert "the barrier is off" in verdict.reason


@pytest.mark.parametrize("sign", [0.0, 1.0], ids=["idle", "pushing inwards"])
def test_a_barrier_that_takes_no_energy_out_of_the_approach_held_nothing(calm, sign):
    assert only(calm(**slowed(0.2, sign))).verdict == VACUOUS


def test_an_ego_that_is_told_a_wrong_distance_where_it_is_least_guarded_another(calm):
    run = slowed(0.2)
    wrong = only(calm(**run, sensed_distance_m=run["distance_m"] + 0.1))
    assert (wrong.verdict, wrong.needed) == (VACUOUS, True)
    assert "0.100 m too large" in wrong.reason
    noise = np.where(np.arange(T) % 2, 0.1, -0.1)[None, :, None]
    assert only(calm(**run, sensed_distance_m=run["distance_m"] + noise)).verdict == HELD


def test_safe_although_a_hypothesis_broke_is_held_beyond_them_and_says_so(calm):
    v = np.full((1, T, 3), 2.0)
    v[0, 20, 0] = 0.05
    verdict = only(calm(**slowed(0.2), speed_mps=v))
    assert verdict.verdict == HELD
    assert "safe beyond its hypotheses: 'ego rolls' broke at 0.20 s" in verdict.reason


def approach(*, breach, unsafe=40):
    """A run that is unsafe at a tick after coming near (d < r/2) at tick 30, an ego that stands at others."""
    d = np.full(T, 0.9)
    d[30:unsafe] = 0.29
    d[unsafe:] = -0.1
    v = np.full((1, T, 3), 2.0)
    v[0, breach, 0] = 0.05
    return {"distance_m": distance(*d), "speed_mps": v}


@pytest.mark.parametrize(
    ("breach", "since_s"),
    [
        (slice(28, 31), 0.28),  # still broken when the approach begins
        (slice(35, 36), 0.35),
        (slice(40, 41), 0.40),  # with the violation itself
        (slice(0, 60), 0.0),
    ],
    ids=["still broken", "in it", "at its end", "all along"],
)
def test_what_is_broken_in_the_approach_excuses_and_is_named_since_when(calm, breach, since_s):
    verdict = only(calm(**approach(breach=breach)))
    assert (verdict.verdict, verdict.unsafe_at_s) == (BROKEN, pytest.approx(0.4))
    assert (verdict.matters.hypothesis, verdict.matters.time_s) == ("ego rolls", pytest.approx(since_s))


@pytest.mark.parametrize("breach", [slice(0, 1), slice(10, 25), slice(41, 60)])
def test_what_was_over_before_the_approach_began_or_came_after_it_excuses_nothing(calm, breach):
    verdict = only(calm(**approach(breach=breach)))
    assert verdict.verdict == REFUTED
    assert [b.hypothesis for b in verdict.breaches] == ["ego rolls"]


def test_the_breach_that_is_named_is_the_first_of_the_approach_and_not_of_the_run(calm):
    run = approach(breach=slice(36, 40))
    run["steer_rad"] = np.zeros((1, T, 3))
    run["steer_rad"][0, 5, 0] = 1.5  # over long before
    verdict = only(calm(**run))
    assert [b.hypothesis for b in verdict.breaches] == ["steering within limit", "ego rolls"]
    assert verdict.matters.hypothesis == "ego rolls"


def test_a_second_violation_that_nothing_excuses_is_not_covered_by_the_excuse_of_the_first(calm):
    run = approach(breach=slice(2, 4), unsafe=40)
    run["distance_m"][0, 3, 0] = -0.1  # with its excuse; and comfortably apart again
    verdict = only(calm(**run))
    assert (verdict.verdict, verdict.unsafe_at_s) == (REFUTED, pytest.approx(0.4))


def test_a_tick_that_can_jump_over_what_is_left_breaks_the_hold(calm):
    rate, u_c = np.zeros((1, T, 2)), np.zeros((1, T, 2))
    rate[0, 30, 0] = -1.1
    u_c[0, 30] = 1.1 / 0.011 * AWAY
    run = {"distance_rate_mps": rate, "u_c_mps2": u_c}
    assert broken(calm(distance_m=dipping(0.0111), **run)) == set()
    assert broken(calm(distance_m=dipping(0.0109), **run)) == {"hold small against d"}
    for other in (0.4, 0.0, -1.0):  # it was not the hold, but a barrier that did not do what it says
        run["u_c_mps2"] = other * u_c
        assert broken(calm(distance_m=dipping(0.0109), **run)) == set()


def test_an_unsafe_run_of_which_something_is_not_known_is_not_refuted(calm):
    speed = np.full((1, T, 3), 2.0)
    speed[0, 18:, 0] = np.nan
    verdict = only(calm(distance_m=distance(*[0.9] * 20, -0.1), speed_mps=speed))
    assert (verdict.verdict, verdict.unsafe_at_s) == (INCOMPLETE, pytest.approx(0.2))
    assert "'ego rolls'" in verdict.reason


@pytest.mark.parametrize("plant", ["double_integrator", "bicycle", "bicycle_limited", "mujoco"])
def test_a_hypothesis_is_asked_only_where_the_plant_has_the_thing(calm, plant):
    wheels = {"ego rolls", "steering within limit"}
    limits, bodies = {"command within limits"}, {"margin covers the bodies"}
    lacks = {
        "double_integrator": wheels | limits | bodies,
        "bicycle": limits | bodies,
        "bicycle_limited": bodies,
        "mujoco": set(),
    }
    assert OF_PAPER - asked(calm(plant=plant)).keys() == lacks[plant]


def test_a_point_that_stands_and_does_not_steer_breaks_nothing(calm):
    still = calm(plant="double_integrator", speed_mps=0.0, steer_rad=np.nan, clearance_m=np.nan)
    assert broken(still) == set()


def test_an_ego_that_is_told_wrong_closing_speeds_breaks_exactly_that(calm):
    told = np.zeros((1, T, 2))
    told[0, 20, 1] = 0.11
    assert broken(calm(sensed_distance_rate_mps=told)) == {"closing speeds known"}
    told[0, 20, 1] = -0.09
    assert broken(calm(sensed_distance_rate_mps=told)) == set()


@pytest.mark.parametrize("plant", ["double_integrator", "bicycle"])
def test_neighbours_that_would_overlap_break_assumption_1_also_where_there_are_no_bodies(calm, plant):
    sheet = data_sheet("rc")
    front = calm().front_m.copy()
    front[0, 30:, 2, 0] = front[0, 30:, 1, 0] - sheet.length_m - 0.001
    apart = {"front_m": front, "clearance_m": np.nan, "contact_impulse_n_s": np.nan, "plant": plant}
    assert broken(calm(**apart)) == set()
    front[0, 40, 2, 0] += 0.002
    assert broken(calm(**apart)) == {"neighbours keep apart"}
    front[0, 40, 2, 1] = sheet.width_m + 0.001  # beside it, in another lane
    assert broken(calm(**apart)) == set()


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


def test_neighbours_that_touch_each_other_are_not_the_egos_fault_but_said(calm):
    clearance, speed = np.full((1, T, 3), 0.5), np.zeros((1, T, 3))
    clearance[0, 20, 2], speed[0, 20, 2] = -0.01, 1.5
    trace = calm(**slowed(0.2), clearance_m=clearance, contact_speed_mps=speed)
    assert broken(trace) == {"neighbours keep apart"}
    verdict = only(trace)
    assert verdict.verdict == HELD
    assert verdict.reason.startswith("vehicle_1 and vehicle_2 collide at 0.20 s at 1.50 m/s; safe beyond")


def test_a_reason_begins_with_the_contact_with_whom_when_and_how_fast(calm):
    clearance, speed = np.full((1, T, 3), 0.5), np.zeros((1, T, 3))
    clearance[0, 20:25, 1], speed[0, 20:25, 1] = -0.01, [0.8, 0.6, 0.0, 0.0, 0.0]
    verdict = only(calm(clearance_m=clearance, contact_speed_mps=speed))
    assert verdict.reason.startswith("the ego hits vehicle_2 at 0.20 s at 0.80 m/s; unsafe at 0.20 s")
    (hit,) = verdict.collisions
    assert (hit.a, hit.b, hit.time_s, hit.speed_mps) == ("ego", "vehicle_2", pytest.approx(0.2), 0.8)


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
    bodiless = calm(**slowed(0.2), clearance_m=np.nan, contact_impulse_n_s=np.nan, plant="bicycle")
    assert only(bodiless).verdict == HELD


@pytest.mark.parametrize(("floor", "held"), [(0.19, True), (0.2, True), (0.21, False)])
def test_the_floor_is_the_least_that_is_allowed(calm, floor, held):
    trace = calm(**slowed(0.2), overrides=[f"expect.min_distance_m.at_least={floor}"])
    assert only(trace).floor_held is held
    assert only(trace).verdict == HELD


def test_no_floor_excuses_touching(calm):
    trace = calm(clearance_m=touching(20), overrides=["expect.min_distance_m.at_least=-5"])
    assert not only(trace).floor_held


def test_simulations_are_judged_each_on_its_own(calm):
    first = slowed(0.2)
    columns = {name: np.concatenate([values, *[np.zeros_like(values)] * 2]) for name, values in first.items()}
    columns["distance_m"][1:] = 0.9
    columns["distance_m"][1, 20:, 0] = -0.1
    trace = calm(runs=3, **columns, stops=[Stop(2, 0.4, "ego", "gone")])
    found = judge(trace, np.full((3, 2), -0.1))
    assert [v.verdict for v in found] == [HELD, REFUTED, INCOMPLETE]
    assert [v.run for v in found] == [0, 1, 2]
