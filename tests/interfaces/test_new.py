"""``mjmerge new``: what it writes works as it stands, and it never writes over anything."""

import json
import tomllib
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.config.meanings import meanings
from mjmerge.scenario.cars import data_sheet
from mjmerge.starts.make import KINDS
from mjmerge.vehicle.datasheet import DataSheet


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def mjmerge(capsys, *args):
    """Runs a command; gives its exit code and what it printed."""
    with pytest.raises(SystemExit) as end:
        main([str(a) for a in args])
    return int(end.value.code or 0), *capsys.readouterr()


def test_a_new_car_is_accepted_and_drives_as_it_stands(capsys, elsewhere):
    code, out, err = mjmerge(capsys, "new", "car", "mine")
    assert (code, err) == (0, "")
    assert "mjmerge run paper --set models.ego=./mine" in out
    assert {p.name for p in (elsewhere / "mine").iterdir()} == {
        "README.md",
        "datasheet.yaml",
        "mine.xml",
        "parts.xml",
    }
    code, out, _ = mjmerge(capsys, "identify", "./mine", "--json")
    assert code == 0
    assert json.loads(out)["passed"] is True
    command = ("run", "paper", "--set", "models.ego=./mine", "--duration", 2, "--no-record", "--json")
    code, out, _ = mjmerge(capsys, *command)
    assert code == 0
    assert json.loads(out)["min_distance_m"]["vehicle_1"] > 0.5


def test_a_new_car_is_whole_wherever_it_is_carried(capsys, elsewhere):
    mjmerge(capsys, "new", "car", "mine")
    assert ".." not in (elsewhere / "mine" / "mine.xml").read_text().replace("...", "")
    (elsewhere / "deep" / "down").mkdir(parents=True)
    (elsewhere / "mine").rename(elsewhere / "deep" / "down" / "mine")
    assert (
        mjmerge(capsys, "export", "paper", "--set", "models.ego=deep/down/mine", "--out", "world.xml")[0] == 0
    )


def test_its_data_sheet_has_every_key_with_its_meaning_and_unit(capsys, elsewhere):
    mjmerge(capsys, "new", "car", "mine")
    text = (elsewhere / "mine" / "datasheet.yaml").read_text()
    assert list(YAML(typ="safe").load(text)) == list(DataSheet.model_fields) == list(meanings(DataSheet))
    for name, meaning in meanings(DataSheet).items():
        above, _, _ = text.partition(f"\n{name}:")
        assert " ".join(meaning.split()) in " ".join(above.replace("#", " ").split())
    new, like = data_sheet("./mine"), data_sheet("rc")
    assert new.model_copy(update={"description": like.description}) == like


def test_a_new_scenario_runs_and_its_floor_holds(capsys, long):
    code, out, _ = mjmerge(capsys, "new", "scenario", "mine", "--json")
    assert code == 0
    assert json.loads(out)["path"] == "mine.yaml"
    code, out, _ = mjmerge(capsys, "run", "mine.yaml", "--plant", "bicycle", "--no-record", "--json")
    assert code == 0
    assert json.loads(out)["merged_at_s"] > 5
    if long:
        assert mjmerge(capsys, "check", "mine.yaml", "--update")[0] == 0
        assert mjmerge(capsys, "check", "mine.yaml")[0] == 0


def test_a_new_campaign_is_a_plan_of_runs(capsys):
    mjmerge(capsys, "new", "campaign", "mine")
    from mjmerge.sweep.campaign import plan

    assert len(plan("mine.yaml").cases) == 12


@pytest.mark.parametrize("kind", KINDS)
def test_json_is_one_object_with_what_was_written_and_what_comes_next(capsys, kind):
    code, out, err = mjmerge(capsys, "new", kind, "mine", "--out", "there", "--json")
    assert (code, err, out.count("\n")) == (0, "", 1)
    told = json.loads(out)
    assert told["kind"] == kind
    assert told["name"] == "mine"
    assert all(Path(file).is_file() for file in told["files"])
    assert all("there/mine" in command for command in told["next"])


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_there_is_never_overwritten(capsys, elsewhere, kind):
    mjmerge(capsys, "new", kind, "mine")
    before = {p: p.read_bytes() for p in elsewhere.rglob("*") if p.is_file()}
    code, out, err = mjmerge(capsys, "new", kind, "mine")
    assert (code, out) == (2, "")
    assert "mine" in err
    assert "exists, and nothing is overwritten" in err
    assert {p: p.read_bytes() for p in elsewhere.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize(
    "name", ["", "../mine", "a/b", "1st", ".hidden", "-x", "my car", "käfer", "x" * 65, "a&b", "a\nb"]
)
def test_a_name_that_can_be_none_is_refused_with_what_can(capsys, elsewhere, name):
    code, out, err = (
        mjmerge(capsys, "new", "car", "--", name)
        if name.startswith("-")
        else mjmerge(capsys, "new", "car", name)
    )
    assert (code, out) == (2, "")
    assert "letters, digits, _ and -" in err or "nrecognized" in err
    assert list(elsewhere.iterdir()) == []


@pytest.mark.parametrize(("kind", "shipped"), [("car", shipped.models), ("scenario", shipped.scenarios)])
def test_the_name_of_something_shipped_is_refused(capsys, elsewhere, kind, shipped):
    code, _, err = mjmerge(capsys, "new", kind, next(iter(shipped())))
    assert code == 2
    assert "mjmerge ships: choose another name" in err
    assert list(elsewhere.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_named_and_nothing_is_left(capsys, elsewhere):
    (elsewhere / "file").write_text("not a folder")
    code, _, err = mjmerge(capsys, "new", "car", "mine", "--out", "file")
    assert code == 2
    assert "cannot write file/mine" in err
    assert [p.name for p in elsewhere.iterdir()] == ["file"]


def test_the_schema_of_a_data_sheet_is_printed_and_knows_every_key(capsys):
    code, out, _ = mjmerge(capsys, "schema", "datasheet")
    assert code == 0
    assert list(json.loads(out)["properties"]) == list(DataSheet.model_fields)


def test_the_texts_of_the_starts_are_in_the_wheel():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    assert project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == ["mjmerge"]
    starts = (Path(__file__).parents[2] / "mjmerge" / "starts").iterdir()
    assert {p.name for p in starts if p.is_file() and p.suffix != ".py"} == {
        "car.md",
        "car.xml",
        "driver.txt",
        "law.txt",
        "metric.txt",
        "campaign.yaml",
        "scenario.yaml",
    }
