"""Parts of a sweep that were run in folders of their own, as one: without gaps, and of nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmerge.errors import MjmergeError
from mjmerge.sweep.folder import claim, differing, place, write
from mjmerge.sweep.losses import lost_of
from mjmerge.sweep.parts import ranges
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.shards import TOGETHER, Shard, shards
from mjmerge.sweep.sweep import gathered, there, whose

if TYPE_CHECKING:
    import pyarrow as pa


def merged(plan: Plan, folders: Sequence[Path], out: Path, *, together: int = TOGETHER) -> pa.Table:
    """The table of a plan whose shards are spread over folders; ``out`` becomes the folder of all of them.

    Args:
        plan: the runs.
        folders: each has been a sweep's.
        out: one of them, or a new one; what it has of this plan counts, too.
        together: runs of a shard, as they were run.

    Raises:
        MjmergeError: a folder is no sweep's, or another's; or runs are missing. Nothing is written then.
        OutputError: the folder cannot be written, or holds something else.
    """
    every = shards(plan, together)
    of = whose(plan, every)
    problems = [said for folder in folders for said in _mixture(folder, of)]
    if problems:
        raise MjmergeError("\n".join(problems))
    sources = [*folders, *([out] if not _mixture(out, of) else [])]
    kept: list[pa.Table] = []
    missing: list[int] = []
    damaged: list[Path] = []
    for shard in every:
        found = {folder: rows for folder in sources if (rows := there(plan, folder, shard)) is not None}
        problems += _contradictions(found)
        if found:
            kept.append(min(found.values(), key=lambda rows: len(lost_of(rows))))
        else:
            missing += shard.at
            damaged += _damaged(sources, shard)
    problems += [f"{path} is damaged" for path in damaged]
    if missing:
        problems.append(
            f"{len(missing)} of {len(plan.cases)} runs are in none of the folders: {ranges(missing)}; "
            "run the parts that they are of"
        )
    if problems:
        raise MjmergeError("\n".join(problems))
    claim(out, of)
    for shard, rows in zip(every, kept, strict=True):
        write(rows, place(out, shard))
    return gathered(plan, out, kept)


def _mixture(folder: Path, of: dict[str, Any]) -> list[str]:
    """Why a folder is not this plan's."""
    try:
        changed = differing(folder, of)
    except OSError:
        return [f"{folder} holds no sweep"]
    what = f"{folder} holds a sweep begun with another {', another '.join(changed)}; rows of both would not"
    return [f"{what} compare"] if changed else []


def _contradictions(found: dict[Path, pa.Table]) -> list[str]:
    """Where two folders have other rows of the same runs."""
    (first, rows), *others = [*found.items()] or [(Path(), None)]
    mine = {} if rows is None else {row["run"]: row for row in rows.to_pylist()} if others else {}
    said = []
    for other, also in others:
        runs = [row["run"] for row in also.to_pylist() if row["run"] in mine and row != mine[row["run"]]]
        if runs:
            said.append(f"{first} and {other} have other rows of the same runs: {ranges(runs)}")
    return said


def _damaged(folders: Sequence[Path], shard: Shard) -> list[Path]:
    return [path for folder in folders if (path := place(folder, shard)).exists()]
