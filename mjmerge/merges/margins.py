"""How close a car comes to its leader and follower while it changes lanes, by what traffic research measures.

Time gap and time to collision are between bumpers (J. C. Hayward, "Near-miss determination through use of a
scale of danger", Highway Research Record 384, 1972), and asked while the bodies overlap across the road.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjmerge.state import Array, Mask
from mjmerge.vehicle.datasheet import DataSheet

SLOWEST_MPS = 0.5
"""A slower car has no time gap to the one ahead."""
LONGEST_TTC_S = 100.0
"""A longer time to collision is none."""


@dataclass(frozen=True)
class Pair:
    """Towards one of the two.

    Attributes:
        distance_m: least d_j, of front axles, less r.
        bumper_m: least distance between bumpers along the lane; ``None`` where the bodies never overlap
            across it. Likewise the others.
        time_gap_s: least time gap of the rear car to the front one.
        ttc_s: least time to collision; ``None`` too where they never close in.
    """

    distance_m: float
    bumper_m: float | None
    time_gap_s: float | None
    ttc_s: float | None

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return dict(vars(self))


@dataclass(frozen=True)
class Margins:
    """Of one lane change.

    Attributes:
        leader: towards the leader.
        follower: towards the follower.
        entered_s: from when the car's front axle stays within the new lane; ``None`` if it does not.
        peak_mps2: the largest acceleration of its front axle, over 0.2 s.
    """

    leader: Pair
    follower: Pair
    entered_s: float | None
    peak_mps2: float

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "leader": self.leader.as_json(),
            "follower": self.follower.as_json(),
            "entered_s": self.entered_s,
            "peak_mps2": self.peak_mps2,
        }


def margins(
    time_s: Array,
    front_m: Array,
    bodies: Sequence[DataSheet],
    r_m: float,
    lane_m: float,
) -> Margins:
    """Margins of the first of three cars towards its leader and its follower; lanes run along x.

    Args:
        time_s: evenly spaced, (T,).
        front_m: front axles, of ego, leader and follower, (T, 3, 2).
        bodies: data sheet of each car.
        r_m: the margin r.
        lane_m: width of the new lane, whose middle is y = 0.
    """
    nose_m = front_m[..., 0] + [body.front_overhang_m for body in bodies]
    tail_m = nose_m - [body.length_m for body in bodies]
    speed_mps = np.gradient(front_m[..., 0], time_s, axis=0)
    pairs = []
    for j, (back, ahead) in enumerate(((0, 1), (2, 0)), 1):
        d_m = np.hypot(*(front_m[:, 0] - front_m[:, j]).T) - r_m
        overlap = np.abs(front_m[:, 0, 1] - front_m[:, j, 1]) < (bodies[0].width_m + bodies[j].width_m) / 2
        gap_m = tail_m[:, ahead] - nose_m[:, back]
        v, closing = speed_mps[:, back], speed_mps[:, back] - speed_mps[:, ahead]
        time_gap_s = gap_m / np.maximum(v, SLOWEST_MPS)
        ttc_s = np.maximum(gap_m, 0.0) / np.maximum(closing, 1e-9)
        closes = overlap & (closing > 0) & (ttc_s <= LONGEST_TTC_S)
        pairs.append(
            Pair(
                float(d_m.min()),
                _least(gap_m, overlap),
                _least(time_gap_s, overlap & (v >= SLOWEST_MPS)),
                _least(ttc_s, closes),
            )
        )
    return Margins(
        pairs[0], pairs[1], entered_s(time_s, front_m[:, 0, 1], lane_m), _peak(time_s, front_m[:, 0])
    )


def entered_s(time_s: Array, y_m: Array, lane_m: float) -> float | None:
    """From when a car stays within a lane around y = 0; ``None`` if it does not."""
    out = np.flatnonzero(np.abs(y_m) >= lane_m / 2)
    first = int(out[-1]) + 1 if len(out) else 0
    return float(time_s[first]) if first < len(y_m) else None


def _least(values: Array, where: Mask) -> float | None:
    return float(values[where].min()) if where.any() else None


def _peak(time_s: Array, at_m: Array) -> float:
    """Largest mean acceleration over 0.2 s, m/s^2."""
    step_s = float(time_s[1] - time_s[0]) if len(time_s) > 1 else 1.0
    k = max(1, round(0.1 / step_s))
    if len(at_m) <= 2 * k:
        return 0.0
    a = (at_m[2 * k :] - 2 * at_m[k:-k] + at_m[: -2 * k]) / (k * step_s) ** 2
    return float(np.hypot(*a.T).max())
