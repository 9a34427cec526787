"""What ``mjmerge sweep`` does with a campaign: all of it, a part of it, or parts made one."""

from __future__ import annotations

import json
import sys
from collections.abc import Collection
from contextlib import AbstractContextManager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from mjmerge.cli.progress import runs_bar
from mjmerge.cli.style import bold

if TYPE_CHECKING:
    import pyarrow as pa

    from mjmerge.sweep.parts import Part
    from mjmerge.sweep.plan import Plan
    from mjmerge.sweep.sweep import Standing
    from mjmerge.sweep.workers import Workers


def run(
    planned: Plan, folder: Path, part: Part, team: AbstractContextManager[Workers], *, as_json: bool
) -> int:
    """Runs a part of a campaign, or all of it; returns the exit code."""
    from mjmerge.sweep.report import write
    from mjmerge.sweep.shards import shards
    from mjmerge.sweep.sweep import do_part

    mine = sum(len(shard.at) for shard in part.among(shards(planned)))
    with runs_bar(mine) as progress, team as who:
        found = do_part(planned, folder, part, who, progress=progress)
    if found.table is None:
        return _say_part(planned, folder, part, found, as_json=as_json)
    if part.of > 1:
        _write_beside(planned, found.table, folder)
    else:
        write(planned, found.table, folder)
    return _say(planned, folder, found.table, as_json=as_json)


def _write_beside(planned: Plan, found: pa.Table, folder: Path) -> None:
    """Writes the report, while others may be writing the same one."""
    from mjmerge.sweep.report import write

    with TemporaryDirectory(".partial", "report.", folder) as own:
        write(planned, found, Path(own))
        for path in Path(own).iterdir():
            path.replace(folder / path.name)


def merge(planned: Plan, folder: Path, folders: Collection[Path], *, as_json: bool) -> int:
    """Makes one sweep of parts in folders of their own; returns the exit code."""
    from mjmerge.sweep.merge import merged
    from mjmerge.sweep.report import write

    found = merged(planned, [*folders], folder)
    write(planned, found, folder)
    return _say(planned, folder, found, as_json=as_json)


def _say(planned: Plan, folder: Path, found: pa.Table, *, as_json: bool) -> int:
    """Says what came of a whole sweep."""
    from rich.console import Console

    from mjmerge.sweep import laws, tally
    from mjmerge.sweep import report as sweep_report
    from mjmerge.sweep.folder import TABLE

    summary = tally.summary(planned, found)
    notes = tally.notes(planned, found)
    if as_json:
        of_laws = {"laws": laws.summary(found.to_pylist())}
        print(json.dumps(summary | of_laws | {"out": str(folder)}))
    else:
        console = Console(highlight=False)
        count = f"{found.num_rows} runs, {summary['distinct']} distinct"
        console.print(f"{bold(planned.name)}, {count}")
        console.print(sweep_report.rich_table(found))
        for note in notes:
            console.print(note, markup=False, soft_wrap=True)
        if summary["worst"]:
            console.print("the worst run:  ", end="")
            console.print(summary["worst"][0]["command"], markup=False, soft_wrap=True)
        console.print(f"table and report:  {bold(folder / TABLE)}, {sweep_report.REPORT}", soft_wrap=True)
    _say_lost(len(summary["lost"]), len(planned.cases))
    return 3 if summary["stopped"] or summary["lost"] else 0


def _say_part(planned: Plan, folder: Path, part: Part, found: Standing, *, as_json: bool) -> int:
    """Says what of a sweep is not there yet."""
    from rich.console import Console

    from mjmerge.sweep import losses

    mine, left = found.mine.num_rows, sum(len(shard.at) for shard in found.missing)
    others = [str(other) for other in part.others(found.missing)]
    if as_json:
        told = {"campaign": planned.name, "part": str(part), "runs": mine, "missing": left}
        lost = losses.as_json(planned, found.lost)
        print(json.dumps(told | {"missing_parts": others, "lost": lost, "out": str(folder)}))
    else:
        console = Console(highlight=False, soft_wrap=True)
        nothing = (
            "; there are fewer shards than parts, and none is its own" if not mine + len(found.lost) else ""
        )
        console.print(f"{bold(planned.name)}, part {part}: {mine} runs{nothing}")
        for line in losses.lines(planned, found.lost):
            console.print(line, markup=False)
        several = "part" if len(others) == 1 else "parts"
        console.print(
            f"{left} runs are missing, of {several} {', '.join(others)}: the last one makes the table"
        )
        console.print(f"rows so far:  {bold(folder)}")
    _say_lost(len(found.lost), mine + len(found.lost))
    stopped = any(why is not None for why in found.mine["stopped"].to_pylist())
    return 3 if found.lost or stopped else 0


def _say_lost(lost: int, of: int) -> None:
    if lost:
        said = f"{lost} of {of} runs kill the worker that is at them, and have no row"
        print(f"mjmerge: {said}; they are tried again when this is run again", file=sys.stderr)
