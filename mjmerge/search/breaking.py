"""Breaking points: along an axis, the smallest mismatch at which a run fails, and the interval it lies in.

Every round runs a row of points on each line in one batch, and goes on between the last point that passed and
the first that failed. Nothing says that what fails stays failed further out: a point beyond that passed again
is reported, and so the answer is the first break, seen from no mismatch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mjmerge.errors import MjmergeError, nearest
from mjmerge.scenario.axis import ranges
from mjmerge.scenario.distinct import random
from mjmerge.scenario.levels import LEVELS
from mjmerge.scenario.mismatch import Mismatch, is_number
from mjmerge.sweep.plan import MISMATCH, Batches, Case, acts, planned, size_of
from mjmerge.sweep.rows import FAILED
from mjmerge.sweep.sweep import measured
from mjmerge.sweep.workers import Workers

if TYPE_CHECKING:
    from collections.abc import Callable

FIRST, NEXT = 17, 9
"""Points of the first round on a line, ends included, and of each round after it, within the bracket."""
WITHIN = 1e-3
"""Width of the interval that is looked for, over that of the whole range."""
FRONTIER = 9
"""Values of the first of two axes."""

Until = Literal["unsafe", "floor"]
_OPEN_END = 4.0  # times the severe level, where an axis has no bound of its own
_NEAR = 0.01  # of the way: how close to a bound that the axis may not reach


@dataclass(frozen=True)
class Range:
    """Where an axis is searched: from no mismatch to the worst."""

    key: str
    start: float
    end: float


@dataclass(frozen=True)
class Tried:
    """One value that was run.

    Attributes:
        value: of the axis.
        failed: whether some seed failed.
        runs: how many distinct runs that is: seeds are one run where nothing is random.
        row: the worst seed's row, as in :mod:`mjmerge.sweep.rows`.
        case: its run.
    """

    value: float
    failed: bool
    runs: int
    row: Mapping[str, Any]
    case: Case


@dataclass(frozen=True)
class Break:
    """What was found along one axis, all else equal.

    Attributes:
        range: where it was searched.
        fixed: the value of the other axis, of two.
        tried: every value that was run, from the start on.
    """

    range: Range
    fixed: float | None
    tried: tuple[Tried, ...]

    @property
    def fails(self) -> Tried | None:
        """The smallest mismatch that failed, if any did."""
        return next((t for t in self.tried if t.failed), None)

    @property
    def passes(self) -> Tried | None:
        """The largest before it that passed; ``None`` if the start failed already."""
        before = [t for t in self.tried if not t.failed and (self.fails is None or self._less(t, self.fails))]
        return before[-1] if before else None

    @property
    def again(self) -> tuple[Tried, ...]:
        """Those beyond the first break that passed: the axis is not monotone."""
        return tuple(t for t in self.tried if not t.failed and self.fails and self._less(self.fails, t))

    @property
    def seeds(self) -> int:
        """How many distinct runs the seeds are, at the point where they are most."""
        return max((t.runs for t in self.tried), default=0)

    def _less(self, one: Tried, other: Tried) -> bool:
        return abs(one.value - self.range.start) < abs(other.value - self.range.start)

    @property
    def text(self) -> str:
        """The interval in words."""
        fails, passes, key = self.fails, self.passes, self.range.key
        if fails is None:
            return f"never, up to {key} = {self.range.end:.4g}"
        if passes is None:
            return f"already at {key} = {self.range.start:.4g}"
        return f"between {_number(passes.value, fails.value)} and {_number(fails.value, passes.value)}"


def ranged(text: str, source: str, settings: Mapping[str, Any], plant: str = "mujoco") -> Range:
    """The range of an axis, given as ``mismatch.friction`` or ``mismatch.friction=1:0.1``.

    Without numbers it goes from the scenario's value to the bound of the axis, in the direction in which it
    gets severe, or to some times the severe level where there is no bound.

    Args:
        text: the axis as on the command line.
        source: the scenario's name or path.
        settings: its keys that differ.
        plant: what moves the cars.

    Raises:
        MjmergeError: it is no axis with numbers, needs them, or is without effect on the plant.
    """
    key, given, numbers = text.partition("=")
    key = key.strip()
    name = key.removeprefix(MISMATCH)
    if key.startswith(MISMATCH) and (name not in Mismatch.model_fields or not is_number(name)):
        axes = [MISMATCH + n for n in Mismatch.model_fields if is_number(n)]
        raise MjmergeError(f"--break {text}: no axis of numbers called {key!r}; {nearest(key, axes)}")
    case = Batches().case(source, plant, settings, lenient=True)
    here = case.value(key)
    if given:
        try:
            start, end = (float(number) for number in numbers.split(":"))
        except ValueError:
            start = end = 0.0
        if start == end or not np.isfinite([start, end, end - start]).all():
            raise MjmergeError(f"--break {text}: a range is START:END, such as {key}=0:0.5")
        return Range(key, start, end)
    if isinstance(here, bool) or not isinstance(here, int | float):
        raise MjmergeError(f"--break {text}: the scenario has no number there; give a range, {key}=START:END")
    if not key.startswith(MISMATCH):
        raise MjmergeError(f"--break {text}: give a range, {key}=START:END")
    severe = LEVELS[size_of(case.batch.scenario)].get(name, ({}, {}, {}))[2].get(name)
    if severe is None or severe == here:
        raise MjmergeError(f"--break {text}: which way? give a range, {key}=START:END")
    return Range(key, float(here), _end(name, float(here), float(severe)))


def _end(name: str, start: float, severe: float) -> float:
    """How far an axis goes beyond a severe mismatch."""
    bounds = ranges(Mismatch)[name]
    if severe < start:
        if "minimum" in bounds:
            return float(bounds["minimum"])
        if "exclusiveMinimum" in bounds:
            low = float(bounds["exclusiveMinimum"])
            return low + _NEAR * (start - low)
    elif "maximum" in bounds:
        return float(bounds["maximum"])
    elif "exclusiveMaximum" in bounds:
        high = float(bounds["exclusiveMaximum"])
        return high - _NEAR * (high - start)
    return start + _OPEN_END * (severe - start)


def search(
    source: str,
    plant: str,
    axes: Sequence[Range],
    settings: Mapping[str, Any],
    team: Workers,
    *,
    across: Range | None = None,
    until: Until = "unsafe",
    seeds: Sequence[int] = (0,),
    progress: Callable[[str], None] | None = None,
) -> list[Break]:
    """The breaking point along each axis, all axes in one batch per round.

    Args:
        source: the scenario's name or path.
        plant: what moves the cars.
        axes: where to look.
        settings: scenario keys that differ in all runs.
        team: what runs them.
        across: a second axis; the search along ``axes[0]`` is then made at ``FRONTIER`` of its values.
        until: what counts as a failure: unsafe (d_j <= 0, or touching bodies), or a broken safety floor. A
            run that ended early fails either way.
        seeds: every point is run with each of them, and fails if one does.
        progress: told what is being run.

    Raises:
        MjmergeError: a point cannot be run.
    """
    lines: list[tuple[Range, float | None, dict[str, Any]]]
    if across is None:
        lines = [(axis, None, dict(settings)) for axis in axes]
    else:
        values = np.linspace(across.start, across.end, FRONTIER).tolist()
        lines = [(axes[0], value, {**settings, across.key: value}) for value in values]
    batches = Batches()
    check(source, plant, axes, settings, across=across, until=until)
    tried: list[list[Tried]] = [[] for _ in lines]

    def point(settings: Mapping[str, Any]) -> list[Case]:
        first = batches.case(source, plant, settings, seed=seeds[0], lenient=True)
        here = first.batch.scenario.model_copy(update={"mismatch": first.mismatch})
        return [replace(first, seed=seed) for seed in (seeds if random(here, plant) else seeds[:1])]

    def evaluate(wanted: Sequence[Sequence[float]]) -> None:
        points = [
            [point({**fixed, axis.key: value}) for value in values]
            for (axis, _, fixed), values in zip(lines, wanted, strict=True)
        ]
        cases = [case for along in points for those in along for case in those]
        rows = iter(measured(planned("breaking", "", cases), team).to_pylist())
        for (axis, _, _), values, along, found in zip(lines, wanted, points, tried, strict=True):
            for value, those in zip(values, along, strict=True):
                of = [(next(rows), case) for case in those]
                row, case = max(of, key=lambda one: (_failed(one[0], until), -margin(one[0])))
                found.append(Tried(value, _failed(row, until), len(those), row, case))
            found.sort(key=lambda t: abs(t.value - axis.start))

    def results() -> list[Break]:
        return [
            Break(axis, fixed, tuple(found)) for (axis, fixed, _), found in zip(lines, tried, strict=True)
        ]

    wanted = [np.linspace(axis.start, axis.end, FIRST).tolist() for axis, _, _ in lines]
    turn = 0
    while any(wanted):
        turn += 1
        if progress is not None:
            progress(f"round {turn}: {sum(map(len, wanted))} points, each with up to {len(seeds)} seeds")
        evaluate(wanted)
        wanted = [_within(found) for found in results()]
    return results()


def check(
    source: str,
    plant: str,
    axes: Sequence[Range],
    settings: Mapping[str, Any],
    *,
    across: Range | None = None,
    until: Until = "unsafe",
) -> None:
    """Refuses a search along an axis, or with a setting, that is without effect wherever it would run.

    Args as those of :func:`search`.

    Raises:
        MjmergeError: with every such key, and where it does act.
    """
    batches, vain, used = Batches(), dict[str, str](), set[str]()
    beside = (
        [settings] if across is None else [{**settings, across.key: x} for x in (across.start, across.end)]
    )
    for axis in axes:
        for keys in beside:
            for value in (axis.start, axis.end):
                case = batches.case(source, plant, {**keys, axis.key: value}, lenient=True)
                vain |= case.idle
                used |= {key for key in (axis.key, *keys) if acts(case, key)}
    searched = {axis.key for axis in (*axes, *([across] if across else []))}
    if until == "unsafe":
        vain |= {key: "acts with --until floor only" for key in searched if key.startswith("expect.")}
        used -= {key for key in searched if key.startswith("expect.")}
    wrong = [
        f"{'--break' if key in searched else '--set'} {key}: {why}"
        for key, why in vain.items()
        if key not in used
    ]
    if wrong:
        raise MjmergeError("\n".join(wrong))


def margin(row: Mapping[str, Any]) -> float:
    """The least d_j of a run, in m; less than any other for one without data."""
    return -np.inf if row["min_distance_m"] is None else float(row["min_distance_m"])


def _within(found: Break) -> list[float]:
    """The next values to run; none where the interval is known well enough, or there is none."""
    if found.fails is None or found.passes is None:
        return []
    low, high = found.passes.value, found.fails.value
    if abs(high - low) <= WITHIN * abs(found.range.end - found.range.start):
        return []
    values: list[float] = np.linspace(low, high, NEXT + 2)[1:-1].tolist()
    return values


def _failed(row: Mapping[str, Any], until: Until) -> bool:
    if row["stopped"] is not None or row["min_distance_m"] is None:
        return True
    return row["unsafe_at_s"] is not None if until == "unsafe" else bool(row["outcome"] == FAILED)


def _number(value: float, other: float) -> str:
    """With as many digits as tell the two apart."""
    digits = 3
    while digits < 12 and f"{value:.{digits}g}" == f"{other:.{digits}g}":
        digits += 1
    return f"{value:.{digits + 1}g}"
