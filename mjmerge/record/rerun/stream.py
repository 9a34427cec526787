"""Rerun's streams: how one is opened, and how those that are over are let go of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings


def new_stream(application: str) -> rr.RecordingStream:
    """A stream that has been told nothing.

    Rerun keeps every stream of a process, with two threads and some memory each, after it was disconnected
    and forgotten. So those that nobody holds any more are ended first, and as many remain as are in use.

    Args:
        application: under which name a viewer knows it.
    """
    rerun_bindings.flush_and_cleanup_orphaned_recordings()
    return rr.RecordingStream(application, send_properties=False)


def save(stream: rr.RecordingStream, path: Path, layout: rrb.Blueprint) -> None:
    """Sends a stream to a file, which begins with a layout."""
    passing = _Passing(layout)
    stream.save(path, default_blueprint=passing)
    passing.over()


def send_layout(stream: rr.RecordingStream, layout: rrb.Blueprint) -> None:
    """Sends a layout, for viewers that have none of that application."""
    passing = _Passing(layout)
    stream.send_blueprint(passing, make_active=False)
    passing.over()


class _Passing(rrb.Blueprint):
    """A layout whose own stream, which Rerun makes of it and never ends, is ended once it was passed on."""

    def __init__(self, layout: rrb.Blueprint) -> None:
        self.__dict__.update(layout.__dict__)
        self._streams: list[Any] = []

    def _log_to_stream(self, stream: Any) -> None:
        super()._log_to_stream(stream)
        self._streams.append(stream)

    def over(self) -> None:
        for stream in self._streams:
            stream.disconnect()
        self._streams.clear()
