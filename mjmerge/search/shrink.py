"""Shrinking: the smallest example of a failure that is still the same failure, and not by a hair.

Runs are made in batches, at the scenario's own step: which parts can be left out, one by one and then all at
once as long as it goes; whether fewer parts that go further do; how much of the mismatch it takes; with how
few digits it can be said. What is left fails with some of it taken back, and at half the step, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

from mjmerge.config.acts import BODIES
from mjmerge.errors import ScenarioError
from mjmerge.scenario.schema import Scenario
from mjmerge.search.against import PROOF, Against
from mjmerge.search.margin import Kind, Pair, pairs
from mjmerge.search.parts import Name, Parts
from mjmerge.sweep.workers import HERE, Workers

SPARES = (0.1, 0.05, 0.02, 0.01)
"""Parts of what is left that are taken back, to tell how far it is from where it would not fail."""
FEW = 2
"""Axes, and moves: with more of them, fewer that go further are tried."""
MOST_RUNS = 100
"""Of one failure, on the plant; what there is then is the result."""
_ENDING = 24  # runs that are kept for the end
_AMOUNTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
_DIGITS = (1, 2, 3, 4)
_TRIES = 3  # amounts that are tried to the end


@dataclass(frozen=True)
class Shrunk:
    """What a failure came to.

    Attributes:
        parts: what is left of it.
        pair: its runs, where it is compared and on the plant, judged.
        runs: how many it took on the plant.
        spare: with this part less of it, it fails in the same way, too: the largest of ``SPARES`` for which
            it does; 0 where it is none.
        half: whether it does at half the step of the physics; ``None`` where there are no bodies.
    """

    parts: Parts
    pair: Pair
    runs: int
    spare: float
    half: bool | None

    @property
    def small(self) -> bool:
        """Whether it takes few axes and few moves."""
        return len(self.parts.companies) <= FEW and sum(map(len, self.parts.moves.values())) <= FEW


def shrink(
    parts: Parts,
    seed: int,
    plant: str,
    *,
    ends: Mapping[str, Any] | None = None,
    against: Against = PROOF,
    team: Workers = HERE,
) -> Shrunk | None:
    """The smallest of its kind.

    Args:
        parts: what it consists of.
        seed: of its run; with 0 it is tried, too, and that is kept where it fails in the same way.
        plant: what moves the cars.
        ends: how far each axis may go.
        against: where the same behaviour must be safe.
        team: who runs them; does not change the result.

    Returns:
        What is left; ``None`` where it does not fail at the scenario's own step and at half of it, or where
        it is compared nothing puts the barrier to the test.
    """
    return _Shrinking(seed, plant, ends or {}, against, team).all(parts)


@dataclass
class _Shrinking:
    """Counts the runs."""

    seed: int
    plant: str
    ends: Mapping[str, Any]
    against: Against
    team: Workers
    kind: Kind | None = None
    runs: int = 0
    known: dict[str, Pair | None] = field(default_factory=dict)

    def all(self, parts: Parts) -> Shrunk | None:
        scenario = parts.scenario()
        seeds = list(dict.fromkeys((self.seed, 0)))
        first, *plain = self._run([(seed, scenario) for seed in seeds])
        if first.real is None or not (first.fails and first.tested):
            return None
        self.kind = first.real.kind
        if any(map(self._same, plain)):
            self.seed = 0
        parts = self._fewer(parts)
        for fewer in self._fewest(parts):
            parts = self._fewer(fewer)
            break
        return self._ended(self._less(parts))

    def _fewer(self, parts: Parts) -> Parts:
        """Without whatever it does not take."""
        while parts.names:
            alone = self._tried([parts.without({name}) for name in parts.names])
            idle = sorted(
                (pair.cost, name)
                for pair, name in zip(alone, parts.names, strict=True)
                if pair is not None and self._same(pair)
            )
            if not idle:
                break
            names = [name for _, name in idle]
            counts = sorted({len(names), *(max(1, len(names) * k // 4) for k in (1, 2, 3))})
            together = self._tried([parts.without(set(names[:count])) for count in counts])
            most = max((c for c, pair in zip(counts, together, strict=True) if self._same(pair)), default=0)
            gone: set[Name] = set(names[: most or 1])
            parts = parts.without(gone)
        return parts

    def _fewest(self, parts: Parts) -> Iterator[Parts]:
        """What is in fewer axes or moves, each axis as far as it may go: the first of these that fails."""
        axes = [name for name in parts.names if name[0] == "axis"]
        moves = [name for name in parts.names if name[0] == "move"]
        if len(axes) <= FEW and len(moves) <= FEW:
            return
        far = parts.further(self.ends)
        some = [set(one) for n in range(1, FEW + 1) for one in combinations(axes, n)] if axes else [set()]
        few = [set(one) for n in range(FEW + 1) for one in combinations(moves, n)]
        sets = [(a | b) for b in ([set(moves)] if len(moves) <= FEW else few[::-1]) for a in some]
        candidates = [far.without(set(far.names) - one) for one in sets]
        candidates = candidates[: max(0, MOST_RUNS - _ENDING - self.runs)]
        made = self._tried(candidates)
        yield from (one for one, pair in zip(candidates, made, strict=True) if self._same(pair))

    def _less(self, parts: Parts) -> list[Parts]:
        """With as little of it as it takes, and some more: from what is best on."""
        amounts = (*_AMOUNTS, 1.0)
        fails = [*(self._same(pair) for pair in self._tried([parts.nearer(a) for a in _AMOUNTS])), True]
        within = [i for i in range(1, len(amounts)) if fails[i - 1] and fails[i]]
        edges = [i for i in range(len(amounts)) if fails[i] and i not in within]
        return [parts.nearer(amounts[i]) for i in (*within, *edges)][:_TRIES]

    def _ended(self, candidates: Sequence[Parts]) -> Shrunk | None:
        """With as few digits as do; the first that fails with some of it taken back too, if there is one."""
        at_last: Shrunk | None = None
        for parts in candidates:
            shorter = [*(parts.rounded(digits) for digits in _DIGITS), parts]
            made = self._tried([*shorter, *(one.nearer(1 - SPARES[0]) for one in shorter)])
            tried, milder = made[: len(shorter)], [self._same(pair) for pair in made[len(shorter) :]]
            for k in sorted(range(len(shorter)), key=lambda k: not milder[k]):  # in order of digits, else
                pair, one = tried[k], shorter[k]
                if pair is None or not self._same(pair) or (at_last is not None and not milder[k]):
                    continue
                half = self._at_half(one)
                if half is not False:
                    at_last = Shrunk(one, pair, self.runs, SPARES[0] if milder[k] else 0.0, half)
                    break
            if at_last is not None and (at_last.spare or self.runs > MOST_RUNS - _ENDING):
                break
        if at_last is None or at_last.spare:
            return at_last
        less = self._tried([at_last.parts.nearer(1 - spare) for spare in SPARES[1:]])
        spare = next((n for n, pair in zip(SPARES[1:], less, strict=True) if self._same(pair)), 0.0)
        return replace(at_last, spare=spare, runs=self.runs)

    def _at_half(self, parts: Parts) -> bool | None:
        if self.plant not in BODIES:
            return None
        scenario = parts.scenario()
        finer = scenario.model_copy(update={"physics_step_s": scenario.physics_step_s / 2})
        (pair,) = self._run([(self.seed, finer)])
        return self._same(pair)

    def _same(self, pair: Pair | None) -> bool:
        real = None if pair is None else pair.real
        return pair is not None and real is not None and pair.fails and pair.tested and real.kind == self.kind

    def _tried(self, candidates: Sequence[Parts]) -> list[Pair | None]:
        """What comes of each, run once however often it is asked for; ``None`` where it is no scenario."""
        scenarios: dict[str, Scenario] = {}
        names: list[str] = []
        for one in candidates:
            name = repr((dict(one.axes), dict(one.moves)))
            names.append(name)
            if name in self.known:
                continue
            try:
                scenarios[name] = one.scenario()
            except ScenarioError:
                self.known[name] = None
        cases = [(self.seed, scenario) for scenario in scenarios.values()]
        self.known |= dict(zip(scenarios, self._run(cases), strict=True))
        return [self.known[name] for name in names]

    def _run(self, cases: Sequence[tuple[int, Scenario]]) -> list[Pair]:
        made = pairs(cases, self.plant, against=self.against, judged=True, team=self.team)
        self.runs += sum(pair.real is not None for pair in made)
        return made
