"""Runs a plan in shards, over processes, and keeps the rows of every shard that is finished.

A shard is simulated together, judged, reduced to rows and written to disk at once and whole; its trace is
dropped. What the shards are depends on the plan alone, and a run's bits do not depend on its company, so the
table is the same however many processes there were and however often the sweep was killed.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmerge import share
from mjmerge.campaign import Batch, Case, Plan
from mjmerge.contract import judge
from mjmerge.errors import MjmergeError, OutputError
from mjmerge.loader import dump
from mjmerge.outcome import FLAGS, NUMBERS, TEXTS, rows
from mjmerge.record.manifest import versions
from mjmerge.scenario import CARS
from mjmerge.simulate import simulate

if TYPE_CHECKING:
    import pyarrow as pa

TOGETHER = 64
"""Runs of a shard, at most."""
MOST_TICKS = 300_000
"""Control ticks of a shard, all runs together, at most: what bounds the memory, at some 1 kB each."""
PLAN, SHARDS, TABLE = "plan.json", "shards", "table.parquet"

_LOOK_S = 0.1
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Shard:
    """Runs that are simulated together.

    Attributes:
        number: which of the plan's shards.
        at: index of each run in the plan.
        cases: the runs; all of one batch.
    """

    number: int
    at: tuple[int, ...]
    cases: tuple[Case, ...]


def shards(plan: Plan, together: int = TOGETHER) -> list[Shard]:
    """A plan's runs in groups that share everything but seed and mismatch, of much the same size.

    Args:
        plan: the plan.
        together: runs of a shard, at most.
    """
    batches: dict[int, list[int]] = {}
    for i, case in enumerate(plan.cases):
        batches.setdefault(id(case.batch), []).append(i)
    found: list[Shard] = []
    for members in batches.values():
        scenario = plan.cases[members[0]].batch.scenario
        most = max(1, min(together, MOST_TICKS // scenario.ticks))
        count = -(-len(members) // most)
        for k in range(count):
            at = tuple(members[len(members) * k // count : len(members) * (k + 1) // count])
            found.append(Shard(len(found), at, tuple(plan.cases[i] for i in at)))
    return found


def measure(shard: Shard, threads: int, progress: Progress | None = None) -> list[dict[str, Any]]:
    """Simulates a shard and reduces it to one row per run.

    Args:
        shard: the runs.
        threads: for the physics, 0 for all cores.
        progress: called with the part that is done, 0 to 1.
    """
    batch = shard.cases[0].batch
    trace = simulate(
        batch.scenario,
        batch.plant,
        threads=threads,
        continuous=batch.continuous,
        cases=[(case.seed, case.mismatch) for case in shard.cases],
        progress=None if progress is None else lambda t: progress(t / batch.scenario.duration_s),
    )
    return [dict(row) for row in rows(trace, judge(trace))]


@contextmanager
def workers(count: int) -> Iterator[Workers]:
    """Processes that measure shards, for as long as the context lasts; with a count of 1, this one does."""
    team = Workers(count)
    try:
        yield team
    except BaseException:
        team.stop()
        raise
    team.close()


class Workers:
    """Measures shards on several processes, or on this one with a thread per core."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: ProcessPoolExecutor | None = None
        self._parts: Any = None
        self._others: set[BaseProcess] = set()

    def map(
        self, todo: Sequence[Shard], keep: Callable[[Shard, list[dict[str, Any]]], None], progress: Progress
    ) -> None:
        """Measures shards in any order.

        Args:
            todo: the shards.
            keep: called with each and its rows, as soon as they are there.
            progress: called now and then with the number of runs done, shards under way in parts.

        Raises:
            MjmergeError: a process died.
        """
        if self._count == 1 or len(todo) == 1:
            done = 0
            for shard in todo:
                n = len(shard.at)
                keep(shard, measure(shard, 0, lambda part, done=done, n=n: progress(done + part * n)))  # type: ignore[misc]
                done += n
                progress(done)
            return
        pool, parts = self._started()
        waiting: dict[Future[list[dict[str, Any]]], Shard] = {}
        left, finished = list(reversed(todo)), 0
        slots = list(range(self._count + 1))  # one shard more than processes, so that none is ever idle
        at: dict[int, int] = {}
        try:
            while left or waiting:
                while left and slots:
                    shard, slot = left.pop(), slots.pop()
                    parts[slot] = 0.0
                    at[shard.number] = slot
                    waiting[pool.submit(_measure, shard, slot)] = shard
                for future in wait(waiting, _LOOK_S, "FIRST_COMPLETED").done:
                    shard = waiting.pop(future)
                    keep(shard, future.result())
                    slots.append(at.pop(shard.number))
                    finished += len(shard.at)
                progress(finished + sum(parts[at[s.number]] * len(s.at) for s in waiting.values()))
        except BrokenProcessPool as error:
            raise MjmergeError(
                "a worker process died: was it killed, or out of memory? "
                "What is finished is kept; run again, with fewer --workers"
            ) from error

    def _started(self) -> tuple[ProcessPoolExecutor, Any]:
        if self._pool is None:
            self._others = set(active_children())
            context = get_context("spawn")
            self._parts = context.Array("d", self._count + 1, lock=False)
            self._pool = ProcessPoolExecutor(self._count, context, _begin, (self._parts,))
        return self._pool, self._parts

    def close(self) -> None:
        """Ends the processes, which have nothing left to do."""
        if self._pool is not None:
            self._pool.shutdown()

    def stop(self) -> None:
        """Ends the processes, wherever they are."""
        if self._pool is not None:
            for process in set(active_children()) - self._others:
                process.terminate()
            self._pool.shutdown(cancel_futures=True)  # waits for the pool's thread, or it races the exit


