"""Nominal tracking: where it comes to rest, and how it gets there."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.law import OpinionDynamics
from mjmerge.law.opinion_dynamics.tracking import target, track, weight

LAW = OpinionDynamics(r_rho_m=-1.2, r_eta_m=1.4)
number = st.floats(-10, 10)
vector = st.tuples(number, number).map(lambda v: np.array([v]))


@given(st.floats(0, 1e3), st.floats(0, 1e3))
def test_the_weight_grows_with_the_opinion_from_0_to_1(z, other):
    low, high = weight(LAW, np.array(sorted((z, other))))
    assert 0 <= low <= high <= 1
    assert weight(LAW, np.zeros(1)) == 0
    assert weight(LAW, np.array([1.0])) == 1


def test_the_slope_of_the_weight_at_indifference_is_k_w():
    assert weight(LAW, np.array([1e-6]))[0] / 1e-6 == pytest.approx(LAW.k_w, rel=1e-6)


@given(st.floats(0, 1))
def test_the_target_moves_straight_across_from_its_lane_to_the_gap(w):
    assert target(LAW, np.array([w]))[0] == pytest.approx([-1.2, (1 - w) * 1.4], abs=1e-15)


@given(vector, vector)
def test_at_the_target_and_at_the_leaders_speed_it_only_passes_the_leaders_acceleration_on(e, u_1):
    assert np.array_equal(track(LAW, e, e, np.zeros((1, 2)), u_1), u_1)


def test_the_error_decays_as_a_damped_oscillator_of_the_two_gains():
    """e'' = -k_p e - k_v e' with k_v^2 > 4 k_p: two exponentials."""
    slow, fast = np.roots([1, LAW.k_v, LAW.k_p])[::-1]
    e, nu, h, star = np.array([[1.0, -0.5]]), np.zeros((1, 2)), 1e-3, np.zeros((1, 2))
    for _ in range(3000):
        middle = nu + h / 2 * track(LAW, e, star, nu, star)
        e_middle = e + h / 2 * nu
        e, nu = e + h * middle, nu + h * track(LAW, e_middle, star, middle, star)
    left = (fast * np.exp(slow * 3) - slow * np.exp(fast * 3)) / (fast - slow)
    assert e[0] == pytest.approx(np.array([1.0, -0.5]) * left, rel=1e-5)
