"""How much dead time the closed loop can stand: its characteristic equation, at the distance it is at.

Towards a neighbour at distance d the barrier adds k_o/d to the velocity gain, K = k_v + k_o/d. With a dead
time tau the front axle as a double integrator obeys

    s^2 + e^(-tau s) (K s + k_p) = 0.

A bicycle under the printed inverse, which divides by the *measured* steering angle, has a = v_r/L beside it:

    s^3 + e^(-tau s) (a s^2 + (s + a)(K s + k_p)) = 0.

Under the inverse by the commanded angle a cancels, and the first holds. Both are stable at tau = 0. They
lose that at the least tau for which a root s = i w lies on the axis: the modulus gives w, the phase gives
tau. (The bare barrier, K = k_o/d and k_p = 0, stands tau = pi d/(2 k_o).)

Under the foreseen state, which reckons with a dead time T (:mod:`mjmerge.vehicle.foresight`), it is

    s^2 + K s + k_p + (e^(-tau s) - e^(-T s)) ((K + k_p T) s + k_p) = 0,

stable at tau = T, whatever T is, and lost on both sides of it: too short a dead time is as wrong as too long
a one.
"""

from __future__ import annotations

import numpy as np

from mjmerge.state import Array

_GAINS, _FREQUENCIES = 200, 4000
_MOST_PER_S = 1e12  # gains beyond are those of a distance that is none
_MANY, _OFF = 100.0, 1.45
"""Where K T is more than the first, K |tau - T| may be this at most: 2 sin(w x/2) = |1 + i x| wants 1.477."""
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


def foreseen_window_s(velocity_gain: Array, position_gain: float, foreseen_s: float) -> tuple[Array, Array]:
    """Between which dead times the loop by the foreseen state is stable, s, (...) each; from 0, or to inf.

    Args:
        velocity_gain: K = k_v + k_o/d, 1/s, (...); of many, what lies between :data:`_GAINS` of them.
        position_gain: k_p, 1/s^2.
        foreseen_s: T, the dead time that is reckoned with, s.
    """
    gains, back = np.unique(np.minimum(velocity_gain, _MOST_PER_S), return_inverse=True)
    if len(gains) > _GAINS:
        gains = np.geomspace(max(gains[0], 1e-6), max(gains[-1], 1e-6), _GAINS)
        ends = np.array([_window(K, position_gain, foreseen_s) for K in gains.tolist()])
        shortest, longest = (np.interp(velocity_gain, gains, end) for end in ends.T)
        return shortest, longest
    ends = np.array([_window(K, position_gain, foreseen_s) for K in gains.tolist()])
    shortest, longest = (end[back].reshape(velocity_gain.shape) for end in ends.T)
    return shortest, longest


def _window(K: float, k_p: float, foreseen_s: float) -> tuple[float, float]:  # noqa: N803
    """The same of one gain: the nearest tau on either side for which |e^(-tau s)| = 1 at an s = i w."""
    T = foreseen_s  # noqa: N806
    most = 3 * (K + k_p * T) + 3 * np.sqrt(k_p)  # beyond, s^2 outweighs all else
    if most == 0:
        return 0.0, np.inf  # nothing is fed back
    if K * T > _MANY:  # more turns than can be looked through, and next to no room
        room = _OFF / (K + k_p * T)
        return max(T - room, 0.0), T + room

    def delayed(w: Array) -> Array:  # what e^(-tau s) has to be
        s = 1j * w
        found: Array = np.exp(-T * s) - (s * s + K * s + k_p) / ((K + k_p * T) * s + k_p)
        return found

    w = np.linspace(0.0, most, _FREQUENCIES)[1:]
    off = np.abs(delayed(w)) - 1
    at = np.flatnonzero(off[1:] * off[:-1] <= 0)
    w = w[at] + off[at] / (off[at] - off[at + 1]) * (w[1] - w[0])
    turn = 2 * np.pi / w
    first = -np.angle(delayed(w)) / w % turn
    before = first + np.floor((T - first) / turn) * turn
    shortest, longest = np.append(before[before >= 0], 0.0).max(), np.append(before + turn, np.inf).min()
    return float(shortest), float(longest)


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
