"""The Intelligent Driver Model (IDM), the standard car-following model of traffic science.

M. Treiber, A. Hennecke, D. Helbing, Congested traffic states in empirical observations and microscopic
simulations, Phys. Rev. E 62 (2000) 1805, with s_1 = 0:

    v' = a [1 - (v/v_0)^delta - (s*/s)^2],    s* = s_0 + max(0, v T + v (v - v_l) / (2 sqrt(a b)))

s is the free road to the car ahead, from nose to tail, and v_l that car's speed; with nobody ahead s is
infinite. The maximum keeps the model from braking for a leader that draws away; it is that of M. Treiber,
A. Kesting, Traffic Flow Dynamics (Springer 2013), chapter 11.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from mjmerge.drivers.base import FASTEST_MPS, Along, Driver, Number
from mjmerge.state import LEAST, Array, Mask


class Idm(Driver):
    """Intelligent Driver Model: goes to its desired speed, brakes for the car ahead, queues and goes on.

    As published but for two bounds, which a car needs: it never brakes harder than a limit (as s goes to 0
    the model's own braking is infinite; bodies that overlap count as s = 0), and never harder than a gain
    times its speed, so that it comes to a stand and does not reverse: where T sqrt(a/(2 s_0)) is below 1 the
    model swings about s_0, and stands a little closer. It yields to the car ahead in its lane, not to the
    ego, whatever the ego does.
    """

    can_lead: ClassVar[bool] = True
    stacks: ClassVar[bool] = True

    kind: Literal["idm"] = "idm"
    desired_speed_mps: Annotated[float, Field(gt=0, le=FASTEST_MPS)]
    """v_0, speed on a free road, m/s."""
    time_gap_s: float = Field(ge=0)
    """T, safe time headway, s; published: 1.6 s."""
    standstill_gap_m: float = Field(gt=0)
    """s_0, free road left to the car ahead at a stand, nose to tail, m; published: 2 m."""
    max_acceleration_mps2: float = Field(default=0.73, gt=0)
    """a, acceleration from a stand on a free road, m/s^2."""
    comfortable_deceleration_mps2: float = Field(default=1.67, gt=0)
    """b, comfortable braking, m/s^2."""
    exponent: float = Field(default=4.0, gt=0)
    """delta, how late it stops accelerating on the way to v_0, 1."""
    limit_mps2: float = Field(default=8.0, gt=0)
    """Hardest braking, m/s^2; about what dry asphalt gives."""
    stop_gain_per_s: float = Field(default=10.0, gt=0)
    """How it comes to a stand: it never brakes harder than this times its speed, 1/s."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """See :meth:`Driver.problems`."""
        if self.limit_mps2 < self.comfortable_deceleration_mps2:
            comfortable = f"the comfortable one ({self.comfortable_deceleration_mps2} m/s^2)"
            yield (
                "limit_mps2",
                f"the hardest braking ({self.limit_mps2} m/s^2) must not be below {comfortable}",
            )

    def equilibrium_gap_m(self, speed_mps: Array) -> Array:
        """s_e(v) = (s_0 + v T) / sqrt(1 - (v/v_0)^delta), the s that it keeps at a speed below v_0, m."""
        free = 1 - (speed_mps / self.desired_speed_mps) ** self.exponent
        gap: Array = (self.standstill_gap_m + speed_mps * self.time_gap_s) / np.sqrt(free)
        return gap

    def stands(self, time_s: float, own: Along, hold_s: float = 0.0) -> Mask:
        """See :meth:`Driver.stands`: where it brakes as hard as its speed lets it."""
        del time_s
        gain = self._gain(hold_s)
        stands: Mask = own.acceleration_mps2 <= -gain * own.speed_mps
        return stands

    def _gain(self, hold_s: float) -> Array | float:
        return np.minimum(self.stop_gain_per_s, 1 / hold_s) if hold_s > 0 else self.stop_gain_per_s

    @np.errstate(over="ignore")  # what overflows is limited
    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """See :meth:`Driver.acceleration_mps2`."""
        del time_s, drawn
        a, b = self.max_acceleration_mps2, self.comfortable_deceleration_mps2
        v = np.maximum(own.speed_mps, 0.0)
        wanted = a * (1 - _power(v / self.desired_speed_mps, self.exponent))
        if leader is not None:
            closing = v * (own.speed_mps - leader.speed_mps) / (2 * np.sqrt(a * b))
            s_star = self.standstill_gap_m + np.maximum(v * self.time_gap_s + closing, 0.0)
            s = np.maximum(own.clear_to_m(leader), LEAST)
            wanted = wanted - a * (s_star / s) ** 2
        gain = self._gain(hold_s)
        least = np.clip(-gain * own.speed_mps, -self.limit_mps2, self.limit_mps2)
        answer: Array = np.maximum(wanted, least)
        return answer


def _power(base: Array, exponent: Number) -> Array:
    """Powers, each to the bits that it has where all have its exponent: NumPy's depend on that."""
    if not isinstance(exponent, np.ndarray):
        alike: Array = base**exponent
        return alike
    found = np.empty_like(base)
    exponents = np.broadcast_to(exponent, base.shape)
    for one in np.unique(exponents).tolist():
        found[exponents == one] = base[exponents == one] ** one
    return found
