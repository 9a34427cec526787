"""Drivers: what every kind promises, and what each profile is."""

from math import pi, sin, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjmerge.config.units import rescaled
from mjmerge.drivers import Along, Traffic, kinds
from mjmerge.drivers.flips import Flips
from mjmerge.drivers.gap import Gap, Move, Sway
from mjmerge.drivers.idm import Idm
from mjmerge.drivers.lane import keep_lane
from mjmerge.drivers.speeds import Change, Speeds
from mjmerge.drivers.steady import Steady
from mjmerge.errors import MjmergeError
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.load import load


def example(kind):
    """A driver of a kind with 2.0 for every number that has no default."""
    fields = kinds()[kind].model_fields
    lists = {"time_s": (0.0, 2.0), "travelled_m": (0.0, 2.0)}
    return kinds()[kind](**{name: lists.get(name, 2.0) for name, f in fields.items() if f.is_required()})


def generators(seeds):
    return [np.random.default_rng(s) for s in seeds]


def moving(runs, seed=0):
    """A follower some metres behind a leader, in many simulations."""
    rng = np.random.default_rng(seed)
    own = Along(rng.uniform(-4, -1, runs), rng.uniform(1, 3, runs), np.zeros(runs), 0.1, 0.5)
    motion = rng.uniform(0, 1, runs), rng.uniform(1, 3, runs), rng.uniform(-1, 1, runs)
    return own, Along(*motion, 0.1, 0.5)


PAPER = load("paper").drivers.vehicle_2
CHARGE = load("charge").drivers.vehicle_2

gaps = pytest.mark.parametrize(
    "gap",
    [
        PAPER,
        CHARGE,
        Gap(
            gap_m=2.0,
            sway=Sway(amplitude_m=0.3, period_s=5.0, phase_rad=1.0),
            moves=(
                Move(start_s=2.0, duration_s=3.0, gap_m=1.5),
                Move(start_s=5.0, duration_s=1.0, gap_m=2.5, step="cubic"),
            ),
        ),
    ],
    ids=["paper", "charge", "swaying"],
)


def kinks(gap):
    """Where a profile's acceleration may jump."""
    return [t for m in gap.moves for t in (m.start_s, m.start_s + m.duration_s)]


@gaps
def test_rates_of_a_gap_profile_are_its_derivatives(gap):
    h = 1e-5
    for t in np.arange(0.05, 22, 0.0731):
        if min(abs(t - k) for k in kinks(gap)) < 1e-3:
            continue
        behind, now, ahead = (np.array(gap.profile(t + k * h)) for k in (-1, 0, 1))
        assert (ahead - behind)[:2] / (2 * h) == pytest.approx(now[1:], abs=1e-6)


@gaps
def test_a_gap_profile_and_its_rate_are_continuous_where_minds_change(gap):
    for t in kinks(gap):
        before, after = (gap.profile(t + k * 1e-9) for k in (-1, 1))
        assert after[:2] == pytest.approx(before[:2], abs=1e-6)
        assert gap.profile(t)[:2] == pytest.approx(before[:2], abs=1e-6)


@pytest.mark.parametrize("move", CHARGE.moves)
def test_a_quintic_move_does_not_jerk_the_acceleration(move):
    for t in (move.start_s, move.start_s + move.duration_s):
        before, after = (CHARGE.profile(t + k * 1e-9)[2] for k in (-1, 1))
        assert after == pytest.approx(before, abs=1e-6)


def test_the_papers_gap_wavers_as_a_sine_and_then_opens_to_2_314():
    for t in (0.0, 2.9, 7.0, 13.37):
        assert PAPER.profile(t)[0] == pytest.approx(1.868 + 0.275 * sin(2 * pi * t / 11.844 + 0.007))
    s = 0.3
    t = 13.374 + s * 5.581
    wavering = 1.868 + 0.275 * sin(2 * pi * t / 11.844 + 0.007)
    assert PAPER.profile(t)[0] == pytest.approx(wavering + (3 * s**2 - 2 * s**3) * (2.314 - wavering))
    for t in (18.956, 25.0, 35.0):
        assert PAPER.profile(t) == pytest.approx((2.314, 0, 0), abs=1e-9)


