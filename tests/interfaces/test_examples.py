"""The scripts under ``examples/`` run as they stand, and print what they say."""

from __future__ import annotations

import runpy
import warnings
from pathlib import Path

import pytest

from mjmerge.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"


def said(name: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """What a script prints, line by line."""
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return capsys.readouterr().out.splitlines()


def test_none_is_left_out():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {
        "dead_time.py", "learn_to_merge.py", "many_neighbours.py", "read_a_recording.py",
    }  # fmt: skip


def test_dead_time_takes_the_margin_away(capsys):
    rows = said("dead_time.py", capsys)
    assert len(rows) == 6
    assert rows[0].endswith("held")
    assert rows[-1].endswith("assumption broken")


def test_what_is_learned_in_a_few_generations_beats_chance(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["learn_to_merge.py", "8"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of cma, about what it could do besides
        rows = dict(row.split(": ") for row in said("learn_to_merge.py", capsys))
    assert float(rows["learned"].partition(",")[0]) > float(rows["chance"]) + 1


def test_more_and_more_neighbours(capsys):
    rows = said("many_neighbours.py", capsys)
    assert [row.split()[0] for row in rows] == ["2", "3", "4", "5", "6"]
    assert all("safe" in row for row in rows)


def test_a_recording_is_read(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["run", "charge", "--set", "duration_s=0.2", "--out", "runs/charge-mujoco-0"])
    capsys.readouterr()
    monkeypatch.setattr("sys.argv", ["read_a_recording.py"])
    rows = said("read_a_recording.py", capsys)
    assert [row.split(":")[0] for row in rows] == ["vehicle_1", "vehicle_2"]
