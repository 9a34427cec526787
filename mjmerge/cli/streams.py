"""Standard output and standard error that never break a command.

A reader that went away (``| head``) has read enough: the rest is dropped, and the exit code is the verdict's.
Standard output that is full or closed loses what was asked for: the command ends as failed, and says so.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO


class _Raw(io.RawIOBase):
    """A file descriptor that takes everything; ``error`` is what kept it from being passed on."""

    def __init__(self, fd: int, error: OSError | None = None) -> None:
        super().__init__()
        self._fd, self.error = fd, error

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._fd

    def isatty(self) -> bool:
        return self.error is None and os.isatty(self._fd)

    def write(self, data: object) -> int:
        content = memoryview(data).cast("B")  # type: ignore[arg-type]  # whatever has a buffer
        at = 0
        while self.error is None and at < len(content):
            try:
                at += os.write(self._fd, content[at:])
            except OSError as error:
                self.error = error
        return len(content)


class Streams:
    """What became of standard output."""

    def __init__(self) -> None:
        self._raw: _Raw | None = None

    @property
    def lost(self) -> str:
        """Why standard output did not take everything; empty if it did, or if nobody reads it any more."""
        with suppress(OSError, ValueError, AttributeError):
            sys.stdout.flush()
        error = None if self._raw is None else self._raw.error
        if error is None or isinstance(error, BrokenPipeError):
            return ""
        return error.strerror or type(error).__name__

    def take(self) -> None:
        """Stands in for the process's own streams; whoever has put others in their place keeps those."""
        closed = _hold_places()
        if sys.stdout is sys.__stdout__:
            gone = OSError(9, "it is closed") if 1 in closed or sys.stdout is None else None
            self._raw = _Raw(1, gone)
            sys.stdout = _text(self._raw, sys.__stdout__)
        if sys.stderr is sys.__stderr__:
            sys.stderr = _text(_Raw(2), sys.__stderr__)


@contextmanager
def standard() -> Iterator[Streams]:
    """The streams of a command, for as long as it runs."""
    before = sys.stdout, sys.stderr
    streams = Streams()
    streams.take()
    try:
        yield streams
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError, AttributeError):
                stream.flush()
        sys.stdout, sys.stderr = before


def _text(raw: _Raw, like: TextIO | None) -> TextIO:
    """Text over a descriptor as Python would set it up; what cannot be encoded is written as an escape."""
    encoding = getattr(like, "encoding", None) or "utf-8"
    buffered = io.BufferedWriter(raw)
    return io.TextIOWrapper(
        buffered, encoding, "backslashreplace", line_buffering=raw.isatty() or raw.fileno() == 2
    )


def _hold_places() -> set[int]:
    """Opens the null device where a standard descriptor is closed, or the next file would get its number."""
    closed = set()
    for fd in (0, 1, 2):
        try:
            os.fstat(fd)
        except OSError:
            closed.add(fd)
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
    return closed
