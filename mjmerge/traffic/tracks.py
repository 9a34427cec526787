"""Recorded traffic as it is once read: who was where, when, and the lanes beneath.

Positions are centres of rectangles in the file's own plane, m, x and y, y to the left of x. Nothing is
smoothed here, and nothing of a file is gone without a word: what cannot be used is in ``unused``, what was
put right in ``notes``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
ONE_STATE = "has one state; a track has at least two"


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

    @property
    def width_m(self) -> float:
        """Between the bounds, half of its length being wider."""
        return float(np.median(np.hypot(*(self.left_m - self.right_m).T)))


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

    def there(self, first: int, last: int) -> bool:
        """Whether it was seen at some time between two time steps, both included."""
        return bool(self.step[0] <= last and first <= self.step[-1])


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
        if not path.is_file():  # opening a pipe would wait
            refuse(path, [Problem("is no file")])
        if size > most_bytes:
            message = f"{size / 1e6:.0f} MB; {what} may have {most_bytes / 1e6:.0f} MB: {advice}"
            refuse(path, [Problem(message)])
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except (OSError, ValueError) as error:
        raise ScenarioError(
            path, [Problem(f"cannot be read: {getattr(error, 'strerror', error)}")]
        ) from error
    if not data.strip():
        refuse(path, [Problem("empty: there is nothing in it")])
    return data


def track(
    given: Track, step_s: float, where: str, notes: list[str], problems: list[Problem]
) -> Track | Unused:
    """A track of states as they stand in a file, which may come twice or leave holes; or why it is none.

    Args:
        given: its ``step`` need not increase by one, and may repeat; ``lane`` may be of length 0.
        step_s: time between two time steps, s.
        where: its element, in words, for messages.
        notes: gets what was put right, a line each.
        problems: gets what is wrong with the file.
    """

    def wrong(message: str) -> Unused:
        problems.append(Problem(message, where, given.line))
        return Unused(given.id, message, given.line)

    step = given.step
    change = np.diff(step, prepend=step[0] - 1)
    if (change < 0).any():
        at = int(step[change < 0][0])
        return wrong(f"its times go back, to time step {at}; they must increase")
    first, again = np.flatnonzero(change > 0), np.flatnonzero(change == 0)
    if len(again):
        before = first[np.searchsorted(first, again) - 1]
        apart = np.hypot(*(given.centre_m[again] - given.centre_m[before]).T).max()
        if apart > FASTEST_MPS * step_s:
            return wrong(f"is in two places at once, {apart:.3g} m apart, at time step {step[again[0]]}")
        notes.append(
            f"{where}: {len(again)} states at times that it had already left out, up to {apart:.2g} m apart"
        )
    if len(first) < 2:
        return wrong(ONE_STATE)
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
        return Unused(given.id, why, given.line)
    if holes.any():
        notes.append(f"{where}: {holes.sum()} states filled in, in {np.count_nonzero(holes)} holes")
        one = _filled(one)
    fastest = np.hypot(*np.diff(one.centre_m, axis=0).T).max() / step_s
    if fastest > FASTEST_MPS:
        return wrong(
            f"moves at {fastest:.4g} m/s; nothing on a road does: are positions in metres, and is the time "
            f"step {step_s:g} s?"
        )
    return one


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
