"""Killed, terminated or interrupted at any moment: nothing half-written looks finished, nothing stays behind.

A moment of each command in CI, 200 with ``--long``.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from PIL import Image

import mjmerge
from mjmerge.config import shipped
from mjmerge.gate import baseline
from mjmerge.record.read import read
from mjmerge.sweep import campaign
from mjmerge.sweep.folder import TABLE
from mjmerge.sweep.sweep import sweep

PACKAGE = str(Path(mjmerge.__file__).parents[1])
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
CAMPAIGN = """\
blocks:
  - scenarios: [short.yaml]
    plants: [double_integrator]
    grid: {law.k_o: [0.5, 0.8, 1, 1.5], mismatch.neighbour_position_noise_m: [0, 0.01]}
    seeds: 2
"""
GATE = """
gate:
  - {name: ideal, plant: double_integrator, at_least_m: 0.1}
  - {name: late, plant: bicycle, set: [mismatch.command_delay_s=0.02], at_least_m: 0.1}
"""


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    """A folder with a scenario of 3 s, a campaign and a gate."""
    text = shipped.scenarios()["charge"].read_text().partition("\ngate:")[0]
    assert "duration_s: 12" in text
    (tmp_path / "short.yaml").write_text(text.replace("duration_s: 12", "duration_s: 3") + GATE)
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN)
    (tmp_path / "tmp").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def started(args: list[str]) -> subprocess.Popen[str]:
    def listens() -> None:  # what starts in the background ignores it
        signal.signal(signal.SIGINT, signal.default_int_handler)

    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([PACKAGE, *sys.path]),
        "TMPDIR": str(Path("tmp").resolve()),
    }
    return subprocess.Popen(
        [sys.executable, "-m", "mjmerge", *args],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        preexec_fn=listens,
        start_new_session=True,
    )


def alive(group: int) -> bool:
    """Whether a process of a group is still there."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, theirs = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(theirs) == group and state != "Z":
            return True
    return False


def disturbed(args: list[str], number: signal.Signals, after_s: float) -> None:
    """Starts a command, sends it a signal, and checks how it ended."""
    process = started(args)
    time.sleep(after_s)
    process.send_signal(number)
    _, err = process.communicate(timeout=120)
    ways = {signal.SIGKILL: {-9}, signal.SIGTERM: {143, -15}, signal.SIGINT: {130, -2}}[number]
    assert process.returncode in ways | {0, 1}, (args, number, after_s, err)
    if number != signal.SIGKILL:  # of one that is killed, Python's own helper says what it tidied up
        lines = [line for line in err.splitlines() if not line.startswith("mjmerge: interrupted")]
        assert not lines, (args, number, after_s, err)
    until = time.monotonic() + 20
    while alive(process.pid):
        assert time.monotonic() < until, f"processes are left after {args}, {number!r} at {after_s:.2f} s"
        time.sleep(0.05)
    assert not list(Path("tmp").iterdir())


def looks_finished_and_is(folder: Path) -> None:
    """Every file that has its own name is whole."""
    for path in folder.rglob("*"):
        match path.name:
            case "run.mcap" | "run.rrd":
                assert read(path).finished, path
            case "summary.json" | "plan.json":
                json.loads(path.read_text())
            case "figure.png":
                Image.open(path).load()
            case "scenario.yaml":
                mjmerge.load(path)
            case name if name.endswith(".parquet"):
                pq.read_table(path)
            case name if name.endswith(".csv"):
                assert len(baseline.read(path)) == 2


def took_s(args: list[str]) -> float:
    began = time.monotonic()
    assert started(args).communicate(timeout=120)
    return time.monotonic() - began


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes as Linux shows them")
@pytest.mark.parametrize("command", ["run", "sweep", "check"])
def test_whenever_a_command_is_stopped_what_looks_finished_is_and_nothing_stays(command, place, long):
    dice = random.Random(command)
    args = {
        "run": ["run", "short.yaml"],
        "sweep": ["sweep", "campaign.yaml", "--workers", "2"],
        "check": ["check", "short.yaml", "--update"],
    }[command]
    longest_s = took_s([*args, *([] if command == "check" else ["--out", "undisturbed"])])
    first = ("run", "sweep", "check").index(command)  # another signal for each, where there is one moment
    for i in range(first, first + (67 if long else 1)):
        out = [] if command == "check" else ["--out", f"out_{i}"]
        disturbed([*args, *out], SIGNALS[i % 3], dice.uniform(0.0, longest_s))
        looks_finished_and_is(place)
        if command == "sweep":
            again = sweep(campaign.plan(place / "campaign.yaml"), place / f"out_{i}")
            assert again.equals(pq.read_table(place / "undisturbed" / TABLE))
            assert not list((place / f"out_{i}").rglob("*.partial"))
