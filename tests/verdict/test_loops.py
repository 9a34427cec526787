"""How much dead time the loop can stand: against numbers by hand, and against a simulation of the loop."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.verdict.loops import foreseen_window_s, longest_delay_s

K_V, K_O, K_P = 2.0, 1.0, 0.7


def at(d, *, turn=None):
    turn = None if turn is None else np.array([turn])
    return float(longest_delay_s(np.array([K_V + K_O / d]), K_P, turn)[0])


@pytest.mark.parametrize(
    ("d", "turn", "longest"),
    [
        (0.13, None, 0.161),  # the double integrator, not 2/pi d/k_o = 0.204
        (0.13, 2.0 / 0.3302, 0.083),  # under the printed inverse of a 1/10 car at 2 m/s
        (np.inf, 2.0 / 0.3302, 0.169),  # without a barrier
    ],
)
def test_published_gains_stand_what_was_computed_by_hand(d, turn, longest):
    assert at(d, turn=turn) == pytest.approx(longest, abs=1e-3)


def test_at_full_size_and_25_mps_the_loop_without_barrier_stands_less():
    s = 8.1  # lengths; k_p goes with 1/s, k_v with 1/sqrt(s)
    longest = longest_delay_s(np.array([K_V / s**0.5]), K_P / s, np.array([25 / 2.7]))
    assert longest[0] == pytest.approx(0.151, abs=1e-3)


def test_the_bare_barrier_stands_a_quarter_turn():
    assert longest_delay_s(np.array([K_O / 0.13]), 0.0)[0] == pytest.approx(np.pi * 0.13 / 2, rel=1e-12)


def test_what_feeds_nothing_back_stands_any_delay():
    assert np.isinf(longest_delay_s(np.zeros(3), 0.0)).all()


@given(st.floats(0.01, 5), st.floats(0.1, 20))
def test_a_car_at_rest_is_a_double_integrator_and_a_rolling_one_stands_less(d, turn):
    assert at(d, turn=0.0) == pytest.approx(at(d), rel=1e-9)
    assert 0 < at(d, turn=turn) < at(d)


@given(st.floats(0.3, 30), st.floats(0.0, 3), st.floats(0.0, 3))
def test_at_the_ends_of_its_window_the_loop_by_the_foreseen_state_has_a_root_on_the_axis(K, k_p, T):
    shortest, longest = (float(end[0]) for end in foreseen_window_s(np.array([K]), k_p, T))
    assert shortest <= T < longest
    if T == 0:
        assert longest == pytest.approx(float(longest_delay_s(np.array([K]), k_p)[0]), rel=1e-4)
    w = np.linspace(0, 3 * (K + k_p * T) + 3 * k_p**0.5, 100_001)[1:]
    s = 1j * w
    for end in {shortest, longest} - {0.0, np.inf}:
        late = np.exp(-end * s) - np.exp(-T * s)
        left = s * s + K * s + k_p + late * ((K + k_p * T) * s + k_p)
        assert (np.abs(left) / (w * w + K * w + k_p)).min() < 2e-3


def test_the_windows_of_many_gains_are_those_of_each():
    many = np.linspace(2.0, 12.0, 600).reshape(30, 20)
    one = foreseen_window_s(many[3:4, 5], 0.7, 0.3)
    for all_of_them, alone in zip(foreseen_window_s(many, 0.7, 0.3), one, strict=True):
        assert all_of_them[3, 5] == pytest.approx(alone[0], abs=1e-4)
    assert foreseen_window_s(np.zeros(1), 0.0, 0.3)[1][0] == np.inf  # nothing is fed back


def test_where_there_is_next_to_no_distance_left_there_is_next_to_no_room():
    """Whatever the dead time; and no more than just before, where the equation itself is asked."""
    for K in (120.0, 1e4, np.inf):
        off = np.abs([end[0] - 1.0 for end in foreseen_window_s(np.array([K]), 0.7, 1.0)])
        assert (off * min(K, 1e12) <= 1.477).all()
    off = np.abs([end[0] - 1.0 for end in foreseen_window_s(np.array([99.0]), 0.7, 1.0)])
    assert (off * 99.7 >= 1.45).all()


def grows(delay_s, K, a, step_s=5e-4, duration_s=40.0):
    """Whether the loop with this dead time grows, by integration."""
    late = round(delay_s / step_s)
    history = np.zeros((late + 1, 3))
    x = np.array([1.0, 0.0, 0.0])  # s^3 X + e^{-tau s}((a + K) s^2 + (k_p + a K) s + a k_p) X = 0
    peak = []
    for k in range(round(duration_s / step_s)):
        history[k % (late + 1)] = x
        old = history[(k + 1) % (late + 1)] if k >= late else np.zeros(3)
        jerk = -((a + K) * old[2] + (K_P + a * K) * old[1] + a * K_P * old[0])
        x = x + step_s * np.array([x[1], x[2], jerk])
        peak.append(abs(x[1]))
    half = len(peak) // 2
    return max(peak[half:]) > max(peak[half // 2 : half])


@pytest.mark.parametrize(("d", "turn"), [(np.inf, 2.0 / 0.3302), (0.13, 2.0 / 0.3302), (0.5, 8.0)])
def test_the_loop_swings_up_beyond_that_delay_and_dies_down_before_it(d, turn):
    K, longest = K_V + K_O / d, at(d, turn=turn)
    assert grows(1.06 * longest, K, turn)
    assert not grows(0.94 * longest, K, turn)
