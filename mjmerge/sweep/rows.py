"""What a sweep keeps of a run: one row of numbers, after which its trace may go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mjmerge.config.acts import BODIES
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array
from mjmerge.verdict import own
from mjmerge.verdict.decision import decision
from mjmerge.verdict.hypotheses import its_own
from mjmerge.verdict.judge import VACUOUS, Verdict
from mjmerge.verdict.metrics import (
    clear_ticks_without_margin,
    merged_at_s,
    peak_u_mps2,
    rms_jerk_mps3,
    saturated,
    touching_ticks_in_margin,
)

PASSED, EMPTY, FAILED = "passed", "vacuous", "failed"
"""How a run counts: one without data, that ended early, or whose own metrics are out of their bounds, has
failed; nothing tested a vacuous one."""

TOUCHES, MARGIN, OFF, ENDED, BELOW = (
    "bodies touch", "d_j falls to 0", "runs off the road", "ends early", "below a floor",
)  # fmt: skip
"""What broke in a run that failed, in figures."""

NUMBERS = (
    "min_distance_m",
    "min_d_1_m",
    "min_d_2_m",
    "t_min_distance_s",
    "min_clearance_m",
    "without_barrier_m",
    "contact_impulse_n_s",
    "contact_speed_mps",
    "first_contact_s",
    "touching_in_margin_s",
    "clear_without_margin_s",
    "unsafe_at_s",
    "broken_at_s",
    "stopped_at_s",
    "merged_at_s",
    "saturated_s",
    "wrong_sign_s",
    "refusal_memory_s",
    "abort_s",
    "straddling_s",
    "least_z",
    "peak_u_mps2",
    "rms_jerk_mps3",
    "own_broken_s",
    "physics_step_s",
)
"""Columns that are numbers, or null where there is none; contacts are those of the ego.

For so long bodies touched though d_j > 0, or stayed clear though d_j <= 0, all neighbours together. For
``own_broken_s`` some hypothesis that is asked of this law alone was broken, such as that its programme can be
met, or that its loop stands the dead time.
"""
TEXTS = ("outcome", "verdict", "first_broken", "stopped")
"""Columns that are text; ``first_broken`` is the hypothesis that the verdict names: of an unsafe run, the
first that was still broken, or broke, in the approach; of a safe one, the first of all."""
FLAGS = ("floor_held", "needed", "underflow")
"""Columns that are true or false, or null; ``needed`` is whether the run is safe because of the barrier."""


def min_d_m(j: int) -> str:
    """Column of the smallest d_j of a neighbour, the first is 1; the first two are in ``NUMBERS``."""
    return f"min_d_{j}_m"


def broke(row: Mapping[str, Any]) -> str:
    """What broke in a run that failed: bodies, margin, or what else."""
    if row["first_contact_s"] is not None:
        return TOUCHES
    least_m, edge_m = row["min_distance_m"], row.get("min_edge_distance_m")
    if edge_m is not None and edge_m <= 0:
        return OFF
    if least_m is not None and least_m <= 0:
        return MARGIN
    return BELOW if row["stopped"] is None else ENDED


METRIC = "metric."
"""Before the name of a metric of a scenario's own: a column of its numbers."""
METRICS_HELD = "metrics_held"
"""Column that says whether these were within the bounds of their scenario; null where it has none."""

OF_THE_END = ("min_edge_distance_m", "ran_off_at_s")
"""Columns of campaigns in which the ego's lane ends: least distance of its body from the edge there, and when
it was over it first."""
Row = dict[str, float | str | bool | None]


Rows = list[dict[str, Any]]
"""Rows of a table, by column."""


