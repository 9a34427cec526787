"""``mjmerge run --live``: the run in a Rerun viewer while it goes on.

A process of its own talks to the viewer: one that is not there, hangs or dies takes nobody with it. What it
does not take in time is dropped, and said so. Only this machine can be reached, and only it can reach in.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import socket
import subprocess
import sys
import threading
import time
from typing import IO, Any

from mjmerge.errors import MjmergeError
from mjmerge.record.posed import Posing
from mjmerge.record.recording import Header, Outcome
from mjmerge.record.rerun import viewer
from mjmerge.record.rerun.viewer import HOST
from mjmerge.record.scene import Scene
from mjmerge.simulation.log import GLIMPSE_S, TickBlock

APPLICATION = "mjmerge_live"
_BACKLOG_S = 30.0
"""Simulated time that may wait for the viewer."""
_GRACE_S = 8.0
"""At the end, a viewer that takes nothing for so long has had its time, s."""
_START_S, _KNOCK_S = 30.0, 2.0
"""Time a viewer gets to open, and to answer when it is said to be open, s."""
_FLUSH_S = 3.0
"""A viewer that takes nothing for so long is given up, s."""


class Live:
    """A sink that shows a run: ``with Live(...) as live``, then ``write`` and, once, ``close``.

    Attributes:
        dropped_s: simulated time that was not shown.
    """

    def __init__(self, header: Header, port: int | None = None, *, real_time: bool = True) -> None:
        """Starts showing.

        Args:
            header: what is known of the run.
            port: of a viewer that is open; ``None`` opens one.
            real_time: whether the run is held back to real time.
        """
        self.dropped_s = 0.0
        self._step_s, self._real_time = header.control_step_s, real_time
        self._began: float | None = None
        self._queue: queue.Queue[object] = queue.Queue(maxsize=round(_BACKLOG_S / GLIMPSE_S))
        self._queue.put(header)
        command = [sys.executable, "-m", "mjmerge.record.rerun.live", *([] if port is None else [str(port)])]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, start_new_session=True, env=viewer.environment()
        )
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def __enter__(self) -> Live:
        return self

    def write(self, block: TickBlock) -> None:
        """Shows the next ticks, or drops them; waits for nobody but the clock."""
        try:
            self._queue.put_nowait(block)
        except queue.Full:
            self.dropped_s += len(block.ticks) * self._step_s
        if self._real_time:
            now = time.monotonic()
            if self._began is None:
                self._began = now - float(block.time_s[0])
            time.sleep(max(0.0, self._began + float(block.time_s[-1]) - now))

    def close(self, outcome: Outcome) -> None:
        """Shows how it ended, as far as the viewer is quick enough."""
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(outcome)

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(None)
        waiting, deadline = self._queue.qsize(), time.monotonic() + _GRACE_S
        while self._process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.05)
            if self._queue.qsize() < waiting:
                waiting, deadline = self._queue.qsize(), time.monotonic() + _GRACE_S
        self._process.kill()
        self._process.wait()
        while True:  # what is left was not shown
            try:
                left = self._queue.get_nowait()
            except queue.Empty:
                return
            self.dropped_s += len(left.ticks) * self._step_s if isinstance(left, TickBlock) else 0.0

    def _send(self) -> None:
        """Passes on what comes, until nobody takes it any more."""
        pipe = self._process.stdin
        assert pipe is not None, "it was asked for"
        with contextlib.suppress(OSError), pipe:
            while (what := self._queue.get()) is not None:
                pickle.dump(what, pipe, pickle.HIGHEST_PROTOCOL)
                pipe.flush()


def port_of(address: str) -> int:
    """The port of ``127.0.0.1:9876``.

    Raises:
        MjmergeError: it is no port, or not on this machine.
    """
    host, _, port = address.rpartition(":")
    if host not in ("", HOST, "localhost") or not port.isdecimal() or not 0 < int(port) < 2**16:
        raise MjmergeError(f"--live-at is {address!r}; it must be {HOST}:PORT, the address of a viewer here")
    return int(port)


def _show(source: IO[bytes], port: int) -> None:
    """Tells a viewer what comes out of a pipe."""
    from mjmerge.record.rerun import layout
    from mjmerge.record.rerun.draw import still_life
    from mjmerge.record.rerun.recorder import Teller
    from mjmerge.record.rerun.stream import new_stream

    header: Header = pickle.load(source)
    scene = Scene(header.model, header.scenario.r_m)
    posing = Posing(header, scene)
    stream = new_stream(APPLICATION)
    blueprint = layout.blueprint(header.scenario, scene.paint, header.plant, live=True)
    stream.connect_grpc(f"rerun+http://{HOST}:{port}/proxy", default_blueprint=blueprint)
    teller = Teller(stream, header, scene, still_life(header, scene))
    while True:
        try:
            what: Any = pickle.load(source)
        except EOFError:
            break
        if isinstance(what, Outcome):
            teller.end(what)
        else:
            posed = posing.block(what)
            teller.numbers(posed)
            teller.draw(posed)
        teller.flush(_FLUSH_S)
    teller.close()


def _open_viewer() -> tuple[int, subprocess.Popen[bytes]]:
    """Opens a viewer; returns its port and its process."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port: int = probe.getsockname()[1]
    command = viewer.command("--port", str(port), "--hide-welcome-screen")
    no = subprocess.DEVNULL
    process = subprocess.Popen(
        command, start_new_session=True, stdin=no, stdout=no, stderr=no, env=viewer.environment()
    )
    return port, process


def _await(port: int, patience_s: float, started: subprocess.Popen[bytes] | None) -> bool:
    """Whether there is a viewer, at the latest after a while."""
    deadline = time.monotonic() + patience_s
    while True:
        try:
            socket.create_connection((HOST, port), timeout=1.0).close()
        except OSError:
            if time.monotonic() > deadline or (started is not None and started.poll()):
                return False
            time.sleep(0.1)
        else:
            return True


def main() -> None:
    """The process that talks to the viewer: ``python -m`` this module, ``[PORT]``, the run on stdin."""
    port, started = (int(sys.argv[1]), None) if len(sys.argv) > 1 else _open_viewer()
    if not _await(port, _START_S if started else _KNOCK_S, started):
        why = "; a viewer needs a display" if started else ""
        sys.exit(f"mjmerge: there is no Rerun viewer at {HOST}:{port}; the run is not shown{why}")
    try:
        _show(sys.stdin.buffer, port)
    except Exception as error:
        print(f"mjmerge: the live view ended: {error}", file=sys.stderr, flush=True)
        os._exit(1)  # Rerun would go on trying for a while


if __name__ == "__main__":
    main()
