"""What a sweep came to, in numbers: failure rates with intervals, margins, the worst runs, their commands."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.scenario.distinct import distinct
from mjmerge.scenario.effect import told
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.sweep import losses
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.rows import EMPTY, FAILED, METRIC, PASSED, Rows, groups
from mjmerge.sweep.statistics import CONFIDENCE, Rate, clopper_pearson
from mjmerge.verdict import own
from mjmerge.versions import versions

if TYPE_CHECKING:
    import pyarrow as pa

WORST = 10
"""Runs that the report shows the command of."""


def failure_rate(rows: Rows) -> Rate:
    """How many failed, of those that were not vacuous; of copies of a run, one counts."""
    counts = Counter(row["outcome"] for row in distinct(rows))
    return clopper_pearson(counts[FAILED], counts[FAILED] + counts[PASSED])


def summary(plan: Plan, table: pa.Table) -> dict[str, Any]:
    """What ``--json`` prints of a sweep."""
    rows: Rows = table.to_pylist()
    return {
        "campaign": plan.name,
        "runs": len(rows),
        "distinct": len(distinct(rows)),
        "left_out": {why: list(axes) for why, axes in plan.left_out.items()},
        "outcomes": {name: sum(row["outcome"] == name for row in rows) for name in (PASSED, EMPTY, FAILED)},
        "failure_rate": as_json(failure_rate(rows)),
        "groups": [
            dict(zip(("scenario", "plant", "variant"), key, strict=True))
            | {
                "runs": len(group),
                "distinct": len(distinct(group)),
                "no_effect": list(_idle(plan, group)),
                "vacuous": vacuous_runs(group),
                "failure_rate": as_json(failure_rate(group)),
                "min_distance_m": least_m(group),
                **({"metrics": own_metrics(plan, group)} if plan.metrics else {}),
            }
            for key, group in groups(rows).items()
        ],
        "physics_step_s": dict(sorted(Counter(f"{row['physics_step_s']}" for row in rows).items())),
        "lost": losses.as_json(plan, losses.lost_of(table)),
        "stopped": sum(row["stopped"] is not None for row in rows),
        "touching_with_margin": len(runs_with("touching_in_margin_s", distinct(rows))),
        "clear_without_margin": len(runs_with("clear_without_margin_s", distinct(rows))),
        "worst": [
            {
                "run": row["run"],
                "min_distance_m": row["min_distance_m"],
                "verdict": row["verdict"],
                "command": command(plan, row),
            }
            for row in worst(rows)
        ],
        "versions": versions(),
    }


def notes(plan: Plan, table: pa.Table) -> list[str]:
    """What a reader of the rates has to know, a line each: keys set, copies, axes left out, keys in vain."""
    rows: Rows = table.to_pylist()
    found = [*_set(plan, rows), *losses.lines(plan, losses.lost_of(table))]
    copies = len(rows) - len(distinct(rows))
    if copies:
        found.append(
            f"{copies} of {len(rows)} runs are copies of others (the same scenario, plant and mismatch, with "
            "the same seed, or where nothing is random): each run counts once"
        )
    found += _steps(plan, rows)
    found += [f"left out of the levels: {', '.join(axes)} ({why})" for why, axes in plan.left_out.items()]
    for (scenario, _), group in groups(rows, ("scenario", "plant")).items():
        idle = _idle(plan, group)
        found += [f"the {key} of {scenario} is without effect: it {why}" for key, why in idle.items()]
    return found


def _set(plan: Plan, rows: Rows) -> Iterator[str]:
    """What the blocks set in all their runs, as far as it acts there; in which runs, if not in all."""

    def names(key: str, of: Rows) -> str:
        return ", ".join(dict.fromkeys(row[key] for row in of))

    by: dict[tuple[str, ...], Rows] = {}
    for row in rows:
        by.setdefault(plan.cases[row["run"]].of_block, []).append(row)
    for said, of in by.items():
        some = [names(k, of) for k in ("scenario", "plant", "variant") if names(k, of) != names(k, rows)]
        only = f" in {len(of)} of {len(rows)} runs" if len(by) > 1 else ""
        which = f" ({'; '.join(some)})" if some else ""
        if said:
            yield f"set{only}{which}: {', '.join(said)}"


def _steps(plan: Plan, rows: Rows) -> list[str]:
    """How many runs were near a decision, and so run again, if larger steps of the physics came first."""
    asked = [row for row in rows if plan.cases[row["run"]].batch.begun is not None]
    if not asked:
        return []
    fidelity = plan.cases[asked[0]["run"]].batch.fidelity
    assert fidelity is not None, "what begins with larger steps was asked to"
    again = sum(row["physics_step_s"] != fidelity.step_s for row in asked)
    return [
        f"{len(asked)} runs were made in steps of {1e3 * fidelity.step_s:g} ms; {again} of them came within "
        f"{fidelity.within_r:g} r of a decision and were made again at their scenario's own (physics_step_s)"
    ]


def _idle(plan: Plan, rows: Rows) -> dict[str, str]:
    """What the scenario of some rows says itself and is without effect in all of them, and why."""
    cases = [plan.cases[row["run"]] for row in rows]
    seen: dict[tuple[int, Mismatch], dict[str, str]] = {}
    for case in cases:
        key = id(case.batch), case.mismatch
        if key not in seen:
            here = case.batch.scenario.model_copy(update={"mismatch": case.mismatch})
            seen[key] = told(here, case.batch.plant, continuous=case.batch.continuous)
    every = list(seen.values())
    return {key: why for key, why in every[0].items() if all(key in other for other in every)}


def vacuous_runs(rows: Rows) -> int:
    """How many of the distinct runs nothing put to the test."""
    return sum(row["outcome"] == EMPTY for row in distinct(rows))


def worst(rows: Rows) -> Rows:
    """The runs that came closest, of copies one; one without data is worse than any other."""

    def margin(row: dict[str, Any]) -> float:
        return -np.inf if row["min_distance_m"] is None else float(row["min_distance_m"])

    return sorted(distinct(rows), key=margin)[:WORST]


def command(plan: Plan, row: Mapping[str, Any]) -> str:
    """The command that gives this run alone, bit for bit, and records it."""
    return shlex.join(("mjmerge", *plan.cases[row["run"]].command_at(row["physics_step_s"])))


def as_json(rate: Rate) -> dict[str, Any]:
    """A rate and its interval."""
    return {
        "failed": rate.count,
        "of": rate.of,
        "rate": rate.value,
        "low": rate.low,
        "high": rate.high,
        "confidence": CONFIDENCE,
    }


def least_m(rows: Rows) -> float | None:
    """The least distance of all, m; ``None`` where none is known."""
    known = [row["min_distance_m"] for row in rows if row["min_distance_m"] is not None]
    return min(known, default=None)


def runs_with(column: str, rows: Rows) -> Rows:
    """Rows in which a duration is more than none."""
    return [row for row in rows if row[column]]


def own_metrics(plan: Plan, rows: Rows) -> dict[str, dict[str, float | int | None]]:
    """Range and middle of each own metric over distinct runs, and in how many it is not known; by name."""
    found: dict[str, dict[str, float | int | None]] = {}
    for name in plan.metrics:
        of = [row for row in distinct(rows) if name in own.names(plan.cases[row["run"]].batch.scenario)]
        known = [row[METRIC + name] for row in of if row[METRIC + name] is not None]
        if of:
            middle = float(np.median(known)) if known else None
            least, most = min(known, default=None), max(known, default=None)
            found[name] = {"least": least, "median": middle, "most": most, "unknown": len(of) - len(known)}
    return found
