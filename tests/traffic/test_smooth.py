"""Smoothing moves nobody by more than it says, leaves what needs none, and makes motions possible."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.traffic.smooth import JERKY_MPS3, LONGEST_S, PLAUSIBLE_MPS2, smoothed


def noisy(seed, steps, noise_m, step_s=0.1):
    rng = np.random.default_rng(seed)
    t = np.arange(steps) * step_s
    way = np.stack([14 * t + 3 * np.sin(0.4 * t), 2 * np.tanh(t - 4)], axis=1)
    return way + rng.normal(0, noise_m, way.shape)


@given(st.integers(0, 10**6), st.integers(2, 120), st.floats(0, 0.4), st.none() | st.floats(0, 4))
def test_smoothing_moves_no_position_by_more_than_it_says(seed, steps, noise_m, period_s):
    centre_m = noisy(seed, steps, noise_m)
    found = smoothed(centre_m, 0.1, period_s)
    moved_m = np.hypot(*(found.centre_m - centre_m).T)
    assert found.centre_m.shape == centre_m.shape
    assert moved_m.max() == found.most_m
    assert np.isclose(np.sqrt((moved_m**2).mean()), found.rms_m)
    assert found.rms_m <= found.most_m
    assert found.period_s or np.array_equal(found.centre_m, centre_m)


@given(st.lists(st.floats(-5, 5), min_size=6, max_size=6), st.integers(2, 90), st.floats(0, 4))
def test_a_motion_of_steady_acceleration_is_left_as_it_is(coefficients, steps, period_s):
    t = np.arange(steps) * 0.1
    centre_m = np.stack([np.polyval(coefficients[:3], t), np.polyval(coefficients[3:], t)], axis=1)
    assert smoothed(centre_m, 0.1, period_s).most_m <= 1e-8


@given(st.floats(0.5, 4), st.sampled_from([0.04, 0.1]))
def test_a_motion_of_the_period_is_halved_and_a_slower_one_is_kept(period_s, step_s):
    t = np.arange(round(8 * period_s / step_s)) * step_s
    inner = slice(len(t) // 4, -len(t) // 4)
    for factor, kept, off in ((1.0, 0.5, 0.01), (3.0, 1.0, 0.005)):
        wave = np.sin(2 * np.pi * t / (factor * period_s))
        found = smoothed(np.stack([wave, wave], axis=1), step_s, period_s).centre_m[inner, 0]
        assert abs(found @ wave[inner] / (wave[inner] @ wave[inner]) - kept) <= off


def test_smooth_positions_are_not_smoothed_and_measured_ones_over_the_shortest_window_that_is_enough():
    plain = smoothed(noisy(0, 90, 0.0), 0.1)
    assert (plain.period_s, plain.most_m) == (0, 0)
    found = smoothed(noisy(0, 90, 0.15), 0.1)
    assert found.plausible
    assert found.acceleration_mps2 <= PLAUSIBLE_MPS2
    assert found.jerk_mps3 <= JERKY_MPS3
    assert 0.5 < found.period_s < LONGEST_S
    assert not smoothed(noisy(0, 90, 0.15), 0.1, found.period_s - 0.2).plausible


def test_a_motion_that_no_window_makes_plausible_is_smoothed_over_the_longest_and_says_so():
    found = smoothed(noisy(0, 90, 30.0), 0.1)
    assert found.period_s == pytest.approx(LONGEST_S)
    assert not found.plausible


@pytest.mark.parametrize("steps", [2, 3, 4, 5, 6])
def test_a_track_of_a_few_states_is_smoothed_too_where_it_can_be(steps):
    found = smoothed(noisy(0, steps, 0.3), 0.1)
    assert (found.period_s > 0) == (steps > 3)
    assert np.isfinite(found.centre_m).all()
