"""The table of a sweep: a row per run, of what it was and what came of it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from mjmerge.scenario.distinct import SAME
from mjmerge.sweep import losses
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.rows import FLAGS, METRIC, METRICS_HELD, NUMBERS, OF_THE_END, TEXTS, min_d_m
from mjmerge.versions import versions

if TYPE_CHECKING:
    import pyarrow as pa


def table(
    plan: Plan,
    at: Sequence[int],
    measured_rows: Sequence[dict[str, Any]],
    lost: Mapping[int, str] | None = None,
) -> pa.Table:
    """Rows of a plan's table: what each run was, and what came of it; and which runs have none."""
    import pyarrow as pa

    columns = _columns(plan, at)
    for names, kind in ((TEXTS, pa.string()), (NUMBERS, pa.float64()), (FLAGS, pa.bool_())):
        columns |= {name: pa.array([row[name] for row in measured_rows], kind) for name in names}
    own = {min_d_m(j): pa.float64() for j in range(3, plan.neighbours + 1)}
    own |= dict.fromkeys(OF_THE_END, pa.float64()) if plan.ends else {}
    own |= {METRIC + name: pa.float64() for name in plan.metrics}
    own |= {METRICS_HELD: pa.bool_()} if plan.bounds else {}
    columns |= {name: pa.array([row.get(name) for row in measured_rows], kind) for name, kind in own.items()}
    return pa.table(columns, metadata=_told(plan, lost or {}))


def joined(plan: Plan, parts: Sequence[pa.Table], lost: Mapping[int, str] | None = None) -> pa.Table:
    """Rows of a plan's table as one, the same bytes however they were parted.

    Args:
        plan: the plan.
        parts: the rows.
        lost: runs without one, and why; by default those of the parts.
    """
    import pyarrow as pa

    if lost is None:
        lost = {run: why for part in parts for run, why in losses.lost_of(part).items()}
    rows = pa.concat_tables(parts).sort_by("run")
    found: pa.Table = rows.replace_schema_metadata(_told(plan, lost))
    return found


def described(plan: Plan, at: Sequence[int]) -> pa.Table:
    """The columns that say what some runs were."""
    import pyarrow as pa

    return pa.table(_columns(plan, at))


def _told(plan: Plan, lost: Mapping[int, str]) -> dict[str, str]:
    """What a table says of itself."""
    without = {losses.LOST: {str(run): lost[run] for run in sorted(lost)}} if lost else {}
    return {"mjmerge": json.dumps({"campaign": plan.name, "versions": versions()} | without)}


def _columns(plan: Plan, at: Sequence[int]) -> dict[str, pa.Array]:
    """The columns that say what each run was."""
    import pyarrow as pa

    cases = [plan.cases[i] for i in at]
    texts = pa.list_(pa.field("element", pa.string()))  # as it is called when it is read from a file
    columns: dict[str, pa.Array] = {
        "run": pa.array(at, pa.int64()),
        "campaign": pa.array([plan.name] * len(cases), pa.string()),
        SAME: pa.array([plan.same_as[i] for i in at], pa.int64()),
        "scenario": pa.array([plan.labels[c.batch.source] for c in cases], pa.string()),
        "plant": pa.array([c.batch.plant for c in cases], pa.string()),
        "variant": pa.array([c.batch.scenario.law.label for c in cases], pa.string()),
        "mismatch": pa.array([c.point for c in cases], pa.string()),
        "seed": pa.array([c.seed for c in cases], pa.int64()),
        "set": pa.array([list(c.overrides) for c in cases], texts),
    }
    kinds = _kinds(plan)
    for axis in plan.axes:
        values = [_plain(c.value(axis)) for c in cases]
        if kinds[axis] is str:
            values = [v if v is None or isinstance(v, str) else json.dumps(v) for v in values]
            columns[axis] = pa.array(values, pa.string())
        else:
            columns[axis] = pa.array(values, pa.bool_() if kinds[axis] is bool else pa.float64())
    columns["floor_m"] = pa.array(
        [c.batch.scenario.expect.min_distance_m.at_least for c in cases], pa.float64()
    )
    return columns


def _kinds(plan: Plan) -> dict[str, type]:
    """What the values of each axis are, over the whole plan: numbers, flags, or else text."""
    found: dict[str, type] = {}
    for axis in plan.axes:
        kinds = {type(v) for c in plan.cases if (v := _plain(c.value(axis))) is not None}
        if kinds <= {int, float}:
            found[axis] = float
        else:
            found[axis] = bool if kinds == {bool} else str
    return found


def _plain(value: Any) -> Any:
    """A value as JSON has it."""
    return value.model_dump(mode="json") if hasattr(value, "model_dump") else value
