"""Shards of a plan: which runs are simulated together, and by which of several processes.

What the shards are depends on the plan alone, and a run's bits do not depend on its company.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from mjmerge.errors import WorkerError
from mjmerge.simulation.loop import simulate
from mjmerge.sweep.plan import Case, Plan
from mjmerge.sweep.rows import rows
from mjmerge.verdict.judge import judge
from mjmerge.verdict.own import measured

TOGETHER = 64
"""Runs of a shard, at most."""
MOST_TICKS = 300_000
"""Control ticks of a shard, all runs together, at most: what bounds the memory, at some 1 kB each."""

_LOOK_S = 0.1
Progress = Callable[[float], None]
Item = TypeVar("Item")
Made = TypeVar("Made")


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

    Raises:
        DoorError: a metric of the scenario's own fails.
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
    return [dict(row) for row in rows(trace, judge(trace), measured(trace))]


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
            WorkerError: a process died.
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
                    with _starting():
                        waiting[pool.submit(_measure, shard, slot)] = shard
                for future in wait(waiting, _LOOK_S, "FIRST_COMPLETED").done:
                    shard = waiting.pop(future)
                    keep(shard, future.result())
                    slots.append(at.pop(shard.number))
                    finished += len(shard.at)
                progress(finished + sum(parts[at[s.number]] * len(s.at) for s in waiting.values()))
        except BrokenProcessPool as error:
            raise WorkerError(
                "a worker process died: was it killed, or out of memory? "
                "What is finished is kept; run again, with fewer --workers"
            ) from error

    @property
    def count(self) -> int:
        """How many there are."""
        return self._count

    def each(self, task: Callable[[Item, int], Made], items: Sequence[Item]) -> list[Made]:
        """What a task makes of each item, in their order.

        Args:
            task: what is done, from an item and the threads that it may use, 0 for one per core.
            items: what it is done with.

        Raises:
            WorkerError: a process died.
        """
        if self._count == 1 or len(items) <= 1:
            return [task(item, 0) for item in items]
        pool, _ = self._started()
        try:
            with _starting():
                waiting = [pool.submit(task, item, 1) for item in items]
            return [future.result() for future in waiting]
        except BrokenProcessPool as error:
            raise WorkerError(
                "a worker process died: was it killed, or out of memory? Run again, with fewer --workers"
            ) from error

    def _started(self) -> tuple[ProcessPoolExecutor, Any]:
        if self._pool is None:
            self._others = set(active_children())
            context = get_context("spawn")
            with _starting():  # Python's own helper, which tidies up after the others
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


HERE = Workers(1)
"""Nobody else."""


@contextmanager
def _starting() -> Iterator[None]:
    """Processes start meanwhile; a signal waits until they have: half-started, they fail with a traceback.

    Ctrl-C is held back for ever in the processes that start: it is their parent's to handle.
    """
    with _held(signal.SIGTERM), _held(signal.SIGINT):
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _held(number: signal.Signals) -> Iterator[None]:
    """Handles a signal that comes meanwhile at the end, whichever thread the system gives it to."""
    before = signal.getsignal(number)
    if before in (signal.SIG_IGN, None) or threading.current_thread() is not threading.main_thread():
        yield
        return
    came = threading.Event()
    try:
        signal.signal(number, lambda *_: came.set())
        yield
    finally:
        signal.signal(number, before)
        if came.is_set():
            signal.raise_signal(number)


_parts: Any = None  # of a worker process: how far its shards are, shared with its parent


def _begin(parts: Any) -> None:
    """A worker process: it does not outlive its parent."""
    global _parts
    _parts = parts
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
