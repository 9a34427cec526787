"""Runs a plan and makes one table of it, a row per run.

A shard is simulated together, judged, reduced to rows and written to disk at once and whole; its trace is
dropped. The table is the same however many processes there were and however often the sweep was killed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmerge.errors import WorkerError
from mjmerge.scenario.distinct import SAME
from mjmerge.sweep import losses
from mjmerge.sweep.folder import SHARDS, TABLE, claim, identity, place, read, write
from mjmerge.sweep.parts import WHOLE, Part
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.rows import FLAGS, METRIC, METRICS_HELD, NUMBERS, OF_THE_END, TEXTS, min_d_m
from mjmerge.sweep.shards import TOGETHER, Shard, shards
from mjmerge.sweep.workers import Progress, Rows, Workers, workers
from mjmerge.versions import versions

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Standing:
    """How far a sweep is.

    Attributes:
        table: one row per run, in the order of the plan; ``None`` where others have not done their part.
        mine: the rows of the part that was done.
        missing: shards that are another part's, and not there yet.
        lost: runs that have no row, as they kill who works on them, and what was seen of each.
    """

    table: pa.Table | None
    mine: pa.Table
    missing: tuple[Shard, ...]
    lost: Mapping[int, str]


def measured(plan: Plan, team: Workers, progress: Progress | None = None) -> pa.Table:
    """The table of a plan, without anything left on disk; see :func:`sweep`.

    Raises:
        WorkerError: a run kills who works on it; or there are no workers any more.
    """
    found: Rows = {}
    lost: dict[int, str] = {}

    def keep(_: Shard, rows: Rows, without: Mapping[int, str]) -> None:
        found.update(rows)
        lost.update(without)

    team.map(shards(plan), keep, progress or (lambda _: None))
    if lost:
        raise WorkerError("\n".join(losses.lines(plan, lost)))
    return table(plan, range(len(plan.cases)), [found[i] for i in range(len(plan.cases))])


def sweep(
    plan: Plan,
    folder: Path,
    *,
    processes: int = 1,
    team: Workers | None = None,
    together: int = TOGETHER,
    progress: Callable[[float, int], None] | None = None,
) -> pa.Table:
    """Runs what of a plan is not yet in a folder, and leaves its table there.

    Args:
        plan: the runs.
        folder: where the rows are kept; an unfinished sweep of the same plan goes on.
        processes: how many to spread over.
        team: who does it, in place of processes; it stays its owner's.
        together: runs of a shard, at most; more take more memory.
        progress: called now and then with the number of runs done and how many of them were there before.

    Returns:
        One row per run, in the order of the plan, but for runs that kill who works on them
        (:func:`mjmerge.sweep.losses.lost_of`).

    Raises:
        OutputError: the folder cannot be written, or holds something else.
        WorkerError: there are no workers any more; or no run has a row.
    """
    with nullcontext(team) if team is not None else workers(min(processes, len(plan.cases))) as who:
        found = do_part(plan, folder, WHOLE, who, together=together, progress=progress).table
    assert found is not None, "nothing is left to others"
    return found


def do_part(
    plan: Plan,
    folder: Path,
    part: Part,
    team: Workers,
    *,
    together: int = TOGETHER,
    progress: Callable[[float, int], None] | None = None,
) -> Standing:
    """Runs what of one part of a plan is not yet in a folder; if all parts are there, leaves their table.

    Args:
        plan: the runs, the same for all parts.
        folder: where the rows are kept, of all parts.
        part: which shards.
        team: who does it.
        together: see :func:`sweep`.
        progress: likewise, of the runs of this part.

    Raises:
        OutputError: the folder cannot be written, or holds something else.
        WorkerError: there are no workers any more; or no run has a row.
    """
    report = progress or (lambda _, __: None)
    every = shards(plan, together)
    mine = part.among(every)
    claim(folder, whose(plan, every))
    kept = _there(plan, folder, mine)
    before = sum(found.num_rows for found in kept.values())

    def keep(shard: Shard, rows: Rows, lost: Mapping[int, str]) -> None:
        found = table(plan, sorted(rows), [rows[i] for i in sorted(rows)], lost)
        if shard.number in kept:  # the others of it were there
            found = joined(plan, [kept[shard.number], found], lost)
        kept[shard.number] = found
        write(found, place(folder, shard))

    lacking = {number: found for number, found in kept.items() if losses.lost_of(found)}
    team.map(
        [shard for shard in mine if shard.number not in kept],
        keep,
        lambda done: report(before + done, before),
        [shard.only(losses.lost_of(lacking[shard.number])) for shard in mine if shard.number in lacking],
    )
    here = joined(plan, [table(plan, (), ()), *(kept[shard.number] for shard in mine)])
    kept |= _there(plan, folder, [shard for shard in every if shard.number not in kept])
    missing = tuple(shard for shard in every if shard.number not in kept)
    found = None if missing else gathered(plan, folder, [kept[shard.number] for shard in every])
    return Standing(found, here, missing, losses.lost_of(here if found is None else found))


def gathered(plan: Plan, folder: Path, parts: Sequence[pa.Table]) -> pa.Table:
    """The table of all shards, which it leaves in the folder.

    Raises:
        OutputError: it cannot be written.
        WorkerError: no run has a row.
    """
    found = joined(plan, parts)
    lost = losses.lost_of(found)
    if not found.num_rows:
        raise WorkerError("\n".join(losses.lines(plan, lost)))
    write(found, folder / TABLE)
    for left in (*folder.glob("*.partial"), *(folder / SHARDS).glob("*.partial")):
        with suppress(OSError):
            left.unlink()
    return found


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
    schema = table(plan, (), ()).schema.remove_metadata()  # what is read from a file has remarks in its own
    rows = pa.concat_tables(part.cast(schema) for part in parts)
    found: pa.Table = rows.sort_by("run").combine_chunks().replace_schema_metadata(_told(plan, lost))
    return found


def whose(plan: Plan, every: Sequence[Shard]) -> dict[str, Any]:
    """What makes a folder this plan's."""
    return {**identity(plan), "shards": [len(shard.at) for shard in every]}


