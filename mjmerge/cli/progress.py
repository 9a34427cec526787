"""Progress bars on standard error, for whoever watches."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_PATIENCE_S = 1.0  # what takes longer gets a bar


@contextmanager
def progress_bar(total: float, doing: str = "simulating") -> Iterator[Callable[[float], None]]:
    """A progress bar on standard error, once it is worth one."""
    from rich.console import Console
    from rich.progress import Progress

    began, console = time.monotonic(), Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        task = None

        def advance(done: float) -> None:
            nonlocal task
            if task is None and time.monotonic() - began > _PATIENCE_S:
                task = bars.add_task(doing, total=total)
            if task is not None:
                bars.update(task, completed=done)

        yield advance


@contextmanager
def runs_bar(total: int, doing: str = "running") -> Iterator[Callable[..., None]]:
    """A progress bar of runs on standard error, with their rate, a note, and the time left."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console, began = Console(stderr=True), time.monotonic()
    columns = (TextColumn(doing), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"))
    with Progress(
        *columns, TimeRemainingColumn(), console=console, transient=True, disable=not console.is_terminal
    ) as bars:
        task = bars.add_task(doing, total=total, rate="")

        def advance(done: float, before: int, note: str = "") -> None:
            rate = (done - before) / max(time.monotonic() - began, 1e-9)
            bars.update(task, completed=int(done), rate=f"{rate:.3g} runs/s{note}")

        yield advance
