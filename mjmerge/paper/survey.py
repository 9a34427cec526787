"""How often the decision goes wrong: random merges behind a neighbour that keeps to nothing.

Unlike in :mod:`mjmerge.paper.theorem`, Vehicle 2 owes the ego no room: it flips between a gap that may be too
small and one that may be wide, at random times and as hard as it likes. Everything is a double integrator, so
what goes wrong here is the law's, and not the cars'.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjmerge.errors import ScenarioError
from mjmerge.scenario.load import load
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.verdict.decision import decision

TOGETHER = 40
"""Runs of one random scenario; they differ in when Vehicle 2 flips."""
_DURATION_S = 20.0


@dataclass(frozen=True)
class SurveyCounts:
    """What came of N random runs of one variant of the law.

    Attributes:
        variant: of the law.
        runs: N.
        wrong_sign: runs in which mu was driven up while a condition was false.
        wrong_sign_s: for how long on average where it was, s.
        violated: runs with d_j <= 0 at some time.
        merged: runs that end in lane between the neighbours.
        refusal_memory_s: median over the runs that have one, s.
        abort_s: the same.
    """

    variant: str
    runs: int
    wrong_sign: int
    wrong_sign_s: float
    violated: int
    merged: int
    refusal_memory_s: float
    abort_s: float


def random_scenario(seed: int, variant: str) -> Scenario:
    """A random merge with the paper's gains: where the cars start, and what Vehicle 2 is like."""
    rng = np.random.default_rng(seed)
    while True:
        lane_m, speed = rng.uniform(0.8, 1.8), float(rng.uniform(1.0, 3.0))
        first, other = float(rng.uniform(1.3, 3.5)), float(rng.uniform(0.7, 3.5))
        ego_m = [float(rng.uniform(-first - 1, 1)), float(lane_m)]
        content: dict[str, Any] = {
            "description": "A random merge.",
            "duration_s": _DURATION_S,
            "initial": {
                "ego": {"front_m": ego_m, "speed_mps": speed + float(rng.uniform(-0.5, 0.5))},
                "vehicle_1": {"front_m": [0.0, 0.0], "speed_mps": speed},
                "vehicle_2": {"front_m": [-first, 0.0], "speed_mps": speed},
            },
            "law": {
                "r_rho_m": -float(rng.uniform(0.62, first - 0.62)),
                "r_eta_m": float(lane_m),
                "variant": variant,
            },
            "drivers": {
                "vehicle_1": {"kind": "steady", "speed_mps": speed},
                "vehicle_2": {
                    "kind": "flips",
                    "closed_gap_m": first,
                    "open_gap_m": other,
                    "limit_mps2": float(rng.uniform(1, 8)),
                    "bandwidth_radps": float(rng.uniform(1, 5)),
                },
            },
            "expect": {"min_distance_m": {"at_least": 0.0}},
        }
        try:
            return load(content)
        except ScenarioError:  # cars that overlap at t = 0: draw again
            continue


def survey(
    runs: int, seed: int, variant: str = "literal", progress: Callable[[int], None] | None = None
) -> SurveyCounts:
    """Runs random scenarios and counts; the same seed gives every variant the same merges.

    Args:
        runs: how many, a multiple of ``TOGETHER`` (else rounded up).
        seed: of the first.
        variant: of the law.
        progress: called with the number of runs done.

    Raises:
        ScenarioError: there is no such variant.
    """
    load("paper", [f"law.variant={variant}"])  # a name that is wrong ends it here, and not in a draw
    found, violated, merged = [], 0, 0
    for batch in range(-(-runs // TOGETHER)):
        scenario = random_scenario(seed + batch, variant)
        trace = simulate(scenario, "double_integrator", runs=TOGETHER, seed=(seed + batch) * TOGETHER)
        found += decision(trace)
        violated += int((trace.min_distance_m <= 0).any(axis=1).sum())
        merged += int((np.abs(trace.front_m[:, -1, 0, 1]) < 0.1).sum())
        if progress is not None:
            progress(len(found))
    wrong = [d.wrong_sign_s for d in found if d.wrong_sign_s]
    return SurveyCounts(
        variant=variant,
        runs=len(found),
        wrong_sign=len(wrong),
        wrong_sign_s=float(np.mean(wrong)) if wrong else 0.0,
        violated=violated,
        merged=merged,
        refusal_memory_s=_median([d.refusal_memory_s for d in found]),
        abort_s=_median([d.abort_s for d in found]),
    )


def _median(values: list[float | None]) -> float:
    known = [v for v in values if v is not None]
    return float(np.median(known)) if known else float("nan")
