"""Larger steps of the physics where they are enough: what is near a decision is run again at its own.

A verdict hangs on where distances are from 0, from the scenario's floor and from r, and on how much further
away the barrier kept the ego. With larger steps a distance comes out a little different, and a decision that
it is further away from than that is the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from mjmerge.config.frozen import Frozen
from mjmerge.scenario.schema import Scenario
from mjmerge.state import G_MPS2
from mjmerge.verdict.judge import NEEDED

UNDECIDED = ("incomplete", "unresolved", "refuted")
"""Verdicts that are never those of larger steps."""


class Fidelity(Frozen):
    """Runs on MuJoCo are made with larger steps first, and again at their own where a decision is near."""

    step_s: Annotated[float, Field(gt=0)] = 0.002
    """Step of the physics that is enough elsewhere, s; scenarios whose own is no smaller keep theirs."""
    within_r: Annotated[float, Field(gt=0, le=1)]
    """What is near: a distance that is no further than this part of r from where a verdict changes."""


def coarse(scenario: Scenario, plant: str, step_s: float | None) -> Scenario:
    """The same with larger steps of the physics, where it has any."""
    if step_s is None or plant != "mujoco" or step_s <= scenario.physics_step_s:
        return scenario
    if abs(round(scenario.control_step_s / step_s) * step_s - scenario.control_step_s) > 1e-12:
        return scenario
    return scenario.model_copy(update={"physics_step_s": step_s})


def first(scenario: Scenario, plant: str, fidelity: Fidelity | None) -> Scenario:
    """The scenario as its runs are made first; those with bounds on metrics of their own as they are.

    Nobody knows how near to a bound a metric from outside is with larger steps.
    """
    if fidelity is None or scenario.expect.metrics:
        return scenario
    return coarse(scenario, plant, fidelity.step_s)


def near(row: Mapping[str, Any], scenario: Scenario, within_r: float) -> bool:
    """Whether a run's outcome or verdict could be another with smaller steps.

    Args:
        row: of its table.
        scenario: what ran.
        within_r: see :class:`Fidelity`.
    """
    if row["stopped"] is not None or row["verdict"] in UNDECIDED:
        return True
    r_m, floor_m = scenario.r_m, scenario.expect.min_distance_m.at_least
    within_m = within_r * r_m
    distances = [row[name] for name in row if name.startswith("min_d_")]
    edges = [row["min_edge_distance_m"]] if "min_edge_distance_m" in row else []
    at_edge = {0.0, scenario.expect.min_edge_distance_m.at_least, r_m}
    least_m = min((d for d in distances if d is not None), default=None)
    if least_m is None or least_m <= -within_m:  # one is unsafe whatever becomes of the others
        return least_m is None
    asked = [(least_m, {floor_m}), *((edge, at_edge) for edge in edges)]
    if not _hit(row, within_m):
        kept_m, without_m = min([least_m, *(e for e in edges if e is not None)]), row["without_barrier_m"]
        asked += [(least_m, {0.0, r_m}), (row["min_clearance_m"], {0.0})]
        if without_m is not None and without_m > 0:
            asked += [(kept_m - without_m, {NEEDED * r_m})]
        elif without_m is not None and kept_m >= r_m:
            return True  # an ideal with the barrier decides, which no row has
    return any(m is not None and abs(m - at) <= within_m for m, those in asked for at in those)


def _hit(row: Mapping[str, Any], within_m: float) -> bool:
    """Whether bodies met so fast that with so much more room they would have, too: no car brakes at 1 g."""
    speed_mps, clearance_m = row["contact_speed_mps"], row["min_clearance_m"]
    there = speed_mps is not None and clearance_m is not None and clearance_m <= 0
    return there and speed_mps**2 > 2 * G_MPS2 * within_m
