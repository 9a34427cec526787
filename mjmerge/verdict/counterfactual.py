"""What the barrier is worth in a run: the same scenario on the ideal plant, without it and with it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from mjmerge.config.doors import from_outside
from mjmerge.drivers import Absent
from mjmerge.scenario.effect import acting
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array

IDEAL = "double_integrator"
"""The plant of the paper's proof."""

_Case = tuple[int, Mismatch]
_MOST_KNOWN = 1_000
_TOGETHER = 256  # simulations at a time: what they leave behind is large, and only its least is kept


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
    scenario = unguarded(trace.scenario)
    if scenario is None or any(isinstance(driver, Absent) for driver in trace.scenario.neighbours):
        return np.full((len(runs), trace.least_m.shape[1]), np.nan)
    kinds = [scenario.law.kind, *(driver.kind for driver in scenario.neighbours)]
    outside = any(map(from_outside, kinds))
    known = {} if outside or scenario.sheets is None else _known(scenario)
    return _ideal_m(scenario, trace, runs, known)


def with_barrier_m(trace: Trace, runs: Sequence[int]) -> Array:
    """How close they come there with it: the same of the scenario as it is."""
    if trace.plant == IDEAL and not trace.continuous and trace.mismatch == (Mismatch(),) * trace.runs:
        return trace.least_m[list(runs)]  # that is what happened
    scenario = trace.scenario.settled().model_copy(update={"mismatch": Mismatch()})
    return _ideal_m(scenario, trace, runs, {})


@lru_cache(maxsize=32)
def _known(scenario: Scenario) -> dict[_Case, Array]:
    """What came of a scenario's cases already; empty at first.

    Every rung of a ladder, row of a gate and step of a search is held against the same few ideal runs. Not
    for code from outside, which may be other code by now.
    """
    del scenario
    return {}


def _ideal_m(scenario: Scenario, trace: Trace, runs: Sequence[int], known: dict[_Case, Array]) -> Array:
    """:attr:`Trace.least_m` of a scenario on the ideal plant, m, (M, C-1 or C).

    With the same neighbours, seeds, measurements and dead time, as far as the ideal plant has them;
    simulations that differ in nothing of that share one run. NaN where that run has no data.

    Args:
        scenario: what to run, with nothing different in truth.
        trace: what happened, and the cases that it happened in.
        runs: which of its simulations, M of them.
        known: what is known of it by case; what comes of others is added.
    """
    cases = [_case(trace, run) for run in runs]
    distinct = [case for case in dict.fromkeys(cases) if case not in known]
    if len(known) + len(distinct) > _MOST_KNOWN:
        known, distinct = {}, list(dict.fromkeys(cases))
    for first in range(0, len(distinct), _TOGETHER):
        part = distinct[first : first + _TOGETHER]
        known |= zip(part, simulate(scenario, IDEAL, cases=part).least_m, strict=True)
    least = [known[case] for case in cases]
    return np.array(least) if least else np.empty((0, trace.least_m.shape[1]))


def _case(trace: Trace, run: int) -> _Case:
    """Its seed, and what of its mismatch the ideal plant has; continuous time knows none."""
    there = trace.scenario.model_copy(update={"mismatch": trace.mismatch[run]})
    return int(trace.seeds[run]), acting(there, IDEAL, continuous=trace.continuous).mismatch
