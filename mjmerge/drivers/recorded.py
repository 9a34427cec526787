"""A car that drove somewhere else: follows a recorded motion along its lane."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from mjmerge.config.bounds import LONGEST_S
from mjmerge.drivers.base import FASTEST_MPS, Along, Driver
from mjmerge.state import Array, Mask

MOST_POINTS = 5_000
"""Points of a record."""
CLOSEST_S = 1e-6
"""Between two points of a record there is more time than this, s."""
SAME_SPEED = 0.02
"""A car begins as its record does, to this part of the record's greatest speed."""

Points = Annotated[float, Field(ge=0, le=1e9)]
Times = Annotated[float, Field(ge=0, le=LONGEST_S)]


@dataclass(frozen=True)
class Curve:
    """A motion through points: in each interval x = a_0 + a_1 s + a_2 s^2 + a_3 s^3 of s = t - t_i.

    Attributes:
        time_s: t_i, s, (K,).
        polynomials: a_0 to a_3 of each interval, (K - 1, 4).
        end_m: the last point, m.
        end_mps: the speed there, which goes on.
    """

    time_s: tuple[float, ...]
    polynomials: tuple[tuple[float, float, float, float], ...]
    end_m: float
    end_mps: float

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Way, speed and acceleration at a time, (m, m/s, m/s^2); from the right where that jumps."""
        if time_s >= self.time_s[-1]:
            return self.end_m + self.end_mps * (time_s - self.time_s[-1]), self.end_mps, 0.0
        i = max(bisect_right(self.time_s, time_s) - 1, 0)
        s = max(time_s - self.time_s[i], 0.0)
        x, v, half, sixth = self.polynomials[i]
        return (
            x + s * (v + s * (half + s * sixth)),
            v + s * (2 * half + 3 * s * sixth),
            2 * half + 6 * s * sixth,
        )


@lru_cache(maxsize=256)  # a driver is frozen, and is asked in every tick
def curve(time_s: tuple[float, ...], travelled_m: tuple[float, ...]) -> Curve:
    """The motion through the points of a record, that never goes back where they do not.

    It is the cubic spline with not-a-knot ends, C2; where that would swing past the points, as at a stand,
    its slopes are bounded as in J. M. Hyman, Accurate monotonicity preserving cubic interpolation, SIAM J.
    Sci. Stat. Comput. 4 (1983) 645, which leaves C1 there: between two equal points it stands.

    Args:
        time_s: increasing, s, (K,).
        travelled_m: not decreasing, m, (K,).
    """
    h = [b - a for a, b in pairwise(time_s)]
    mean = [(b - a) / step for (a, b), step in zip(pairwise(travelled_m), h, strict=True)]
    bounds = [3 * min(pair) for pair in pairwise([mean[0], *mean, mean[-1]])]
    v = [min(max(slope, 0.0), most) for slope, most in zip(_slopes(h, mean), bounds, strict=True)]
    polynomials = tuple(
        (x, v_0, (3 * m - 2 * v_0 - v_1) / step, (v_0 + v_1 - 2 * m) / (step * step))
        for x, (v_0, v_1), m, step in zip(travelled_m[:-1], pairwise(v), mean, h, strict=True)
    )
    return Curve(time_s, polynomials, travelled_m[-1], v[-1])


def _slopes(h: list[float], mean: list[float]) -> list[float]:
    """Slopes of the cubic spline at its knots, (K,), from lengths and mean slopes of the intervals."""
    if len(h) == 1:
        return [mean[0], mean[0]]
    if len(h) == 2:  # a parabola
        bend = (mean[1] - mean[0]) / (h[0] + h[1])
        return [mean[0] - bend * h[0], mean[0] + bend * h[0], mean[1] + bend * h[1]]
    first, last = h[0] + h[1], h[-1] + h[-2]
    lower = [0.0, *h[1:], last]
    middle = [h[1], *(2 * (a + b) for a, b in pairwise(h)), h[-2]]
    upper = [first, *h[:-1], 0.0]
    right = [
        ((h[0] + 2 * first) * h[1] * mean[0] + h[0] * h[0] * mean[1]) / first,
        *(3 * (b * m + a * n) for (a, b), (m, n) in zip(pairwise(h), pairwise(mean), strict=True)),
        ((h[-1] + 2 * last) * h[-2] * mean[-1] + h[-1] * h[-1] * mean[-2]) / last,
    ]
    for i in range(1, len(middle)):  # Thomas's algorithm
        part = lower[i] / middle[i - 1]
        middle[i] -= part * upper[i - 1]
        right[i] -= part * right[i - 1]
    slopes = [right[-1] / middle[-1]]
    for i in range(len(middle) - 2, -1, -1):
        slopes.append((right[i] - upper[i] * slopes[-1]) / middle[i])
    return slopes[::-1]


class Recorded(Driver):
    """Follows a recorded motion along its lane, from wherever its car starts.

    The intended acceleration is the record's own, over a hold its mean, plus a critically damped return to
    it. It never reverses, and it sees nobody: it drives through whoever stands where nobody was then.
    """

    can_lead: ClassVar[bool] = True

    kind: Literal["recorded"] = "recorded"
    time_s: Annotated[tuple[Times, ...], Field(strict=False, max_length=MOST_POINTS)]
    """Times of its points, s: from 0, to the end of the run or beyond."""
    travelled_m: Annotated[tuple[Points, ...], Field(strict=False, max_length=MOST_POINTS)]
    """How far its front axle has come along its lane at each of these times, m: from 0, never back."""
    source: Annotated[str, Field(max_length=1000)] = ""
    """Where the record comes from, in words."""
    bandwidth_radps: float = Field(default=2.0, gt=0)
    """Speed of the return to the record, rad/s."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """See :meth:`Driver.problems`; the first of each kind."""
        time_s, x_m = self.time_s, self.travelled_m
        if len(time_s) != len(x_m):
            yield "travelled_m", f"must have as many points as time_s ({len(time_s)}), got {len(x_m)}"
        few = [(key, len(of)) for key, of in (("time_s", time_s), ("travelled_m", x_m)) if len(of) < 2]
        for key, points in few:
            yield key, f"must have two points or more, got {points}"
        if few:
            return
        for key, first in (("time_s", time_s[0]), ("travelled_m", x_m[0])):
            if first != 0:
                yield f"{key}.0", f"must begin with 0, got {first}"
        late = next((i for i, (a, b) in enumerate(pairwise(time_s), 1) if b - a <= CLOSEST_S), None)
        if late is not None:
            yield (
                f"time_s.{late}",
                f"must come after the time before it, {time_s[late - 1]}, got {time_s[late]}",
            )
        back = next((i for i, (a, b) in enumerate(pairwise(x_m), 1) if b < a), None)
        if back is not None:
            yield f"travelled_m.{back}", f"must not go back, from {x_m[back - 1]}, got {x_m[back]}"
        if late is not None or len(time_s) != len(x_m):
            return
        for i, ((s, t), (a, b)) in enumerate(zip(pairwise(time_s), pairwise(x_m), strict=True), 1):
            if b - a > FASTEST_MPS * (t - s):
                fast = f"{(b - a) / (t - s):.6g} m/s from {s:g} s to {t:g} s"
                yield f"travelled_m.{i}", f"must not be faster than {FASTEST_MPS:g} m/s, got {fast}"
                return

    @property
    def curve(self) -> Curve:
        """The motion through the points."""
        return curve(self.time_s, self.travelled_m)

    def fits(self, speed_mps: float, duration_s: float) -> Iterator[tuple[str, str]]:
        """What of a run and of its car's start the record does not fit; for one without problems.

        Args:
            speed_mps: of its car at t = 0.
            duration_s: of the run.

        Yields:
            ``"duration"`` or ``"speed"``, and what is wrong with it.
        """
        end_s, first_mps = self.time_s[-1], self.curve.at(0.0)[1]
        if duration_s > end_s * (1 + 1e-9):
            yield "duration", f"the record ends at {end_s:g} s, and the run at {duration_s:g} s"
        most_mps = max(v for _, v, *_ in self.curve.polynomials)
        if abs(speed_mps - first_mps) > SAME_SPEED * max(most_mps, self.curve.end_mps) + 1e-9:
            yield "speed", f"the record begins at {first_mps:.4g} m/s, got {speed_mps:g} m/s"

    def switches(self, drawn: Array | None) -> Array:
        """See :meth:`Driver.switches`: the points, where the curve is not smooth."""
        del drawn
        return np.array(self.time_s)

    def stands(self, time_s: float, own: Along, hold_s: float = 0.0) -> Mask:
        """See :meth:`Driver.stands`: where the record does."""
        (now_m, now_mps, _), (then_m, then_mps, _) = self.curve.at(time_s), self.curve.at(time_s + hold_s)
        still = now_m == then_m and now_mps == 0 == then_mps
        return np.full(len(own.speed_mps), still)

    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """See :meth:`Driver.acceleration_mps2`."""
        del leader, drawn
        v = own.speed_mps
        way_m, wanted_mps, rate = self.curve.at(time_s)
        w = self.bandwidth_radps
        if hold_s > 0:
            rate = (self.curve.at(time_s + hold_s)[1] - wanted_mps) / hold_s
            w = min(w, 0.5 / hold_s)
        braking = rate * np.clip(v, 0.0, wanted_mps) / wanted_mps if rate < 0 < wanted_mps else rate
        towards_mps = np.maximum(wanted_mps + w / 2 * (way_m - own.travelled_m), 0.0)
        answer: Array = braking + 2 * w * (towards_mps - v)
        return answer
