"""Who does the work: this process, others on this machine, or any executor; what is lost is done again.

A worker that dies loses what it was at, which is tried again. What is lost every time is taken apart, until
the runs that kill their workers are known by themselves, and everything else is there.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

from mjmerge.errors import MjmergeError, WorkerError
from mjmerge.sweep.elsewhere import Raised, do, sent
from mjmerge.sweep.plan import Case
from mjmerge.sweep.processes import Processes, tell
from mjmerge.sweep.shards import TOGETHER, Shard, dealt, measure

AGAIN = 3
"""How often what was lost is tried again."""

_LOOK_S = 0.1
Progress = Callable[[float], None]
Rows = dict[int, dict[str, Any]]
"""Rows by index of their run."""
Keep = Callable[[Shard, Rows, Mapping[int, str]], None]
"""Takes a shard, the rows of its runs, and of those that kill their workers what was seen of it."""
Item = TypeVar("Item")
Made = TypeVar("Made")


class Crew(Protocol):
    """Who works on several tasks at a time."""

    def submit(self, task: Callable[..., Any], *given: Any) -> Future[Any]:
        """Has a task done; raises :class:`BrokenExecutor` where somebody died, and with them everything."""

    def part(self, future: Future[Any]) -> float:
        """What of it is done, 0 to 1, as far as that is known."""

    def renew(self) -> None:
        """Others, after that; raises :class:`WorkerError` where there are none."""

    def close(self) -> None:
        """Lets them go, who have nothing left to do."""

    def stop(self) -> None:
        """Lets them go, wherever they are."""


class Given:
    """An executor that somebody else began, and will end."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def submit(self, task: Callable[..., Any], *given: Any) -> Future[Any]:
        """See :class:`Crew`."""
        return self._executor.submit(task, *given)

    def part(self, future: Future[Any]) -> float:
        """Not known before it is done."""
        return float(future.done())

    def renew(self) -> None:
        """It is not ours to begin anew."""
        raise WorkerError(
            "the executor is broken, as a worker died; what is finished is kept: run again with a new one"
        )

    def close(self) -> None:
        """It is not ours to end."""

    def stop(self) -> None:
        """It is not ours to end."""


@dataclass(frozen=True)
class _Piece:
    """What one task is given: some items, the index of each, and how often it was lost."""

    at: tuple[int, ...]
    items: tuple[Any, ...]
    lost: int = 0

    @classmethod
    def of(cls, together: Sequence[Shard]) -> _Piece:
        """Of shards that are simulated at once."""
        cases = tuple(case for shard in together for case in shard.cases)
        return cls(tuple(i for shard in together for i in shard.at), cases)

    def singly(self) -> list[_Piece]:
        """Each item by itself."""
        return [_Piece((i,), (item,)) for i, item in zip(self.at, self.items, strict=True)]


@contextmanager
def workers(count: int) -> Iterator[Workers]:
    """Processes that work, for as long as the context lasts; with a count of 1, this one does."""
    with at_work(Workers(count)) as team:
        yield team


@contextmanager
def at_work(team: Workers) -> Iterator[Workers]:
    """Workers for as long as the context lasts."""
    try:
        yield team
    except BaseException:
        team.stop()
        raise
    team.close()


