"""The live view shows a run, and a viewer that is not there, hangs or dies does not matter to it."""

from __future__ import annotations

import socket
import time
from functools import partial
from pathlib import Path

import pytest

from mjmerge.errors import MjmergeError
from mjmerge.record.rerun.live import Live, port_of
from mjmerge.run import run
from mjmerge.scenario.load import load

from .viewer import await_views, complaints, free_port, has_vulkan, headless_viewer


def shown(port: int, *, duration_s: float = 3.0, real_time: bool = False):
    scenario = load("paper", [f"duration_s={duration_s}"])
    return run(scenario, "double_integrator", live=partial(Live, port=port, real_time=real_time))


@pytest.mark.viewer
@pytest.mark.skipif(not has_vulkan(), reason="no Vulkan driver (Debian: mesa-vulkan-drivers)")
def test_the_viewer_shows_the_run(tmp_path: Path) -> None:
    port = free_port()
    with headless_viewer(port) as viewer:
        done = shown(port)
        await_views(viewer)
        time.sleep(1.0)
        assert done.unseen_s == 0
        assert len(viewer.get_state().views) > 10
        assert complaints(viewer) == []
        viewer.save_screenshot(str(tmp_path / "live.png"))
    assert (tmp_path / "live.png").stat().st_size > 10_000


def test_a_viewer_that_is_not_there_does_not_matter(capfd) -> None:
    done = shown(free_port())
    assert done.exit_code == 0
    assert done.trace.time_s[-1] == pytest.approx(3.0)
    assert "there is no Rerun viewer" in capfd.readouterr().err


def test_a_viewer_that_hangs_does_not_slow_the_run() -> None:
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        deaf.listen()
        began = time.monotonic()
        done = shown(deaf.getsockname()[1])
        assert done.exit_code == 0
        assert done.unseen_s > 0
        assert time.monotonic() - began < 30  # the run, and what the viewer gets for what is left


def test_real_time_is_kept() -> None:
    began = time.monotonic()
    shown(free_port(), duration_s=2.0, real_time=True)
    assert time.monotonic() - began > 1.9


@pytest.mark.parametrize("address", ["0.0.0.0:9876", "example.org:9876", "127.0.0.1", "127.0.0.1:0", "x:y"])
def test_only_a_viewer_on_this_machine_is_talked_to(address: str) -> None:
    with pytest.raises(MjmergeError, match=r"127\.0\.0\.1:PORT"):
        port_of(address)


@pytest.mark.parametrize("address", ["127.0.0.1:9876", "localhost:9876", ":9876"])
def test_a_viewer_on_this_machine_has_a_port(address: str) -> None:
    assert port_of(address) == 9876
