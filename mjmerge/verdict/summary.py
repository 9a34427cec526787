"""What a person gets from a trace: the summary, the table, the figure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.scenario.effect import told
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.trace import Trace, worst_run
from mjmerge.state import Array
from mjmerge.vehicle.acceptance import Acceptance
from mjmerge.verdict import own
from mjmerge.verdict.decision import decision
from mjmerge.verdict.hypotheses import asked
from mjmerge.verdict.judge import VERDICTS, Verdict
from mjmerge.verdict.metrics import merged_at_s, saturated, turned_rad
from mjmerge.verdict.records import sentence, strays

if TYPE_CHECKING:
    pass


def summary(
    trace: Trace, verdicts: Sequence[Verdict], metrics: Mapping[str, Array] | None = None
) -> dict[str, Any]:
    """What ``--json`` prints and ``summary.json`` holds, but for the time it took, run folder and versions.

    Distances are the smallest over all simulations; times, merge, hypotheses (when each first broke), the
    decision and the scenario's own metrics are those of the worst one.

    Args:
        trace: what happened.
        verdicts: on each simulation.
        metrics: what the scenario's own metrics came to, by name, each (N,); not known where left out.
    """
    run = worst_run(trace)
    distance_m = trace.distance_m[run]
    worst = max(verdicts, key=lambda v: (VERDICTS.index(v.verdict), v.run == run))
    there = trace.roster
    clearance = trace.min_clearance_m[:, : len(there.neighbours)]
    return {
        "scenario": trace.scenario.name,
        "plant": trace.plant,
        "continuous": trace.continuous,
        "seed": int(trace.seeds[0]),
        "runs": trace.runs,
        "verdict": worst.verdict,
        "reason": worst.reason,
        "verdicts": dict(Counter(v.verdict for v in verdicts)),
        "floor_m": trace.scenario.expect.min_distance_m.at_least,
        "floor_held": all(v.floor_held for v in verdicts),
        "floor_held_runs": sum(v.floor_held for v in verdicts),
        "worst_seed": int(trace.seeds[run]),
        "min_distance_m": {
            car: number(least)
            for car, least in zip(there.neighbours, _least(trace.min_distance_m), strict=True)
        },
        "t_min_distance_s": {
            car: number(trace.time_s[np.argmin(np.where(np.isnan(d), np.inf, d))])
            for car, d in zip(there.neighbours, distance_m.T, strict=True)
        },
        "min_clearance_m": number(_least(clearance.reshape(-1, 1))[0]),
        "collisions": [
            {"seed": int(trace.seeds[v.run]), **asdict(collision)}
            for v in verdicts
            for collision in v.collisions
        ],
        "needed": verdicts[run].needed,
        "without_barrier_m": verdicts[run].without_barrier_m,
        "merged_at_s": number(merged_at_s(trace)[run]),
        "turned_rad": number(turned_rad(trace)[run]),
        "saturated_s": {
            car: number(saturated(trace)[run, :, c].sum() * trace.scenario.control_step_s)
            for c, car in enumerate(there.cars)
        },
        "peak_u_c_mps2": number(-_least(-np.hypot(*trace.u_c_mps2[run].T)[:, None])[0]),
        "hypotheses": dict.fromkeys(asked(trace)) | {b.hypothesis: b.time_s for b in verdicts[run].breaches},
        "decision": {key: _plain(value) for key, value in decision(trace)[run].as_dict().items()},
        "stops": [
            {
                "seed": int(trace.seeds[s.run]),
                "time_s": s.time_s,
                "car": s.car,
                "reason": s.reason,
                "touched": s.touched,
                "crossing": s.crossing,
            }
            for s in trace.stops
        ],
        "duration_s": number(float(ends_s(trace).max())),
        **_end(trace, verdicts),
        **_strays(trace),
        **_own(trace, metrics or {}, run),
    }


def ends_s(trace: Trace) -> Array:
    """When each simulation ended, s, (N,); 0 where it stopped before its first tick."""
    known = ~np.isnan(trace.front_m[:, :, 0, 0])
    last: Array = np.where(known, trace.time_s, 0.0).max(axis=1)
    return last


def _end(trace: Trace, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """What is said of the end of the ego's lane; nothing where it goes on."""
    if trace.edge_distance_m is None:
        return {}
    return {
        "ran_off": [
            {"seed": int(trace.seeds[v.run]), **asdict(v.ran_off)} for v in verdicts if v.ran_off is not None
        ],
        "min_edge_distance_m": number(_least(trace.least_m[:, -1:])[0]),
        "edge_floor_m": trace.scenario.expect.min_edge_distance_m.at_least,
    }


