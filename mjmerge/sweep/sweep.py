"""Runs a plan and makes one table of it, a row per run.

A shard is simulated together, judged, reduced to rows and written to disk at once and whole; its trace is
dropped. The table is the same however many processes there were and however often the sweep was killed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmerge.errors import OutputError, WorkerError
from mjmerge.sweep import losses
from mjmerge.sweep.folder import SHARDS, TABLE, claim, identity, place, read, write
from mjmerge.sweep.parts import WHOLE, Part
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.shards import TOGETHER, Shard, shards
from mjmerge.sweep.table import described, joined, table
from mjmerge.sweep.workers import Progress, Rows, Workers, workers

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
    if found is None:
        raise OutputError(f"{folder}: rows that were written there are gone, or damaged; run it again")
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
    begun = {n: (found.num_rows, losses.lost_of(found)) for n, found in _there(plan, folder, mine).items()}
    before = sum(rows for rows, _ in begun.values())
    whole = {shard.number: shard for shard in mine}
    lacking = {number: lost for number, (_, lost) in begun.items() if lost}

    def keep(shard: Shard, rows: Rows, lost: Mapping[int, str]) -> None:
        found = table(plan, sorted(rows), [rows[i] for i in sorted(rows)], lost)
        others = there(plan, folder, whole[shard.number]) if shard.number in lacking else None
        write(found if others is None else joined(plan, [others, found], lost), place(folder, shard))

    team.map(
        [shard for shard in mine if shard.number not in begun],
        keep,
        lambda done: report(before + done, before),
        [whole[number].only(lost) for number, lost in lacking.items()],
    )
    kept = _there(plan, folder, every)  # not before: until then a million rows are on disk alone
    own = [kept[shard.number] for shard in mine if shard.number in kept]
    here = joined(plan, [table(plan, (), ()), *own])
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


def whose(plan: Plan, every: Sequence[Shard]) -> dict[str, Any]:
    """What makes a folder this plan's."""
    return {**identity(plan), "shards": [len(shard.at) for shard in every]}


def there(plan: Plan, folder: Path, shard: Shard) -> pa.Table | None:
    """The rows of a shard that a folder has; ``None`` where there are none, or they are damaged."""
    return read(folder, shard, table(plan, (), ()).schema, lambda at: described(plan, at))


def _there(plan: Plan, folder: Path, some: Sequence[Shard]) -> dict[int, pa.Table]:
    found = {shard.number: there(plan, folder, shard) for shard in some}
    return {number: rows for number, rows in found.items() if rows is not None}
