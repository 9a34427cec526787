"""Tracking filtered by control barrier functions of relative degree two: a quadratic programme at every tick.

    minimise |u - u_n|^2
    subject to d_j'' + (alpha_1 + alpha_2) d_j' + alpha_1 alpha_2 d_j >= 0 for all j

with d_j = |p - p_j| - r, d_j' = g_j . nu_j and d_j'' = g_j . (u - u_j) + (|nu_j|^2 - d_j'^2) / |p - p_j|.
It is the exponential control barrier function of Nguyen and Sreenath (ACC 2016, p. 322), and the high-order
one of Xiao and Belta (CDC 2019, p. 474) with linear class-K functions: in continuous time d_j stays positive
where d_j > 0 and psi_j = d_j' + alpha_1 d_j >= 0 at the start, the constraints can be met at all times, and
u_j is known or within its bound.

u_j is not sensed: the leader's is told, of all others g_j . u_j <= a_j is taken, the worst case. Where the
constraints contradict each other, u is the point that violates the worst of them least. The programme is
solved exactly, see :mod:`mjmerge.law.halfplanes`.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

import numpy as np

from mjmerge.config.frozen import NonNegative, Positive
from mjmerge.config.units import Unit
from mjmerge.law.base import Decision, Memory, Signal
from mjmerge.law.halfplanes import nearest
from mjmerge.law.nominal import Tracking
from mjmerge.law.sensed import Sensed, geometry
from mjmerge.roster import PER_NEIGHBOUR
from mjmerge.state import Array, dot


class CbfQp(Tracking):
    """Tracking filtered by control barrier functions of relative degree two, an exact QP at every tick."""

    guard: ClassVar[str] = "the filter"
    gives: ClassVar[tuple[str, ...]] = ("target_m", "u_n_mps2", "u_c_mps2")

    kind: Literal["cbf_qp"] = "cbf_qp"
    alpha_1: Annotated[Positive, Unit(0, -1)] = 2.0
    """Fastest decay of d_j that is let be, 1/s: d_j' >= -alpha_1 d_j."""
    alpha_2: Annotated[Positive, Unit(0, -1)] = 2.0
    """Fastest decay of d_j' + alpha_1 d_j that is let be, 1/s."""
    a_j_mps2: NonNegative = 1.0
    """Most that a neighbour but the leader accelerates towards the ego, m/s^2."""
    guarded: bool = True
    """Whether the filter is on; without, it is the tracking alone."""

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Whether the programme could be met, and the barrier functions."""
        return (
            Signal("qp_feasible", "1 where the programme can be met", asks="the barriers do not contradict"),
            Signal(
                "psi_mps",
                "d_j' + alpha_1 d_j, the barrier function of first order",
                "psi_j",
                (PER_NEIGHBOUR,),
            ),
        )

    def constraints(self, seen: Sensed) -> tuple[Array, Array]:
        """Normals a_j, (N, C-1, 2), and bounds b_j, m/s^2, (N, C-1): a_j . u >= b_j."""
        near = geometry(self, seen)
        nu = seen.v[:, None] - seen.v_j
        apart = near.d + self.r_m
        across = np.maximum(dot(nu, nu) - near.d_dot * near.d_dot, 0.0) / np.where(apart == 0, 1.0, apart)
        towards = np.full(near.d.shape, self.a_j_mps2)
        towards[:, self.j_1] = dot(near.g[:, self.j_1], seen.u_1)
        damped = (self.alpha_1 + self.alpha_2) * near.d_dot + self.alpha_1 * self.alpha_2 * near.d
        return near.g, towards - across - damped

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """The command nearest to the tracking's that all barriers let through."""
        del memory, step_s
        u_n, target = self.nominal(seen)
        near = geometry(self, seen)
        met = np.ones(len(u_n), dtype=bool)
        u = u_n
        if self.guarded:
            u, met = nearest(u_n, *self.constraints(seen))
        return Decision(
            u,
            {
                "target_m": target,
                "u_n_mps2": u_n,
                "u_c_mps2": u - u_n,
                "qp_feasible": met.astype(np.float64),
                "psi_mps": near.d_dot + self.alpha_1 * near.d,
            },
        )

    def unguarded(self) -> Self:
        """With the filter off."""
        return self.model_copy(update={"guarded": False}) if self.guarded else self
