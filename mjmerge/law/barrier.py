"""Dissipative barrier feedback: what keeps the ego away from the neighbours.

u_c = - sum_j k_o g_j d_j' / d_j,    d_j = |p - p_j| - r,    d_j' = g_j . nu_j
"""

from __future__ import annotations

import numpy as np

from mjmerge.scenario import Law
from mjmerge.state import Array


def barrier(law: Law, g: Array, d: Array, d_dot: Array) -> Array:
    """u_c, m/s^2, (N, 2).

    It is two-sided (it also drags the ego after a car that leaves) and pulls inward once d < 0, as printed.
    At d = 0 exactly the printed law divides by zero; the smallest positive number stands in for it.

    Args:
        law: gains.
        g: unit vectors from the neighbours to the ego, (N, 2, 2), neighbour before component.
        d: distances d_j, m, (N, 2).
        d_dot: their rates, m/s, (N, 2).
    """
    phi = d_dot / np.where(d == 0, np.finfo(float).tiny, d)
    pull = -law.k_o * phi
    u_c: Array = pull[:, :1] * g[:, 0] + pull[:, 1:] * g[:, 1]
    return u_c
