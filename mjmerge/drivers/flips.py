"""A follower that flips between yielding and not yielding at times nobody knows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from mjmerge.drivers.base import Along, Driver
from mjmerge.state import Array


class Flips(Driver):
    """An intermittent yielder: between two gaps, at random times, within an acceleration limit.

    Behind a leader that stands it opens its gap by reversing; ``idm`` never does.
    """

    stacks: ClassVar[bool] = True

    kind: Literal["flips"] = "flips"
    closed_gap_m: float = Field(gt=0)
    """Gap it keeps while it does not yield, front axle to front axle, m; it starts with this."""
    open_gap_m: float = Field(gt=0)
    """Gap it opens to while it yields, m."""
    hold_min_s: float = Field(default=1.0, ge=0.01)
    """Shortest time it keeps an intention, s."""
    hold_max_s: float = Field(default=4.0, gt=0)
    """Longest time it keeps an intention, s; drawn uniformly between the two."""
    limit_mps2: float = Field(default=2.0, gt=0)
    """Largest acceleration and braking, m/s^2."""
    bandwidth_radps: float = Field(default=1.5, gt=0)
    """How eagerly it follows its intention, rad/s."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """See :meth:`Driver.problems`."""
        if self.hold_min_s > self.hold_max_s:
            longest = f"must not exceed the longest ({self.hold_max_s} s)"
            yield "hold_min_s", f"the shortest hold ({self.hold_min_s} s) {longest}"

    def draw(self, rngs: Sequence[np.random.Generator], duration_s: float) -> Array:
        """Times of the flips, s, (N, K), increasing along the last axis."""
        least, most = (np.broadcast_to(hold_s, len(rngs)) for hold_s in (self.hold_min_s, self.hold_max_s))
        count = int(np.ceil(duration_s / least.min())) + 1  # those beyond the end do not matter
        drawn = zip(rngs, least.tolist(), most.tolist(), strict=True)
        return np.stack([np.cumsum(rng.uniform(low, high, count)) for rng, low, high in drawn])

    def random(self, duration_s: float) -> bool:
        """See :meth:`Driver.random`: the times are, if there are any, and if they matter."""
        flips = self.hold_min_s < min(self.hold_max_s, duration_s)
        return flips and self.open_gap_m != self.closed_gap_m

    def switches(self, drawn: Array | None) -> Array:
        """See :meth:`Driver.switches`: the flips."""
        assert drawn is not None, "draw() comes first"
        return drawn

    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """See :meth:`Driver.acceleration_mps2`."""
        del hold_s
        assert drawn is not None, "draw() comes first"
        assert leader is not None, "it follows"
        yielding = np.count_nonzero(drawn <= time_s, axis=1) % 2 == 1
        gap = np.where(yielding, self.open_gap_m, self.closed_gap_m)
        w = self.bandwidth_radps
        gap_error = leader.position_m - own.position_m - gap
        rate_error = leader.speed_mps - own.speed_mps
        wanted = leader.acceleration_mps2 + w * w * gap_error + 2 * w * rate_error
        return np.clip(wanted, -self.limit_mps2, self.limit_mps2)
