"""Shards of a plan: which runs are simulated together, and what is made of them.

What the shards are depends on the plan alone, and a run's bits do not depend on its company.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.sweep.fidelity import near
from mjmerge.sweep.plan import Case, Plan
from mjmerge.sweep.rows import rows
from mjmerge.verdict.judge import judge
from mjmerge.verdict.own import measured

TOGETHER = 64
"""Runs of a shard, at most."""
MOST_TICKS = 300_000
"""Control ticks of a shard, all runs together, at most: what bounds the memory, at some 1 kB each."""


@dataclass(frozen=True)
class Shard:
    """Runs that are simulated together.

    Attributes:
        number: which of the plan's shards.
        at: index of each run in the plan.
        cases: the runs; all of one batch.
    """

    number: int
    at: tuple[int, ...]
    cases: tuple[Case, ...]

    def only(self, runs: Collection[int]) -> Shard:
        """It with some of its runs alone."""
        left = [(i, case) for i, case in zip(self.at, self.cases, strict=True) if i in runs]
        return Shard(self.number, tuple(i for i, _ in left), tuple(case for _, case in left))


def shards(plan: Plan, together: int = TOGETHER) -> list[Shard]:
    """A plan's runs in groups that share everything but seed and mismatch, of much the same size.

    Args:
        plan: the plan.
        together: runs of a shard, at most.
    """
    batches: dict[int, list[int]] = {}
    for i, case in enumerate(plan.cases):
        batches.setdefault(id(case.batch), []).append(i)
    found: list[Shard] = []
    for members in batches.values():
        scenario = plan.cases[members[0]].batch.scenario
        most = max(1, min(together, MOST_TICKS // scenario.ticks))
        count = -(-len(members) // most)
        for k in range(count):
            at = tuple(members[len(members) * k // count : len(members) * (k + 1) // count])
            found.append(Shard(len(found), at, tuple(plan.cases[i] for i in at)))
    return found


def dealt(some: Sequence[Shard], workers: int) -> list[tuple[Shard, ...]]:
    """Shards that are simulated at once: two by two, as far as all workers have as much to do as before.

    Twice as many runs take less than twice the time, but for the physics. What comes first is largest.

    Args:
        some: the shards; of one batch and in a row those that go together.
        workers: how many work at a time.
    """
    found: list[tuple[Shard, ...]] = []
    for _, mine in groupby(some, key=lambda shard: id(shard.cases[0].batch)):
        left = list(mine)
        rounds = -(-len(left) // (2 * workers))
        pairs = max(0, len(left) - rounds * workers)
        for _ in range(pairs):
            two, left = left[:2], left[2:]
            ticks = two[0].cases[0].batch.scenario.ticks * sum(len(shard.at) for shard in two)
            found += [tuple(two)] if ticks <= MOST_TICKS else [(shard,) for shard in two]
        found += [(shard,) for shard in left]
    return sorted(found, key=len, reverse=True)


def measure(
    cases: Sequence[Case], threads: int, progress: Callable[[float], None] | None = None
) -> list[dict[str, Any]]:
    """Simulates runs of one batch and reduces them to one row each; near decisions at their own step.

    Args:
        cases: the runs.
        threads: for the physics, 0 for all cores.
        progress: called with the part that is done, 0 to 1.

    Raises:
        DoorError: a metric of the scenario's own fails.
    """
    batch = cases[0].batch
    if batch.begun is None or batch.fidelity is None:
        return _rows(batch.scenario, cases, threads, progress)
    found = _rows(batch.begun, cases, threads, progress)
    again = [i for i, row in enumerate(found) if near(row, batch.scenario, batch.fidelity.within_r)]
    if again:
        own = _rows(batch.scenario, [cases[i] for i in again], threads, None)
        for i, row in zip(again, own, strict=True):
            found[i] = row
    return found


def _rows(
    scenario: Scenario, cases: Sequence[Case], threads: int, progress: Callable[[float], None] | None
) -> list[dict[str, Any]]:
    batch = cases[0].batch
    trace = simulate(
        scenario,
        batch.plant,
        threads=threads,
        continuous=batch.continuous,
        cases=[(case.seed, case.mismatch) for case in cases],
        progress=None if progress is None else lambda t: progress(t / scenario.duration_s),
    )
    return [dict(row) for row in rows(trace, judge(trace), measured(trace))]
