"""Many scenarios at once: those that are alike enough run together, each to the bits that it has alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mjmerge.config.bounds import MOST_SEED, check_runs, most_threads, whole
from mjmerge.config.document import described
from mjmerge.drivers import ahead
from mjmerge.errors import MjmergeError
from mjmerge.law import lacking
from mjmerge.law.several import COMMON
from mjmerge.plant import check
from mjmerge.scenario.cars import car_sheets, equipped
from mjmerge.scenario.effect import check as check_effect
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.arguments import check_scenario
from mjmerge.simulation.loop import run, ticks
from mjmerge.simulation.trace import Trace

SHARED = (
    "duration_s", "control_step_s", "physics_step_s", "models", "road", "actuation", "belief",
)  # fmt: skip
"""Sections of a scenario in which simulations that run together do not differ."""


def simulate_each(
    cases: Sequence[tuple[int, Scenario]],
    plant: str = "mujoco",
    *,
    threads: int = 0,
    continuous: bool = False,
    progress: Callable[[float], None] | None = None,
) -> list[Trace]:
    """Runs each scenario once: its trace is the one that :func:`mjmerge.simulate` gives, bit for bit.

    Simulations may differ in anything. Those that differ in mismatch, initial state, drivers and the law's
    own keys alone run together. The numbers of a driver cost nothing: they are arrays. A law of other keys is
    asked by itself.

    Args:
        cases: seed and scenario of each of N simulations.
        plant: what moves the cars, one of ``mjmerge.plant.PLANTS``.
        threads: threads for the physics, 0 for all cores; does not change the result.
        continuous: in continuous time, see :func:`mjmerge.simulate`; one after the other.
        progress: called now and then with the part that is done, 0 to 1.

    Returns:
        A trace of one simulation for each, N of them, in their order.

    Raises:
        MjmergeError: as of :func:`mjmerge.simulate`.
    """
    if not isinstance(cases, Sequence) or isinstance(cases, str):
        raise MjmergeError(f"cases must be a list of pairs (seed, scenario), got {described(cases)}")
    whole("threads", threads, 0, most_threads())
    for case in cases:
        if not isinstance(case, tuple) or len(case) != 2:
            raise MjmergeError(f"a case must be a pair (seed, scenario), got {described(case)}")
        seed, scenario = case
        whole("a seed", seed, 0, MOST_SEED)
        check_scenario(scenario)
        for message in lacking(scenario.law):
            raise MjmergeError(message)
        check(plant, scenario)
        check_effect(scenario, plant, continuous=continuous)
        check_runs(scenario, 1, (seed, seed), [scenario.mismatch])
    settled = [equipped(scenario.settled()) for _, scenario in cases]
    batches: list[tuple[object, list[int]]] = []
    for i, scenario in enumerate(settled):
        key = (i,) if continuous else alike(scenario)
        for other, members in batches:
            if key == other:
                members.append(i)
                break
        else:
            batches.append((key, [i]))
    found: dict[int, Trace] = {}
    for _, members in batches:
        each = [settled[i] for i in members]

        seeds = [cases[i][0] for i in members]
        so_far = None if progress is None else _part(progress, len(found), each, len(cases))
        going = ticks(each[0], each, seeds, plant, threads=threads, continuous=continuous, progress=so_far)
        log = run(going)
        found |= dict(zip(members, log.each(each), strict=True))
    return [found[i] for i in range(len(cases))]


def _part(
    progress: Callable[[float], None], before: int, each: Sequence[Scenario], runs: int
) -> Callable[[float], None]:
    """Progress of one batch, s, as that of all: 0 to 1."""
    return lambda time_s: progress((before + len(each) * time_s / each[0].duration_s) / runs)


def alike(scenario: Scenario) -> tuple[object, ...]:
    """What is the same in scenarios that can run together."""
    law, starts = scenario.law, scenario.starts[1:]
    sheets = car_sheets(scenario)
    follows = ahead([start.front_m for start in starts], sheets[1:], (law.j_1, law.j_2))
    return (
        *(getattr(scenario, name) for name in SHARED),
        scenario.roster.cars,
        sheets,
        follows,
        type(law),
        law.kind,
        law.gives,
        law.remembers,
        law.signals,
        *(getattr(law, name) for name in COMMON),
    )
