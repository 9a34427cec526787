"""What a search makes of a scenario: how close it comes, and whether that is fair to hold against its law.

A failure is fair if the same behaviour, on the plant of the proof and with nothing different in truth, keeps
the scenario's floor with every hypothesis true. So what fails is the mismatch, and not a merge that nobody
could have made.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from mjmerge.drivers import Absent
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.search.against import PROOF, Against
from mjmerge.simulation.each import simulate_each
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array
from mjmerge.sweep.fidelity import coarse
from mjmerge.sweep.workers import HERE, Workers
from mjmerge.verdict.counterfactual import IDEAL, guarded, unguarded
from mjmerge.verdict.hypotheses import broken
from mjmerge.verdict.judge import HELD, Breach, judge

Kind = Literal["touch", "d<=0", "end", "ran off", "unstable"]
KINDS: dict[Kind, str] = {
    "touch": "bodies touch",
    "d<=0": "d_j falls to 0",
    "end": "the ego runs off the end of its lane",
    "ran off": "a car leaves the road",
    "unstable": "the simulation ends early",
}
"""How a run fails, from the worst on, in words."""
OFF = ("it ran away", "it is off its wheels")
"""Why a simulation ends where a car has left the road."""


@dataclass(frozen=True)
class Margin:
    """How close one run came.

    Attributes:
        least_m: of every d_j and every clearance of the ego, and of its distance from the edge where its lane
            ends, the least, m; NaN where nothing is known.
        min_distance_m: least d_j, m.
        min_clearance_m: least clearance of the ego's body, m; NaN on plants without bodies.
        kind: how it failed; ``None`` where it did not.
        holds: whether it kept the scenario's floor to the end.
        broken: hypotheses that broke, and when each did first, in order of time.
        unsafe_at_s: when it was unsafe first, or ended early, s; ``None`` where it was not and did not.
        verdict: of the run; ``None`` where nobody asked.
    """

    least_m: float
    min_distance_m: float
    min_clearance_m: float
    kind: Kind | None
    holds: bool
    broken: tuple[Breach, ...]
    unsafe_at_s: float | None = None
    verdict: str | None = None


@dataclass(frozen=True)
class Pair:
    """A scenario as it is held against its law: on the plant, and where it is compared.

    Attributes:
        scenario: with its mismatch.
        seed: of both runs.
        ideal: how close it comes there.
        real: how close it comes on the plant; ``None`` where it was not fair and so was not run.
        strict: whether a hypothesis that breaks there makes it unfair.
    """

    scenario: Scenario
    seed: int
    ideal: Margin
    real: Margin | None
    strict: bool = True

    @property
    def fair(self) -> bool:
        """Whether the ideal keeps the floor, with every hypothesis true."""
        return self.ideal.holds and not (self.strict and self.ideal.broken)

    @property
    def fails(self) -> bool:
        """Whether it is a failure that counts."""
        return self.fair and self.real is not None and self.real.kind is not None

    @property
    def tested(self) -> bool:
        """Whether it was safe where it is compared because of the barrier; of pairs that were judged."""
        return not self.strict or self.ideal.verdict == HELD

    @property
    def cost(self) -> float:
        """What a search makes smaller: the margin less what it has lost against the ideal, m.

        By the margin alone it would end where the ideal itself hardly keeps its floor, and not where the
        plant is worse than that. Beyond all margins where it would not be fair.
        """
        if not self.fair or self.real is None:
            short_m = max(self.scenario.expect.min_distance_m.at_least - self.ideal.least_m, 0.0)
            return 1e3 + (short_m if np.isfinite(short_m) else 1e3) + len(self.ideal.broken)
        least_m = self.real.least_m if np.isfinite(self.real.least_m) else 0.0
        if self.real.kind is not None:
            least_m = min(least_m, 0.0)  # it fails, however far away it ends
        return least_m - (self.ideal.least_m - least_m)


def margin(trace: Trace, r_m: float | None = None) -> Margin:
    """How close a run came; of a trace of one simulation.

    Args:
        trace: the run.
        r_m: the margin r by which it is judged, m; by default that of its law.
    """
    wider_m = 0.0 if r_m is None else trace.scenario.r_m - r_m
    distance, ego = float(trace.min_distance_m[0].min()) + wider_m, len(trace.roster.neighbours)
    clearance = float(trace.min_clearance_m[0, :ego].min())
    stops, floor = trace.stops, trace.scenario.expect.min_distance_m.at_least
    kind: Kind | None = None
    if np.any(trace.touching_ego):
        kind = "touch"
    elif distance <= 0 or any(stop.crossing for stop in stops):
        kind = "d<=0"
    elif np.any(trace.off_the_end):
        kind = "end"
    elif stops:
        kind = "ran off" if stops[0].reason in OFF else "unstable"
    edge_m = np.inf if trace.edge_distance_m is None else float(trace.least_m[0, -1])
    least = float(np.nanmin([distance, clearance, edge_m])) if np.isfinite(distance) else float("nan")
    holds = (
        kind is None and distance >= floor and edge_m >= trace.scenario.expect.min_edge_distance_m.at_least
    )
    return Margin(least, distance, clearance, kind, holds, _breaches(trace), _unsafe_at_s(trace))


def _breaches(trace: Trace) -> tuple[Breach, ...]:
    """What broke in a trace of one simulation, in order of time; in the order of the docs at one time."""
    first = {name: int(np.argmax(marks[0])) for name, marks in broken(trace).items() if marks.any()}
    found = [Breach(name, float(trace.time_s[tick])) for name, tick in first.items()]
    return tuple(sorted(found, key=lambda breach: breach.time_s))


def _unsafe_at_s(trace: Trace) -> float | None:
    """When a trace of one simulation is unsafe first, or ends early, s."""
    inside = np.any((trace.distance_m[0] <= 0) | trace.touching_ego[0], axis=1)
    ticks = np.flatnonzero(inside | trace.off_the_end[0])
    times = [float(trace.time_s[k]) for k in ticks[:1]] + [stop.time_s for stop in trace.stops]
    return min(times, default=None)


def margins(
    cases: Sequence[tuple[int, Scenario]],
    plant: str,
    *,
    step_s: float | None = None,
    judged: bool = False,
    continuous: bool = False,
    r_m: float | None = None,
    team: Workers = HERE,
) -> list[Margin]:
    """How close each comes; the same for any number of workers.

    Args:
        cases: seed and scenario of each.
        plant: what moves the cars.
        step_s: of the physics, s, in place of the scenarios' own; none smaller than theirs.
        judged: whether unsafe ones get a verdict, and safe ones in which nothing is different in truth.
        continuous: whether in continuous time.
        r_m: the margin r by which they are judged, m; by default that of each one's law.
        team: who runs them.
    """
    made = [(seed, coarse(scenario, plant, step_s)) for seed, scenario in cases]
    return team.each(partial(_margins, plant, judged, continuous, r_m), made, called)


def called(case: tuple[int, Scenario]) -> str:
    """What a run is called where it is not known by a point: its scenario, seed, and what is different."""
    seed, scenario = case
    plain = Mismatch().model_dump(mode="json")
    other = {k: v for k, v in scenario.mismatch.model_dump(mode="json").items() if v != plain[k]}
    differs = "".join(f", mismatch.{key}={json.dumps(value)}" for key, value in other.items())
    return f"{scenario.name} with seed {seed}{differs}"


def _margins(
    plant: str,
    judged: bool,
    continuous: bool,
    r_m: float | None,
    cases: Sequence[tuple[int, Scenario]],
    threads: int,
) -> list[Margin]:
    traces = simulate_each(cases, plant, threads=threads, continuous=continuous)
    found = [margin(trace, r_m) for trace in traces]
    if not judged:
        return found
    without = _without_barrier_m(found, traces)
    return [
        one
        if i not in without and one.kind is None
        else replace(one, verdict=_verdict(trace, without.get(i)))
        for i, (one, trace) in enumerate(zip(found, traces, strict=True))
    ]


def _verdict(trace: Trace, without: Array | None) -> str:
    (found,) = judge(trace, without)
    return found.verdict


def _without_barrier_m(found: Sequence[Margin], traces: Sequence[Trace]) -> dict[int, Array]:
    """What a verdict asks of safe runs in which nothing is different in truth, all at once.

    That is :attr:`Trace.least_m` without the barrier, (1, C-1 or C), by number of the run.
    """
    bare = {}
    for i, (one, trace) in enumerate(zip(found, traces, strict=True)):
        scenario = trace.scenario
        if one.kind is None and scenario.mismatch == Mismatch() and guarded(scenario):
            other = unguarded(scenario)
            if other is not None and not any(isinstance(d, Absent) for d in scenario.neighbours):
                bare[i] = (int(trace.seeds[0]), other)
    made = simulate_each(list(bare.values()), IDEAL)
    return {i: trace.least_m for i, trace in zip(bare, made, strict=True)}


def pairs(
    cases: Sequence[tuple[int, Scenario]],
    plant: str,
    *,
    against: Against = PROOF,
    step_s: float | None = None,
    judged: bool = False,
    r_m: float | None = None,
    team: Workers = HERE,
) -> list[Pair]:
    """How close each comes, and whether that is fair; on the plant only those that are.

    Args:
        cases: seed and scenario of each.
        plant: what moves the cars.
        against: where the same behaviour must be safe.
        step_s: of the physics, s, in place of the scenarios' own; none smaller than theirs.
        judged: see :func:`margins`.
        r_m: likewise.
        team: who runs them.
    """
    there = [(seed, against.of(scenario)) for seed, scenario in cases]
    safe = margins(there, against.plant(plant), step_s=step_s, judged=judged, r_m=r_m, team=team)
    half = [Pair(s, n, m, None, against.law is None) for (n, s), m in zip(cases, safe, strict=True)]
    fair = [(pair.seed, pair.scenario) for pair in half if pair.fair]
    real = iter(margins(fair, plant, step_s=step_s, judged=judged, r_m=r_m, team=team))
    return [replace(pair, real=next(real)) if pair.fair else pair for pair in half]


def known(value: float) -> float | None:
    """A number as JSON has it: one that is not known is none."""
    return float(value) if np.isfinite(value) else None
