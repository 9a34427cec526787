"""The cases of the regression gate, what is measured of each, and what it must keep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

import mjmerge

FLOORS_M = {
    ("paper", "double_integrator", ""): 0.12,
    ("paper", "bicycle", ""): 0.12,
    ("paper", "mujoco", ""): 0.12,
    ("paper", "mujoco", "mismatch.friction=0.6"): 0.12,
    ("paper", "mujoco", "mismatch.friction=0.3"): 0.12,
    ("paper", "mujoco", "mismatch.command_delay_s=0.05"): 0.12,
    ("paper", "mujoco", "mismatch.command_delay_s=0.1"): 0.12,
    ("charge", "double_integrator", ""): 0.19,
    ("charge", "bicycle", ""): 0.19,
    ("charge", "mujoco", ""): 0.19,
    ("charge", "mujoco", "mismatch.friction=0.8"): 0.17,
    ("charge", "mujoco", "mismatch.friction=0.7"): 0.12,
    ("charge", "mujoco", "mismatch.command_delay_s=0.05"): 0.19,
    ("charge", "mujoco", "mismatch.command_delay_s=0.1"): 0.19,
}
"""Safety floor on min over t of d_1 and d_2, m. One-sided, set by hand, never regenerated."""

RATE_DEFECT_MPS = 0.1
"""The recorded d_j' must be the rate of the recorded d_j to within this much."""


@dataclass(frozen=True)
class Measured:
    """What is kept of one run, m and m/s."""

    min_d_1_m: float
    min_d_2_m: float
    min_clearance_m: float
    rate_defect_mps: float
    safe: bool


def measure(scenario: str, plant: str, mismatch: str, *more: str) -> Measured:
    """Runs a case."""
    overrides = [*mismatch.split(), *more]
    trace = mjmerge.simulate(mjmerge.load(scenario, overrides), plant)
    (verdict,) = mjmerge.judge(trace)
    d, rate = trace.distance_m[0], trace.distance_rate_mps[0]
    defect = np.diff(d, axis=0) / trace.scenario.control_step_s - (rate[1:] + rate[:-1]) / 2
    return Measured(
        *trace.min_distance_m[0].tolist(),
        trace.min_clearance_m[0, :2].min(),
        float(np.abs(defect).max()),
        verdict.unsafe_at_s is None and not trace.stops,
    )


measured = cache(measure)
"""The same, once per session."""


def problems(found: Measured, floor_m: float) -> Iterator[str]:
    """Why a case fails the gate; nothing if it passes."""
    for j, least in ((1, found.min_d_1_m), (2, found.min_d_2_m)):
        if not least >= floor_m:  # NaN fails
            yield f"min d_{j} is {least:.4f} m, below the floor of {floor_m} m"
    if not found.safe:
        yield "unsafe: d_j <= 0, bodies in contact, or a run that stopped"
    if not found.rate_defect_mps < RATE_DEFECT_MPS:
        yield f"d_j' is off the rate of d_j by {found.rate_defect_mps:.3f} m/s: is the sign of g_j right?"


def baseline(scenario: str) -> dict[str, list[str | float]]:
    """The columns of a scenario's baseline, a row per case."""
    cases = [case for case in FLOORS_M if case[0] == scenario]
    rows = [measured(*case) for case in cases]
    return {
        "plant": [plant for _, plant, _ in cases],
        "mismatch": [mismatch or "none" for _, _, mismatch in cases],
        "mujoco": [mujoco.__version__ if plant == "mujoco" else "-" for _, plant, _ in cases],
        "min_d_1_m": [row.min_d_1_m for row in rows],
        "min_d_2_m": [row.min_d_2_m for row in rows],
        "min_clearance_m": [row.min_clearance_m for row in rows],
    }