def there(plan: Plan, folder: Path, shard: Shard) -> pa.Table | None:
    """The rows of a shard that a folder has; ``None`` where there are none, or they are damaged."""
    import pyarrow as pa

    return read(folder, shard, table(plan, (), ()).schema, lambda at: pa.table(_described(plan, at)))


def _there(plan: Plan, folder: Path, some: Sequence[Shard]) -> dict[int, pa.Table]:
    found = {shard.number: there(plan, folder, shard) for shard in some}
    return {number: rows for number, rows in found.items() if rows is not None}


def table(
    plan: Plan,
    at: Sequence[int],
    measured_rows: Sequence[dict[str, Any]],
    lost: Mapping[int, str] | None = None,
) -> pa.Table:
    """Rows of a plan's table: what each run was, and what came of it; and which runs have none."""
    import pyarrow as pa

    columns = _described(plan, at)
    for names, kind in ((TEXTS, pa.string()), (NUMBERS, pa.float64()), (FLAGS, pa.bool_())):
        columns |= {name: pa.array([row[name] for row in measured_rows], kind) for name in names}
    own = {min_d_m(j): pa.float64() for j in range(3, plan.neighbours + 1)}
    own |= dict.fromkeys(OF_THE_END, pa.float64()) if plan.ends else {}
    own |= {METRIC + name: pa.float64() for name in plan.metrics}
    own |= {METRICS_HELD: pa.bool_()} if plan.bounds else {}
    columns |= {name: pa.array([row.get(name) for row in measured_rows], kind) for name, kind in own.items()}
    return pa.table(columns, metadata=_told(plan, lost or {}))


def _told(plan: Plan, lost: Mapping[int, str]) -> dict[str, str]:
    """What a table says of itself."""
    without = {losses.LOST: {str(run): lost[run] for run in sorted(lost)}} if lost else {}
    return {"mjmerge": json.dumps({"campaign": plan.name, "versions": versions()} | without)}


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
        "set": pa.array([list(c.overrides) for c in cases], pa.list_(pa.field("element", pa.string()))),
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
