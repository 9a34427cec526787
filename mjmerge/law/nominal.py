"""The paper's tracking alone: straight to the target in the leader's lane, with nothing that keeps it clear.

    u = -k_p (e_1 - rho r^rho) - k_v nu_1 + u_1

What the other laws are worth shows beside it.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

import numpy as np

from mjmerge.config.frozen import NonNegative
from mjmerge.config.units import Unit
from mjmerge.law.base import Decision, Law, Memory
from mjmerge.law.sensed import Sensed
from mjmerge.state import Array


class Tracking(Law):
    """Keys of a law that tracks a target behind the leader, in its lane."""

    k_p: Annotated[NonNegative, Unit(0, -2)] = 0.7
    """Position gain, 1/s^2."""
    k_v: Annotated[NonNegative, Unit(0, -1)] = 2.0
    """Velocity gain, 1/s."""
    r_rho_m: float
    """Offset of the target behind the leader, m; negative, because rho points forward."""

    def nominal(self, seen: Sensed) -> tuple[Array, Array]:
        """u_n, m/s^2, and the target, m, in the road frame, each (N, 2)."""
        target = seen.p_j[:, self.j_1] + np.array([self.r_rho_m, 0.0])
        nu_1 = seen.v - seen.v_j[:, self.j_1]
        return -self.k_p * (seen.p - target) - self.k_v * nu_1 + seen.u_1, target


class Nominal(Tracking):
    """The paper's tracking alone, straight into the leader's lane: nothing keeps it clear of anybody."""

    guard: ClassVar[str] = "a barrier"
    gives: ClassVar[tuple[str, ...]] = ("target_m", "u_n_mps2", "u_c_mps2")

    kind: Literal["nominal"] = "nominal"

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """See :class:`Law`."""
        del memory, step_s
        u_n, target = self.nominal(seen)
        return Decision(u_n, {"target_m": target, "u_n_mps2": u_n, "u_c_mps2": np.zeros_like(u_n)})

    def unguarded(self) -> Self:
        """It has nothing to take out."""
        return self
