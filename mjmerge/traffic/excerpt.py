"""The motion of one road user in a file of traffic, for a driver that follows it."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from mjmerge.config.frozen import Frozen, NonNegative
from mjmerge.errors import MjmergeError, nearest
from mjmerge.traffic.lanes import frame
from mjmerge.traffic.smooth import smoothed
from mjmerge.traffic.tracks import OUTSIDE, Tracks

MADE = ("time_s", "travelled_m", "source")
"""Keys of the driver that follow from the file."""
_OFF = 1e-6  # of a time step


class Excerpt(Frozen):
    """Keys that name a road user's motion in a file; they stand in the place of ``MADE``."""

    file: str
    """CommonRoad 2020a, or a table; beside the scenario, or in the current folder."""
    car: Annotated[str | int, Field(union_mode="left_to_right")]
    """Its name in the file."""
    from_s: NonNegative | None = None
    """From which time in the file on, s; null: from when it is seen first."""
    smoothing_s: NonNegative | None = None
    """Period below which motions are smoothed away, s; null: as long as it takes."""
    map: str | None = None
    """Of a table, the map of its columns."""


class ExcerptError(MjmergeError):
    """A motion that is not in the file.

    Attributes:
        key: the one of :class:`Excerpt` that is wrong.
    """

    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


def excerpt(given: Excerpt, near: Path | None) -> dict[str, Any]:
    """What a driver follows: times, the way along the lane that the road user is in at first, and its source.

    Args:
        given: which road user, from when.
        near: where the file is looked for first.

    Raises:
        ScenarioError: the file is wrong.
        ExcerptError: the motion is not in it.
    """
    path = Path(given.file)
    if near is not None and (near / path).is_file():
        path = near / path
    traffic = _traffic(path, given.map or "")
    name = str(given.car)
    if name not in traffic.tracks:
        why = {one.id: one.why for one in traffic.unused}.get(name)
        said = f"is of no use: {why}" if why else f"is not in the file: {nearest(name, traffic.tracks)}"
        raise ExcerptError("car", f"{name!r} {said}")
    one = traffic.tracks[name]
    step_s = traffic.step_s
    seen = f"it is seen from {one.step[0] * step_s:g} s to {one.step[-1] * step_s:g} s, every {step_s:g} s"
    exact = one.step[0] if given.from_s is None else given.from_s / step_s
    first = round(exact)
    if abs(exact - first) > _OFF or not one.sees(first, first + 1):
        raise ExcerptError("from_s", f"there is no motion of {name!r} from {given.from_s:g} s on: {seen}")
    start = first - int(one.step[0])
    lane = str(one.lane[start])
    if lane == OUTSIDE:
        raise ExcerptError("from_s", f"{name!r} is in no lane then")
    smooth = smoothed(one.centre_m, step_s, given.smoothing_s)
    along_m = frame(traffic.lanes, lane).place(smooth.centre_m[start:])[:, 0]
    travelled_m = np.maximum.accumulate(along_m - along_m[0])
    how = (
        f"smoothed over {smooth.period_s:.2g} s, moved by {smooth.most_m:.2f} m at most"
        if smooth.period_s
        else "as it stands there"
    )
    return {
        "time_s": [round(i * step_s, 6) for i in range(len(travelled_m))],
        "travelled_m": [round(float(x), 5) for x in travelled_m],
        "source": f"{path.name}, car {name}, from {first * step_s:.2f} s; {how}",
    }


def _traffic(path: Path, columns: str) -> Tracks:
    try:
        stat = path.stat()
        state = (stat.st_mtime_ns, stat.st_size)
    except (OSError, ValueError):
        state = (0, 0)
    return _known(path, columns, state)


@lru_cache(maxsize=4)  # a campaign loads a scenario a thousand times
def _known(path: Path, columns: str, state: tuple[int, int]) -> Tracks:
    from mjmerge.traffic.read import read  # lxml and pyarrow take their time to import

    del state
    return read(path, columns)
