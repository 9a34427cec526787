"""Dissipative barrier feedback: what keeps the ego away from the neighbours.

u_c = - sum_j k_o g_j d_j' / d_j,    d_j = |p - p_j| - r,    d_j' = g_j . nu_j
"""

from __future__ import annotations

import numpy as np

from mjmerge.law.opinion_dynamics.parameters import Parameters
from mjmerge.law.opinion_dynamics.variants import reading
from mjmerge.state import LEAST, Array, nonzero


def barrier(law: Parameters, g: Array, d: Array, d_dot: Array) -> Array:
    """u_c, m/s^2, (N, 2).

    As printed it is two-sided (it also drags the ego after a car that leaves) and pulls inward once d < 0.
    On d = 0 itself the printed law divides by zero; here it is huge there, and points as for d > 0.

    Args:
        law: gains and variant.
        g: unit vectors from the neighbours to the ego, (N, C-1, 2), neighbour before component.
        d: distances d_j, m, (N, C-1).
        d_dot: their rates, m/s, (N, C-1).
    """
    for part in reading(law.variant).approach:
        d, d_dot = part(law, d, d_dot)
    phi = d_dot / nonzero(d)
    pull = -law.k_o * phi
    u_c = pull[:, :1] * g[:, 0]
    for j in range(1, pull.shape[1]):
        u_c = u_c + pull[:, j : j + 1] * g[:, j]
    return u_c


def effective_distance(law: Parameters, d: Array) -> Array:
    """What the barrier of the law's variant divides by at the distances d, m, (...): d itself as printed."""
    d_dot = np.zeros_like(d)
    for part in reading(law.variant).approach:
        d, d_dot = part(law, d, d_dot)
    return d


def singular(law: Parameters) -> bool:
    """Whether the barrier grows without bound as d_j falls to zero, so that no motion goes on from there."""
    return law.k_o > 0 and bool(effective_distance(law, np.array(LEAST)) <= LEAST)
