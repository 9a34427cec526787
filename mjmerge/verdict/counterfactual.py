"""What the barrier is worth in a run: the same scenario on the ideal plant, without it and with it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mjmerge.config.doors import from_outside
from mjmerge.drivers import Absent
from mjmerge.scenario.cars import equipped
from mjmerge.scenario.effect import acting
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.each import alike
from mjmerge.simulation.loop import run, ticks
from mjmerge.simulation.trace import OF_LEAST, Trace
from mjmerge.state import Array

IDEAL = "double_integrator"
"""The plant of the paper's proof."""

_Case = tuple[int, Mismatch]
_MOST_KNOWN = 1_000
_MOST_TOGETHER, _MOST_TICKS = 256, 1_000_000  # simulations at a time, and all their ticks: 0.1 kB each


class _Ideal(NamedTuple):
    """A scenario to be run on the ideal plant, with nothing different in truth, and what is known of it."""

    scenario: Scenario
    known: dict[_Case, Array]


def guarded(scenario: Scenario) -> bool | None:
    """Whether its law has something that keeps it away; ``None`` where nobody knows how to take it out."""
    without = scenario.law.unguarded()
    return None if without is None else without != scenario.law


def unguarded(scenario: Scenario) -> Scenario | None:
    """The scenario with its law's safety part taken out (k_o = 0), and nothing different in truth.

    ``None`` where nobody knows how.
    """
    law = scenario.law.unguarded()
    if law is None:
        return None
    return scenario.settled().model_copy(update={"law": law, "mismatch": Mismatch()})


def without_barrier_m(trace: Trace, runs: Sequence[int]) -> Array:
    """How close simulations come on the ideal plant without the barrier: ``Trace.least_m``, (M, C-1 or C).

    NaN where that cannot be asked: a driver's code is not here, or the law cannot be without.
    """
    return ideals_m(trace, runs, ())[0]


def with_barrier_m(trace: Trace, runs: Sequence[int]) -> Array:
    """How close they come there with it: the same of the scenario as it is, NaN likewise."""
    return ideals_m(trace, (), runs)[1]


def ideals_m(trace: Trace, without: Sequence[int], with_it: Sequence[int]) -> tuple[Array, Array]:
    """Both, each of its own simulations: what is to be run runs together."""
    asked = (_without(trace) if without else None, without), (_with(trace) if with_it else None, with_it)
    bare, kept = _least_m(trace, asked)
    return bare, kept


def _without(trace: Trace) -> _Ideal | None:
    scenario = unguarded(trace.scenario)
    return None if scenario is None or _absent(scenario) else _ideal(scenario)


def _absent(scenario: Scenario) -> bool:
    """Whether a driver's code is not here."""
    return any(isinstance(driver, Absent) for driver in scenario.neighbours)


def _with(trace: Trace) -> _Ideal | None:
    if _absent(trace.scenario):
        return None
    scenario = trace.scenario.settled().model_copy(update={"mismatch": Mismatch()})
    if trace.plant == IDEAL and not trace.continuous and trace.mismatch == (Mismatch(),) * trace.runs:
        cases = [_case(trace, one) for one in range(trace.runs)]
        return _Ideal(scenario, dict(zip(cases, trace.least_m, strict=True)))  # that is what happened
    return _ideal(scenario)


def _ideal(scenario: Scenario) -> _Ideal:
    """What of code from outside is known may be of other code by now."""
    there = acting(equipped(scenario), IDEAL)
    kinds = [scenario.law.kind, *(driver.kind for driver in scenario.neighbours)]
    lasting = scenario.sheets is not None and not any(map(from_outside, kinds))
    return _Ideal(there, _known(there) if lasting else {})


@lru_cache(maxsize=64)
def _known(scenario: Scenario) -> dict[_Case, Array]:
    """What came of a scenario's cases already; empty at first.

    Every rung of a ladder, row of a gate and step of a search is held against the same few ideal runs.
    """
    del scenario
    return {}


def _least_m(trace: Trace, asked: Sequence[tuple[_Ideal | None, Sequence[int]]]) -> list[Array]:
    """:attr:`Trace.least_m` of scenarios on the ideal plant, m, (M, C-1 or C) each.

    With the same neighbours, seeds, measurements and dead time, as far as the ideal plant has them;
    simulations that differ in nothing of that share one run. NaN where that run has no data, or there is
    nothing to run.

    Args:
        trace: what happened, and the cases that it happened in.
        asked: scenarios, and of which of the trace's simulations, M of them, each.
    """
    there, todo = [], []
    for ideal, runs in asked:
        cases = [] if ideal is None else [_case(trace, one) for one in runs]
        known = {} if ideal is None else ideal.known
        distinct = [case for case in dict.fromkeys(cases) if case not in known]
        if distinct and len(known) + len(distinct) > _MOST_KNOWN:
            known, distinct = {}, list(dict.fromkeys(cases))
        todo += [(ideal.scenario, known, case) for case in distinct if ideal is not None]
        there.append((known, cases, len(runs)))
    while todo:
        part = _together(todo)
        todo = todo[len(part) :]
        for (_, known, case), least in zip(part, _simulated_m(part), strict=True):
            known[case] = least
    found = [np.full((runs, trace.least_m.shape[1]), np.nan) for _, _, runs in there]
    for least_m, (known, cases, _) in zip(found, there, strict=True):
        if cases:
            least_m[:] = [known[case] for case in cases]
    return found


_Todo = tuple[Scenario, dict[_Case, Array], _Case]


def _together(todo: Sequence[_Todo]) -> Sequence[_Todo]:
    """What of it comes first and can be simulated together, as much as there is room for."""
    scenario = todo[0][0]
    most = max(1, min(_MOST_TOGETHER, _MOST_TICKS // scenario.ticks))
    others = [i for i, (one, _, _) in enumerate(todo) if one is not scenario]
    fits = not others or alike(todo[others[0]][0]) == alike(scenario)
    return todo[: most if fits else min(most, others[0])]


def _simulated_m(part: Sequence[_Todo]) -> Array:
    """:attr:`Trace.least_m` of simulations on the ideal plant, (M, C-1 or C)."""
    each = [scenario.model_copy(update={"mismatch": mismatch}) for scenario, _, (_, mismatch) in part]
    seeds = [seed for _, _, (seed, _) in part]
    return run(ticks(each[0], each, seeds, IDEAL, kept=OF_LEAST)).finish().least_m


def _case(trace: Trace, run: int) -> _Case:
    """Its seed, and what of its mismatch the ideal plant has; continuous time knows none."""
    there = trace.scenario.model_copy(update={"mismatch": trace.mismatch[run]})
    return int(trace.seeds[run]), acting(there, IDEAL, continuous=trace.continuous).mismatch