def _strays(trace: Trace) -> dict[str, Any]:
    """How far neighbours stray from their records, in all simulations; nothing where none has one."""
    found = {
        car: {"usual_m": number(one.usual_m), "most_m": number(one.most_m), "within": one.within}
        for car, one in strays(trace).items()
    }
    return {"strays": found} if found else {}


def _own(trace: Trace, values: Mapping[str, Array], run: int) -> dict[str, Any]:
    """What is said of the scenario's own metrics; nothing where it has none."""
    names, bounds = own.names(trace.scenario), trace.scenario.expect.metrics
    if not names:
        return {}
    every = {name: values.get(name, np.full(trace.runs, np.nan)) for name in names}
    found: dict[str, Any] = {"metrics": {name: number(of[run]) for name, of in every.items()}}
    if trace.runs > 1:
        found["metrics_range"] = {
            name: {
                "least": number(_least(of[:, None])[0]),
                "most": number(-_least(-of[:, None])[0]),
                "unknown": int(np.isnan(of).sum()),
            }
            for name, of in every.items()
        }
    if bounds:
        within = {
            name: [own.within(bound, value) for value in every[name].tolist()]
            for name, bound in bounds.items()
        }
        found["metrics_bounds"] = {
            name: {
                **bound.model_dump(),
                "held_runs": sum(within[name]),
                "first_broken_seed": None
                if all(within[name])
                else int(trace.seeds[within[name].index(False)]),
            }
            for name, bound in bounds.items()
        }
        found["metrics_held"] = all(all(of) for of in within.values())
    return found


def ground(
    scenario: Scenario,
    plant: str,
    accepted: Mapping[str, Mapping[str, Any]],
    found: Mapping[str, Any],
    *,
    continuous: bool,
) -> dict[str, Any]:
    """The part of a summary that says what its verdict stands on: the cars, and what is without effect.

    Args:
        scenario: what ran.
        plant: what moved the cars.
        accepted: what is known of each physical model's acceptance tests, as recorded, by its name.
        found: what :func:`summary` found.
        continuous: whether in continuous time.
    """
    idle = told(scenario, plant, continuous=continuous)
    cars = [Acceptance(name, known["state"], tuple(known["failed"])) for name, known in accepted.items()]
    doubts = [car.sentence for car in cars if car.sentence]
    doubts += [sentence(car, one) for car, one in found.get("strays", {}).items() if not one["within"]]
    doubts += [f"the scenario's {key} is without effect: it {why}" for key, why in idle.items()]
    return {"verdict_doubts": doubts, "no_effect": list(idle), "acceptance": dict(accepted)}


def _least(values: Array) -> Array:
    """Minimum over simulations that ignores NaN unless there is nothing else."""
    least: Array = np.where(np.isnan(values), np.inf, values).min(axis=0)
    return np.where(np.isinf(least), np.nan, least)


def number(value: float) -> float | None:
    """A JSON number; JSON has no NaN."""
    return None if math.isnan(value) else float(value)


def _plain(value: float | bool | None) -> float | bool | None:
    """What JSON has: no infinity either, of what was never measured."""
    return value if value is None or math.isfinite(value) else None
