"""Whatever ends a run, its files can be read: killed, terminated, interrupted, out of space, out of luck."""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import count, product
from pathlib import Path

import numpy as np
import pytest

from mjmerge.cli import main
from mjmerge.record.mcap.recorder import McapRecorder
from mjmerge.record.read import read
from mjmerge.record.recording import PosedBlock
from mjmerge.record.rerun.recorder import RerunRecorder
from mjmerge.review.recover import recover, recovered_name
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.load import load
from mjmerge.simulation.log import BLOCK_S

from .viewer import rerun_cli

KILLS = int(os.environ.get("MJMERGE_KILLS", "2"))
"""How often a run is killed; 50 for a thorough look."""
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
PARTIAL = ("run.mcap.partial", "run.rrd.partial")

# says how far it is, tick by tick
RUN = """
import sys
from pathlib import Path
import mjmerge.simulation.loop
from mjmerge.scenario.load import load
from mjmerge.run import run
mjmerge.simulation.loop._PROGRESS_TICKS = 1
run(load("paper"), sys.argv[2], folder=Path(sys.argv[1]), progress=lambda t: print(t, flush=True))
"""


READ_BY_RERUN = {".rrd": ("rrd", "stats"), ".mcap": ("mcap", "convert", "--recover", "-o", os.devnull)}
CHECKED_BY_RERUN = {".rrd": ("rrd", "verify"), ".mcap": ("mcap", "check")}


def rerun(*arguments: str | Path) -> str:
    """What the program complains of, if it ends with an error."""
    done = subprocess.run([rerun_cli(), *arguments], capture_output=True, text=True, timeout=60)
    return done.stderr if done.returncode else ""


def unfinished(path: Path) -> float:
    """How far a file goes, s, that has nothing wrong with it but that it is unfinished."""
    found = verify(path)
    assert [check.name for check in found.checks if check.right is False] == ["file"], found.checks
    assert "recover" in found.checks[0].says
    return found.recorded.last_s if len(found.recorded.ticks) else -found.recorded.step_s


@pytest.mark.parametrize("kill", range(KILLS))
def test_a_killed_run_loses_half_a_second_at_most_and_can_be_recovered(tmp_path: Path, kill: int) -> None:
    dice = random.Random(kill)
    until_s, plant = dice.uniform(0.3, 9.0), dice.choice(["double_integrator", "mujoco"])
    command = [sys.executable, "-c", RUN, str(tmp_path), plant]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT) as process:
        assert process.stdout is not None
        reached_s = 0.0
        for line in process.stdout:
            reached_s = float(line)
            if reached_s >= until_s:
                break
        time.sleep(dice.uniform(0.0, 0.03))
        process.kill()
        for line in process.stdout:  # said after we stopped listening
            reached_s = float(line) if line.endswith("\n") else reached_s
    for name in PARTIAL:
        path = tmp_path / name
        assert unfinished(path) >= reached_s - BLOCK_S, (name, reached_s)
        killed = tmp_path / f"killed.{name.split('.')[1]}"  # Rerun goes by the ending
        killed.hardlink_to(path)
        assert rerun(*READ_BY_RERUN[killed.suffix], killed) == ""
        whole = recovered_name(path)
        before = recover(path, whole)
        assert verify(whole).right, verify(whole).checks
        after = read(whole)
        assert after.verdict == "incomplete"
        for column, values in before.columns.items():
            assert after.columns[column].tobytes() == values.tobytes(), column
        assert rerun(*CHECKED_BY_RERUN[whole.suffix], whole) == ""


@pytest.mark.parametrize("plant", ["bicycle", "mujoco"])
def test_wherever_a_file_of_a_run_ends_it_contradicts_nothing(tmp_path: Path, plant: str, long: bool) -> None:
    left: dict[str, bytes] = {}

    def look(time_s: float) -> None:  # what is on disk, should the run be killed now
        if time_s > 5.7 and not left:
            left.update((name, (tmp_path / "a" / name).read_bytes()) for name in PARTIAL)

    run(load("charge", ["duration_s=6.0"]), plant, folder=tmp_path / "a", progress=look)
    parts = np.linspace(0.6, 1.0, 30) if long else [0.9]
    for (name, part), k in zip(product(PARTIAL, parts), count()):
        path = tmp_path / f"{k}.{name.partition('.')[2]}"
        path.write_bytes(left[name][: int(part * len(left[name]))])
        assert unfinished(path) > 0.4
        whole = recovered_name(path)
        recover(path, whole)
        assert verify(whole).right, (part, verify(whole).checks)


