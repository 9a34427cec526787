"""Processes of this machine that work for a command: begun when there is work, and anew when one has died.

A process that dies takes with it what the others are at: which of them was the cause, nobody knows.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from typing import Any

from mjmerge.errors import WorkerError


class Processes:
    """So many processes, each with one thread for the physics."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: ProcessPoolExecutor | None = None
        self._parts: Any = None
        self._slots: list[Future[Any] | None] = [None] * (count + 1)  # one more, so that none is ever idle
        self._others: set[BaseProcess] | None = None

    def submit(self, task: Callable[..., Any], *given: Any) -> Future[Any]:
        """Has a task done; at most one more at a time than there are processes.

        Raises:
            BrokenProcessPool: a process has died.
        """
        pool = self._started()
        slot = next(i for i, future in enumerate(self._slots) if future is None or future.done())
        self._parts[slot] = 0.0
        with _starting():
            future = pool.submit(_do, slot, task, given)
        self._slots[slot] = future
        return future

    def part(self, future: Future[Any]) -> float:
        """What of it is done, 0 to 1."""
        return float(self._parts[self._slots.index(future)])

    def renew(self) -> None:
        """Other processes, after one has died.

        Raises:
            WorkerError: they die, too, before they have anything to do.
        """
        if self._pool is not None:
            self._pool.shutdown()
        self._pool, self._slots = None, [None] * (self._count + 1)
        try:
            self.submit(_nothing).result()
        except BrokenProcessPool as error:
            raise WorkerError(
                "worker processes die as soon as they start: is there memory for them? A script of your own "
                'needs `if __name__ == "__main__":` around what it runs'
            ) from error

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            if self._others is None:
                self._others = set(active_children())
            context = get_context("spawn")
            with _starting():  # Python's own helper, which tidies up after the others
                self._parts = context.Array("d", self._count + 1, lock=False)
                self._pool = ProcessPoolExecutor(self._count, context, _begin, (self._parts,))
        return self._pool

    def close(self) -> None:
        """Ends the processes, which have nothing left to do."""
        if self._pool is not None:
            self._pool.shutdown()

    def stop(self) -> None:
        """Ends the processes, wherever they are."""
        if self._pool is not None:
            for process in set(active_children()) - (self._others or set()):
                process.terminate()
            self._pool.shutdown(cancel_futures=True)  # waits for the pool's thread, or it races the exit


@contextmanager
def _starting() -> Iterator[None]:
    """Processes start meanwhile; a signal waits until they have: half-started, they fail with a traceback.

    Ctrl-C is held back for ever in the processes that start: it is their parent's to handle.
    """
    with held(signal.SIGTERM), held(signal.SIGINT):
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def held(number: signal.Signals) -> Iterator[None]:
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


_parts: Any = None  # of a worker process: how far what it is at is, shared with its parent
_slot = 0


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


def _do(slot: int, task: Callable[..., Any], given: Sequence[Any]) -> Any:
    global _slot
    _slot = slot
    return task(*given)


def _nothing() -> None:
    """What any process can do."""


def tell(part: float) -> None:
    """In a worker process of ours, says what of its task is done, 0 to 1; elsewhere nobody hears."""
    if _parts is not None:
        _parts[_slot] = part
