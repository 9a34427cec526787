"""How much dead time the closed loop can stand: its characteristic equation, at the distance it is at.

Towards a neighbour at distance d the barrier adds k_o/d to the velocity gain, K = k_v + k_o/d. With a dead
time tau the front axle as a double integrator obeys

    s^2 + e^(-tau s) (K s + k_p) = 0.

A bicycle under the printed inverse, which divides by the *measured* steering angle, has a = v_r/L beside it:

    s^3 + e^(-tau s) (a s^2 + (s + a)(K s + k_p)) = 0.

Under the inverse by the commanded angle a cancels, and the first holds. Both are stable at tau = 0. They
lose that at the least tau for which a root s = i w lies on the axis: the modulus gives w, the phase gives
tau. (The bare barrier, K = k_o/d and k_p = 0, stands tau = pi d/(2 k_o).)
"""

from __future__ import annotations

import numpy as np

from mjmerge.state import Array

_NEWTON = 60  # from above, where the cubic is convex, it converges quadratically; this is for the far start


def longest_delay_s(velocity_gain: Array, position_gain: float, turn_per_s: Array | None = None) -> Array:
    """The dead time at which the loop loses its stability, s, (...).

    Args:
        velocity_gain: K = k_v + k_o/d, 1/s, (...).
        position_gain: k_p, 1/s^2.
        turn_per_s: a = v_r/L >= 0, 1/s, broadcast against (...); ``None`` for a double integrator.
    """
    K, k_p = velocity_gain, position_gain  # noqa: N806
    with np.errstate(divide="ignore", invalid="ignore"):
        if turn_per_s is None:
            w = np.sqrt((K * K + np.sqrt(K**4 + 4 * k_p * k_p)) / 2)
            longest: Array = np.arctan2(K * w, k_p) / w
        else:
            a = np.broadcast_to(turn_per_s, K.shape)
            w = np.sqrt(_largest_root(a, K, k_p))
            phase = np.arctan2((k_p + a * K) * w, a * k_p - (a + K) * w * w)  # in (0, pi)
            longest = (phase - np.pi / 2) / w
    return np.where(w > 0, longest, np.inf)  # nothing fed back: nothing to be late


def _largest_root(a: Array, K: Array, k_p: float) -> Array:  # noqa: N803
    """Largest x = w^2 with |a s^2 + (s + a)(K s + k_p)| = w^3 at s = i w, (...)."""
    square, linear, constant = (a + K) ** 2, k_p * k_p + (a * K) ** 2 - 2 * a * a * k_p, (a * k_p) ** 2
    x = square + np.sqrt(np.abs(linear)) + np.cbrt(constant) + 1e-300  # beyond every root
    for _ in range(_NEWTON):
        step = (((x - square) * x - linear) * x - constant) / ((3 * x - 2 * square) * x - linear)
        x = x - np.maximum(step, 0.0)
        if not np.any(step > 1e-14 * x):
            break
    return x