def test_a_finished_file_without_the_last_poses_is_wrong(tmp_path: Path, monkeypatch) -> None:
    def shorter(posed: PosedBlock) -> PosedBlock:
        most = slice(0, -1)
        drawn = {name: getattr(posed, name)[most] for name in ("drawn", "pos_m", "quat", "shades")}
        return replace(posed, **drawn)

    for recorder in (McapRecorder, RerunRecorder):
        write = recorder.write
        monkeypatch.setattr(recorder, "write", lambda self, posed, write=write: write(self, shorter(posed)))
    run(load("paper", ["duration_s=0.3"]), "mujoco", folder=tmp_path / "a")
    for name in ("run.mcap", "run.rrd"):
        assert "poses" in [c.name for c in verify(tmp_path / "a" / name).checks if c.right is False]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_terminated_run_closes_its_files(tmp_path: Path, number: signal.Signals, code: int) -> None:
    command = [sys.executable, "-m", "mjmerge", "run", "paper", "--out", str(tmp_path / "a")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT) as process:
        watched = tmp_path / "a" / PARTIAL[0]
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and not (watched.exists() and watched.stat().st_size > 200_000):
            time.sleep(0.01)
        process.send_signal(number)
        _, error = process.communicate(timeout=60)
    assert process.returncode == code, error
    assert "Traceback" not in error
    for name in PARTIAL:
        assert unfinished(tmp_path / "a" / name) > 0.4


def test_when_space_runs_out_the_run_goes_on_and_its_files_are_readable(tmp_path: Path) -> None:
    def limit() -> None:  # a file may grow to this and no further, as on a full disk
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))

    args = ["run", "paper", "--plant", "double_integrator", "--out", str(tmp_path / "a"), "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "mjmerge", *args],
        preexec_fn=limit,
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        timeout=120,
    )
    assert done.returncode == 3, done.stderr
    assert "recorder failed" in done.stderr
    assert json.loads(done.stdout)["verdict"] == "held"
    for name in PARTIAL:
        assert unfinished(tmp_path / "a" / name) > 0.4


def test_a_folder_that_cannot_be_written_is_named_and_another_one_works(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir("/proc")  # read-only for root, too
    args = ["run", "paper", "--plant", "double_integrator", "--duration", "0.5"]
    with pytest.raises(SystemExit) as stop:
        main(args)
    assert stop.value.code == 2
    assert "cannot write to runs/paper" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main([*args, "--out", str(tmp_path / "elsewhere")])
    assert stop.value.code == 0
    assert verify(tmp_path / "elsewhere" / "run.rrd").right


def test_paths_may_have_spaces_and_letters_of_all_kinds(tmp_path: Path, monkeypatch, capsys) -> None:
    here = tmp_path / "Größe, 東京 und Raum"
    here.mkdir()
    monkeypatch.chdir(here)

    def mjmerge(*args: str) -> int:
        with pytest.raises(SystemExit) as stop:
            main(list(args))
        return int(stop.value.code or 0)

    assert mjmerge("run", "paper", "--plant", "bicycle", "--duration", "0.5", "--out", "ein Lauf") == 0
    assert {p.name for p in (here / "ein Lauf").iterdir()} >= {"run.rrd", "run.mcap"}
    for name in ("run.rrd", "run.mcap"):
        assert mjmerge("verify", f"ein Lauf/{name}") == 0
        data = (here / "ein Lauf" / name).read_bytes()
        cut = here / f"geköpft {name}"
        cut.write_bytes(data[: int(0.8 * len(data))])
        found = read(cut)
        assert not found.finished
        assert np.all(np.diff(found.ticks) == 1)
    assert mjmerge("convert", "ein Lauf", "--csv", "--out", "Tafel.csv") == 0
