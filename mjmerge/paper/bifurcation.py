"""The bifurcation diagram of the opinion: equilibria of z' = (mu z - z^2)/eps, and what converges to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjmerge.law import OpinionDynamics
from mjmerge.law.opinion_dynamics.opinion import advance, rates
from mjmerge.state import Array, Mask

_STEP = 1e-4  # of the central difference, which is exact for a parabola


@dataclass(frozen=True)
class Branches:
    """Both equilibria of z for every mu.

    Attributes:
        mu: bifurcation parameter, (M,).
        z: equilibria z_a = 0 and z_b = mu, (M, 2).
        slope_per_s: dz'/dz there, 1/s, (M, 2).
    """

    mu: Array
    z: Array
    slope_per_s: Array

    @property
    def stable(self) -> Mask:
        """Whether z comes back from nearby, (M, 2)."""
        return self.slope_per_s < 0


def rate(law: OpinionDynamics, z: Array, mu: Array) -> Array:
    """z', 1/s, of the shape that z and mu broadcast to."""
    growth, _ = rates(law, z, mu, np.zeros_like(mu))
    return z * growth


def branches(law: OpinionDynamics, mu: Array) -> Branches:
    """Equilibria and the sign of the derivative there, for each mu of (M,)."""
    z = np.stack([np.zeros_like(mu), mu], axis=1)
    slope = (rate(law, z + _STEP, mu[:, None]) - rate(law, z - _STEP, mu[:, None])) / (2 * _STEP)
    return Branches(mu, z, slope)


def converging(law: OpinionDynamics, mu: Array, z_0: Array, time_s: Array) -> Array:
    """The opinion over time, as the simulation itself advances it, with mu held, (T, M, K).

    Args:
        law: gains.
        mu: where it is held, (M,).
        z_0: where the opinion starts, > 0, (K,).
        time_s: evenly spaced from 0, s, (T,).
    """
    held, z = (np.ravel(a) for a in np.broadcast_arrays(mu[:, None], z_0))
    rows = [z]
    for step_s in np.diff(time_s):
        z, _ = advance(law, z, held, law.k_mu * held, float(step_s))  # this input keeps mu where it is
        rows.append(z)
    return np.stack(rows).reshape(len(time_s), len(mu), len(z_0))
