"""Lane changes in recorded traffic: who, from where to where, when, between whom; or why one is of no use."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjmerge.state import Array, Mask
from mjmerge.traffic.lanes import Frame, frame, goes_on
from mjmerge.traffic.tracks import OUTSIDE, Track, Tracks

SHORTEST_STAY_S = 1.0
"""A car that is in a lane for a shorter time and comes back has not changed lanes."""
BEFORE_S, AFTER_S = 10.0, 20.0
"""Of a lane change, how much is used at most, before the crossing and after it."""
LEAST_BEFORE_S, LEAST_AFTER_S = 1.0, 1.0
"""And at least."""
NOT_FOUR_WHEELS = ("pedestrian", "bicycle", "motorcycle", "train")


@dataclass(frozen=True)
class Change:
    """A lane change in which leader and follower are seen.

    Attributes:
        car: who changes lanes.
        from_lane: the piece of lane that it leaves.
        to_lane: the one that it enters.
        crossed: the time step at which its centre is in the new lane first.
        first: the time step from which all three are seen where they belong.
        last: until then.
        leader: the next car ahead in the new lane when it is entered.
        follower: the next one behind.
        frame: coordinates along the new lane.
        others: how many further road users are seen in that time; they are left out.
        between: the cars that are between leader and follower at some time: they are left out, too.
    """

    car: str
    from_lane: str
    to_lane: str
    crossed: int
    first: int
    last: int
    leader: str
    follower: str
    frame: Frame
    others: int
    between: tuple[str, ...]

    @property
    def three(self) -> tuple[str, str, str]:
        """Ego, leader and follower."""
        return self.car, self.leader, self.follower


@dataclass(frozen=True)
class Skipped:
    """A lane change, or what looks like one, that makes no scenario, and why."""

    id: str
    why: str


def lane_changes(traffic: Tracks) -> Iterator[Change | Skipped]:
    """Every lane change in a file, in order of tracks and of time."""
    frames: dict[str, Frame] = {}
    for one in traffic.tracks.values():
        for from_, to, crossed, stay, back in _crossings(one, traffic):
            id_ = f"car {one.id} at {crossed * traffic.step_s:.1f} s"
            if back:
                yield Skipped(id_, f"is in lane {to} for {stay * traffic.step_s:.1f} s only, and comes back")
                continue
            if to not in frames:
                frames[to] = frame(traffic.lanes, to)
            yield _change(traffic, one, from_, to, crossed, frames[to], id_)


def _crossings(one: Track, traffic: Tracks) -> Iterator[tuple[str, str, int, int, bool]]:
    """Lanes left and entered, when, for how many time steps, and whether it comes back after a short stay."""
    there = np.flatnonzero(one.lane != OUTSIDE)
    runs: list[tuple[str, str, int, int]] = []  # piece of lane at first and at last, place in the track
    for i in there:
        name = str(one.lane[i])
        if runs and (runs[-1][1] == name or goes_on(traffic.lanes, runs[-1][1], name)):
            runs[-1] = (runs[-1][0], name, runs[-1][2], int(i))
        else:
            runs.append((name, name, int(i), int(i)))
    k = 1
    while k < len(runs):
        (_, from_, *_), (to, _, start, end) = runs[k - 1], runs[k]
        stay = end - start + 1
        next_ = runs[k + 1] if k + 1 < len(runs) else None
        returns = next_ is not None and (next_[0] == from_ or goes_on(traffic.lanes, from_, next_[0]))
        if next_ is not None and returns and stay * traffic.step_s < SHORTEST_STAY_S:
            yield from_, to, int(one.step[start]), stay, True
            runs[k - 1 : k + 2] = [(runs[k - 1][0], next_[1], runs[k - 1][2], next_[3])]
            continue
        yield from_, to, int(one.step[start]), stay, False
        k += 1


def _change(
    traffic: Tracks, one: Track, from_: str, to: str, crossed: int, along: Frame, id_: str
) -> Change | Skipped:
    """A lane change with its leader and follower, or why there is none."""
    step_s = traffic.step_s
    if one.kind in NOT_FOUR_WHEELS:
        return Skipped(id_, f"is a {one.kind}")
    way = along.place(one.centre_m)
    here = crossed - one.step[0]
    if way[-1, 0] - way[0, 0] < 0:
        return Skipped(id_, f"lane {to} runs against it: it overtakes, or turns")
    ahead: list[tuple[float, str]] = []
    behind: list[tuple[float, str]] = []
    for other in traffic.tracks.values():
        if other.id == one.id or not other.sees(crossed, crossed):
            continue
        if other.lane[crossed - other.step[0]] in along.lanes:
            apart = along.place(other.at(np.array([crossed])))[0, 0] - way[here, 0]
            (ahead if apart > 0 else behind).append((abs(float(apart)), other.id))
    for side, word in ((ahead, "leader"), (behind, "follower")):
        if not side:
            return Skipped(id_, f"no {word} is seen in lane {to} when it is entered")
    leader, follower = min(ahead)[1], min(behind)[1]
    for name in (leader, follower):
        if traffic.tracks[name].kind in NOT_FOUR_WHEELS:
            return Skipped(id_, f"is between road users of which {name} is a {traffic.tracks[name].kind}")
    first, last = _seen(traffic, one, leader, follower, to, crossed, along, way)
    before_s, after_s = (crossed - first) * step_s, (last - crossed) * step_s
    for has_s, least_s, word in ((before_s, LEAST_BEFORE_S, "before"), (after_s, LEAST_AFTER_S, "after")):
        if has_s < least_s - 1e-9:
            return Skipped(
                id_,
                f"it, its leader {leader} and its follower {follower} are seen together, in their lanes, for "
                f"{has_s:.1f} s {word} it; at least {least_s:.1f} s are needed",
            )
    others = sum(
        other.there(first, last)
        for other in traffic.tracks.values()
        if other.id not in (one.id, leader, follower)
    )
    between = _between(traffic, (one.id, leader, follower), first, last, along)
    return Change(one.id, from_, to, crossed, first, last, leader, follower, along, int(others), between)


def _seen(
    traffic: Tracks,
    one: Track,
    leader: str,
    follower: str,
    to: str,
    crossed: int,
    along: Frame,
    way: Array,
) -> tuple[int, int]:
    """Time steps around the crossing between which all three are seen, and these two are in the new lane."""
    step_s = traffic.step_s
    first = max(int(one.step[0]), crossed - round(BEFORE_S / step_s))
    last = min(int(one.step[-1]), crossed + round(AFTER_S / step_s))
    steps = np.arange(first, last + 1)
    half_m = traffic.lanes[to].width_m / 2
    belong = (steps < crossed) | _inside(one, steps, along, half_m)
    side = np.sign(way[:, 1])  # it comes from one side
    belong &= (steps >= crossed) | (side[steps - one.step[0]] == side[crossed - one.step[0] - 1])
    for name in (leader, follower):
        other = traffic.tracks[name]
        seen = (steps >= other.step[0]) & (steps <= other.step[-1])
        belong &= seen
        belong[seen] &= _inside(other, steps[seen], along, half_m)
    at = crossed - first
    off = np.flatnonzero(~belong)
    before, after = off[off < at], off[off > at]
    return (
        first + (int(before[-1]) + 1 if len(before) else 0),
        first + (int(after[0]) - 1 if len(after) else len(steps) - 1),
    )


def _inside(one: Track, steps: NDArray[np.int64], along: Frame, half_m: float) -> Mask:
    """Whether it is in a lane at times that it is seen at, (M,), or before that begins or after it ends."""
    lane = one.lane[steps - one.step[0]]
    beyond = (lane == OUTSIDE) & (np.abs(along.place(one.at(steps))[:, 1]) <= half_m)
    found: Mask = np.isin(lane, [*along.lanes]) | beyond
    return found


def _between(
    traffic: Tracks, three: tuple[str, str, str], first: int, last: int, along: Frame
) -> tuple[str, ...]:
    """Who else is in the new lane between leader and follower at some time."""
    leader, follower = (traffic.tracks[name] for name in three[1:])
    found = []
    for other in traffic.tracks.values():
        if other.id in three or not other.there(first, last):
            continue
        steps = np.arange(max(first, int(other.step[0])), min(last, int(other.step[-1])) + 1)
        steps = steps[np.isin(other.lane[steps - other.step[0]], [*along.lanes])]
        if not len(steps):
            continue
        x, x_1, x_2 = (along.place(car.at(steps))[:, 0] for car in (other, leader, follower))
        if ((x_2 < x) & (x < x_1)).any():
            found.append(other.id)
    return tuple(found)
