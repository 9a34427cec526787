"""Recorded traffic as it is once read: who was where, when, and the lanes beneath.

Positions are centres of rectangles in the file's own plane, m, x and y, y to the left of x. Nothing is smoothed
here, and nothing of a file is gone without a word: what cannot be used is in ``unused``, what was put right in
``notes``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mjmerge.errors import Problem, ScenarioError
from mjmerge.state import Array

OUTSIDE = ""
"""Where no lane is."""
LONGEST_HOLE_S = 0.5
"""A track that is not seen for longer than this is no track; shorter holes are filled with straight lines."""
FASTEST_MPS = 120.0
"""Faster than anything on a road: a unit is wrong."""
_MEDIAN_LENGTH_M = (2.0, 12.0)
_MEDIAN_OFF = (0.6, 1.6)
_UNITS = {"feet": 1 / 0.3048, "metres where feet are meant": 0.3048, "km/h": 3.6, "mph": 2.237}


@dataclass(frozen=True)
class Lane:
    """A piece of a lane: a lanelet of CommonRoad, or a lane of a table.

    Attributes:
        id: its name in the file.
        left_m: left bound in the direction of driving, (K, 2).
        right_m: right bound, (K, 2), as many points.
        after: the pieces that it goes on into, by name.
        line: where it stands in the file.
    """

    id: str
    left_m: Array
    right_m: Array
    after: tuple[str, ...] = ()
    line: int | None = None

    @property
    def centre_m(self) -> Array:
        """Between the bounds, (K, 2)."""
        return (self.left_m + self.right_m) / 2


@dataclass(frozen=True)
class Track:
    """One road user.

    Attributes:
        id: its name in the file.
        kind: what it is, in the file's word: car, truck, pedestrian.
        length_m: of its rectangle.
        width_m: of its rectangle.
        step: the number of the time step of each state, increasing by one, (T,).
        centre_m: centre of the rectangle, (T, 2).
        lane: the lane that each state is in, (T,); ``OUTSIDE`` where there is none.
        speed_mps: as the file gives it, (T,); NaN where it does not.
        acceleration_mps2: likewise.
        line: where it stands in the file.
    """

    id: str
    kind: str
    length_m: float
    width_m: float
    step: NDArray[np.int64]
    centre_m: Array
    lane: NDArray[np.str_]
    speed_mps: Array
    acceleration_mps2: Array
    line: int | None = None

    def at(self, step: NDArray[np.int64]) -> Array:
        """Centre at time steps that it was seen at, (M, 2)."""
        found: Array = self.centre_m[step - self.step[0]]
        return found

    def sees(self, first: int, last: int) -> bool:
        """Whether it was seen from one time step to another, both included."""
        return bool(self.step[0] <= first and last <= self.step[-1])


@dataclass(frozen=True)
class Unused:
    """A road user that makes no track, and why."""

    id: str
    why: str
    line: int | None = None


@dataclass(frozen=True)
class Tracks:
    """A file of recorded traffic.

    Attributes:
        path: the file.
        format: what it is, in words.
        step_s: time between two time steps, s.
        tracks: by name.
        lanes: by name.
        unused: road users that make no track.
        notes: what was put right, a line each.
    """

    path: Path
    format: str
    step_s: float
    tracks: Mapping[str, Track]
    lanes: Mapping[str, Lane]
    unused: tuple[Unused, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def road_users(self) -> int:
        """How many the file has, of whatever use."""
        return len(self.tracks) + len(self.unused)


def refuse(path: Path, problems: Iterable[Problem]) -> None:
    """Raises what is wrong with a file, if anything is, by line.

    Raises:
        ScenarioError: with every problem.
    """
    found = sorted(dict.fromkeys(problems), key=lambda p: p.line or 0)
    if found:
        raise ScenarioError(path, found)


def read_bytes(path: Path, most_bytes: int, what: str, advice: str) -> bytes:
    """What is in a file, if it is not too large to be read.

    Args:
        path: the file.
        most_bytes: larger ones are not opened.
        what: the kind of file, in words.
        advice: what to do about a large one.

    Raises:
        ScenarioError: it cannot be read, or is too large.
    """
    try:
        size = path.stat().st_size
        if size > most_bytes:
            message = f"{size / 1e6:.0f} MB; {what} may have {most_bytes / 1e6:.0f} MB: {advice}"
            refuse(path, [Problem(message)])
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except (OSError, ValueError) as error:
        raise ScenarioError(path, [Problem(f"cannot be read: {getattr(error, 'strerror', error)}")]) from error
    if not data.strip():
        refuse(path, [Problem("empty: there is nothing in it")])
    return data


def track(
    given: Track, step_s: float, where: str
) -> tuple[Track | Unused, list[str], list[Problem]]:
    """A track of states as they stand in a file, which may come twice or leave holes.

    Args:
        given: its ``step`` need not increase by one, and may repeat; ``lane`` may be of length 0.
        step_s: time between two time steps, s.
        where: its element, in words, for messages.

    Returns:
        The track, or why it is none; what was put right, a line each; what is wrong with the file.
    """
    step, notes = given.step, []
    if (np.diff(step) < 0).any():
        at = int(step[1:][np.diff(step) < 0][0])
        return Unused(given.id, "times go back", given.line), [], [
            Problem(f"its times go back, to time step {at}; they must increase", where, given.line)
        ]
    first = np.flatnonzero(np.diff(step, prepend=step[0] - 1) > 0)
    if len(first) < len(step):
        again = np.flatnonzero(np.diff(step, prepend=step[0] - 1) == 0)
        before = first[np.searchsorted(first, again) - 1]
        apart = np.hypot(*(given.centre_m[again] - given.centre_m[before]).T).max()
        if apart > FASTEST_MPS * step_s:
            return Unused(given.id, "in two places at once", given.line), [], [
                Problem(
                    f"is in two places at once, {apart:.3g} m apart, at time step {step[again[0]]}",
                    where,
                    given.line,
                )
            ]
        notes.append(
            f"{where}: {len(again)} states at times that it had already left out, up to {apart:.2g} m apart"
        )
    if len(first) < 2:
        return Unused(given.id, "one state", given.line), [], [
            Problem("has one state; a track has at least two", where, given.line)
        ]
    one = replace(
        given,
        step=step[first],
        centre_m=given.centre_m[first],
        lane=given.lane[first] if len(given.lane) else given.lane,
        speed_mps=given.speed_mps[first],
        acceleration_mps2=given.acceleration_mps2[first],
    )
    holes = np.diff(one.step) - 1
    if holes.max() * step_s > LONGEST_HOLE_S:
        at = int(np.argmax(holes))
        why = f"not seen from {one.step[at] * step_s:.2f} s to {one.step[at + 1] * step_s:.2f} s"
        return Unused(given.id, why, given.line), notes, []
    if holes.any():
        notes.append(f"{where}: {holes.sum()} states filled in, in {np.count_nonzero(holes)} holes")
        one = _filled(one)
    fastest = np.hypot(*np.diff(one.centre_m, axis=0).T).max() / step_s
    if fastest > FASTEST_MPS:
        return Unused(given.id, "too fast", given.line), notes, [
            Problem(
                f"moves at {fastest:.4g} m/s; nothing on a road does: are positions in metres, and is the time "
                f"step {step_s:g} s?",
                where,
                given.line,
            )
        ]
    return one, notes, []


def _filled(one: Track) -> Track:
    """The same with a state at every time step, between others on a straight line."""
    step = np.arange(one.step[0], one.step[-1] + 1)
    before = np.searchsorted(one.step, step, side="right") - 1
    centre_m = np.stack([np.interp(step, one.step, one.centre_m[:, i]) for i in (0, 1)], axis=1)
    return replace(
        one,
        step=step,
        centre_m=centre_m,
        lane=one.lane[before] if len(one.lane) else one.lane,
        speed_mps=np.interp(step, one.step, one.speed_mps),
        acceleration_mps2=np.interp(step, one.step, one.acceleration_mps2),
    )


def doubts_of_units(tracks: Sequence[Track], step_s: float) -> list[Problem]:
    """Where sizes or speeds cannot be in metres and seconds, as a whole: each car alone may be odd."""
    found = []
    vehicles = [one for one in tracks if one.kind not in ("pedestrian", "bicycle", "motorcycle")]
    if vehicles:
        length = float(np.median([one.length_m for one in vehicles]))
        low, high = _MEDIAN_LENGTH_M
        if not low <= length <= high:
            found.append(
                Problem(f"half of all vehicles are {length:.3g} m long: are lengths in metres?", "length")
            )
    given, moved = [], []
    for one in tracks:
        speed = np.hypot(*np.gradient(one.centre_m, step_s, axis=0).T)
        rolls = (speed > 2) & ~np.isnan(one.speed_mps)
        given.append(np.abs(one.speed_mps[rolls]))
        moved.append(speed[rolls])
    if given and sum(map(len, given)):
        ratio = float(np.median(np.concatenate(given) / np.concatenate(moved)))
        if not _MEDIAN_OFF[0] <= ratio <= _MEDIAN_OFF[1]:
            near = [word for word, of in _UNITS.items() if abs(ratio / of - 1) < 0.1]
            guess = f", as if in {near[0]}" if near else ""
            found.append(
                Problem(
                    f"speeds are {ratio:.3g} times what the positions say{guess}: are units and the time step "
                    "right?",
                    "velocity",
                )
            )
    return found


def biased(tracks: Sequence[Track], step_s: float) -> list[str]:
    """What the file says of speeds and accelerations that its positions do not: told, and not used."""
    off, clipped, states, missing = [], 0, 0, 0
    for one in tracks:
        speed = np.hypot(*np.gradient(one.centre_m, step_s, axis=0).T)
        off.append((one.speed_mps - speed)[~np.isnan(one.speed_mps)])
        a = np.abs(one.acceleration_mps2)
        missing += int(np.isnan(a).all())
        states += len(a)
    if not tracks:
        return []
    every = np.abs(np.concatenate([one.acceleration_mps2 for one in tracks]))
    every = every[~np.isnan(every)]
    if len(every) and every.max() > 0:
        clipped = int(np.count_nonzero(every >= every.max() * (1 - 1e-6)))
    found = []
    speeds = np.concatenate(off)
    if len(speeds):
        found.append(
            f"speeds in the file, less those of its positions: median {np.median(speeds):+.2f} m/s, 95 % within "
            f"{np.quantile(np.abs(speeds), 0.95):.2f} m/s; positions are used"
        )
    if clipped > max(0.01 * states, 10) and every.max() > 1:
        found.append(
            f"accelerations in the file are clipped at {every.max():.2f} m/s^2 ({clipped} of {states} states); "
            "positions are used"
        )
    if missing:
        found.append(f"{missing} of {len(tracks)} tracks have no accelerations; positions are used")
    return found
