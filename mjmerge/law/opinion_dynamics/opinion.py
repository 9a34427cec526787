"""Opinion z and bifurcation parameter mu: whether the ego wants to merge.

    z'  = (mu z - z^2) / eps                                                       (zi-2)
    mu' = -k_mu mu + k_s tanh(-k (rho.g_1)(rho.g_2)(dbar - 2r)(dbar'/dbar + eps_1))  (mu)

Over one control step the input of the mu-law is held, and both equations are then solved, not stepped:
mu exactly, z exactly for the step's mean mu. So z >= 0 always, and z does not depend on the step size.

A variant's floor under z holds after every step. In continuous time it is the limit of that: z rests on the
floor while (zi-2) points below it, z' = max(z', 0), and leaves it as soon as mu exceeds it.
"""

from __future__ import annotations

import numpy as np

from mjmerge.law.opinion_dynamics.parameters import Parameters
from mjmerge.law.opinion_dynamics.variants import reading
from mjmerge.state import Array, limit, nonzero

_MAX_EXPONENT = 600.0  # exp() of much more overflows; z is 0 or mu to the last bit long before


def bifurcation_input(law: Parameters, rho_g: Array, dbar: Array, dbar_dot: Array) -> Array:
    """Right-hand side of (mu) without the decay: k_s tanh(...), 1/s, (N,).

    Args:
        law: gains and variant.
        rho_g: rho.g_1 and rho.g_2, of the leader and the follower, (N, 2).
        dbar: gap between these two less r, m, (N,).
        dbar_dot: its rate, m/s, (N,).
    """
    beside = rho_g[:, 0] * rho_g[:, 1]  # < 0 between the two
    room = dbar - 2 * law.r_m  # > 0 if there is room
    open_ = dbar_dot / nonzero(dbar) + law.eps_1  # > 0 if it stays open
    x = -law.k * beside * room * open_
    for part in reading(law.variant).consent:
        x = part(x, beside, room, open_)
    return law.k_s * np.tanh(x)


def advance(law: Parameters, z: Array, mu: Array, mu_input: Array, step_s: float) -> tuple[Array, Array]:
    """The opinion z and mu one control step later, each (N,).

    Args:
        law: gains and variant.
        z: opinion, >= 0, (N,).
        mu: bifurcation parameter, (N,).
        mu_input: :func:`bifurcation_input`, held over the step, 1/s, (N,).
        step_s: control step h, s.
    """
    h = step_s
    mu_inf = mu_input / law.k_mu  # where mu goes while the input is held
    settled = -np.expm1(-law.k_mu * h)
    mu_next = mu + (mu_inf - mu) * settled
    mu_mean = mu_inf + (mu - mu_inf) * (settled / (law.k_mu * h))

    # logistic z' = (m z - z^2)/eps:  z(h) = z / (e^-x + z (1 - e^-x)/m),  x = m h/eps
    x = mu_mean * (h / law.eps)
    exponent = limit(x, _MAX_EXPONENT)
    flat = np.abs(x) < 1e-12  # (1 - e^-x)/m -> h/eps
    growth = np.where(flat, h / law.eps, -np.expm1(-exponent) / np.where(flat, 1.0, x) * (h / law.eps))
    return floored(law, z / (np.exp(-exponent) + z * growth)), mu_next


def floored(law: Parameters, z: Array) -> Array:
    """The opinion, not below the floor of the law's variant if it has one."""
    for least in reading(law.variant).least_z:
        z = np.maximum(z, least(law))
    return z


def rates(law: Parameters, z: Array, mu: Array, mu_input: Array) -> tuple[Array, Array]:
    """(zi-2) and (mu) in continuous time: d(ln z)/dt, which is z'/z, and mu', each 1/s, (N,).

    Args:
        law: gains and variant.
        z: opinion, (N,).
        mu: bifurcation parameter, (N,).
        mu_input: :func:`bifurcation_input`, 1/s, (N,).
    """
    growth = (mu - z) / law.eps
    for least in reading(law.variant).least_z:
        growth = np.where(z <= least(law), np.maximum(growth, 0.0), growth)
    return growth, mu_input - law.k_mu * mu