_parts: Any = None  # of a worker process: how far its shards are, shared with its parent


def _begin(parts: Any) -> None:
    """A worker process: interrupts are its parent's to handle, and it does not outlive its parent."""
    global _parts
    _parts = parts
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = parent_process()
    assert parent is not None, "a worker has a parent"

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _measure(shard: Shard, slot: int) -> list[dict[str, Any]]:
    def progress(part: float) -> None:
        _parts[slot] = part

    return measure(shard, 1, progress)


def measured(plan: Plan, team: Workers, progress: Progress | None = None) -> pa.Table:
    """The table of a plan, without anything left on disk; see :func:`sweep`."""
    found: dict[int, list[dict[str, Any]]] = {}

    def keep(shard: Shard, rows: list[dict[str, Any]]) -> None:
        found.update({i: [row] for i, row in zip(shard.at, rows, strict=True)})

    team.map(shards(plan), keep, progress or (lambda _: None))
    return table(plan, range(len(plan.cases)), [found[i][0] for i in range(len(plan.cases))])


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
    _claim(folder, {**_identity(plan), "shards": [len(shard.at) for shard in todo]})
    parts: dict[int, pa.Table] = {}
    for shard in todo:
        there = _read(folder, shard)
        if there is not None:
            parts[shard.number] = there
    before = sum(part.num_rows for part in parts.values())

    def keep(shard: Shard, rows: list[dict[str, Any]]) -> None:
        parts[shard.number] = table(plan, shard.at, rows)
        _write(parts[shard.number], _place(folder, shard))

    with workers(min(processes, len(todo))) as team:
        team.map(
            [shard for shard in todo if shard.number not in parts],
            keep,
            lambda done: report(before + done, before),
        )
    found: pa.Table = pa.concat_tables(parts.values()).sort_by("run")
    _write(found, folder / TABLE)
    for left in (folder / SHARDS).glob("*.partial"):
        with suppress(OSError):
            left.unlink()
    return found


