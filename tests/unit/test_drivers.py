"""Drivers: what every kind promises, and what each profile is."""

from math import pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from mjmerge.drivers import Along, kinds
from mjmerge.drivers.flips import Flips
from mjmerge.drivers.gap import Gap, Move, Sway
from mjmerge.drivers.lane import keep_lane
from mjmerge.drivers.steady import Steady
from mjmerge.loader import load


def example(kind):
    """A driver of a kind with 2.0 for every key that has no default."""
    fields = kinds()[kind].model_fields
    return kinds()[kind](**{name: 2.0 for name, f in fields.items() if f.is_required()})


def generators(seeds):
    return [np.random.default_rng(s) for s in seeds]


def moving(runs, seed=0):
    """A follower some metres behind a leader, in many simulations."""
    rng = np.random.default_rng(seed)
    own = Along(rng.uniform(-4, -1, runs), rng.uniform(1, 3, runs), np.zeros(runs))
    return own, Along(rng.uniform(0, 1, runs), rng.uniform(1, 3, runs), rng.uniform(-1, 1, runs))


@pytest.mark.parametrize("kind", sorted(kinds()))
@pytest.mark.parametrize("runs", [1, 3])
def test_every_kind_gives_one_finite_acceleration_per_simulation(kind, runs):
    driver = example(kind)
    drawn = driver.draw(generators(range(runs)), 10.0)
    for time_s in (0.0, 0.5, 7.3, 10.0):
        u = driver.acceleration_mps2(time_s, *moving(runs), drawn)
        assert u.shape == (runs,)
        assert u.dtype == np.float64
        assert np.isfinite(u).all()


@pytest.mark.parametrize("kind", sorted(kinds()))
def test_every_kind_answers_the_same_to_the_same_question_and_leaves_it_alone(kind):
    driver = example(kind)
    drawn = driver.draw(generators(range(4)), 10.0)
    own, leader = moving(4)
    before = [a.copy() for a in (*vars(own).values(), *vars(leader).values())]
    kept = None if drawn is None else drawn.copy()
    late, early = (driver.acceleration_mps2(t, own, leader, drawn) for t in (9.0, 2.0))
    assert np.array_equal(driver.acceleration_mps2(9.0, own, leader, drawn), late)
    assert np.array_equal(driver.acceleration_mps2(2.0, own, leader, drawn), early)
    for old, new in zip(before, (*vars(own).values(), *vars(leader).values()), strict=True):
        assert np.array_equal(old, new)
    assert kept is None or np.array_equal(kept, drawn)


@pytest.mark.parametrize("kind", sorted(kinds()))
def test_every_kind_is_frozen(kind):
    driver = example(kind)
    for name in type(driver).model_fields:
        with pytest.raises(ValidationError, match="frozen"):
            setattr(driver, name, 3.0)


@pytest.mark.parametrize("kind", sorted(kinds()))
def test_every_kind_does_in_a_batch_what_it_does_alone(kind):
    driver = example(kind)
    together = driver.draw(generators(range(5)), 10.0)
    own, leader = moving(5)
    u = driver.acceleration_mps2(3.0, own, leader, together)
    for i in range(5):
        row = slice(i, i + 1)
        alone = driver.draw(generators([i]), 10.0)
        assert (alone is None) == (together is None)
        assert alone is None or np.array_equal(alone[0], together[i])
        o, lead = (Along(*(a[row] for a in vars(x).values())) for x in (own, leader))
        assert driver.acceleration_mps2(3.0, o, lead, alone)[0] == u[i]


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


def test_lane_keeping_pulls_back_without_crossing_the_lane():
    y, v, h = np.array([-2.0, -0.1, 0.0, 1.5]), np.zeros(4), 0.01
    side = np.sign(y)
    for _ in range(400):
        v = v + h * keep_lane(np.zeros(1), y, v)
        y = y + h * v
        assert (side * y >= 0).all()
    assert np.abs(y).max() < 0.01
