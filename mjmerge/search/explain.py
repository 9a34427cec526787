"""Why a run fails: what it needs, and what is enough.

A breach of a hypothesis is a symptom. A cause is shown by an ablation: the same run with one thing taken
back, a mismatch, a move of a neighbour, or a rung of the ladder of plants. What is taken back alone and makes
the run safe is needed; a set that fails with all else taken back is enough.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Any

import numpy as np

from mjmerge.drivers.gap import Gap
from mjmerge.drivers.speeds import Speeds
from mjmerge.errors import MjmergeError, ScenarioError, WorkerError
from mjmerge.plant import check as check_plant
from mjmerge.roster import PLANTS
from mjmerge.scenario.effect import acting, check
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Belief, Scenario
from mjmerge.search.calm import doing
from mjmerge.search.margin import KINDS, Kind, Margin, margins
from mjmerge.search.parts import Name, Parts, said
from mjmerge.sweep.plan import MISMATCH
from mjmerge.sweep.workers import HERE, Workers

MOST_SETS = 120
"""Sets of parts that are run in the search for the smallest that are enough, at most, of each size."""
LARGEST = 3
"""Parts of the largest sets of which all are tried; a larger one is found by leaving out part after part."""
BELIEF = "belief."


@dataclass(frozen=True)
class Ablation:
    """A run with one thing taken back.

    Attributes:
        what: in words.
        margin: how close it comes then; ``None`` where what is left is no scenario, or cannot be run.
        moves_m: by how much the margin is larger then, m; ``None`` where one of them is not known.
    """

    what: str
    margin: Margin | None
    moves_m: float | None

    @property
    def safe(self) -> bool:
        """Whether it is safe then."""
        return self.margin is not None and self.margin.kind is None

    @property
    def then(self) -> str:
        """What comes of it, in words."""
        if self.margin is None:
            return "cannot be run without"
        return "safe" if self.margin.kind is None else KINDS[self.margin.kind]


@dataclass(frozen=True)
class Explanation:
    """What a failure needs, and what is enough.

    Attributes:
        scenario: what was run.
        plant: on what.
        seed: with which seed.
        continuous: whether in continuous time.
        margin: how close it came, and which hypotheses broke when.
        table: each thing taken back by itself; nothing of a run that is safe.
        enough: the smallest sets that fail with all else taken back, in words; one that is empty says that
            nothing that could be taken back is needed.
        complete: whether those are all of that size.
        runs: how many runs it took.
    """

    scenario: Scenario
    plant: str
    seed: int
    continuous: bool
    margin: Margin
    table: tuple[Ablation, ...]
    enough: tuple[tuple[str, ...], ...]
    complete: bool
    runs: int

    @property
    def unsafe(self) -> bool:
        """Whether there is anything to explain."""
        return self.margin.kind is not None

    @property
    def needs(self) -> tuple[str, ...]:
        """What makes it safe, taken back alone: its causes."""
        return tuple(one.what for one in self.table if one.safe)


def explain(
    scenario: Scenario,
    plant: str = "mujoco",
    *,
    seed: int = 0,
    continuous: bool = False,
    team: Workers = HERE,
) -> Explanation:
    """Takes back one thing after another, if the run is unsafe.

    What can be taken back: each mismatch that acts there, of the truth or of what the ego believes of itself,
    keys that act only together as one; each move of a neighbour and what else it does; the plant, for each
    one below it. The initial state, the law and all else have nothing to be taken back to.

    Args:
        scenario: what failed.
        plant: on what.
        seed: with which seed.
        continuous: whether in continuous time, see :func:`mjmerge.simulate`.
        team: who runs it; does not change the result.

    Raises:
        MjmergeError: the plant is none, or has no continuous time.
        ScenarioError: a key that was given beside the scenario's file is without effect there.
    """
    check_plant(plant, scenario)
    check(scenario, plant, continuous=continuous)
    return _Asking(scenario.settled(), plant, seed, continuous, team).all()


class _Asking:
    """Counts the runs."""

    def __init__(self, scenario: Scenario, plant: str, seed: int, continuous: bool, team: Workers) -> None:
        self._scenario, self._plant, self._seed, self._team = scenario, plant, seed, team
        self._continuous, self._runs = continuous, 0
        self._known: dict[tuple[Name, ...], Margin | None] = {}  # by the parts that are left, in order

    def all(self) -> Explanation:
        (whole,) = self._run([self._scenario])
        table: tuple[Ablation, ...] = ()
        enough: tuple[tuple[str, ...], ...] = ()
        complete = True
        if whole.kind is not None:
            parts = parts_of(self._scenario, self._plant, continuous=self._continuous)
            table = (*self._alone(parts, whole), *self._below(whole))
            enough, complete = self._enough(parts, whole.kind)
        return Explanation(
            self._scenario,
            self._plant,
            self._seed,
            self._continuous,
            whole,
            table,
            enough,
            complete,
            self._runs,
        )

    def _alone(self, parts: Parts, whole: Margin) -> Iterator[Ablation]:
        """Each part by itself; and meanwhile what is left of the least, as one batch costs less than two."""
        names = parts.names
        least = [left for size in range(min(1, len(names)) + 1) for left in combinations(names, size)]
        alone = [tuple(other for other in names if other != name) for name in names]
        self._only(parts, [*alone, *least])
        for name, one in zip(names, self._only(parts, alone), strict=True):
            yield _ablation(whole, said(parts, name), one)

    def _below(self, whole: Margin) -> Iterator[Ablation]:
        """Each plant below this one in its place."""
        ladder = list(PLANTS)
        for below in ladder[: ladder.index(self._plant)][::-1]:
            scenario = acting(self._scenario, below, continuous=self._continuous)
            (one,) = self._made([scenario], below)
            yield _ablation(whole, f"{self._plant}, for {below}", one)

    def _enough(self, parts: Parts, kind: Kind) -> tuple[tuple[tuple[str, ...], ...], bool]:
        """The smallest sets of parts that fail in the same way with all else taken back."""
        names = parts.names

        def fails(sets: Sequence[tuple[Name, ...]]) -> list[bool]:
            return [one is not None and one.kind == kind for one in self._only(parts, sets)]

        for size in range(min(LARGEST, len(names)) + 1):
            if comb(len(names), size) > MOST_SETS:
                break
            sets = list(combinations(names, size))
            found = [one for one, bad in zip(sets, fails(sets), strict=True) if bad]
            if found:
                return tuple(tuple(said(parts, name) for name in one) for one in found), True
        left = tuple(names)
        for name in names:
            fewer = tuple(other for other in left if other != name)
            if fails([fewer])[0]:
                left = fewer
        return (tuple(said(parts, name) for name in left),), False

    def _only(self, parts: Parts, sets: Sequence[tuple[Name, ...]]) -> list[Margin | None]:
        """How close it comes with only some of the parts; ``None`` for what cannot be run."""
        every, made = set(parts.names), dict[tuple[Name, ...], Scenario]()
        for left in sets:
            if left not in self._known and left not in made:
                try:
                    made[left] = parts.without(every - set(left)).scenario()
                except ScenarioError:  # such as moves that overlap
                    self._known[left] = None
        self._known |= dict(zip(made, self._made(list(made.values()), self._plant), strict=True))
        return [self._known[left] for left in sets]

    def _made(self, scenarios: Sequence[Scenario], plant: str) -> list[Margin | None]:
        """How close each comes; ``None`` for what cannot be run, such as tyres that slip at large steps."""
        try:
            return list(self._run(scenarios, plant))
        except WorkerError:
            raise
        except MjmergeError:
            if len(scenarios) <= 1:
                return [None for _ in scenarios]
            return [one for scenario in scenarios for one in self._made([scenario], plant)]

    def _run(self, scenarios: Sequence[Scenario], plant: str | None = None) -> list[Margin]:
        self._runs += len(scenarios)
        cases = [(self._seed, one) for one in scenarios]
        return margins(cases, plant or self._plant, continuous=self._continuous, team=self._team)


def _ablation(whole: Margin, what: str, one: Margin | None) -> Ablation:
    moved = float("nan") if one is None else one.least_m - whole.least_m
    return Ablation(what, one, float(moved) if np.isfinite(moved) else None)


def parts_of(scenario: Scenario, plant: str, *, continuous: bool = False) -> Parts:
    """What of a scenario can be taken back: its mismatch, as far as it acts, and what neighbours do when."""
    acts = acting(scenario, plant, continuous=continuous)
    axes = {
        above + name: getattr(section, name)
        for above, section in ((MISMATCH, acts.mismatch), (BELIEF, acts.belief))
        for name, field in type(section).model_fields.items()
        if getattr(section, name) != field.default
    }
    does = {car: doing(scenario, car) for car in scenario.roster.neighbours}
    drivers = {car: one.calm for car, one in does.items()}
    base = scenario.model_copy(
        update={
            "mismatch": Mismatch(),
            "belief": Belief(),
            "drivers": scenario.drivers.model_copy(update=drivers),
        }
    )
    ends_s = scenario.duration_s
    moves = {car: tuple(m for m in one.moves if m.start_s < ends_s) for car, one in does.items()}
    moves = {car: of for car, of in moves.items() if of}
    driven = {car: one for car in moves if isinstance(one := drivers[car], Gap | Speeds)}
    keys = {(car, key): value for car, one in does.items() for key, value in one.keys.items()}
    return Parts(base, axes, moves, driven, keys)


def sentences(found: Explanation) -> Iterator[str]:
    """It in words, a line each."""
    margin = found.margin
    if margin.kind is None:
        short = "" if margin.holds else ", though below its safety floor or not to its end"
        yield f"it is safe{short}: there is nothing to explain"
        return
    when = "" if margin.unsafe_at_s is None else f" at {margin.unsafe_at_s:.2f} s"
    least = f"; its least margin is {margin.least_m:.3g} m" if np.isfinite(margin.least_m) else ""
    yield f"{KINDS[margin.kind]}{when}{least}"
    broke = ", ".join(f"'{one.hypothesis}' at {one.time_s:.2f} s" for one in margin.broken)
    yield f"hypotheses that broke:  {broke or 'none'}"
    if not found.table:
        yield "needs:  what it has: there is nothing in it that could be taken back"
    else:
        yield "needs:  " + (
            "; ".join(found.needs) or "no single thing: it fails whatever is taken back alone"
        )
    for one in found.enough:
        yield f"enough on {found.plant}:  " + ("; ".join(one) or _nothing(found))
    if not found.complete:
        yield "(one such set: there are too many to try them all)"


def _nothing(found: Explanation) -> str:
    """What is said where no part is needed."""
    rest = "the law, its gains and where the cars start"
    if any(one.safe and one.what.startswith(f"{found.plant}, for ") for one in found.table):
        return f"nothing more than that plant, {rest}"
    return f"nothing more than {rest}"


def as_json(found: Explanation) -> dict[str, Any]:
    """What ``mjmerge explain --json`` prints, and what is recorded."""
    return {
        "scenario": found.scenario.name,
        "plant": found.plant,
        "seed": found.seed,
        "continuous": found.continuous,
        "unsafe": found.unsafe,
        "kind": found.margin.kind,
        "margin_m": _known(found.margin.least_m),
        "unsafe_at_s": found.margin.unsafe_at_s,
        "broken": [{"hypothesis": one.hypothesis, "time_s": one.time_s} for one in found.margin.broken],
        "needs": list(found.needs),
        "enough": [list(one) for one in found.enough],
        "complete": found.complete,
        "table": [
            {
                "taken_back": one.what,
                "margin_m": None if one.margin is None else _known(one.margin.least_m),
                "moves_m": one.moves_m,
                "kind": None if one.margin is None else one.margin.kind,
                "safe": one.safe,
                "then": one.then,
            }
            for one in found.table
        ],
        "runs": found.runs,
        "sentences": list(sentences(found)),
    }


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
