"""A lane change as three cars on a straight road: where their front axles were, and what they are."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import log, sqrt

import numpy as np

from mjmerge.plant import STRETCH
from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.load import load
from mjmerge.state import Array
from mjmerge.traffic.changes import Change, Skipped
from mjmerge.traffic.smooth import Smoothed, smoothed
from mjmerge.traffic.tracks import Tracks
from mjmerge.vehicle.actuation import BelievedCars, wheel_torques
from mjmerge.vehicle.datasheet import DataSheet

LIKE = "highway"
"""The shipped scenario whose law is taken, at the size of the cars."""
MODELS = ("sedan", "van", "rc")
"""Cars that ship; the first is the one of that scenario."""
STARTS_APART = 0.02
"""Of r: the least d_j(0)."""
LACKS_MPS2 = 0.1
"""What a model's drive or brakes may lack at any time of what its record asks for."""
GENTLE_MPS2 = 4.0
"""What the barrier asks for at t = 0 where that can be chosen: more, and physical cars cannot do it."""


@dataclass(frozen=True)
class Event:
    """A lane change in the frame of its new lane: x along it from where the leader starts, y to its left.

    Arrays have the order ego, leader, follower; the ego is the human who changed lanes.

    Attributes:
        change: where it comes from.
        name: of a file.
        from_s: the time in the file at which it begins.
        crossed_s: when the human's centre is in the new lane, from there.
        time_s: from 0, (T,).
        front_m: front axles, (T, 3, 2), smoothed; y of leader and follower are as they were.
        bodies: of the sizes of the record, (3,).
        models: the car model of each: the nearest in length that can drive like that.
        r_m: the margin of the law at that size.
        lane_m: width of the new lane.
        smoothing: what was done to each, three of them.
        mirrored: whether left and right changed places: the ego always comes from the left.
        first_mps2: what the barrier asks for at t = 0, of the two the more.
        tightened: what was done to the follower, in words; empty where nothing was.
        step: how far that is towards the least gap, 0 to 1.
    """

    change: Change
    name: str
    from_s: float
    crossed_s: float
    time_s: Array
    front_m: Array
    bodies: tuple[DataSheet, DataSheet, DataSheet]
    models: tuple[str, str, str]
    r_m: float
    lane_m: float
    smoothing: tuple[Smoothed, Smoothed, Smoothed]
    mirrored: bool
    first_mps2: float
    tightened: str = ""
    step: float = 0.0

    @property
    def gap_m(self) -> Array:
        """Between the front axles of leader and follower along the lane, (T,)."""
        found: Array = self.front_m[:, 1, 0] - self.front_m[:, 2, 0]
        return found

    @property
    def smoothing_m(self) -> float:
        """How far smoothing moved a position, at most."""
        return max(one.most_m for one in self.smoothing)

    @property
    def breaks(self) -> str:
        """How the record breaks Assumption 1, in words; empty where it does not."""
        least = int(np.argmin(self.gap_m))
        if self.gap_m[least] > 2 * self.r_m:
            return ""
        return (
            f"the gap is {self.gap_m[least]:.2f} m at {self.time_s[least]:.1f} s; 2r is {2 * self.r_m:.2f} m"
        )


def event(traffic: Tracks, change: Change) -> Event | Skipped:
    """A lane change as three cars on a straight road, from the first time at which the law may begin.

    Args:
        traffic: the file.
        change: one of its lane changes.
    """
    step_s = traffic.step_s
    tracks = [traffic.tracks[name] for name in change.three]
    smoothing = tuple(smoothed(one.centre_m, step_s) for one in tracks)
    models = tuple(
        _model(one.length_m, smooth.centre_m, step_s) for one, smooth in zip(tracks, smoothing, strict=True)
    )
    sheets = tuple(map(data_sheet, models))
    bodies = tuple(
        sheet.stretched(one.length_m, one.width_m) for sheet, one in zip(sheets, tracks, strict=True)
    )
    r_m = margin_m(bodies)
    steps = np.arange(change.first, change.last + 1)
    ways = []
    for one, smooth, sheet in zip(tracks, smoothing, bodies, strict=True):
        way = change.frame.place(smooth.centre_m[steps - one.step[0]])
        way[:, 0] += sheet.length_m / 2 - sheet.front_overhang_m  # from the centre to the front axle
        ways.append(way)
    front_m = np.stack(ways, axis=1)
    mirrored = bool(front_m[change.crossed - change.first - 1, 0, 1] < 0)
    if mirrored:
        front_m[..., 1] *= -1
    asked_mps2 = barrier_mps2(front_m, np.gradient(front_m[..., 0], step_s, axis=0), r_m)
    start = _start(front_m, asked_mps2, r_m, change.crossed - change.first)
    id_ = f"car {change.car} at {change.crossed * step_s:.1f} s"
    if isinstance(start, str):
        return Skipped(id_, start)
    front_m = front_m[start:]
    front_m[..., 0] -= front_m[0, 1, 0]
    front_m[:, 1:, 0] = np.maximum.accumulate(front_m[:, 1:, 0], axis=0)  # nobody rolls back
    from_ = change.first + start
    return Event(
        change=change,
        name=f"car-{_slug(change.car)}-{change.crossed * step_s:.1f}s",
        from_s=from_ * step_s,
        crossed_s=(change.crossed - from_) * step_s,
        time_s=np.round(np.arange(len(front_m)) * step_s, 9),
        front_m=front_m,
        bodies=bodies,  # type: ignore[arg-type]  # three of each
        models=models,  # type: ignore[arg-type]
        r_m=r_m,
        lane_m=traffic.lanes[change.to_lane].width_m,
        smoothing=smoothing,  # type: ignore[arg-type]
        mirrored=mirrored,
        first_mps2=float(asked_mps2[start]),
    )


