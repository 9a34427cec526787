"""Proof that the gate can fail: faults sown into a copy make it fail, and it passes when they are undone.

The rows and floors themselves are in ``scenarios/*.yaml`` and are tests through the project's own pytest
plugin.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import mjmerge
from mjmerge.config import shipped
from mjmerge.gate import baseline, gate

ROWS = ("ideal", "grippy")


_KNOWN: dict[bytes, dict[str, tuple[str, ...]]] = {}


def fails(folder: Path) -> dict[str, tuple[str, ...]]:
    """The rows of a folder's gate that fail, and why; the same text runs once."""
    text = (folder / "charge.yaml").read_bytes()
    if text not in _KNOWN:
        _KNOWN[text] = _fails(folder)
    return _KNOWN[text]


def _fails(folder: Path) -> dict[str, tuple[str, ...]]:
    rows = [row for row in gate.rows([folder]) if row.check.name in ROWS]
    assert {row.check.name for row in rows} == set(ROWS)
    baselines = shipped.folder("scenarios") / "baselines"
    return {r.row.check.name: r.problems for r in gate.run(rows, baselines) if r.problems}


@pytest.fixture
def scratch(tmp_path):
    """``charge`` in a folder of its own."""
    file = tmp_path / "charge.yaml"
    shutil.copy(shipped.scenarios()["charge"], file)
    return file


def sow(file: Path, section: str, line: str) -> None:
    """Puts a key into a section of a scenario."""
    text = file.read_text(encoding="utf-8")
    head, found, tail = text.partition(f"\n{section}:")
    if found:
        rest, newline, tail = tail.partition("\n")
        file.write_text(f"{head}\n{section}:{rest}\n  {line}{newline}{tail}", encoding="utf-8")
    else:
        file.write_text(f"{text}\n{section}:\n  {line}\n", encoding="utf-8")


FAULTS = {
    "k_o lowered by a fifth": ("law", "k_o: 0.8", set(ROWS)),
    "barrier switched off": ("law", "k_o: 0", set(ROWS)),
    "steering lag doubled": ("mismatch", "steer_lag: 2", {"grippy"}),
    "a hundredth of a second more delay": ("mismatch", "command_delay_s: 0.01", set(ROWS)),
    "one sensor 2 cm off": ("mismatch", "neighbour_position_bias_m: 0.02", set(ROWS)),
}


def test_the_gate_passes_with_nothing_wrong(scratch):
    assert fails(scratch.parent) == {}


@pytest.mark.parametrize(("section", "line", "rows"), FAULTS.values(), ids=FAULTS)
def test_the_gate_fails_with_a_fault_sown_and_passes_when_it_is_undone(scratch, section, line, rows):
    good = scratch.read_bytes()
    sow(scratch, section, line)
    assert set(fails(scratch.parent)) == rows
    scratch.write_bytes(good)
    assert fails(scratch.parent) == {}


WRONG_SIGNS = {
    "in the barrier": (
        "law/opinion_dynamics/law.py",
        "barrier(law, seen.g,",
        "barrier(law, -seen.g,",
        "below the floor",
    ),
    "everywhere": (
        "law/sensed.py",
        "g = e / np.maximum(length, LEAST)[..., None]",
        "g = -e / np.maximum(length, LEAST)[..., None]",
        "off the rate of d_j",
    ),
}


@pytest.fixture
def copy(tmp_path):
    """All of the code in a folder of its own."""
    home = Path(mjmerge.__file__).parent
    shutil.copytree(home, tmp_path / "mjmerge", ignore=shutil.ignore_patterns("__pycache__"))
    for kind in ("models", "scenarios"):
        shutil.copytree(shipped.folder(kind), tmp_path / kind, dirs_exist_ok=True)
    return tmp_path


def checked(copy: Path) -> subprocess.CompletedProcess[str]:
    """Its own gate, a row of it."""
    command = [sys.executable, "-m", "mjmerge", "check", "--only", "charge, ideal"]
    environment = os.environ | {"PYTHONPATH": str(copy), "MUJOCO_GL": "disable"}
    return subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("file", "right", "wrong", "word"), WRONG_SIGNS.values(), ids=WRONG_SIGNS)
def test_the_gate_fails_when_g_has_the_wrong_sign(copy, file, right, wrong, word):
    """Everywhere: the command is even in g_j, no distance moves, and the recorded rate gives it away."""
    target = copy / "mjmerge" / file
    text = target.read_text(encoding="utf-8")
    assert text.count(right) == 1
    target.write_text(text.replace(right, wrong), encoding="utf-8")
    done = checked(copy)
    assert done.returncode == 1, done.stderr
    assert word in done.stdout


def test_the_gate_of_a_copy_in_which_nothing_was_changed_passes(copy):
    done = checked(copy)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("fault", ["mismatch.friction=0.2", "mismatch.command_delay_s=0.2"])
def test_charge_breaks_where_physics_says_so(fault):
    trace = mjmerge.simulate(mjmerge.load("charge", [fault]), "mujoco")
    (verdict,) = mjmerge.judge(trace)
    assert verdict.verdict == "assumption broken"
    assert not verdict.floor_held


def test_physics_costs_charge_less_than_3_cm_on_grippy_ground():
    known = baseline.read(shipped.folder("scenarios") / "baselines" / "charge.csv")
    ideal, real = known["ideal"][0], known["grippy"][0]
    assert real.min_d_m == pytest.approx(ideal.min_d_m, abs=0.03)