def test_the_charge_closes_holds_and_opens_as_published():
    t = np.arange(0, 12, 2e-3)
    gap, rate, acceleration = np.array([CHARGE.profile(x) for x in t]).T
    for when, held in (
        (t < 3.939, 3.436),
        ((t > 5.12) & (t < 7.109), 3.436 - 1.791),
        (t > 9.328, 3.436),
    ):
        assert np.ptp(gap[when]) < 1e-12
        assert gap[when][0] == pytest.approx(held)
    assert rate.min() == pytest.approx(-1.875 * 1.791 / 1.181, rel=1e-4)  # 2.8 m/s
    assert np.abs(acceleration).max() == pytest.approx(7.4, abs=0.05)


@gaps
def test_a_follower_on_its_profile_stays_on_it_whatever_the_leader_does(gap):
    """Its acceleration is the leader's less the profile's, so the error is that of the integration."""

    def leader(t):
        return Along(*(np.array([x]) for x in (2 * t + sin(t), 2 + np.cos(t), -sin(t))))

    def rate(t, x):
        own = Along(x[:1], x[1:], np.zeros(1))
        return np.concatenate([x[1:], gap.acceleration_mps2(t, own, leader(t), None)])

    g, g_dot, _ = gap.profile(0.0)
    within = 2e-3 if any(m.step == "cubic" for m in gap.moves) else 1e-5  # a cubic's acceleration jumps
    x, h = np.array([leader(0).position_m[0] - g, leader(0).speed_mps[0] - g_dot]), 0.005
    for k in range(2000):
        t = k * h
        k_1 = rate(t, x)
        k_2 = rate(t + h / 2, x + h / 2 * k_1)
        k_3 = rate(t + h / 2, x + h / 2 * k_2)
        k_4 = rate(t + h, x + h * k_3)
        x = x + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
        behind = leader(t + h).position_m[0] - x[0]
        assert behind == pytest.approx(gap.profile(t + h)[0], abs=within)


def test_a_follower_off_its_profile_returns_to_it():
    gap, h = Gap(gap_m=2.0), 1e-3
    x = np.array([-2.5, 2.0])
    for k in range(4000):
        leader = Along(np.array([2 * k * h]), np.array([2.0]), np.zeros(1))
        u = gap.acceleration_mps2(k * h, Along(x[:1], x[1:], np.zeros(1)), leader, None)[0]
        x = x + h * np.array([x[1], u])
    assert 8.0 - x[0] == pytest.approx(2.0, abs=2e-3)


FLIPS = Flips(closed_gap_m=1.7, open_gap_m=2.4, hold_min_s=0.5, hold_max_s=3.0)


@given(st.integers(0, 2**32), st.floats(0.1, 60))
def test_flips_come_in_order_within_their_limits_and_last_to_the_end(seed, duration_s):
    times = FLIPS.draw(generators([seed]), duration_s)[0]
    holds = np.diff(times, prepend=0)
    assert holds.min() >= FLIPS.hold_min_s - 1e-12
    assert holds.max() <= FLIPS.hold_max_s + 1e-12
    assert times[-1] > duration_s


def test_a_run_flips_at_the_same_times_whoever_runs_beside_it():
    together = FLIPS.draw(generators(range(8)), 35.0)
    for i in range(8):
        assert np.array_equal(FLIPS.draw(generators([i]), 35.0)[0], together[i])
    assert len({row.tobytes() for row in together}) == 8


def test_flips_never_accelerates_beyond_its_limit_and_opens_first():
    own, leader = moving(50)
    drawn = FLIPS.draw(generators(range(50)), 10.0)
    for t in np.arange(0, 10, 0.37):
        assert np.abs(FLIPS.acceleration_mps2(t, own, leader, drawn)).max() <= FLIPS.limit_mps2
    still = Along(np.array([-FLIPS.closed_gap_m]), np.array([2.0]), np.zeros(1))
    ahead = Along(np.zeros(1), np.array([2.0]), np.zeros(1))
    first, second = drawn[0, :2]
    for t, sign in ((first / 2, 0), ((first + second) / 2, -1), (second + 1e-6, 0)):
        u = FLIPS.acceleration_mps2(t, still, ahead, drawn[:1])[0]
        assert np.sign(u) == sign