def margin_m(bodies: Sequence[DataSheet]) -> float:
    """The margin r of ego, leader and follower: as much more than they reach in one lane as it ships with."""
    ego, leader, follower = bodies
    reach_m = max(tail_m(leader) + ego.front_overhang_m, tail_m(ego) + follower.front_overhang_m)
    return load(LIKE).r_m / data_sheet(MODELS[0]).length_m * reach_m


def tail_m(body: DataSheet) -> float:
    """How far a body reaches behind its front axle, m."""
    return body.length_m - body.front_overhang_m


def barrier_mps2(front_m: Array, speed_mps: Array, r_m: float) -> Array:
    """What the barrier of the law would ask for, k_o |d_j'| / d_j of the neighbour where it is more, (T,).

    Args:
        front_m: of ego, leader and follower, (T, 3, 2).
        speed_mps: along the lane, (T, 3).
        r_m: the margin r.
    """
    own = load(LIKE).law
    apart = front_m[:, :1] - front_m[:, 1:]  # (T, 2, 2)
    distance_m = np.hypot(apart[..., 0], apart[..., 1])
    rate_mps = apart[..., 0] * (speed_mps[:, :1] - speed_mps[:, 1:]) / distance_m
    d_m = np.maximum(distance_m - r_m, 1e-9)
    k_o = getattr(own, "k_o", 0.0) * sqrt(r_m / own.r_m)
    found: Array = (k_o * np.abs(rate_mps) / d_m).max(axis=1)
    return found


def _start(front_m: Array, asked_mps2: Array, r_m: float, crossed: int) -> int | str:
    """The first place before the crossing where the law's own hypotheses hold, or why there is none.

    If there is such a one, the first from which cars can do what the barrier asks for.
    """
    d_m = np.hypot(*np.moveaxis(front_m[:crossed, :1] - front_m[:crossed, 1:], -1, 0)) - r_m  # (T, 2)
    gap_m = front_m[:crossed, 1, 0] - front_m[:crossed, 2, 0]
    apart = d_m.min(axis=1) >= STARTS_APART * r_m
    wide = gap_m > 2 * (1 + STARTS_APART) * r_m
    good = apart & wide
    gentle = good & (asked_mps2[:crossed] <= GENTLE_MPS2)
    if good.any():
        return int(np.argmax(gentle if gentle.any() else good))
    if not wide.any():
        return (
            f"the gap is {gap_m.max():.2f} m at most before it, front axle to front axle; to begin, the law "
            f"needs more than 2r = {2 * r_m:.2f} m"
        )
    best_m = d_m.min(axis=1)[wide].max()
    return (
        f"it is too near to one of them until it crosses, front axle to front axle: d_j is {best_m:.2f} m at "
        f"best, and to begin, the law needs {STARTS_APART * r_m:.2f} m"
    )


def _model(length_m: float, centre_m: Array, step_s: float) -> str:
    """The shipped model that is nearest in length, by a factor; if any can, one that can drive like that.

    Args:
        length_m: of the car, m.
        centre_m: where it was, smoothed, (T, 2).
        step_s: between two places, s.
    """
    sizes = {name: abs(log(data_sheet(name).length_m / length_m)) for name in MODELS}
    nearest = sorted(MODELS, key=lambda name: sizes[name])
    near = [name for name in nearest if sizes[name] <= log(STRETCH)]
    speed_mps = np.hypot(*np.gradient(centre_m, step_s, axis=0).T)[:, None]
    a_mps2 = np.gradient(speed_mps, step_s, axis=0)
    for name in near:
        car = BelievedCars.of([data_sheet(name)], limited=True)
        lacks_n_m = wheel_torques(speed_mps, a_mps2, car)[1]
        if (np.abs(lacks_n_m) <= LACKS_MPS2 * car.wheel_radius_m * car.effective_mass_kg).all():
            return name
    return nearest[0]


def _slug(text: str) -> str:
    return re.sub(r"[^\w.-]+", "_", text)[:40] or "_"
