"""Positions of recorded cars, smoothed as little as makes their motion possible; how far they moved is told.

The smoothed positions z of measured ones y are those of least |y - z|^2 + lambda |third differences of z|^2:
what is left between misfit and jerk. Source: E. T. Whittaker, "On a new method of graduation", Proceedings of
the Edinburgh Mathematical Society 41 (1922). Against a Savitzky-Golay filter of the same effect it moves
positions less, and it has no edges. Parabolas stay as they are. By the period P at which motions are halved,
lambda is (2 sin(pi step / P))^-6.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sin

import numpy as np

from mjmerge.state import Array

PLAUSIBLE_MPS2 = 5.0
"""Accelerations that a smoothed track may have: everyday driving stays below, measured positions do not."""
JERKY_MPS3 = 15.0
"""And jerks: the bound of V. Punzo, M. T. Borzacchiello, B. Ciuffo, "On the assessment of vehicle trajectory
data accuracy", Transportation Research C 19 (2011)."""
SMOOTH_M = 1e-3
"""Positions that differ from what they are smoothed to by no more than this need no smoothing."""
LONGEST_S = 4.0
"""The longest period."""
_ORDER = 3
_DIFFERENCES = (-1.0, 3.0, -3.0, 1.0)


@dataclass(frozen=True)
class Smoothed:
    """Positions as they are used, and what it took.

    Attributes:
        centre_m: (T, 2).
        period_s: motions of shorter ones were more than halved; 0 where nothing was smoothed.
        most_m: how far the furthest position was moved.
        rms_m: how far they were moved, root of the mean square.
        acceleration_mps2: the largest that is left, by second differences.
        jerk_mps3: likewise, by third differences.
    """

    centre_m: Array
    period_s: float
    most_m: float
    rms_m: float
    acceleration_mps2: float
    jerk_mps3: float

    @property
    def plausible(self) -> bool:
        """Whether a car drives like that."""
        return self.acceleration_mps2 <= PLAUSIBLE_MPS2 and self.jerk_mps3 <= JERKY_MPS3


def smoothed(centre_m: Array, step_s: float, period_s: float | None = None) -> Smoothed:
    """Positions of a track, smoothed.

    Args:
        centre_m: measured, (T, 2).
        step_s: time between two of them, s.
        period_s: below which motions are to be halved; 0 for none; ``None`` for the shortest that leaves what
            a car can do, or the longest, and none where positions are smooth as they are.
    """
    if period_s is not None:
        return _over(centre_m, step_s, period_s)
    found = _over(centre_m, step_s, 0.0)
    shortest = _over(centre_m, step_s, 4 * step_s)
    if found.plausible and shortest.most_m <= SMOOTH_M:
        return found
    for steps in range(4, round(LONGEST_S / step_s) + 1, 2):
        found = _over(centre_m, step_s, steps * step_s)
        if found.plausible:
            break
    return found


def _over(centre_m: Array, step_s: float, period_s: float) -> Smoothed:
    if len(centre_m) <= _ORDER:
        period_s = 0.0
    after = centre_m
    if period_s > 2 * step_s:  # shorter motions are not in it
        after = _graduated(centre_m, (2 * sin(pi * step_s / period_s)) ** (-2 * _ORDER))
    moved_m = np.hypot(*(after - centre_m).T)
    a, j = (np.hypot(*np.diff(after, order, axis=0).T) / step_s**order for order in (2, 3))
    return Smoothed(
        after,
        period_s,
        float(moved_m.max()),
        float(np.sqrt((moved_m**2).mean())),
        float(a.max(initial=0.0)),
        float(j.max(initial=0.0)),
    )


def _graduated(values: Array, weight: float) -> Array:
    """What solves (1 + weight D^T D) z = values, D third differences, by columns, (T, 2)."""
    from scipy.linalg import solveh_banded

    count = len(values)
    bands = np.zeros((_ORDER + 1, count))  # the upper ones, the diagonal last
    for a, one in enumerate(_DIFFERENCES):
        for b, other in enumerate(_DIFFERENCES[a:], a):
            bands[_ORDER - (b - a), b : count - _ORDER + b] += weight * one * other
    bands[_ORDER] += 1.0
    first = values[:1]  # far from the origin, numbers are coarse
    found: Array = solveh_banded(bands, values - first) + first
    return found
