"""Opens a recording in the real viewer, without a window; all use of its experimental control is here."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rerun.experimental import ViewerClient

_PATIENCE_S = 30.0
_SETTLE_S = 1.5
_HARMLESS = "Software rasterizer"


def rerun_cli() -> str:
    """The ``rerun`` program of this environment."""
    return str(Path(sys.executable).with_name("rerun"))


def has_vulkan() -> bool:
    """Whether there is a Vulkan driver, a software one included."""
    return any(
        any(Path(root).glob("vulkan/icd.d/*.json")) for root in ("/usr/share", "/usr/local/share", "/etc")
    )


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


@contextmanager
def headless_viewer(port: int | None = None) -> Iterator[ViewerClient]:
    """A viewer of our own, which only this machine can reach."""
    port = port or free_port()
    arguments = ["--headless", "--hide-welcome-screen", "--bind", "127.0.0.1", "--port", str(port)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen([rerun_cli(), *arguments], start_new_session=True, **quiet)
    try:
        yield _connect(f"rerun+http://127.0.0.1:{port}/proxy")
    finally:
        os.killpg(process.pid, signal.SIGTERM)  # the program is a script that starts the viewer
        process.wait(_PATIENCE_S)


def _connect(url: str) -> ViewerClient:
    deadline = time.monotonic() + _PATIENCE_S
    while True:
        try:
            client = ViewerClient.connect(url)
            client.get_state()
        except Exception:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)
        else:
            return client


def open_headless(rrd: Path, png: Path, time_s: float, timeline: str = "sim_time") -> list[str]:
    """Shows a recording at a time and takes a picture.

    Returns:
        What the views and the viewer complained about; empty when all is well.
    """
    with headless_viewer() as viewer:
        viewer.open(str(rrd))
        await_views(viewer)
        viewer.set_time(timeline, duration=time_s, play_state="paused")
        time.sleep(_SETTLE_S)
        viewer.save_screenshot(str(png))
        return complaints(viewer)


def await_views(viewer: ViewerClient) -> None:
    """Waits until a recording is there and shown."""
    deadline = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline:
        state = viewer.get_state()
        if state.views and not state.loading:
            return
        time.sleep(0.2)


def complaints(viewer: ViewerClient) -> list[str]:
    """What views and viewer complain about."""
    views = viewer.get_state().views
    reports = [f"{v.name}: {r.severity}: {r.summary} {r.details}" for v in views for r in v.reports]
    logs = [f"{e.level}: {e.message}" for e in viewer.get_logs() if e.level in ("WARN", "ERROR")]
    return reports + [line for line in logs if _HARMLESS not in line]
