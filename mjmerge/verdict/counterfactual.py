"""What the barrier is worth in a run: the same scenario on the ideal plant, without it and with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjmerge.drivers import Absent
from mjmerge.scenario.effect import acting
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array

IDEAL = "double_integrator"
"""The plant of the paper's proof."""

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
    """How close simulations come on the ideal plant without the barrier: least d_j, m, (M, C-1).

    NaN where that cannot be asked: a driver's code is not here, or the law cannot be without.
    """
    scenario = unguarded(trace.scenario)
    if scenario is None or any(isinstance(driver, Absent) for driver in trace.scenario.neighbours):
        return np.full((len(runs), trace.distance_m.shape[2]), np.nan)
    return _ideal_m(scenario, trace, runs)


def with_barrier_m(trace: Trace, runs: Sequence[int]) -> Array:
    """How close they come there with it: the same of the scenario as it is."""
    scenario = trace.scenario.settled().model_copy(update={"mismatch": Mismatch()})
    return _ideal_m(scenario, trace, runs)


def _ideal_m(scenario: Scenario, trace: Trace, runs: Sequence[int]) -> Array:
    """Least d_j of a scenario on the ideal plant, m, (M, C-1).

    With the same neighbours, seeds, measurements and dead time, as far as the ideal plant has them;
    simulations that differ in nothing of that share one run. NaN where that run has no data.

    Args:
        scenario: what to run, with nothing different in truth.
        trace: what happened, and the cases that it happened in.
        runs: which of its simulations, M of them.
    """
    cases: dict[tuple[int, Mismatch], int] = {}
    which = [cases.setdefault(_case(trace, run), len(cases)) for run in runs]
    least = np.full((len(cases), trace.distance_m.shape[2]), np.nan)
    distinct = list(cases)
    for first in range(0, len(distinct), _TOGETHER):
        part = slice(first, first + _TOGETHER)
        least[part] = simulate(scenario, IDEAL, cases=distinct[part]).min_distance_m
    return least[which]


def _case(trace: Trace, run: int) -> tuple[int, Mismatch]:
    """Its seed, and what of its mismatch the ideal plant has; continuous time knows none."""
    there = trace.scenario.model_copy(update={"mismatch": trace.mismatch[run]})
    return int(trace.seeds[run]), acting(there, IDEAL, continuous=trace.continuous).mismatch