def rows(trace: Trace, verdicts: Sequence[Verdict], metrics: Mapping[str, Array] | None = None) -> list[Row]:
    """One row for every simulation of a trace, with the columns ``NUMBERS``, ``TEXTS`` and ``FLAGS``.

    And one for each neighbour from the third on, and each metric of the scenario's own, by name, (N,).
    """
    bounds, metrics = trace.scenario.expect.metrics, metrics or {}
    least_m, edge_m = trace.min_distance_m, None if trace.edge_distance_m is None else trace.least_m[:, -1]
    least = least_m.min(axis=1)  # NaN where any is unknown
    d = np.where(np.isnan(trace.distance_m), np.inf, trace.distance_m).min(axis=2)
    closest_s = trace.time_s[np.argmin(d, axis=1)]
    neighbours = len(trace.roster.neighbours)
    clearance = trace.min_clearance_m[:, :neighbours].min(axis=1)
    merged = merged_at_s(trace)
    busy_s = saturated(trace)[:, :, 0].sum(axis=1) * trace.scenario.control_step_s
    impulse, speed, first = _contacts(trace)
    step_s = trace.scenario.control_step_s
    bodies = ~np.isnan(clearance)
    touching_s = np.where(bodies, touching_ticks_in_margin(trace).sum(axis=1) * step_s, np.nan)
    clear_s = np.where(bodies, clear_ticks_without_margin(trace).sum(axis=1) * step_s, np.nan)
    peak, jerk, own_s = peak_u_mps2(trace), rms_jerk_mps3(trace), _own_broken_s(trace)
    stops = {stop.run: stop for stop in trace.stops}
    found: list[Row] = []
    for i, (verdict, decided) in enumerate(zip(verdicts, decision(trace), strict=True)):
        broken = verdict.matters
        stop = stops.get(i)
        row: Row = {
            "outcome": outcome(verdict),
            "verdict": verdict.verdict,
            "floor_held": verdict.floor_held,
            "needed": verdict.needed,
            "without_barrier_m": verdict.without_barrier_m,
            "min_distance_m": _known(least[i]),
            **{min_d_m(j): _known(d_j) for j, d_j in enumerate(least_m[i], 1)},
            "t_min_distance_s": _known(closest_s[i] if np.isfinite(least[i]) else np.nan),
            "min_clearance_m": _known(clearance[i]),
            "contact_impulse_n_s": _known(impulse[i]),
            "contact_speed_mps": _known(speed[i]),
            "first_contact_s": _known(first[i]),
            "touching_in_margin_s": _known(touching_s[i]),
            "clear_without_margin_s": _known(clear_s[i]),
            "unsafe_at_s": verdict.unsafe_at_s,
            "first_broken": broken.hypothesis if broken else None,
            "broken_at_s": broken.time_s if broken else None,
            "stopped": f"{stop.car}: {stop.reason}" if stop else None,
            "stopped_at_s": stop.time_s if stop else None,
            "merged_at_s": _known(merged[i]),
            "saturated_s": float(busy_s[i]),
            **decided.as_dict(),
            "peak_u_mps2": _known(peak[i]),
            "rms_jerk_mps3": _known(jerk[i]),
            "own_broken_s": _known(own_s[i]),
            "physics_step_s": trace.scenario.physics_step_s if trace.plant in BODIES else None,
        }
        if decided.least_z is None or not np.isfinite(decided.least_z):
            row["least_z"] = None
        if edge_m is not None:
            off_s = None if verdict.ran_off is None else verdict.ran_off.time_s
            row |= dict(zip(OF_THE_END, (_known(edge_m[i]), off_s), strict=True))
        row |= {METRIC + name: _known(of[i]) for name, of in metrics.items()}
        if bounds:
            row[METRICS_HELD] = own.held(bounds, metrics, i)
            row["outcome"] = row["outcome"] if row[METRICS_HELD] else FAILED
        found.append(row)
    return found


def _own_broken_s(trace: Trace) -> Array:
    """For how long some hypothesis of the law's own was broken, s, (N,); NaN where it has none."""
    marks = [one.marks(trace) for one in its_own(trace).values()]
    if not marks:
        return np.full(trace.runs, np.nan)
    broken: Array = np.any(marks, axis=0).sum(axis=1) * trace.scenario.control_step_s
    return broken


def outcome(verdict: Verdict) -> str:
    """How a run counts, one of ``PASSED``, ``EMPTY`` and ``FAILED``."""
    if not verdict.floor_held:
        return FAILED
    return EMPTY if verdict.verdict == VACUOUS else PASSED


def _contacts(trace: Trace) -> tuple[Array, Array, Array]:
    """Of the ego with any neighbour: impulse, N s; fastest approach, m/s; first time, s; each (N,)."""
    neighbours = len(trace.roster.neighbours)
    impulse = trace.contact_impulse_n_s[:, :, :neighbours]
    known: Any = ~np.isnan(impulse).all(axis=(1, 2))
    speed = np.nan_to_num(trace.contact_speed_mps[:, :, :neighbours]).max(axis=(1, 2))
    touching = np.any(trace.touching_ego, axis=2)
    first = np.where(touching.any(axis=1), trace.time_s[np.argmax(touching, axis=1)], np.nan)
    return (
        np.where(known, np.nansum(impulse, axis=(1, 2)), np.nan),
        np.where(touching.any(axis=1), speed, np.nan),
        first,
    )


def _known(value: float) -> float | None:
    """A number, or ``None`` for NaN: in a table, what is not known is missing."""
    return None if np.isnan(value) else float(value)


def groups(rows: Rows, keys: Sequence[str] = ("scenario", "plant", "variant")) -> dict[tuple[Any, ...], Rows]:
    """Rows by the values of some columns, in the order they come up."""
    found: dict[tuple[Any, ...], Rows] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found
