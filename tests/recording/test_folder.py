"""``mjmerge verify FOLDER``: no file of a run folder contradicts another and is called right."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mjmerge.cli import main
from mjmerge.errors import UnreadableError
from mjmerge.review.folder import beside, verify_run
from mjmerge.review.verify import Verified, verify
from mjmerge.run import run
from mjmerge.scenario.load import load

NOISE = "mismatch.neighbour_position_noise_m=0.02"
SHORT = "duration_s=0.2"


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("one")
    run(load("charge", [SHORT, NOISE]), "bicycle", folder=folder)
    return folder


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("many")
    run(
        load("charge", [SHORT, NOISE, "expect.min_distance_m.at_least=9"]),
        "mujoco",
        runs=5,
        seed=3,
        folder=folder,
    )
    return folder


def wrong(folder: Path) -> dict[str, str]:
    return {check.name: check.says for check in verify_run(folder).checks if check.right is False}


def summary(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        found = json.loads((folder / "summary.json").read_text())
        change(found)
        (folder / "summary.json").write_text(json.dumps(found))

    return damage


def text(name: str, old: str, new: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        there = (folder / name).read_text()
        assert old in there
        (folder / name).write_text(there.replace(old, new, 1))

    return damage


DAMAGES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "no summary": ("summary.json", lambda folder: (folder / "summary.json").unlink()),
    "summary is null": ("summary.json", lambda folder: (folder / "summary.json").write_text("null")),
    "summary is cut off": ("summary.json", lambda folder: (folder / "summary.json").write_text('{"runs":')),
    "summary is no text": ("summary.json", lambda folder: (folder / "summary.json").write_bytes(b"\xff\xfe")),
    "another verdict": ("summary.json", summary(lambda s: s.update(verdict="held", verdicts={"held": 1}))),
    "a number of an entry": ("summary.json", summary(lambda s: s["decision"].update(least_z=9.0))),
    "another distance": (
        "summary.json",
        summary(lambda s: s["min_distance_m"].update(vehicle_1=9, vehicle_2=9)),
    ),
    "an entry is gone": ("summary.json", summary(lambda s: s.pop("hypotheses"))),
    "the verdict is gone": ("summary.json", summary(lambda s: s.pop("verdict"))),
    "an entry more": ("summary.json", summary(lambda s: s.update(certified=True))),
    "runs is a text": ("summary.json", summary(lambda s: s.update(runs="1"))),
    "more runs": ("summary.json", summary(lambda s: s.update(runs=s["runs"] + 1))),
    "another seed": ("summary.json", summary(lambda s: s.update(seed=40, worst_seed=40))),
    "floor": ("summary.json", summary(lambda s: s.update(floor_held=not s["floor_held"]))),
    "no scenario": ("scenario.yaml", lambda folder: (folder / "scenario.yaml").unlink()),
    "another law": ("scenario.yaml", text("scenario.yaml", "k_o:", "k_o: 1 #")),
}
RECORDINGS: dict[str, Callable[[Path], object]] = {
    "another run's": lambda folder: _another(folder),
    "cut off": lambda folder: (folder / "run.rrd").write_bytes((folder / "run.rrd").read_bytes()[:-4000]),
    "nothing in it": lambda folder: (folder / "run.rrd").write_bytes(b"RRF2"),
}


def _another(folder: Path) -> None:
    """A right recording of another run."""
    run(load("charge", [SHORT, "law.k_o=0"]), "bicycle", folder=folder / "again")
    shutil.copy(folder / "again" / "run.rrd", folder / "run.rrd")


@pytest.mark.parametrize("which", ["one", "many"])
def test_what_a_run_left_is_right(which, request):
    found = verify_run(request.getfixturevalue(which))
    assert found.right, wrong(found.recorded.path.parent)
    names = [check.name for check in found.checks]
    assert {"run.rrd", "scenario.yaml", "summary.json"} <= {*names}
    assert ("world.xml" in names and any("violation" in n for n in names)) == (which == "many")
    assert names[-1] == "not derived"


def test_of_two_runs_the_median_is_the_worst_and_is_not_recorded_twice(tmp_path):
    run(load("charge", [SHORT]), "double_integrator", runs=2, folder=tmp_path)
    assert not (tmp_path / "median.rrd").exists()
    assert wrong(tmp_path) == {}


@pytest.fixture(scope="module")
def verified(one: Path, many: Path) -> dict[str, Verified]:
    return {"one": verify(one / "run.mcap"), "many": verify(many / "run.mcap")}


def copied(folder: Path, to: Path, first: Verified) -> Verified:
    """The folder's files but for its recordings, and the recording as if it were there."""
    shutil.copytree(folder, to, ignore=shutil.ignore_patterns("*.rrd", "*.mcap"))
    return replace(first, recorded=replace(first.recorded, path=to / "run.mcap"))


@pytest.mark.parametrize("which", ["one", "many"])
@pytest.mark.parametrize("name", DAMAGES)
def test_a_file_that_contradicts_the_recording_is_wrong(which, name, request, tmp_path, verified):
    first = copied(request.getfixturevalue(which), tmp_path / "run", verified[which])
    assert all(check.right for check in beside(first))
    file, damage = DAMAGES[name]
    damage(tmp_path / "run")
    assert [check.name for check in beside(first) if not check.right] == [file]


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_recording_that_contradicts_another_is_wrong(name, one, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(one, folder)
    RECORDINGS[name](folder)
    assert [*wrong(folder)] == ["run.rrd"]


def test_another_seed_is_expected_of_another_recording(many, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(many, folder, ignore=shutil.ignore_patterns("violation*", "run.rrd"))
    shutil.copy(many / "run.rrd", folder / "median.rrd")
    assert [*wrong(folder)] == ["median.rrd"]


def test_what_a_summary_says_of_many_runs_agrees_with_the_worst_and_with_itself(many, tmp_path, verified):
    folder = tmp_path / "run"
    first = copied(many, folder, verified["many"])

    def says(**entries):
        summary(lambda s: s.update(entries))(folder)
        return {check.name: check.says for check in beside(first) if not check.right}["summary.json"]

    assert "the worst run's is not" in says(floor_held=True, floor_held_runs=5)
    assert "its verdicts are" in says(floor_held=False, floor_held_runs=0, verdict="refuted")
    text("world.xml", "<mujoco", "<!-- mine --><mujoco")(folder)
    assert [check.name for check in beside(first) if not check.right] == ["world.xml", "summary.json"]


def test_the_command_looks_at_all_of_a_folder_and_a_folder_without_recording_is_unreadable(
    one, tmp_path, capsys
):
    folder = tmp_path / "run"
    shutil.copytree(one, folder)
    (folder / "summary.json").unlink()
    with pytest.raises(SystemExit) as end:
        main(["verify", str(folder), "--json"])
    assert end.value.code == 1
    assert json.loads(capsys.readouterr().out)["right"] is False
    with pytest.raises(SystemExit) as end:
        main(["verify", str(folder / "run.mcap"), "--json"])
    assert end.value.code == 0
    for name in ("run.mcap", "run.rrd"):
        (folder / name).unlink()
    with pytest.raises(UnreadableError, match="no recording in that folder"):
        verify_run(folder)
