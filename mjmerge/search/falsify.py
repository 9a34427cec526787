"""Falsification: points are asked for and run in batches, until the budget is spent or enough was found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mjmerge.errors import ScenarioError
from mjmerge.scenario.schema import Scenario
from mjmerge.search.against import PROOF, Against
from mjmerge.search.margin import Kind, Pair, known, pairs
from mjmerge.search.methods import METHODS, Method
from mjmerge.search.space import Ground
from mjmerge.state import Array
from mjmerge.sweep.workers import HERE, Workers

SCREEN_S = 0.002
"""Step of the physics while points are looked at; what is found is run again at the scenario's own."""
_INVALID = 2e3  # cost of a point that is no scenario


@dataclass(frozen=True)
class Look:
    """One point that was looked at.

    Attributes:
        number: of all points, from 0.
        seed: of its run.
        point: its coordinates, (D,).
        cost: what the search makes smaller, see :attr:`mjmerge.search.margin.Pair.cost`.
        fair: whether the same behaviour is safe where nothing is different.
        kind: how it failed; ``None`` where it did not, or was not fair.
        margin_m: least of every d_j and clearance, m; ``None`` where it was not run, or is not known.
        ideal_m: the same on the ideal plant, m; ``None`` where the point is no scenario, likewise.
    """

    number: int
    seed: int
    point: tuple[float, ...]
    cost: float
    fair: bool
    kind: Kind | None
    margin_m: float | None
    ideal_m: float | None

    @classmethod
    def of(cls, number: int, seed: int, point: Array, pair: Pair | None) -> Look:
        """From the runs of a point; ``None`` for one that is no scenario."""
        where = tuple(point.tolist())
        if pair is None:
            return cls(number, seed, where, _INVALID, fair=False, kind=None, margin_m=None, ideal_m=None)
        margin_m = known(pair.real.least_m) if pair.fair and pair.real is not None else None
        kind = pair.real.kind if pair.fails and pair.real is not None else None
        return cls(number, seed, where, pair.cost, pair.fair, kind, margin_m, known(pair.ideal.least_m))

    @property
    def fails(self) -> bool:
        """Whether it is a failure that counts."""
        return self.kind is not None

    @property
    def depth_m(self) -> float:
        """The margin of one that was run, m; what fails without coming close counts as 0."""
        least_m = np.inf if self.margin_m is None else self.margin_m
        return float(least_m if self.kind is None else min(least_m, 0.0))


How = Method | Literal["samples"]
"""How points came: by a method, or they were there."""


@dataclass(frozen=True)
class Search:
    """What a search found, as it was screened.

    Attributes:
        ground: where it looked.
        method: how.
        seed: of the method.
        looks: every point, in order.
    """

    ground: Ground
    method: How
    seed: int
    looks: tuple[Look, ...]

    @property
    def valid(self) -> int:
        """How many were fair."""
        return sum(look.fair for look in self.looks)

    @property
    def failures(self) -> tuple[Look, ...]:
        """Those that failed, in order."""
        return tuple(look for look in self.looks if look.fails)

    @property
    def first_failure_at_run(self) -> int | None:
        """Counted from 1; ``None`` without any."""
        return self.failures[0].number + 1 if self.failures else None

    @property
    def best(self) -> Look | None:
        """The fair one that came closest."""
        fair = [look for look in self.looks if look.fair]
        return min(fair, key=lambda look: look.depth_m, default=None)


def search(
    ground: Ground,
    budget: int,
    *,
    method: Method = "cma",
    seed: int = 0,
    against: Against = PROOF,
    team: Workers = HERE,
    before: Sequence[Look] = (),
    told: Callable[[Search], None] | None = None,
) -> Search:
    """Looks for failures.

    Args:
        ground: where.
        budget: how many points, at most.
        method: how they are chosen.
        seed: of the method; a run's own is the number of its point.
        against: where the same behaviour must be safe.
        team: who runs them; does not change the result.
        before: what an earlier search of the same kind has looked at already, in order.
        told: called after each batch with what there is so far.
    """
    asked = METHODS[method](ground.size, seed)
    looks: list[Look] = []
    while len(looks) < budget:
        points = asked.ask()
        there = list(before[len(looks) : len(looks) + len(points)])
        if len(there) < len(points) or [look.point for look in there] != [tuple(p.tolist()) for p in points]:
            there = look_at(ground, points, len(looks), against=against, team=team)
        found = there
        asked.tell([look.cost for look in found])
        looks += found[: budget - len(looks)]
        if told is not None:
            told(Search(ground, method, seed, tuple(looks)))
    return Search(ground, method, seed, tuple(looks))


def again(
    ground: Ground,
    samples: Sequence[tuple[int, Sequence[float]]],
    *,
    against: Against = PROOF,
    team: Workers = HERE,
) -> Search:
    """Looks at points that are there, such as the samples of an estimate.

    Args:
        ground: where.
        samples: seed of the run of each, and point, (D,).
        against: see :func:`search`.
        team: likewise.
    """
    points, seeds = np.array([point for _, point in samples]), [seed for seed, _ in samples]
    looks = look_at(ground, points, 0, seeds=seeds, against=against, team=team)
    return Search(ground, "samples", 0, tuple(looks))


def look_at(
    ground: Ground,
    points: Array,
    first: int,
    *,
    seeds: Sequence[int] | None = None,
    against: Against = PROOF,
    team: Workers = HERE,
) -> list[Look]:
    """Runs some points, screened.

    Args:
        ground: where.
        points: (M, D).
        first: number of the first of them.
        seeds: of their runs; by default their numbers.
        against: see :func:`search`.
        team: likewise.
    """
    seeds = range(first, first + len(points)) if seeds is None else seeds
    scenarios: dict[int, Scenario] = {}
    for i, point in enumerate(points):
        try:
            scenarios[i] = ground.at(point)
        except ScenarioError:
            continue
    cases = [(seeds[i], scenario) for i, scenario in scenarios.items()]
    made = pairs(cases, ground.plant, against=against, step_s=SCREEN_S, r_m=ground.r_m, team=team)
    by = dict(zip(scenarios, made, strict=True))
    return [Look.of(first + i, seeds[i], point, by.get(i)) for i, point in enumerate(points)]
