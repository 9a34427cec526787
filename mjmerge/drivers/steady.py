"""A leader that keeps its speed."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from mjmerge.drivers.base import FASTEST_MPS, Along, Driver
from mjmerge.state import Array, Mask


class Steady(Driver):
    """Keeps a speed: u = gain (speed - v)."""

    can_lead: ClassVar[bool] = True
    stacks: ClassVar[bool] = True

    kind: Literal["steady"] = "steady"
    speed_mps: float = Field(ge=-FASTEST_MPS, le=FASTEST_MPS)
    """Speed to keep, m/s."""
    gain_per_s: float = Field(default=2.0, gt=0)
    """How hard it goes back to that speed, 1/s."""

    def stands(self, time_s: float, own: Along, hold_s: float = 0.0) -> Mask:
        """See :meth:`Driver.stands`."""
        del time_s, hold_s
        found = np.empty(len(own.speed_mps), dtype=bool)
        found[:] = np.equal(self.speed_mps, 0)
        return found

    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """See :meth:`Driver.acceleration_mps2`."""
        del time_s, leader, drawn, hold_s
        return self.gain_per_s * (self.speed_mps - own.speed_mps)