class Workers:
    """Work on several processes, or on this one with a thread per core.

    Attributes:
        losses: how often work was lost, and tried again.
    """

    def __init__(self, count: int, crew: Crew | None = None, threads: int = 1) -> None:
        """A team.

        Args:
            count: how many work at a time.
            crew: who works; by default as many processes of this machine, or with a count of 1 this one.
            threads: that each may use, where a crew is given.

        Raises:
            MjmergeError: nobody is there to work.
        """
        if count < 1:
            raise MjmergeError(f"there are {count} workers; there must be at least 1")
        self._count, self._threads = count, threads
        self._alone = crew is None  # whether this process may do the work
        self._crew = crew
        self.losses = 0

    @classmethod
    def on(cls, executor: Executor, count: int, threads: int = 1) -> Workers:
        """A team of whoever an executor has: anything with ``submit`` as in :mod:`concurrent.futures`.

        Args:
            executor: who works; it stays its owner's, who also ends it.
            count: how many of it work at a time.
            threads: that each may use.
        """
        return cls(count, Given(executor), threads)

    @property
    def count(self) -> int:
        """How many there are."""
        return self._count

    def map(
        self, todo: Sequence[Shard], keep: Keep, progress: Progress, killers: Sequence[Shard] = ()
    ) -> None:
        """Measures shards in any order.

        Args:
            todo: the shards.
            keep: called with each and its rows, as soon as they are there.
            progress: called now and then with the number of runs done, shards under way in parts.
            killers: shards of runs that killed their workers before; this process never does them.

        Raises:
            WorkerError: there are no workers any more.
        """
        owner = {i: shard for shard in (*todo, *killers) for i in shard.at}
        rows: Rows = {}
        lost: dict[int, str] = {}

        def settle(piece: _Piece) -> None:
            for shard in {owner[i].number: owner[i] for i in piece.at}.values():
                if all(i in rows or i in lost for i in shard.at):
                    here = {i: rows.pop(i) for i in shard.at if i in rows}
                    keep(shard, here, {i: lost.pop(i) for i in shard.at if i in lost})

        def took(piece: _Piece, made: Sequence[dict[str, Any]]) -> None:
            rows.update(zip(piece.at, made, strict=True))
            settle(piece)

        def gone(piece: _Piece, why: str) -> None:
            lost[piece.at[0]] = why
            settle(piece)

        done = 0
        if self._alone and (self._count == 1 or len(todo) == 1):
            for piece in map(_Piece.of, dealt(todo, 1)):
                n = len(piece.at)
                found = measure(piece.items, 0, lambda part, done=done, n=n: progress(done + part * n))  # type: ignore[misc]
                took(piece, found)
                done += n
                progress(done)
            todo = []
        pieces = [_Piece.of(together) for together in dealt(todo, self._count)]
        again = [one for shard in killers for one in _Piece.of([shard]).singly()]
        self._work(_measure, [*pieces, *again], took, gone, lambda n: progress(done + n))

    def each(
        self,
        task: Callable[[Sequence[Item], int], Sequence[Made]],
        items: Sequence[Item],
        named: Callable[[Item], str] = repr,
    ) -> list[Made]:
        """What a task makes of each item, in their order.

        Args:
            task: what is done: from some of the items, and the threads that it may use (0 for one per core),
                it makes one thing of each.
            items: what it is done with.
            named: what an item is called.

        Raises:
            WorkerError: an item kills whoever works on it; or there are no workers any more.
        """
        most = max(1, min(TOGETHER, -(-len(items) // self._count)))
        starts = range(0, len(items), most)
        if self._alone and (self._count == 1 or len(starts) <= 1):
            return [one for first in starts for one in task(items[first : first + most], 0)]
        found: dict[int, Made] = {}

        def took(piece: _Piece, made: Sequence[Made]) -> None:
            found.update(zip(piece.at, made, strict=True))

        def gone(piece: _Piece, why: str) -> None:
            raise WorkerError(f"a run kills the worker that is at it, {why}: {named(piece.items[0])}")

        every = range(len(items))
        pieces = [_Piece(tuple(every[i : i + most]), tuple(items[i : i + most])) for i in starts]
        self._work(task, pieces, took, gone, lambda _: None)
        return [found[i] for i in every]

    def _work(
        self,
        task: Callable[[Sequence[Any], int], Sequence[Any]],
        pieces: Sequence[_Piece],
        took: Callable[[_Piece, Sequence[Any]], None],
        gone: Callable[[_Piece, str], None],
        progress: Progress,
    ) -> None:
        """Has everything done, what is lost again; what is lost every time, singly; then it is gone."""
        if not pieces:
            return
        crew = self._crew = self._crew or Processes(self._count)
        left, suspects = deque(pieces), deque[_Piece]()
        waiting: dict[Future[Any], _Piece] = {}
        singly, done = False, 0  # one by one, so that it is known who dies of what
        try:
            while left or suspects or waiting:
                broken = False
                try:
                    singly = bool(suspects) or (singly and bool(waiting))
                    queue = suspects if singly else left
                    while queue and len(waiting) < (1 if singly else self._count + 1):
                        waiting[crew.submit(do, *sent(task, queue[0].items, self._threads))] = queue[0]
                        queue.popleft()
                except BrokenExecutor:  # before it took that
                    broken = True
                ended = _ended(waiting, broken)
                while ended:
                    future = ended.pop()
                    piece, error = waiting.pop(future), None
                    try:
                        made = future.result()
                    except Exception as died:  # what the task itself raises is no exception here
                        error = died
                    if error is not None:
                        self.losses += 1
                        queue = suspects if isinstance(error, BrokenExecutor) else left
                        if isinstance(error, BrokenExecutor) and not broken:
                            broken, ended = True, _ended(waiting, True)
                        piece = replace(piece, lost=piece.lost + 1)
                        if piece.lost <= AGAIN:
                            queue.append(piece)
                            continue
                        if len(piece.items) > 1:
                            queue.extend(piece.singly())
                            continue
                        gone(piece, f"{piece.lost} times of {piece.lost}{_said(error)}")
                    elif isinstance(made, Raised):
                        raise made.error
                    else:
                        took(piece, made)
                    done += len(piece.items)
                if broken:
                    crew.renew()
                progress(done + sum(crew.part(f) * len(piece.items) for f, piece in waiting.items()))
        except BaseException:
            for future in waiting:
                future.cancel()
            raise

    def close(self) -> None:
        """Lets those go that were begun, and have nothing left to do."""
        if self._crew is not None:
            self._crew.close()

    def stop(self) -> None:
        """Lets those go that were begun, wherever they are."""
        if self._crew is not None:
            self._crew.stop()


HERE = Workers(1)
"""Nobody else."""


def _ended(waiting: Mapping[Future[Any], object], every: bool = False) -> set[Future[Any]]:
    """Those that are done, after a moment, or all of them when they are."""
    if all(isinstance(future, Future) for future in waiting):
        when = "ALL_COMPLETED" if every else "FIRST_COMPLETED"
        return set(wait(waiting, None if every else _LOOK_S, when).done)
    while not (found := {future for future in waiting if future.done()}) or (
        every and len(found) < len(waiting)
    ):
        time.sleep(_LOOK_S)
    return found


def _said(error: Exception) -> str:
    """What an executor says of a loss; of a broken one nothing that helps."""
    if isinstance(error, BrokenExecutor):
        return ""
    return f" ({type(error).__name__}{f': {error}' if str(error) else ''})"


def _measure(cases: Sequence[Case], threads: int) -> list[dict[str, Any]]:
    return measure(cases, threads, tell)
