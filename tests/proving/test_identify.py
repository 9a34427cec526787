"""`mjmerge identify` as other programs rely on it: exit codes, one JSON object, its folder, what it keeps."""

from __future__ import annotations

import csv
import json
import shutil

import pytest

from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.proving.report import FILES
from mjmerge.vehicle.acceptance import FILE, acceptance


def identify(capsys, *args: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        main(["identify", *args])
    out, err = capsys.readouterr()
    return stop.value.code or 0, out, err


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_sound_car_ends_with_0_a_table_and_its_plots(capsys, tmp_path):
    code, out, _ = identify(capsys, "rc")
    assert code == 0
    assert "understeer gradient" in out
    folder = tmp_path / "identified" / "rc"
    assert {p.name for p in folder.iterdir()} == set(FILES)
    with (folder / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {"effective mass", "steering lag", "wheelbase seen by yaw"} <= {row["name"] for row in rows}
    assert all(row["passed"] in ("True", "") for row in rows)
    assert (folder / "cornering.png").read_bytes().startswith(b"\x89PNG")


def test_a_car_that_does_not_drive_as_its_data_sheet_says_ends_with_1_and_is_stored_as_failed(
    capsys, tmp_path
):
    shutil.copytree(shipped.folder("models"), tmp_path / "models")
    car = tmp_path / "models" / "rc"
    data_sheet = (car / "datasheet.yaml").read_text()
    (car / "datasheet.yaml").write_text(data_sheet.replace("steer_lag_s: 0.016", "steer_lag_s: 0.05"))
    code, out, _ = identify(capsys, str(car), "--out", "found", "--json", "--accept")
    found = json.loads(out)
    assert code == 1
    assert out.count("\n") == 1
    assert found["passed"] is False
    wrong = [row["name"] for row in found["table"] if row["passed"] is False]
    assert wrong == ["steering lag"]
    assert acceptance(car).state == "failed"
    assert list(acceptance(car).failed) == wrong
    assert (car / FILE).is_file()


def test_a_car_that_is_not_as_heavy_as_its_data_sheet_says_is_refused_with_both_numbers(capsys, tmp_path):
    shutil.copytree(shipped.folder("models"), tmp_path / "models")
    car = tmp_path / "models" / "rc"
    data_sheet = (car / "datasheet.yaml").read_text()
    (car / "datasheet.yaml").write_text(data_sheet.replace("mass_kg: 3.74", "mass_kg: 4.1"))
    code, out, err = identify(capsys, str(car), "--json", "--accept")
    assert (code, out) == (2, "")
    assert "the mass of all bodies is 3.74 kg; datasheet.yaml says mass_kg: 4.1" in err
    assert acceptance(car).state == "stale"


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["sedna"], "did you mean 'sedan'?"),
        (["models/none"], "no car model called"),
        (["rc", "--out", "mine"], "--out"),
    ],
)
def test_bad_input_ends_with_2_before_anything_is_driven(capsys, tmp_path, args, says):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work")
    code, _, err = identify(capsys, *args)
    assert code == 2
    assert says in err
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["thesis.tex"]


def test_a_car_without_a_wheel_is_refused_by_name_and_leaves_nothing_behind(capsys, tmp_path):
    shutil.copytree(shipped.folder("models"), tmp_path / "models")
    car = tmp_path / "models" / "rc"
    text = (car / "rc.xml").read_text()
    assert text.count('name="tyre_rear_left"') == 1
    (car / "rc.xml").write_text(text.replace('name="tyre_rear_left"', 'name="tyre_rear_lift"'))
    code, _, err = identify(capsys, str(car))
    assert code == 2
    assert "did you mean 'tyre_rear_left'?" in err or "tyre_rear_left" in err
    assert not (tmp_path / "identified").exists()
