"""How likely a margin below a bound is, under the distributions of a scenario's search space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Any, Literal

import numpy as np

from mjmerge.errors import MjmergeError, ScenarioError, UnknownNameError
from mjmerge.plant import check as check_plant
from mjmerge.roster import PLANTS
from mjmerge.scenario.effect import acting
from mjmerge.scenario.schema import Scenario
from mjmerge.search.margin import margins
from mjmerge.search.rare import (
    CONFIDENCE,
    LEAST_EACH,
    PART,
    Estimate,
    Function,
    Samples,
    Seeds,
    monte_carlo,
    subset,
)
from mjmerge.search.screen import LEAST_RUNS, Screened, screened
from mjmerge.search.space import Ground
from mjmerge.state import Array
from mjmerge.sweep.shards import TOGETHER
from mjmerge.sweep.workers import HERE, Workers

Way = Literal["subset", "montecarlo"]
CHEAP_EACH = 1350
"""Samples of a level on a cheap plant: about 5000 runs for 1e-4."""
_LEVELS = 4  # a budget is for so many: what is likelier takes fewer
_LEVELS_RUNS = 1 + (_LEVELS - 1) * (1 - PART)  # over the samples of one level
LEAST_BUDGET = round(LEAST_EACH * _LEVELS_RUNS)
"""Of a subset simulation."""


@dataclass(frozen=True)
class Asked:
    """What is to be estimated, and how.

    Attributes:
        bound_m: the event is a margin of at most this, m.
        budget: runs, about: a subset simulation takes fewer where the event is likelier than 1e-4, and more
            where it is rarer; with ``screen`` of the plant itself.
        way: how.
        seed: of the samples; the seed of a run is part of its sample.
        screen: a cheap plant that looks first; ``None`` for none.
    """

    bound_m: float
    budget: int
    way: Way = "subset"
    seed: int = 0
    screen: str | None = None

    @property
    def runs(self) -> int:
        """On both plants, about."""
        return self.budget if self.screen is None else self.budget + round(2 * CHEAP_EACH * _LEVELS_RUNS)

    def check(self, ground: Ground) -> None:
        """Refuses what cannot be estimated.

        Raises:
            MjmergeError: the bound is no number, the budget is too small, or the cheap plant is none that
                could look first.
        """
        if not isfinite(self.bound_m):
            raise MjmergeError(f"--below is {self.bound_m}; it must be a finite number")
        if self.screen is None:
            if self.way == "subset" and self.budget < LEAST_BUDGET:
                raise MjmergeError(
                    f"--budget is {self.budget}; subset simulation takes {LEAST_BUDGET} at least, "
                    "and --method montecarlo any number"
                )
            return
        if self.screen not in PLANTS:
            raise UnknownNameError("plant", self.screen, list(PLANTS))
        if self.way != "subset":
            raise MjmergeError("--screen goes with --method subset: independent samples need no cheap plant")
        if self.screen == ground.plant:
            raise MjmergeError(f"--screen is {self.screen}, the plant itself; it must be a cheaper one")
        check_plant(self.screen, ground.scenario)
        if self.budget < LEAST_RUNS:
            raise MjmergeError(
                f"--budget is {self.budget}; to correct what {self.screen} says takes {LEAST_RUNS} at least"
            )


@dataclass(frozen=True)
class Probability:
    """An estimate, and what it is of.

    Attributes:
        ground: the scenario and the distributions.
        asked: what was to be estimated.
        estimate: on the plant; with a cheap plant that looked first, on that one.
        screened: by way of the cheap plant; ``None`` without one.
    """

    ground: Ground
    asked: Asked
    estimate: Estimate
    screened: Screened | None = None

    @property
    def interval(self) -> tuple[float, float, float]:
        """The probability, and both ends of its interval."""
        one = self.estimate if self.screened is None else self.screened.whole
        return one.probability, one.low, one.high

    @property
    def runs(self) -> int:
        """On the plant itself."""
        return self.estimate.runs if self.screened is None else self.screened.runs

    @cached_property
    def below(self) -> Samples:
        """Samples that fail on the plant, each once, the least margin first."""
        return (self.estimate.below if self.screened is None else self.screened.below).differing()

    @property
    def nowhere(self) -> float:
        """Part of the independent samples that are no scenario or whose margin nobody knows."""
        return float(np.isinf(self.estimate.levels[0].samples.values).mean())


class _Run:
    """Runs samples, or takes over what is known of them: margins in the order in which they are asked for."""

    def __init__(
        self, ground: Ground, team: Workers, known: Sequence[float], told: Callable[[Array], None] | None
    ) -> None:
        self._ground, self._team, self._told = ground, team, told
        self._known = list(known)
        self._done = 0

    def on(self, plant: str) -> Function:
        from scipy.special import ndtr  # takes its time to import

        def least(u: Array, seeds: Seeds) -> Array:
            return np.concatenate([np.empty(0), *self._parts(plant, ndtr(u), seeds)])

        return least

    def _parts(self, plant: str, points: Array, seeds: Seeds) -> list[Array]:
        here = self._known[self._done : self._done + len(points)]
        parts, first = [np.array(here, dtype=float)], len(here)
        self._done += len(here)
        each = TOGETHER * self._team.count
        for k in range(first, len(points), each):
            found = self._margins(plant, points[k : k + each], seeds[k : k + each])
            parts.append(found)
            self._done += len(found)
            if self._told is not None:
                self._told(found)
        return parts

    def _margins(self, plant: str, points: Array, seeds: Seeds) -> Array:
        """Margins of some points, m, (M,); infinite where a point is no scenario."""
        scenarios: dict[int, Scenario] = {}
        for i, point in enumerate(points):
            try:
                scenario = self._ground.at(point)
            except ScenarioError:
                continue
            scenarios[i] = scenario if plant == self._ground.plant else acting(scenario, plant)
        cases = [(int(seeds[i]), scenario) for i, scenario in scenarios.items()]
        found = np.full(len(points), np.inf)
        for i, one in zip(scenarios, margins(cases, plant, team=self._team), strict=True):
            found[i] = one.least_m if np.isfinite(one.least_m) else np.inf
        return found


def probability(
    ground: Ground,
    asked: Asked,
    *,
    team: Workers = HERE,
    known: Sequence[float] = (),
    told: Callable[[Array], None] | None = None,
) -> Probability:
    """Estimates how likely a margin of at most a bound is.

    Args:
        ground: the scenario and its space: each coordinate a part of all draws.
        asked: the bound, and how it is estimated.
        team: who runs the samples; does not change the result.
        known: margins of the first samples, m, from an earlier estimate of the same that did not end.
        told: called with the margins of every further batch, m.

    Raises:
        MjmergeError: see :meth:`Asked.check`.
    """
    asked.check(ground)
    run = _Run(ground, team, known, told)
    real, bound_m, seed = run.on(ground.plant), asked.bound_m, asked.seed
    if asked.screen is not None:
        by = screened(run.on(asked.screen), real, ground.size, bound_m, CHEAP_EACH, asked.budget, seed)
        return Probability(ground, asked, by.cheap, by)
    if asked.way == "montecarlo":
        return Probability(ground, asked, monte_carlo(real, ground.size, bound_m, asked.budget, seed))
    each = round(asked.budget / _LEVELS_RUNS)
    return Probability(ground, asked, subset(real, ground.size, bound_m, each, seed))


def as_json(found: Probability) -> dict[str, Any]:
    """What ``mjmerge probability --json`` prints, and ``results.json`` says."""
    value, low, high = found.interval
    e, asked = found.estimate, found.asked
    return {
        "scenario": found.ground.scenario.name,
        "plant": found.ground.plant,
        "below_m": asked.bound_m,
        "method": asked.way,
        "seed": asked.seed,
        "probability": value,
        "low": low,
        "high": high,
        "confidence": CONFIDENCE,
        "runs": found.runs,
        "levels": [
            {
                "bound_m": _finite(level.bound),
                "part": level.part,
                "variation": level.variation,
                "accepted": level.accepted,
                "samples": len(level.samples),
                "chains": e.chains if k else 0,
                "chain_length": e.length if k else 1,
            }
            for k, level in enumerate(e.levels)
        ],
        "failing": len(found.below),
        "no_scenario": found.nowhere,
        "left_out": dict(found.ground.left_out),
        "screen": None if found.screened is None else _screen(found.screened, asked.screen),
    }


def _screen(by: Screened, plant: str | None) -> dict[str, Any]:
    return {
        "plant": plant,
        "runs": by.cheap_runs,
        "offset_m": by.offset,
        "probability": by.cheap.probability,
        "low": by.cheap.low,
        "high": by.cheap.high,
        "found": vars(by.found),
        "missed": vars(by.missed),
        "strata": [
            {
                "above_m": _finite(one.above),
                "up_to_m": _finite(one.up_to),
                "weight": one.weight,
                "runs": one.runs,
                "failing": one.failing,
            }
            for one in by.strata
        ],
    }


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None