def test_a_steady_leader_returns_to_its_speed():
    leader = Steady(speed_mps=2.0, gain_per_s=1.5)
    own = Along(np.zeros(3), np.array([1.0, 2.0, 4.0]), np.zeros(3))
    assert leader.acceleration_mps2(0.0, own, own, None) == pytest.approx([1.5, 0.0, -3.0])


@st.composite
def profiles(draw):
    """A driver of a speed profile with up to four changes, far enough apart."""
    first = speed = draw(st.floats(0, 30))
    changes, free_s = [], 0.0
    for _ in range(draw(st.integers(0, 4))):
        start_s, rate = free_s + draw(st.floats(0, 3)), draw(st.floats(0.2, 9))
        wanted = draw(st.just(0.0) | st.floats(0, 30))
        changes.append(Change(start_s=start_s, rate_mps2=rate, speed_mps=wanted))
        free_s, speed = start_s + abs(wanted - speed) / rate, wanted
    return Speeds(speed_mps=first, changes=tuple(changes))


def followed(driver, v, hold_s, until_s, leader=None):
    """Speeds of a point mass that does as a driver says, a row per hold; as exact as floating point."""
    x, speeds = np.zeros_like(v), [v]
    for k in range(round(until_s / hold_s)):
        ahead = None if leader is None else leader(k * hold_s)
        u = driver.acceleration_mps2(k * hold_s, Along(x, v, np.zeros_like(v)), ahead, None, hold_s)
        x, v = x + hold_s * v + hold_s**2 / 2 * u, v + hold_s * u
        speeds.append(v)
    return np.array(speeds)


@given(profiles(), st.floats(0, 60))
def test_a_change_of_speed_ends_when_its_rate_says_and_is_a_straight_line(driver, time_s):
    assert not list(driver.problems())
    speed = driver.speed_mps
    for change in driver.changes:
        lasts_s = abs(change.speed_mps - speed) / change.rate_mps2
        for part in (0.0, 0.25, 1.0):
            there = speed + part * (change.speed_mps - speed)
            assert driver.profile_mps(change.start_s + part * lasts_s) == pytest.approx(there, abs=1e-9)
        speed = change.speed_mps
    assert driver.profile_mps(1e3) == speed
    h = 1e-6
    if all(abs(time_s - at) > 2 * h for at in driver.switches(None)):
        slope = (driver.profile_mps(time_s + h) - driver.profile_mps(time_s - h)) / (2 * h)
        assert driver.rate_mps2(time_s, 0.0) == pytest.approx(slope, abs=1e-6)


@given(profiles(), st.sampled_from([0.01, 0.037, 0.2]))
@settings(max_examples=30)
def test_at_every_tick_a_leader_on_its_profile_has_the_speed_it_says_whatever_the_hold(driver, hold_s):
    speeds = followed(driver, np.array([driver.speed_mps]), hold_s, 20.0)[:, 0]
    said = [driver.profile_mps(k * hold_s) for k in range(len(speeds))]
    assert speeds == pytest.approx(said, abs=1e-9)


@given(profiles(), st.lists(st.floats(0, 60), min_size=1, max_size=3), st.floats(0.005, 1.0))
@settings(max_examples=30)
def test_a_leader_that_is_off_its_profile_never_reverses_and_comes_back_to_it(driver, v, hold_s):
    speeds = followed(driver, np.array(v), hold_s, 80.0 + hold_s)
    assert speeds.min() > -1e-9
    last = max([0.0, *driver.switches(None)])
    if last < 60:
        assert speeds[-1] == pytest.approx(driver.profile_mps(80.0), abs=1e-6)


def test_a_leader_told_to_stand_asks_for_nothing_at_a_stand_and_starts_when_told():
    stop = Change(start_s=1.0, rate_mps2=4.0, speed_mps=0.0)
    driver = Speeds(speed_mps=2.0, changes=(stop, Change(start_s=9.0, rate_mps2=1.0, speed_mps=1.0)))
    still = Along(np.zeros(2), np.zeros(2), np.zeros(2))
    for hold_s in (0.0, 0.01):
        for time_s, u in ((1.5, 0.0), (8.9, 0.0), (9.0, 1.0), (9.5, 1.0 + 2 * 0.5)):
            assert driver.acceleration_mps2(time_s, still, None, None, hold_s) == pytest.approx(u, abs=1e-9)


