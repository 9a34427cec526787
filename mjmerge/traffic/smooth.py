"""Positions of recorded cars, smoothed as little as makes their accelerations possible; how far is told.

Source: A. Savitzky, M. J. E. Golay, "Smoothing and Differentiation of Data by Simplified Least Squares
Procedures", Analytical Chemistry 36 (1964). A cubic is fitted around every point; near the ends, around the
window's middle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mjmerge.state import Array

PLAUSIBLE_MPS2 = 5.0
"""Accelerations that a smoothed track may have: everyday driving stays below, measured positions do not."""
JERKY_MPS3 = 15.0
"""And jerks: the bound of V. Punzo, M. T. Borzacchiello, B. Ciuffo, "On the assessment of vehicle trajectory
data accuracy", Transportation Research C 19 (2011)."""
SMOOTH_M = 1e-3
"""Positions that are off a local parabola by no more than this need no smoothing."""
LONGEST_S = 3.1
"""Of a window."""
_ORDER = 3


@dataclass(frozen=True)
class Smoothed:
    """Positions as they are used, and what it took.

    Attributes:
        centre_m: (T, 2).
        window_s: of the smoothing; 0 where there was none.
        most_m: how far the furthest position was moved.
        rms_m: how far they were moved, root of the mean square.
        acceleration_mps2: the largest that is left, by second differences.
        jerk_mps3: likewise, by third differences.
    """

    centre_m: Array
    window_s: float
    most_m: float
    rms_m: float
    acceleration_mps2: float
    jerk_mps3: float

    @property
    def plausible(self) -> bool:
        """Whether a car drives like that."""
        return self.acceleration_mps2 <= PLAUSIBLE_MPS2 and self.jerk_mps3 <= JERKY_MPS3


def smoothed(centre_m: Array, step_s: float, window_s: float | None = None) -> Smoothed:
    """Positions of a track, smoothed.

    Args:
        centre_m: measured, (T, 2).
        step_s: time between two of them, s.
        window_s: over how long; 0 not at all; ``None`` over the shortest window that leaves what a car can
            do, or the longest, and not at all where they are smooth as they are.
    """
    if window_s is not None:
        half = round(window_s / step_s) // 2
        return _over(centre_m, step_s, 2 * half + 1 if half else 0)
    found = _over(centre_m, step_s, 0)
    if found.plausible and _roughness_m(centre_m) <= SMOOTH_M:
        return found
    for points in range(5, round(LONGEST_S / step_s) + 1, 2):
        if points > len(centre_m):
            break
        found = _over(centre_m, step_s, points)
        if found.plausible:
            break
    return found


def _over(centre_m: Array, step_s: float, points: int) -> Smoothed:
    points = min(points, len(centre_m) - 1 + len(centre_m) % 2)  # odd
    if points <= _ORDER:
        after, points = centre_m, 0
    else:
        after = _fitted(centre_m, points)
    moved_m = np.hypot(*(after - centre_m).T)
    a, j = (np.hypot(*np.diff(after, order, axis=0).T) / step_s**order for order in (2, 3))
    return Smoothed(
        after,
        points * step_s,
        float(moved_m.max()),
        float(np.sqrt((moved_m**2).mean())),
        float(a.max(initial=0.0)),
        float(j.max(initial=0.0)),
    )


@lru_cache(maxsize=256)
def _projection(points: int, order: int) -> Array:
    """What a least-squares polynomial makes of a window, at each of its points, (points, points)."""
    x = np.linspace(-1, 1, points)
    q, _ = np.linalg.qr(np.vander(x, order + 1))
    found: Array = q @ q.T
    return found


def _fitted(values: Array, points: int, order: int = _ORDER) -> Array:
    """Each value of a local polynomial around it, (T, 2)."""
    half, fit = points // 2, _projection(points, order)
    windows = np.lib.stride_tricks.sliding_window_view(values, points, axis=0)  # (T - points + 1, 2, points)
    found = np.empty_like(values)
    found[half : len(values) - half] = windows @ fit[half]
    found[:half] = fit[:half] @ values[:points]
    found[len(values) - half :] = fit[half + 1 :] @ values[-points:]
    return found


def _roughness_m(centre_m: Array) -> float:
    """How far positions are off a parabola through five of them, m, at most."""
    if len(centre_m) < 5:
        return 0.0
    return float(np.hypot(*(_fitted(centre_m, 5, 2) - centre_m).T).max())
