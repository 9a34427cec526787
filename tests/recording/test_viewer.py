"""The layouts work in the real viewer: it opens all that we write, and no view has a complaint."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from mjmerge.record import Header, Outcome, Recording, open_rrd
from mjmerge.review.view import write_view
from mjmerge.run import run
from mjmerge.scenario.load import load

from .conftest import MakeBlocks
from .viewer import has_vulkan, open_headless

pytestmark = [
    pytest.mark.viewer,
    pytest.mark.skipif(not has_vulkan(), reason="no Vulkan driver (Debian: mesa-vulkan-drivers)"),
]


@pytest.fixture
def shows(tmp_path: Path) -> Callable[..., None]:
    """Opens a recording; ``MJMERGE_PICTURES`` in the environment keeps the pictures in that folder."""

    def show(rrd: Path, name: str, time_s: float, timeline: str = "sim_time") -> None:
        picture = Path(os.environ.get("MJMERGE_PICTURES", tmp_path)) / f"{name}.png"
        assert open_headless(rrd, picture, time_s, timeline) == []
        assert picture.stat().st_size > 10_000

    return show


def test_a_recording_and_a_journal(tmp_path: Path, header: Header, make_blocks: MakeBlocks, shows) -> None:
    outcome = Outcome([], "held", {})
    for name, finish in (("whole", True), ("cut", False)):
        (tmp_path / name).mkdir()
        with Recording(tmp_path / name, header, {"run.rrd": open_rrd}) as recording:
            for block in make_blocks(50, 50):
                recording.write(block)
            if finish:
                recording.close(outcome)
        assert recording.failures == []
    shows(tmp_path / "whole" / "run.rrd", "tiny", 0.5)
    (tmp_path / "cut" / "run.rrd.partial").rename(tmp_path / "cut.rrd")  # the viewer goes by the ending
    shows(tmp_path / "cut.rrd", "journal", 0.5)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    scenario = load("charge", ["duration_s=6", "mismatch.friction=0.2"])
    done = run(scenario, "mujoco", runs=2, folder=folder / "r")
    assert done.failures == []
    return folder / "r"


@pytest.mark.parametrize("name", ["run", "compare"])
def test_the_recordings_of_many_runs(runs: Path, shows, name: str) -> None:
    shows(runs / f"{name}.rrd", name, 5.6)  # just after a contact


def test_an_mcap(runs: Path, tmp_path: Path, shows) -> None:
    write_view(runs / "run.mcap", tmp_path / "mcap.rrd")
    shows(tmp_path / "mcap.rrd", "mcap", 5.6, "message_log_time")


def test_an_mcap_that_rerun_opens_by_itself_shows_cars_and_says_what_happened(runs: Path, shows) -> None:
    shows(runs / "run.mcap", "mcap_alone", 5.6, "message_log_time")