def test_changes_of_speed_that_overlap_or_are_out_of_order_are_told_and_those_that_meet_are_not():
    first, second = (Change(start_s=t, rate_mps2=4.0, speed_mps=v) for t, v in ((5.0, 0.0), (5.2, 1.0)))
    for changes in ((first, second), (second, first)):
        (problem,) = Speeds(speed_mps=2.0, changes=changes).problems()
        assert problem[0] == "changes.1.start_s"
    meets = Change(start_s=5.5, rate_mps2=1.0, speed_mps=1.0)
    assert not list(Speeds(speed_mps=2.0, changes=(first, meets)).problems())


@given(st.floats(0.1, 10), st.floats(0.1, 10), st.floats(0.05, 50))
def test_changes_that_meet_still_meet_at_any_other_size(start_s, speed_mps, length):
    first = Change(start_s=start_s, rate_mps2=3.0, speed_mps=0.0)
    then = Change(start_s=start_s + speed_mps / 3.0, rate_mps2=1.0, speed_mps=1.0)
    move = Move(start_s=start_s, duration_s=speed_mps, gap_m=2.0)
    after = Move(start_s=start_s + speed_mps, duration_s=1.0, gap_m=1.0)
    speeds = Speeds(speed_mps=speed_mps, changes=(first, then))
    for driver in (speeds, Gap(gap_m=1.0, moves=(move, after))):
        assert not list(rescaled(driver, length, sqrt(length)).problems())


idms = st.builds(
    Idm,
    desired_speed_mps=st.floats(1, 40),
    time_gap_s=st.floats(0, 3),
    standstill_gap_m=st.floats(0.2, 5),
    max_acceleration_mps2=st.floats(0.3, 3),
    comfortable_deceleration_mps2=st.floats(0.5, 5),
    exponent=st.floats(1, 8),
)


@given(idms, st.floats(0.0, 0.98), st.floats(0, 3), st.floats(0, 6))
def test_an_idm_at_its_equilibrium_gap_from_bumper_to_bumper_keeps_its_speed(idm, part, nose_m, tail_m):
    v = np.array([part * idm.desired_speed_mps])
    gap = idm.equilibrium_gap_m(v)
    reach = idm.standstill_gap_m + v * idm.time_gap_s
    assert gap == pytest.approx(reach / sqrt(1 - part**idm.exponent), rel=1e-9)
    own, ahead = (Along(x, v, np.zeros(1), nose_m, tail_m) for x in (np.zeros(1), gap + nose_m + tail_m))
    assert idm.acceleration_mps2(0.0, own, ahead, None) == pytest.approx(0.0, abs=1e-9)


def test_an_idm_accelerates_and_brakes_as_the_published_equation_says():
    """v_0 = 120 km/h, T = 1.6 s, s_0 = 2 m, a = 0.73, b = 1.67, delta = 4 (the paper's table), by hand."""
    idm = Idm(desired_speed_mps=120 / 3.6, time_gap_s=1.6, standstill_gap_m=2.0)
    own = Along(np.zeros(3), np.array([0.0, 20.0, 20.0]), np.zeros(3))
    assert idm.acceleration_mps2(0.0, own, None, None) == pytest.approx([0.73, 0.635392, 0.635392], abs=1e-6)
    ahead = Along(np.array([50.0, 50.0, 60.0]), np.array([0.0, 20.0, 15.0]), np.zeros(3))
    s_star = np.array([2.0, 34.0, 2 + 32 + 20 * 5 / (2 * sqrt(0.73 * 1.67))])
    wanted = 0.73 * (1 - np.array([0.0, 0.6, 0.6]) ** 4 - (s_star / np.array([50.0, 50.0, 60.0])) ** 2)
    assert idm.acceleration_mps2(0.0, own, ahead, None) == pytest.approx(wanted, abs=1e-9)


