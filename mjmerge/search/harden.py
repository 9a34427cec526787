"""The inverse question: which keys of the law stand the failures that were found, and what that costs.

Rounds: a search looks for what breaks the law at hand; a law is chosen that has the best worst margin over
all that was found so far; the next round begins with that one. At the end the first and the last law are both
searched anew, with seeds that no round used: only that says what was won.

Every law is judged by the margin r of the scenario: one with a larger r of its own gains nothing by the name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjmerge.errors import ScenarioError
from mjmerge.scenario.schema import Scenario
from mjmerge.scenario.space import Distribution
from mjmerge.search.candidate import Candidate, Case, counted_m, held_against, spelt
from mjmerge.search.falsify import SCREEN_S, Look, Search, search
from mjmerge.search.keys import chosen
from mjmerge.search.margin import Margin, pairs
from mjmerge.search.methods import folded
from mjmerge.search.space import Ground, altered, checked
from mjmerge.state import Array
from mjmerge.sweep.fidelity import coarse
from mjmerge.sweep.workers import HERE, Workers

CASES = 24
"""Runs that each law is held against, at most: of every search as many."""
BATCH = 8
"""Laws that are tried together."""
_WIDE, _NARROW = 0.25, 0.08  # standard deviation about the best law, over the width of the cube
_ANYWHERE = 0.5  # part of the tries that is drawn from everywhere

_Best = tuple[Array, Candidate]
"""A law, and the parts of the keys that it comes from, (K,)."""


@dataclass(frozen=True)
class Round:
    """One round.

    Attributes:
        search: what was looked for, against the law that the round began with.
        cases: how many runs the laws were held against.
        before: the scenario's own law, held against them.
        candidates: all other laws that were tried and are scenarios.
        refused: how many were none.
        chosen: the best; the scenario's own where no other is better.
    """

    search: Search
    cases: int
    before: Candidate
    candidates: tuple[Candidate, ...]
    refused: int
    chosen: Candidate


@dataclass(frozen=True)
class Fresh:
    """A search that no choice has seen.

    Attributes:
        search: it.
        own_step: its worst run again at the scenario's own step of the physics; ``None`` if there is none, or
            the search ran at that step.
    """

    search: Search
    own_step: Margin | None

    @property
    def worst_m(self) -> float | None:
        """The worst margin of a fair run, m; ``None`` without any."""
        found = [counted_m(look.margin_m, look.kind) for look in self.search.looks if look.fair]
        return min(found, default=None)

    @property
    def own_step_m(self) -> float | None:
        """The margin of its worst run at the scenario's own step, m."""
        if self.own_step is None:
            return self.worst_m
        return counted_m(self.own_step.least_m, self.own_step.kind)


@dataclass(frozen=True)
class Hardened:
    """What came of it.

    Attributes:
        ground: the scenario, and where its failures were looked for.
        keys: what was chosen, and between what.
        first: what was looked for against the scenario's own law.
        rounds: one after the other; none where nothing was found.
        fresh: searches of seeds that no round used, against the scenario's own law.
        hardened: the same seeds, against the last choice.
    """

    ground: Ground
    keys: Mapping[str, Distribution]
    first: Search
    rounds: tuple[Round, ...] = ()
    fresh: tuple[Fresh, ...] = ()
    hardened: tuple[Fresh, ...] = ()

    @property
    def winner(self) -> Candidate | None:
        """The last choice; ``None`` where there was nothing to choose."""
        return self.rounds[-1].chosen if self.rounds else None

    @property
    def scenario(self) -> Scenario:
        """The scenario under the last choice."""
        return self.ground.scenario if self.winner is None else under(self.ground.scenario, self.winner)

    @property
    def gained_m(self) -> float | None:
        """By how much the worst margin over the fresh searches rises, m; ``None`` if that is not known."""
        before, after = worst_m(self.fresh), worst_m(self.hardened)
        return None if before is None or after is None else after - before

    @property
    def better(self) -> bool:
        """Whether it rises."""
        return self.gained_m is not None and self.gained_m > 0

    @property
    def frontier(self) -> tuple[Candidate, ...]:
        """Laws of the last round that no other beats in both: worst margin, and time to merge."""
        if not self.rounds:
            return ()
        last = self.rounds[-1]
        good = [one for one in (last.before, *last.candidates) if one.solves]
        found: list[Candidate] = []
        for one in sorted(good, key=lambda c: (c.merged_s or 0.0, -c.worst_m)):
            if not found or one.worst_m > found[-1].worst_m:
                found.append(one)
        return tuple(found)

    @property
    def runs(self) -> int:
        """All runs on the plant, those at the scenario's own step too; the comparisons are not counted."""
        searches = [self.first, *(one.search for one in self.rounds[1:])]
        searches += [one.search for one in (*self.fresh, *self.hardened)]
        looks = sum(look.fair for one in searches for look in one.looks)
        laws = sum(one.runs for r in self.rounds for one in (r.before, *r.candidates))
        return looks + laws + sum(one.own_step is not None for one in (*self.fresh, *self.hardened))