def table(plan: Plan, at: Sequence[int], measured_rows: Sequence[dict[str, Any]]) -> pa.Table:
    """Rows of a plan's table: what each run was, and what came of it."""
    import pyarrow as pa

    cases = [plan.cases[i] for i in at]
    columns: dict[str, Any] = {
        "run": pa.array(at, pa.int64()),
        "campaign": pa.array([plan.name] * len(cases), pa.string()),
        "scenario": pa.array([c.batch.scenario.name for c in cases], pa.string()),
        "plant": pa.array([c.batch.plant for c in cases], pa.string()),
        "variant": pa.array([c.batch.scenario.law.variant for c in cases], pa.string()),
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
    for names, kind in ((TEXTS, pa.string()), (NUMBERS, pa.float64()), (FLAGS, pa.bool_())):
        columns |= {name: pa.array([row[name] for row in measured_rows], kind) for name in names}
    told = {"mjmerge": json.dumps({"campaign": plan.name, "versions": versions()})}
    return pa.table(columns, metadata=told)


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


def _identity(plan: Plan) -> dict[str, Any]:
    """What the rows of a plan depend on: name of each part, and a digest of it."""
    batches: dict[int, Batch] = {id(case.batch): case.batch for case in plan.cases}
    order = {key: i for i, key in enumerate(batches)}
    scenarios = [[b.scenario.name, b.plant, b.continuous, dump(b.scenario)] for b in batches.values()]
    models = {getattr(b.scenario.models, car) for b in batches.values() for car in CARS}
    runs = [
        [order[id(case.batch)], case.point, case.seed, *case.overrides, case.mismatch.model_dump(mode="json")]
        for case in plan.cases
    ]
    return {
        "campaign": _digest(json.dumps([plan.name, runs])),
        "scenarios": _digest(json.dumps(scenarios)),
        "car models": _digest(
            *(p.read_bytes() for name in sorted(models) for p in sorted(share.model_folder(name).glob("*.*")))
        ),
        "mjmerge's code": _digest(
            *(p.read_bytes() for p in sorted(Path(__file__).parent.rglob("*.py")) if p.name != "cli.py")
        ),
        "versions": versions(),
    }


def _digest(*parts: bytes | str) -> str:
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()


def _claim(folder: Path, identity: dict[str, Any]) -> None:
    """Makes the folder this plan's, or finds that it is.

    Raises:
        OutputError: it is no folder, cannot be written, or is something else's.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        plan = folder / PLAN
        if plan.exists():
            changed = _changed(plan.read_text(encoding="utf-8"), identity)
            if changed:
                raise OutputError(
                    f"{folder} holds a sweep begun with another {', another '.join(changed)}; rows of both "
                    "would not compare: choose another --out, or remove that folder"
                )
        elif any(p.suffix != ".partial" for p in folder.iterdir()):
            raise OutputError(f"{folder} is not empty, and holds no sweep: choose another --out")
        (folder / SHARDS).mkdir(exist_ok=True)
        if not plan.exists():
            _replace(plan, (json.dumps(identity, indent=2) + "\n").encode())
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror or error}") from error


def _changed(text: str, identity: dict[str, Any]) -> list[str]:
    """What of a plan is not as it was, in words."""
    try:
        before = json.loads(text)
        told = {**before.pop("versions"), **before}
    except (ValueError, TypeError, KeyError, AttributeError):
        return ["file format"]
    now = {**identity["versions"], **{k: v for k, v in identity.items() if k != "versions"}}
    return [
        f"version of {name} ({told.get(name, 'none')}, now {now.get(name, 'none')})"
        if name in identity["versions"] or name not in identity
        else {"campaign": "campaign", "scenarios": "scenario", "shards": "size of shards"}.get(name, name)
        for name in {**told, **now}
        if told.get(name) != now.get(name)
    ]


def _place(folder: Path, shard: Shard) -> Path:
    return folder / SHARDS / f"{shard.number:06d}.parquet"


def _read(folder: Path, shard: Shard) -> pa.Table | None:
    """A finished shard's rows; ``None`` where there are none, or they are damaged."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    place = _place(folder, shard)
    if not place.exists():
        return None
    try:
        found: pa.Table = pq.read_table(place)
        return found if found["run"].to_pylist() == list(shard.at) else None
    except (pa.ArrowException, OSError, KeyError):
        return None


def _write(found: pa.Table, path: Path) -> None:
    """A table as a file that is there whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    buffer = pa.BufferOutputStream()
    pq.write_table(found, buffer, compression="zstd")
    try:
        _replace(path, buffer.getvalue().to_pybytes())
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error


def _replace(path: Path, content: bytes) -> None:
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    with partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
