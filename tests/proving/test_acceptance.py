"""What is stored of a model's acceptance, and when it no longer counts."""

import json
import math
import shutil

import numpy as np
import pytest

from mjmerge.config import shipped
from mjmerge.vehicle.acceptance import FILE, Measured, acceptance, fingerprint, store

GOOD = Measured("mass", "kg", 1.001, 1.0, 0.01, "scales")
BAD = Measured("radius", "m", 0.3, 0.2, 0.01, "ruler")
OPEN = Measured("colour", "", 3.0, None, None, "eye")


@pytest.fixture
def folder(tmp_path):
    """A copy of a shipped model with the parts it shares."""
    shutil.copytree(shipped.folder("models"), tmp_path / "models")
    found = tmp_path / "models" / "rc"
    (found / FILE).unlink(missing_ok=True)
    return found


@pytest.mark.parametrize(
    ("row", "passed"),
    [
        (GOOD, True),
        (BAD, False),
        (OPEN, None),
        (Measured("creep", "mm/s", math.nan, 0.0, 0.1, ""), False),
        (Measured("creep", "mm/s", -0.1, 0.0, 0.1, ""), True),
        (Measured("rate", "rad/s", 1.0, 2.0, None, ""), None),
    ],
)
def test_a_row_passes_within_its_tolerance_and_not_without_a_number(row, passed):
    assert row.passed is passed


def test_a_row_of_numpy_numbers_fails_like_any_other():
    row = Measured("mass", "kg", np.float64(2.0), np.float64(1.0), np.float64(0.1), "scales")
    assert row.passed is False


def test_how_far_off_is_a_part_of_what_was_expected():
    assert GOOD.off == pytest.approx(0.001)
    assert OPEN.off is None
    assert Measured("creep", "mm/s", 0.05, 0.0, 0.1, "").off is None


@pytest.mark.parametrize(("table", "state"), [([GOOD, OPEN], "passed"), ([GOOD, BAD], "failed")])
def test_what_is_stored_is_found_again(folder, table, state):
    assert acceptance(folder).state == "missing"
    assert "never" in acceptance(folder).sentence
    store(folder, table, {"mujoco": "3.17.0"})
    found = acceptance(folder)
    assert found.state == state
    assert found.versions == (("mujoco", "3.17.0"),)
    assert found.failed == (("radius",) if state == "failed" else ())
    assert ("radius" in found.sentence) == (state == "failed")


@pytest.mark.parametrize("edited", ["rc/rc.xml", "rc/datasheet.yaml", "parts/car.xml"])
def test_a_car_that_was_edited_since_is_stale_even_in_a_part_it_shares(folder, edited):
    store(folder, [GOOD], {})
    file = folder.parent / edited
    file.write_text(file.read_text() + "\n")
    assert acceptance(folder).state == "stale"
    assert "edited" in acceptance(folder).sentence


def test_a_car_whose_meshes_are_in_a_folder_of_their_own_is_stale_when_one_of_them_changes(folder):
    mjcf, mesh = folder / "rc.xml", folder / "shapes" / "shell.obj"
    mesh.parent.mkdir()
    mesh.write_text("v 0 0 0\n")
    parts = """<include file="../parts/car.xml"/>"""
    asset = """<!-- file="gone.obj" --><compiler meshdir="shapes"/>
    <asset><mesh name="m" file="shell.obj"/></asset>"""
    mjcf.write_text(mjcf.read_text().replace(parts, parts + asset))
    store(folder, [GOOD], {})
    assert acceptance(folder).state == "passed"
    mesh.write_text("v 1 1 1\n")
    assert acceptance(folder).state == "stale"


def test_the_fingerprint_is_of_the_files_and_not_of_where_they_are(folder):
    assert fingerprint(folder) == fingerprint(shipped.model_folder("rc"))
    (folder / "README.md").write_text("other words")
    assert fingerprint(folder) == fingerprint(shipped.model_folder("rc"))


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"table": 3}', "\x00"])
def test_a_file_that_says_nothing_counts_as_missing(folder, content):
    (folder / FILE).write_text(content)
    assert acceptance(folder).state == "missing"


def test_numbers_are_stored_as_json_knows_them(folder):
    store(folder, [GOOD], {})
    (row,) = json.loads((folder / FILE).read_text())["table"]
    assert row["measured"] == 1.001
    assert row["passed"] is True
