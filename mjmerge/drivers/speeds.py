"""A leader with a speed profile: it brakes and accelerates at given times, and stands if told."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from mjmerge.config.frozen import Frozen
from mjmerge.drivers.base import Along, Driver, Forwards, Number, overlap
from mjmerge.state import LEAST, Array, Mask


class Change(Frozen):
    """A change of speed: at a steady rate from the speed before it to a new one."""

    start_s: float = Field(ge=0)
    """When it starts, s."""
    rate_mps2: float = Field(gt=0)
    """How hard it brakes or accelerates, m/s^2: a magnitude; the two speeds say which of them it is."""
    speed_mps: Forwards
    """The speed it ends with and then keeps, m/s; 0 is a stand."""


class Speeds(Driver):
    """Drives a speed profile: brakes at a given time at a given rate, to a stand if told, and goes on.

    The intended acceleration is the profile's own plus a return to it. It never reverses: what is slower than
    the profile brakes by as much less.
    """

    can_lead: ClassVar[bool] = True
    stacks: ClassVar[bool] = True

    kind: Literal["speeds"] = "speeds"
    speed_mps: Forwards
    """Speed until the first change, m/s."""
    changes: Annotated[tuple[Change, ...], Field(strict=False)] = ()
    """Changes of speed, in order of time; each ends before the next one starts."""
    gain_per_s: float = Field(default=2.0, gt=0)
    """How hard it goes back to the profile, 1/s."""

    def _ramps(self) -> Iterator[tuple[Any, Any, Any, Any]]:
        """Start and end of each change, s, and the speeds it leads between, m/s."""
        before_mps = self.speed_mps
        for change in self.changes:
            lasts_s = abs(change.speed_mps - before_mps) / change.rate_mps2
            yield change.start_s, change.start_s + lasts_s, before_mps, change.speed_mps
            before_mps = change.speed_mps

    def problems(self) -> Iterator[tuple[str, str]]:
        """See :meth:`Driver.problems`."""
        for i, ((_, end_s, _, _), (start_s, _, _, _)) in enumerate(pairwise(self._ramps()), start=1):
            if overlap(end_s, start_s):
                late = f"before the change above it ends, at {end_s:g} s"
                yield f"changes.{i}.start_s", f"starts at {start_s} s, {late}"

    def profile_mps(self, time_s: float) -> Number:
        """The intended speed, m/s."""
        speed_mps: Number = self.speed_mps
        for start_s, end_s, before_mps, after_mps in self._ramps():
            if isinstance(end_s, float):  # one for all, and no arrays
                if time_s >= end_s:
                    speed_mps = after_mps
                elif time_s > start_s:
                    speed_mps += (after_mps - before_mps) * (time_s - start_s) / (end_s - start_s)
                continue
            lasts_s = np.maximum(end_s - start_s, LEAST)
            on_the_way = speed_mps + (after_mps - before_mps) * (time_s - start_s) / lasts_s
            before_it = time_s <= start_s
            speed_mps = np.where(time_s >= end_s, after_mps, np.where(before_it, speed_mps, on_the_way))
        return speed_mps if np.ndim(speed_mps) else float(speed_mps)

    def rate_mps2(self, time_s: float, hold_s: float) -> Number:
        """The profile's own acceleration, m/s^2: its mean over the hold: at ticks, speeds are exact."""
        if hold_s > 0:
            return (self.profile_mps(time_s + hold_s) - self.profile_mps(time_s)) / hold_s
        for start_s, end_s, before_mps, after_mps in self._ramps():
            if start_s <= time_s < end_s:
                return float((after_mps - before_mps) / (end_s - start_s))
        return 0.0

    def switches(self, drawn: Array | None) -> Array:
        """See :meth:`Driver.switches`: start and end of every change."""
        del drawn
        return np.unique([t for start_s, end_s, _, _ in self._ramps() for t in (start_s, end_s)])

    def stands(self, time_s: float, own: Along, hold_s: float = 0.0) -> Mask:
        """See :meth:`Driver.stands`."""
        goes = (self.profile_mps(time_s) > 0) | (self.profile_mps(time_s + hold_s) > 0)
        return np.broadcast_to(~np.asarray(goes), len(own.speed_mps))

    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """See :meth:`Driver.acceleration_mps2`."""
        del leader, drawn
        v, wanted_mps, rate = own.speed_mps, self.profile_mps(time_s), self.rate_mps2(time_s, hold_s)
        gain = np.minimum(self.gain_per_s, 1 / hold_s) if hold_s > 0 else self.gain_per_s
        if isinstance(wanted_mps, float) and isinstance(rate, float):
            one = np.clip(v, 0.0, wanted_mps) / wanted_mps if rate < 0 < wanted_mps else 1.0
            alike: Array = rate * one + gain * (wanted_mps - v)
            return alike
        slows = (rate < 0) & (wanted_mps > 0)
        part = np.where(slows, np.clip(v, 0.0, wanted_mps) / np.where(slows, wanted_mps, 1.0), 1.0)
        return rate * part + gain * (wanted_mps - v)