@given(idms, st.floats(-1, 60), st.floats(-1, 60), st.floats(-20, 200), st.sampled_from([0.0, 0.01, 1.0]))
def test_an_idm_stays_within_its_bounds_whatever_it_meets_overlapping_bodies_too(idm, v, v_l, x, hold_s):
    own, ahead = (Along(np.array([p]), np.array([s]), np.zeros(1), 1.0, 3.0) for p, s in ((0, v), (x, v_l)))
    (u,) = idm.acceleration_mps2(0.0, own, ahead, None, hold_s)
    assert -idm.limit_mps2 <= u
    assert u <= (idm.max_acceleration_mps2 if v >= 0 else idm.limit_mps2)
    assert v < 0 or v + hold_s * u >= -1e-9
    assert v > 0 or u >= 0
    if x <= 4.0 and v * idm.stop_gain_per_s >= idm.limit_mps2 and hold_s < 0.1:
        assert u == -idm.limit_mps2


PUBLISHED = Idm(desired_speed_mps=120 / 3.6, time_gap_s=1.6, standstill_gap_m=2.0)


@pytest.mark.parametrize(
    "idm", [load("stop_and_go").drivers.vehicle_2, PUBLISHED], ids=["shipped", "published"]
)
@pytest.mark.parametrize("hold_s", [0.01, 0.1])
def test_a_queue_on_idms_stops_behind_what_stops_stands_and_goes_on(idm, hold_s):
    v_0 = idm.desired_speed_mps / 2
    stop = Change(start_s=2.0, rate_mps2=4.0, speed_mps=0.0)
    lead = Speeds(speed_mps=v_0, changes=(stop, Change(start_s=60.0, rate_mps2=1.0, speed_mps=v_0)))
    times = np.arange(0, 100 + hold_s, hold_s)
    lead_mps = np.array([lead.profile_mps(t) for t in times])
    apart_m = np.array([1.0, 1.2, 2.0]) * idm.equilibrium_gap_m(np.array(v_0))
    lead_m = apart_m + np.concatenate([[0], np.cumsum((lead_mps[1:] + lead_mps[:-1]) / 2 * hold_s)])[:, None]

    def leader(t):
        k = round(t / hold_s)
        return Along(lead_m[k], np.full(3, lead_mps[k]), np.zeros(3))

    speeds = followed(idm, np.full(3, v_0), hold_s, 100.0, leader)
    n = len(speeds)
    moved_m = np.concatenate([np.zeros((1, 3)), np.cumsum((speeds[1:] + speeds[:-1]) / 2 * hold_s, axis=0)])
    gaps = lead_m[:n] - moved_m
    standing = (times[:n] > 50) & (times[:n] < 60)
    assert speeds.min() >= -1e-12
    # near s_0 the model swings, damped by T sqrt(a/(2 s_0)) = 0.42 and 0.68: it stops a little late
    assert gaps[standing].min() > 0.85 * idm.standstill_gap_m
    assert gaps[standing].max() < 1.02 * idm.standstill_gap_m
    assert np.ptp(gaps[standing], axis=0).max() < 0.01 * idm.standstill_gap_m
    assert (speeds[-1] > 0.9 * v_0).all()


@pytest.mark.parametrize("kind", sorted(kinds()))
def test_who_needs_somebody_ahead_is_refused_where_there_is_nobody(kind):
    """Whatever has been done to a scenario since it was loaded."""
    driver, sheets = example(kind), car_sheets(load("paper"))[1:]
    drivers = driver, Steady(speed_mps=2.0)
    if driver.can_lead:
        traffic = Traffic.of([drivers], [0], 10.0, np.zeros((1, 2, 2)), sheets, 0.01)
        assert tuple(one.driver for (one,) in traffic.drivers) == drivers
    else:
        with pytest.raises(MjmergeError, match=f"'{kind}' follows the car ahead"):
            Traffic.of([drivers], [0], 10.0, np.zeros((1, 2, 2)), sheets, 0.01)


def test_lane_keeping_pulls_back_without_crossing_the_lane():
    y, v, h = np.array([-2.0, -0.1, 0.0, 1.5]), np.zeros(4), 0.01
    side = np.sign(y)
    for _ in range(400):
        v = v + h * keep_lane(np.zeros(1), y, v)
        y = y + h * v
        assert (side * y >= 0).all()
    assert np.abs(y).max() < 0.01
