"""Runs a plan and makes one table of it, a row per run.

A shard is simulated together, judged, reduced to rows and written to disk at once and whole; its trace is
dropped. The table is the same however many processes there were and however often the sweep was killed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmerge.scenario.distinct import SAME
from mjmerge.sweep.folder import SHARDS, TABLE, claim, identity, place, read, write
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.rows import FLAGS, METRIC, METRICS_HELD, NUMBERS, OF_THE_END, TEXTS, min_d_m
from mjmerge.sweep.workers import TOGETHER, Progress, Shard, Workers, shards, workers
from mjmerge.versions import versions

if TYPE_CHECKING:
    import pyarrow as pa


def measured(plan: Plan, team: Workers, progress: Progress | None = None) -> pa.Table:
    """The table of a plan, without anything left on disk; see :func:`sweep`."""
    found: dict[int, dict[str, Any]] = {}

    def keep(shard: Shard, rows: list[dict[str, Any]]) -> None:
        found.update(zip(shard.at, rows, strict=True))

    team.map(shards(plan), keep, progress or (lambda _: None))
    return table(plan, range(len(plan.cases)), [found[i] for i in range(len(plan.cases))])


def sweep(
    plan: Plan,
    folder: Path,
    *,
    processes: int = 1,
    together: int = TOGETHER,
    progress: Callable[[float, int], None] | None = None,
) -> pa.Table:
    """Runs what of a plan is not yet in a folder, and leaves its table there.

    Args:
        plan: the runs.
        folder: where the rows are kept; an unfinished sweep of the same plan goes on.
        processes: how many to spread over.
        together: runs of a shard, at most; more take more memory.
        progress: called now and then with the number of runs done and how many of them were there before.

    Returns:
        One row per run, in the order of the plan.

    Raises:
        OutputError: the folder cannot be written, or holds something else.
        MjmergeError: a process died.
    """
    import pyarrow as pa

    report = progress or (lambda _, __: None)
    todo = shards(plan, together)
    claim(folder, {**identity(plan), "shards": [len(shard.at) for shard in todo]})
    parts: dict[int, pa.Table] = {}
    schema = table(plan, (), ()).schema
    for shard in todo:
        there = read(folder, shard, schema, pa.table(_described(plan, shard.at)))
        if there is not None:
            parts[shard.number] = there
    before = sum(part.num_rows for part in parts.values())

    def keep(shard: Shard, rows: list[dict[str, Any]]) -> None:
        parts[shard.number] = table(plan, shard.at, rows)
        write(parts[shard.number], place(folder, shard))

    with workers(min(processes, len(todo))) as team:
        team.map(
            [shard for shard in todo if shard.number not in parts],
            keep,
            lambda done: report(before + done, before),
        )
    found: pa.Table = pa.concat_tables(parts.values()).sort_by("run")
    write(found, folder / TABLE)
    for left in (folder / SHARDS).glob("*.partial"):
        with suppress(OSError):
            left.unlink()
    return found


def table(plan: Plan, at: Sequence[int], measured_rows: Sequence[dict[str, Any]]) -> pa.Table:
    """Rows of a plan's table: what each run was, and what came of it."""
    import pyarrow as pa

    columns = _described(plan, at)
    for names, kind in ((TEXTS, pa.string()), (NUMBERS, pa.float64()), (FLAGS, pa.bool_())):
        columns |= {name: pa.array([row[name] for row in measured_rows], kind) for name in names}
    own = {min_d_m(j): pa.float64() for j in range(3, plan.neighbours + 1)}
    own |= dict.fromkeys(OF_THE_END, pa.float64()) if plan.ends else {}
    own |= {METRIC + name: pa.float64() for name in plan.metrics}
    own |= {METRICS_HELD: pa.bool_()} if plan.bounds else {}
    columns |= {name: pa.array([row.get(name) for row in measured_rows], kind) for name, kind in own.items()}
    told = {"mjmerge": json.dumps({"campaign": plan.name, "versions": versions()})}
    return pa.table(columns, metadata=told)


def _described(plan: Plan, at: Sequence[int]) -> dict[str, pa.Array]:
    """The columns that say what each run was."""
    import pyarrow as pa

    cases = [plan.cases[i] for i in at]
    columns: dict[str, pa.Array] = {
        "run": pa.array(at, pa.int64()),
        "campaign": pa.array([plan.name] * len(cases), pa.string()),
        SAME: pa.array([plan.same_as[i] for i in at], pa.int64()),
        "scenario": pa.array([plan.labels[c.batch.source] for c in cases], pa.string()),
        "plant": pa.array([c.batch.plant for c in cases], pa.string()),
        "variant": pa.array([c.batch.scenario.law.label for c in cases], pa.string()),
        "mismatch": pa.array([c.point for c in cases], pa.string()),
        "seed": pa.array([c.seed for c in cases], pa.int64()),
        "set": pa.array([list(c.overrides) for c in cases], pa.list_(pa.string())),
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
