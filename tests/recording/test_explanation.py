"""Why a run fails is in its report, its recordings and its folder; and what is meant by any of these."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from mjmerge.cli import main
from mjmerge.errors import MjmergeError
from mjmerge.record import content, report
from mjmerge.record.content import ContentError
from mjmerge.record.read import read
from mjmerge.record.rerun.reader import rrd_batches
from mjmerge.review.convert import to_parquet
from mjmerge.review.explained import explained
from mjmerge.review.folder import beside, verify_run
from mjmerge.review.verify import Verified
from mjmerge.run import FinishedRun, run
from mjmerge.scenario.load import load
from mjmerge.search.explain import as_json
from mjmerge.search.meant import meant

UNSAFE = ("duration_s=5", "control_step_s=0.02", "law.k_o=0")
CHARGES = "Vehicle 2 goes to a gap of 1.645 m at 3.939 s, in 1.181 s"


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    folder = tmp_path_factory.mktemp("one") / "charge"
    return run(load("charge", UNSAFE), "double_integrator", folder=folder, explain=True)


@pytest.fixture(scope="module")
def folder(done: FinishedRun) -> Path:
    return Path(done.summary["run_dir"])


@pytest.fixture(scope="module")
def verified(folder: Path) -> Verified:
    return verify_run(folder)


def ended(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(list(arguments))
    assert isinstance(end.value.code, int)
    return end.value.code


def report_of(rrd: Path) -> str:
    shown = [
        batch["TextDocument:text"].to_pylist()[-1][0]
        for entity, batch in rrd_batches(rrd)
        if entity == "/run/report" and "TextDocument:text" in batch.schema.names
    ]
    return str(shown[-1])


def test_it_is_the_same_in_the_run_its_folder_both_recordings_and_the_report(done, folder, verified):
    assert done.explanation is not None
    said = as_json(done.explanation)
    assert said["needs"] == [CHARGES]
    assert done.failures == []
    assert "explanation" not in done.summary
    assert json.loads((folder / "explanation.json").read_text()) == said
    for name in ("run.mcap", "run.rrd"):
        assert read(folder / name, wary=False).explanation == said
    assert verified.right
    assert {"explanation", "explanation.json"} <= {check.name for check in verified.checks}
    text = report_of(folder / "run.rrd")
    section = "\n".join(report.why(said))
    assert section in text
    assert f"| {CHARGES} | 0." in section
    assert text.index("**Verdict") < text.index("#### Why") < text.index(report.LEGEND)
    assert section in report.of(["charge on bicycle"], "", {}, None, said)


def test_nobody_asked_or_it_is_safe_and_nothing_is_said(tmp_path):
    found = run(load("charge", ["duration_s=0.2"]), "bicycle", folder=tmp_path / "a", explain=True)
    assert found.explanation is None
    assert not (tmp_path / "a" / "explanation.json").exists()
    assert read(tmp_path / "a" / "run.mcap", wary=False).explanation is None
    assert "#### Why" not in report_of(tmp_path / "a" / "run.rrd")


def test_of_several_runs_the_worst_is_explained(tmp_path):
    keys = [*UNSAFE, "mismatch.position_noise_m=0.01"]
    found = run(load("charge", keys), "double_integrator", runs=3, folder=tmp_path / "a", explain=True)
    assert found.explanation is not None
    assert found.explanation.seed == found.summary["worst_seed"]
    worst, median = (read(tmp_path / "a" / name, wary=False) for name in ("run.mcap", "median.rrd"))
    assert worst.explanation == as_json(found.explanation)
    assert median.explanation is None
    run_ = meant(str(tmp_path / "a"))
    assert (run_.seed, run_.runs, run_.plant) == (found.summary["worst_seed"], 3, "double_integrator")
    assert run_.min_distance_m == found.explanation.margin.min_distance_m


def without(folder: Path) -> None:
    (folder / "explanation.json").unlink()


def other(folder: Path) -> None:
    path = folder / "explanation.json"
    path.write_text(path.read_text().replace("safe", "fine"))


def none(folder: Path) -> None:
    (folder / "explanation.json").write_text("{}")


@pytest.mark.parametrize("damage", [without, other, none])
def test_a_folder_that_explains_otherwise_than_its_recording_is_wrong(damage, folder, tmp_path, verified):
    there = shutil.copytree(folder, tmp_path / "there")
    damage(there)
    moved = replace(verified, recorded=replace(verified.recorded, path=there / "run.mcap"))
    assert [check.name for check in beside(moved) if check.right is False] == ["explanation.json"]


def change(key: str, value: Any) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda said: said | {key: value}


@pytest.mark.parametrize(
    "lie",
    [
        change("seed", 1),
        change("plant", "bicycle"),
        change("margin_m", 0.1),
        change("kind", "touch"),
        change("broken", []),
        change("needs", []),
        change("unsafe_at_s", 4.0),
    ],
)
def test_an_explanation_of_another_run_is_wrong(lie, folder):
    found = read(folder / "run.mcap", wary=False)
    trace = found.run()
    (right,) = explained(found, trace)
    assert right.right
    (check,) = explained(replace(found, explanation=lie(dict(found.explanation))), trace)
    assert check.right is False
    (early,) = explained(replace(found, verdict=None), trace)
    assert early.right is False


@pytest.mark.parametrize("text", ["[]", "{}", '{"table": 5}', "nan", '{"scenario": 1}'])
def test_what_is_no_explanation_is_unreadable(text):
    with pytest.raises(ContentError, match=r"explanation\.json"):
        content.explanation_of(text)


def test_a_table_keeps_it(folder, tmp_path):
    found = read(folder / "run.mcap", wary=False)
    to_parquet(found, tmp_path / "a.parquet")
    about = pq.read_schema(tmp_path / "a.parquet").metadata
    assert json.loads(about[b"mjmerge.explanation"]) == found.explanation


def test_the_command_says_the_same_of_the_folder_and_of_a_recording(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    said = json.loads((folder / "explanation.json").read_text())
    for what in (folder, folder / "run.mcap"):
        assert ended("explain", str(what), "--workers", "1", "--json") == 1
        out, err = capsys.readouterr()
        assert json.loads(out) == said
        assert err == ""
    shutil.copytree(folder, tmp_path / "runs" / "before")
    assert ended("explain", "before", "--workers", "1") == 1
    assert "charge on double_integrator, seed 0" in capsys.readouterr().out
    assert ended("explain", str(folder / "run.mcap"), "--workers", "1", "--set", "law.k_o=1") == 0
    assert "it is safe" in capsys.readouterr().out
    assert not [p for p in tmp_path.iterdir() if p.name != "runs"]


def test_run_says_it_too(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    keys = [word for key in UNSAFE for word in ("--set", key)]
    words = ("run", "charge", "--plant", "double_integrator", "--no-record", "--explain", *keys)
    assert ended(*words) == 1
    out = capsys.readouterr().out
    assert "why the run fails:" in out
    assert f"needs:  {CHARGES}" in out
    assert ended(*words, "--json") == 1
    assert json.loads(capsys.readouterr().out)["explanation"]["needs"] == [CHARGES]
    short = ("run", "charge", "--plant", "double_integrator", "--no-record", "--explain", "--duration", "1")
    assert ended(*short) == 0
    assert "the run is safe: there is nothing to explain" in capsys.readouterr().out


def damaged(folder: Path) -> None:
    (folder / "summary.json").write_text("{}")


def not_a_plant(folder: Path) -> None:
    path = folder / "summary.json"
    path.write_text(path.read_text().replace('"double_integrator"', '"tram"'))


@pytest.mark.parametrize(
    ("damage", "says"), [(damaged, "does not say what the run was"), (not_a_plant, "'tram'")]
)
def test_a_folder_that_does_not_say_what_it_was_is_bad_input(damage, says, folder, tmp_path, capsys):
    there = shutil.copytree(folder, tmp_path / "there")
    damage(there)
    assert ended("explain", str(there)) == 2
    assert says in capsys.readouterr().err


def test_what_is_no_run_is_bad_input(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "no.mcap").write_text("no")
    for what, says in (
        ("empty", "is not the folder of a run: there is no scenario.yaml in it"),
        ("no.mcap", "neither a Rerun nor an MCAP recording"),
        ("none.rrd", "there is no recording of that name"),
        ("none.yaml", "none.yaml"),
    ):
        assert ended("explain", str(tmp_path / what)) == 2
        assert says in capsys.readouterr().err


def test_what_was_not_finished_says_in_its_recording_what_it_was_and_a_finding_says_nothing(folder, tmp_path):
    there = shutil.copytree(folder, tmp_path / "there")
    (there / "summary.json").unlink()
    assert meant(str(there)).plant == "double_integrator"
    for name in ("run.mcap", "run.rrd"):
        (there / name).unlink()
    found = meant(str(there))
    assert (found.plant, found.seed, found.scenario.name) == ("mujoco", 0, "there")


def test_another_version_of_the_run_is_told(folder, tmp_path, capsys):
    there = shutil.copytree(folder, tmp_path / "there")
    path = there / "scenario.yaml"
    path.write_text(path.read_text().replace("gap_m: 1.645", "gap_m: 1.65"))
    assert ended("explain", str(there), "--workers", "1") == 1
    assert "this is another run" in capsys.readouterr().err


OWN = """
from mjmerge.drivers import Driver
class Own(Driver):
    kind: str
    def acceleration_mps2(self, time_s, own, leader, drawn, hold_s=0.0):
        return 0 * own.speed_mps
"""


def test_code_from_outside_is_run_from_a_folder_and_never_from_a_recording(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    scenario = load("charge", ["duration_s=0.1", "drivers.vehicle_2={kind: 'own.py:Own'}"])
    run(scenario, "double_integrator", folder=tmp_path / "a")
    monkeypatch.chdir(tmp_path / "a")
    assert meant(str(tmp_path / "a")).scenario.drivers == scenario.drivers
    with pytest.raises(MjmergeError, match=r"own\.py:Own is in it and is never run from it"):
        meant(str(tmp_path / "a" / "run.mcap"))
