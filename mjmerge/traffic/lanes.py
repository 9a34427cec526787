"""Lanes: which one a position is in, and coordinates along and across one.

Along is measured from the start of the lane that a frame was made for, m; across is to the left of its centre
line, m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjmerge.state import Array, Mask
from mjmerge.traffic.tracks import OUTSIDE, Lane

SPACING_M = 1.0
"""Between the points of a frame's line."""
BLUR_M = 8.0
"""Over how much of a bent line its kinks are evened out: surveyed bounds have points centimetres apart."""
_BEYOND_M = 2000.0  # a frame goes straight on, before its lane begins and after it ends
_STRAIGHT_M = 15.0  # over which that direction is taken


@dataclass(frozen=True)
class Frame:
    """Coordinates along a lane.

    Attributes:
        line_m: centre line, (K, 2).
        along_m: of each of its points, (K,).
        lanes: the lanes that it runs through.
        start_m: along, where these begin.
        end_m: along, where they end: beyond, it is straight.
        moved_m: how far evening out moved the line, at most.
    """

    line_m: Array
    along_m: Array
    lanes: frozenset[str]
    start_m: float
    end_m: float
    moved_m: float

    def place(self, points_m: Array) -> Array:
        """Along and across, m, of points in the plane, (..., 2)."""
        flat = points_m.reshape(-1, 2)
        if len(flat) <= 512:
            return self._place(flat).reshape(points_m.shape)
        found = np.concatenate([self._place(part) for part in np.array_split(flat, len(flat) // 512 + 1)])
        return found.reshape(points_m.shape)

    def _place(self, points_m: Array) -> Array:
        start, way = self.line_m[:-1], np.diff(self.line_m, axis=0)
        length = np.hypot(*way.T)
        unit = way / length[:, None]
        off = points_m[:, None] - start  # (P, K-1, 2)
        on = np.clip((off * unit).sum(-1), 0, length)
        apart = ((off - on[..., None] * unit) ** 2).sum(-1)
        k = np.argmin(apart, axis=1)
        row = np.arange(len(points_m))
        to = off[row, k]
        across = unit[k, 0] * to[:, 1] - unit[k, 1] * to[:, 0]
        return np.stack([self.along_m[k] + on[row, k], across], axis=1)


def frame(lanes: Mapping[str, Lane], of: str) -> Frame:
    """Coordinates along a lane and those that it comes from and goes on into, straightest first."""
    chain = [of]
    while (next_ := _straightest(lanes, chain[-1], lanes[chain[-1]].after, chain)) is not None:
        chain.append(next_)
    before: dict[str, list[str]] = {}
    for lane in lanes.values():
        for other in lane.after:
            before.setdefault(other, []).append(lane.id)
    ahead = len(chain)
    while (last := _straightest(lanes, chain[0], before.get(chain[0], ()), chain, back=True)) is not None:
        chain.insert(0, last)
    origin = len(chain) - ahead
    parts = [lanes[name].centre_m for name in chain]
    points = np.concatenate(parts)
    keep = np.append(True, np.hypot(*np.diff(points, axis=0).T) > 1e-6)
    every = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    zero = float(every[sum(map(len, parts[:origin]))])
    points = points[keep]
    if len(points) < 2:
        points = np.array([points[0], points[0] + (1.0, 0.0)])
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    line, moved_m = _even(points, along)
    step = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    return Frame(line, step - _BEYOND_M - zero, frozenset(chain), -zero, along[-1] - zero, moved_m)


def _straightest(
    lanes: Mapping[str, Lane],
    from_: str,
    others: tuple[str, ...] | list[str],
    chain: list[str],
    *,
    back: bool = False,
) -> str | None:
    """The lane that goes on with the least turn; ``None`` where none does, or only one that was there."""

    def turn(name: str) -> float:
        one, two = lanes[from_].centre_m, lanes[name].centre_m
        if back:
            one, two = two, one
        a, b = one[-1] - one[0], two[-1] - two[0]
        return abs(float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)))

    left = [name for name in others if name in lanes and name not in chain]
    return min(left, key=lambda name: (turn(name), name), default=None)


def _even(points: Array, along: Array) -> tuple[Array, float]:
    """The line at even spacing, without kinks, with straight ends; and how far that moved it, m."""
    ends = []
    for end, inner in (
        (0, np.searchsorted(along, _STRAIGHT_M)),
        (-1, np.searchsorted(along, along[-1] - _STRAIGHT_M) - 1),
    ):
        inner = int(np.clip(inner, 0, len(points) - 1))
        way = points[end] - points[inner]
        if np.hypot(*way) < 1e-6:
            way = points[end] - points[-1 - end if end else -1]
        ends.append(points[end] + way / np.hypot(*way) * _BEYOND_M)
    line = np.concatenate([ends[:1], points, ends[1:]])
    if len(points) == 2:  # straight as it is
        return line, 0.0
    length = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    near = np.arange(_BEYOND_M - 4 * BLUR_M, length[-1] - _BEYOND_M + 4 * BLUR_M, SPACING_M)
    fine = np.stack([np.interp(near, length, line[:, i]) for i in (0, 1)], axis=1)
    reach = int(3 * BLUR_M / SPACING_M)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) * SPACING_M / BLUR_M) ** 2)
    weight /= weight.sum()
    wide = np.arange(near[0] - reach * SPACING_M, near[-1] + (reach + 0.5) * SPACING_M, SPACING_M)
    wide = np.stack([np.interp(wide, length, line[:, i]) for i in (0, 1)], axis=1)
    blurred = np.stack([np.convolve(wide[:, i], weight, mode="valid") for i in (0, 1)], axis=1)[: len(fine)]
    moved_m = float(np.hypot(*(blurred - fine[: len(blurred)]).T).max())
    return np.concatenate([line[:1], blurred, line[-1:]]), moved_m


def located(points_m: Array, lanes: Mapping[str, Lane]) -> NDArray[np.str_]:
    """The lane that each of a track's positions is in, (T,); where lanes overlap, the one that it comes from.

    Args:
        points_m: in order of time, (T, 2).
        lanes: by name.
    """
    inside = {name: _within(points_m, lane) for name, lane in lanes.items()}
    found: list[str] = []
    for i in range(len(points_m)):
        there = [name for name, mask in inside.items() if mask[i]]
        last = found[-1] if found else OUTSIDE
        on = [name for name in there if name == last] or [
            name for name in there if last != OUTSIDE and name in lanes[last].after
        ]
        found.append((on or there or [OUTSIDE])[0])
    return np.array(found, dtype=str)


def _within(points_m: Array, lane: Lane) -> Mask:
    """Which points are inside a lane's bounds, (P,): by the crossings of a ray."""
    polygon = np.concatenate([lane.left_m, lane.right_m[::-1]])
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    near = ((points_m >= low) & (points_m <= high)).all(axis=1)
    found = np.zeros(len(points_m), dtype=bool)
    if near.any():
        (x, y), a, b = points_m[near].T[:, :, None], polygon, np.roll(polygon, -1, axis=0)
        spans = (a[:, 1] > y) != (b[:, 1] > y)
        rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
        left_of = x < a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
        found[near] = (spans & left_of).sum(axis=1) % 2 == 1
    return found


def goes_on(lanes: Mapping[str, Lane], first: str, other: str) -> bool:
    """Whether a lane goes on into another, at once or further on."""
    ways, seen = [first], {first}
    while ways:
        lane = lanes.get(ways.pop())
        for name in () if lane is None else lane.after:
            if name == other:
                return True
            if name not in seen:
                seen.add(name)
                ways.append(name)
    return False
