"""Nominal tracking: towards the target that the opinion chooses.

    u_n = -k_p (e_1 - e_1*) - k_v nu_1 + u_1,    e_1* = rho r^rho + (1 - w) eta r^eta,    w = tanh(k_w z)

The paper writes the first gain as k_d once; everywhere else, and in the proof, it is k_p.
"""

from __future__ import annotations

import numpy as np

from mjmerge.law.opinion_dynamics.parameters import Parameters
from mjmerge.state import Array

RHO = np.array([1.0, 0.0])
"""Longitudinal unit vector of the road, in the road frame."""
ETA = np.array([0.0, 1.0])
"""Lateral unit vector of the road, in the road frame."""


def weight(law: Parameters, z: Array) -> Array:
    """w(z) = tanh(k_w z), (N,)."""
    return np.tanh(law.k_w * z)


def target(law: Parameters, w: Array) -> Array:
    """e_1*, where the ego should be as seen from the leader, m, (N, 2)."""
    return law.r_rho_m * RHO + (1 - w)[:, None] * (law.r_eta_m * ETA)


def track(law: Parameters, e_1: Array, e_1_star: Array, nu_1: Array, u_1: Array) -> Array:
    """u_n, m/s^2, (N, 2).

    Args:
        law: gains.
        e_1: p - p_1, m, (N, 2).
        e_1_star: :func:`target`, m, (N, 2).
        nu_1: v - v_1, m/s, (N, 2).
        u_1: acceleration of the leader, m/s^2, (N, 2).
    """
    return -law.k_p * (e_1 - e_1_star) - law.k_v * nu_1 + u_1