def worst_m(searches: Sequence[Fresh]) -> float | None:
    """The worst margin of some searches, m; ``None`` if that of any is not known."""
    found = [one.worst_m for one in searches]
    known = [one for one in found if one is not None]
    return min(known) if known and len(known) == len(found) else None


def most_runs(budget: int, tries: int, rounds: int, fresh: int) -> int:
    """How many runs it takes, at most and about."""
    return budget * (rounds + 2 * fresh) + rounds * (tries + 1) * (CASES + 1)


def harden(
    ground: Ground,
    keys: Mapping[str, Distribution],
    *,
    budget: int,
    tries: int,
    rounds: int,
    fresh: int,
    seed: int = 0,
    team: Workers = HERE,
    told: Callable[[int], None] | None = None,
    said: Callable[[str], None] | None = None,
) -> Hardened:
    """Chooses keys of the law.

    Args:
        ground: the scenario, and where its failures are looked for.
        keys: which keys, and between what.
        budget: runs of each search.
        tries: laws that each round tries.
        rounds: how many.
        fresh: searches that judge the last choice, and as many the scenario's own law.
        seed: of the searches and of the choices.
        team: who runs them; does not change the result.
        told: called with the number of runs so far.
        said: called with a line for each step.
    """
    ground = replace(ground, r_m=ground.scenario.r_m)
    say, done = said or (lambda _: None), _Done(told)
    searches: list[Search] = []
    found: list[Round] = []
    at_hand: Candidate | None = None
    best: _Best | None = None
    for k in range(rounds):
        here = _against(ground, at_hand)
        searches.append(search(here, budget, seed=seed + k, team=team, told=done.looked))
        done.add(budget)
        say(f"round {k + 1}: {len(searches[-1].failures)} failures of {budget} runs")
        if not searches[0].failures:
            return Hardened(ground, keys, searches[0])
        cases = worst_cases(ground, searches)
        rng = np.random.default_rng([seed, k])
        before, every, refused, best = _tried(ground, keys, cases, tries, rng, best, team, done)
        at_hand = max((one for one in (before, *every) if one.solves), key=_worth, default=before)
        found.append(Round(searches[-1], len(cases), before, tuple(every), refused, at_hand))
        worst = f"worst margin {before.worst_m:.3g} m, {at_hand.worst_m:.3g} m with {at_hand.words}"
        say(f"round {k + 1}: {worst}")
    assert at_hand is not None, "there is a round"
    both: list[tuple[Fresh, ...]] = []
    for law in (None, at_hand):
        if law is not None and not law.settings:  # the scenario's own again
            both.append(both[0])
            continue
        looked = []
        for k in range(fresh):
            looked.append(_fresh(_against(ground, law), budget, seed + rounds + k, team, done))
            fails = f"{len(looked[-1].search.failures)} failures of {budget} runs"
            say(f"fresh search {k + 1}, {'as it is' if law is None else law.words}: {fails}")
        both.append(tuple(looked))
    return Hardened(ground, keys, searches[0], tuple(found), *both)


class _Done:
    """How many runs there were so far."""

    def __init__(self, told: Callable[[int], None] | None) -> None:
        self._told, self._before = told, 0

    def looked(self, found: Search) -> None:
        """A search is so far."""
        if self._told is not None:
            self._told(self._before + len(found.looks))

    def add(self, runs: int) -> None:
        """So many more are done."""
        self._before += runs
        if self._told is not None:
            self._told(self._before)


def _worth(one: Candidate) -> float:
    return one.worst_m


def under(scenario: Scenario, law: Candidate) -> Scenario:
    """A scenario under another law.

    Raises:
        ScenarioError: it is none.
    """
    return checked(altered(scenario, law.settings)) if law.settings else scenario


