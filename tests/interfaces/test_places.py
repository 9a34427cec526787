"""Nothing is overwritten unasked: what differs goes elsewhere, and what makes way is said."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from mjmerge.cli import main
from mjmerge.cli.places import slug
from mjmerge.config import shipped

RUN = ("run", "paper", "--plant", "double_integrator", "--duration", "0.2")
ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _elsewhere_and_quick(tmp_path, monkeypatch):
    """In an empty folder; what takes its time and is not asked about here is left out."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mjmerge.run.FORMATS", {})
    monkeypatch.setattr("mjmerge.run.overview", lambda *_, **__: None)
    monkeypatch.setattr("mjmerge.run.save", lambda _, path: path.write_text("drawn"))


def does(capsys, *args: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        main(list(args))
    return int(stop.value.code or 0), *capsys.readouterr()


def ran_in(capsys, *args: str) -> Path:
    code, out, _ = does(capsys, *args, "--json")
    assert code == 0
    return Path(json.loads(out)["run_dir"])


def contents(folder: str) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in sorted(Path(folder).rglob("*")) if p.is_file()}


def test_no_run_makes_way_for_another_one(capsys):
    plain = ran_in(capsys, *RUN)
    assert plain == Path("runs/paper-double_integrator-0")  # by contract
    seen = {plain: contents("runs")}
    others = [
        ("--set", "law.k_o=0.9"),
        ("--set", "law.k_o=0.90000000000000002", "--set", "law.k_v=1.5"),
        ("--set", "initial.ego.front_m=[-1.5, 1.3]"),
        ("--set", "initial.ego.front_m=[-1.5, 1.31]"),
        ("--set", f"law.k_p=0.7{'0' * 200}1"),
        ("--set", f"law.k_p=0.7{'0' * 200}2"),
        ("--seed", "1"),
        ("--runs", "2"),
        ("--continuous",),
        ("--duration", "0.3"),
    ]
    for more in others:
        before = contents("runs")
        folder = ran_in(capsys, *RUN, *more)
        assert folder not in seen, more
        assert {name: data for name, data in contents("runs").items() if name in before} == before, more
        seen[folder] = {}
    assert Path("runs/paper-double_integrator-0-law.k_o=0.9") in seen
    assert not any(set(folder.name) & set("[]() '\"") for folder in seen)


def test_the_same_run_again_makes_way_for_itself_and_says_so(capsys):
    for more in ((), ("--set", "law.k_o=0.9")):
        first = ran_in(capsys, *RUN, *more)
        code, _, err = does(capsys, *RUN, *more, "--json")
        assert (code, err) == (0, f"mjmerge: the earlier run in {first} was replaced\n")


def test_the_run_of_an_edited_file_leaves_that_of_the_file_as_it_was(capsys):
    text = shipped.scenarios()["paper"].read_text()
    args = ("run", "mine.yaml", *RUN[2:])
    Path("mine.yaml").write_text(text)
    first = ran_in(capsys, *args)
    before = contents(str(first))
    Path("mine.yaml").write_text(text + "\nroad: {lane_width_m: 1.3}\n")
    second = ran_in(capsys, *args)
    assert second != first
    assert contents(str(first)) == before
    assert ran_in(capsys, *args) == second


def test_what_a_killed_run_left_makes_way(capsys):
    first = ran_in(capsys, *RUN)
    (first / "summary.json").unlink()
    (first / "run.mcap.partial").write_text("half")
    assert ran_in(capsys, *RUN, "--duration", "0.3") == first


def test_one_axis_does_not_replace_another_nor_one_ladder_another(capsys):
    quick = ("sweep", "paper", "--plant", "double_integrator", "--set", "duration_s=0.2", "--workers", "1")
    searches = [
        ("--break", "mismatch.command_delay_s=0:0.1"),
        ("--break", "mismatch.command_delay_s=0:0.2"),
        ("--break", "mismatch.sensing_delay_s=0:0.1"),
        ("--break", "mismatch.sensing_delay_s=0:0.1", "--until", "floor"),
        ("--break", "mismatch.sensing_delay_s=0:0.1", "--set", "law.k_o=0.9"),
    ]
    places = set()
    for search in searches:
        before = contents("breaking") if places else {}
        code, out, _ = does(capsys, *quick, *search, "--json")
        assert code == 0
        places.add(json.loads(out)["out"])
        assert {name: data for name, data in contents("breaking").items() if name in before} == before
    assert len(places) == len(searches)
    assert "was replaced" in does(capsys, *quick, *searches[0])[2]


def test_names_of_folders_tell_apart_what_they_stand_for():
    words = [
        "law.k_o=1",
        "law.k_o=10",
        "a=[1, 2]",
        "a=[1,2]",
        "a=(1, 2)",
        "x" * 300,
        "x" * 301,
        "a/b",
        "a_b",
        "-a",
    ]
    found = {slug(word) for word in words} | {slug("a", "b"), slug("a b")}
    assert len(found) == len(words) + 2
    assert slug() == slug("") == ""
    assert all(len(name) < 120 and "/" not in name for name in found)


def test_git_sees_nothing_of_what_commands_leave():
    left = [
        "runs/a/run.rrd", "sweeps/a/table.parquet", "ladders/a/ladder.md", "breaking/a/breaking.md",
        "identified/rc/table.md", "reproduced/facts.md", "compared/figure.png", "a.csv.partial",
        "run.recovered.mcap", "run.recovered.rrd", "mjmerge-error-20260101-120000-1.txt",
    ]  # fmt: skip
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout")
    done = subprocess.run(
        ["git", "check-ignore", *left], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == left
    tracked = ["git", "ls-files", "-i", "-c", "--exclude-standard"]
    assert subprocess.run(tracked, cwd=ROOT, capture_output=True, text=True, check=True).stdout == ""
