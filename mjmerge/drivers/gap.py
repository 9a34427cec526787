"""A follower whose gap to the leader is a given function of time: yielding is opening it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import cos, pi, sin
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from mjmerge.config.frozen import Frozen
from mjmerge.drivers.base import Along, Driver, Number, each, overlap
from mjmerge.state import Array


def _smooth_step(shape: str, x: Number) -> tuple[Number, Number, Number]:
    """A step from 0 to 1 over 0 <= x <= 1 with its first two derivatives in x; at rest before and after."""
    within = (x >= 0) & (x < 1)
    at: Any = min(max(x, 0.0), 1.0) if isinstance(x, float) else np.minimum(np.maximum(x, 0.0), 1.0)
    if shape == "cubic":
        return at * at * (3 - 2 * at), 6 * at * (1 - at), within * (6 - 12 * at)
    cube, up = each(lambda one: one**3, at), at * (1 - at)
    return cube * (10 - 15 * at + 6 * at * at), 30 * (up * up), 60 * at * (1 - at) * (1 - 2 * at)


class Sway(Frozen):
    """An indecision: the gap breathes by A sin(2 pi t/T + phase)."""

    amplitude_m: float
    """A, m."""
    period_s: float = Field(gt=0)
    """T, s."""
    phase_rad: float = 0.0
    """Phase at t = 0, rad."""


class Move(Frozen):
    """A change of mind: from whatever the gap was to a new one, along a smooth step."""

    start_s: float = Field(ge=0)
    """When it starts, s."""
    duration_s: float = Field(gt=0)
    """How long it takes, s."""
    gap_m: float = Field(gt=0)
    """The gap it ends with, front axle to front axle, m."""
    step: Literal["cubic", "quintic"] = "quintic"
    """Shape of the step: 3s^2 - 2s^3 or 10s^3 - 15s^4 + 6s^5."""


class Gap(Driver):
    """Follows a gap profile behind the leader: yields by opening it, refuses by closing it.

    The intended acceleration is the profile's own plus a critically damped return to it. Behind a leader that
    stands it opens its gap by reversing; ``idm`` never does.
    """

    stacks: ClassVar[bool] = True

    kind: Literal["gap"] = "gap"
    gap_m: float = Field(gt=0)
    """Gap to start from, front axle to front axle, m."""
    sway: Sway | None = None
    """Breathing of that gap, until a move replaces it."""
    moves: Annotated[tuple[Move, ...], Field(strict=False)] = ()
    """Changes of mind, in order of time."""
    bandwidth_radps: float = Field(default=3.0, gt=0)
    """Speed of the return to the profile, rad/s."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """See :meth:`Driver.problems`."""
        if self.sway is not None and abs(self.sway.amplitude_m) >= self.gap_m:
            narrow = f"must be less than the gap that sways ({self.gap_m} m)"
            yield "sway.amplitude_m", f"{narrow}, got {self.sway.amplitude_m}: it would close"
        for i, (before, move) in enumerate(pairwise(self.moves), start=1):
            end = before.start_s + before.duration_s
            if overlap(end, move.start_s):
                yield (
                    f"moves.{i}.start_s",
                    (f"starts at {move.start_s} s, before the move above it ends, at {end:g} s"),
                )

    def profile(self, time_s: float) -> tuple[Number, Number, Number]:
        """The intended gap and its first two time derivatives, (m, m/s, m/s^2)."""
        gap: Number = self.gap_m
        rate: Number = 0.0
        acceleration: Number = 0.0
        if self.sway is not None:
            amplitude, w = self.sway.amplitude_m, 2 * pi / self.sway.period_s
            phase = w * time_s + self.sway.phase_rad
            gap = gap + amplitude * each(sin, phase)
            rate = amplitude * w * each(cos, phase)
            acceleration = -amplitude * w * w * each(sin, phase)
        for move in self.moves:
            duration = move.duration_s
            s, s1, s2 = _smooth_step(move.step, (time_s - move.start_s) / duration)
            to = move.gap_m - gap
            acceleration = (1 - s) * acceleration - 2 * s1 / duration * rate + s2 / (duration * duration) * to
            rate = (1 - s) * rate + s1 / duration * to
            gap = gap + s * to
        return gap, rate, acceleration

    def switches(self, drawn: Array | None) -> Array:
        """See :meth:`Driver.switches`: start and end of every move."""
        del drawn
        return np.array([t for move in self.moves for t in (move.start_s, move.start_s + move.duration_s)])

    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """See :meth:`Driver.acceleration_mps2`."""
        del drawn, hold_s
        assert leader is not None, "it follows"
        gap, rate, acceleration = self.profile(time_s)
        gap_error = leader.position_m - own.position_m - gap
        rate_error = leader.speed_mps - own.speed_mps - rate
        w = self.bandwidth_radps
        return leader.acceleration_mps2 - acceleration + w * w * gap_error + 2 * w * rate_error