def _against(ground: Ground, law: Candidate | None) -> Ground:
    """Where failures of a law are looked for; of the scenario's own for ``None``."""
    return ground if law is None else replace(ground, scenario=under(ground.scenario, law))


def _fresh(ground: Ground, budget: int, seed: int, team: Workers, done: _Done) -> Fresh:
    found = search(ground, budget, seed=seed, team=team, told=done.looked)
    done.add(budget)
    fair = [look for look in found.looks if look.fair]
    worst = min(fair, key=lambda look: counted_m(look.margin_m, look.kind), default=None)
    if worst is None or coarse(ground.scenario, ground.plant, SCREEN_S) is ground.scenario:
        return Fresh(found, None)
    case = (worst.number, ground.at(np.array(worst.point)))
    (pair,) = pairs([case], ground.plant, r_m=ground.r_m, team=team)
    return Fresh(found, pair.real)


def worst_cases(ground: Ground, searches: Sequence[Search]) -> list[Case]:
    """What laws are held against: of each search as many, failures first, and no two that are much alike.

    One half are the worst runs, the other half the failures that are furthest from all before.

    Args:
        ground: the scenario with its own law.
        searches: what was found.
    """
    each = max(1, CASES // len(searches))
    cases: list[Case] = []
    for one in searches:
        left = sorted(
            (look for look in one.looks if look.fair),
            key=lambda look: (not look.fails, counted_m(look.margin_m, look.kind)),
        )
        picked: list[Look] = []
        while left and len(picked) < each:
            failures = [look for look in left if look.fails]
            look = left[0] if len(picked) < (each + 1) // 2 or not failures else _furthest(failures, picked)
            left.remove(look)
            picked.append(look)
        for look in picked:
            try:
                cases.append((look.number, ground.at(np.array(look.point))))
            except ScenarioError:  # under another law it was one
                continue
    return cases


def _furthest(left: Sequence[Look], others: Sequence[Look]) -> Look:
    near = np.array([look.point for look in others])
    return max(left, key=lambda look: float(np.linalg.norm(near - np.array(look.point), axis=1).min()))


def _tried(
    ground: Ground,
    keys: Mapping[str, Distribution],
    cases: Sequence[Case],
    tries: int,
    rng: np.random.Generator,
    last: _Best | None,
    team: Workers,
    done: _Done,
) -> tuple[Candidate, list[Candidate], int, _Best | None]:
    """The scenario's own law, and others, each against all cases; how many were no scenarios; and the best.

    The best of the last round is one of them. The first half is drawn from everywhere, the second about the
    best so far.
    """
    (before,) = held_against(ground, [{}], cases, anyway=True, team=team)
    assert before is not None, "the scenario's own law is one"
    done.add(CASES + 1)
    known: dict[str, Candidate | None] = {before.words: before}
    best: _Best | None = None
    if last is not None:
        (again,) = held_against(ground, [last[1].settings], cases, team=team)
        known[last[1].words] = again
        best = (last[0], again) if again is not None and again.solves else None
    for first in range(0, tries, BATCH):
        points = [_point(rng, len(keys), k / tries, best) for k in range(first, min(first + BATCH, tries))]
        settings = [chosen(ground.scenario, keys, point.tolist()) for point in points]
        new = {spelt(one): one for one in settings if spelt(one) not in known}
        known |= zip(new, held_against(ground, list(new.values()), cases, team=team), strict=True)
        for point, one in zip(points, settings, strict=True):
            law = known[spelt(one)]
            if law is not None and law.solves and (best is None or law.worst_m > best[1].worst_m):
                best = point, law
        done.add(len(points) * (CASES + 1))
    others = [law for law in known.values() if law is not None and law is not before]
    return before, others, sum(law is None for law in known.values()), best


def _point(rng: np.random.Generator, size: int, part: float, best: tuple[Array, Candidate] | None) -> Array:
    """Parts of the keys, (K,): from everywhere at first, and then nearer and nearer to the best."""
    if best is None or part < _ANYWHERE:
        return rng.random(size)
    late = (part - _ANYWHERE) / (1 - _ANYWHERE)
    spread = _WIDE + late * (_NARROW - _WIDE)
    return folded(best[0] + rng.normal(0.0, spread, size))
