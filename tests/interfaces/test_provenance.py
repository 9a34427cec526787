"""A verdict says what is known of the cars that it stands on."""

import shutil

import pytest

from mjmerge.config import shipped
from mjmerge.run import run
from mjmerge.scenario.load import load


@pytest.fixture
def own(tmp_path):
    """A copy of the rc, and a scenario with it as the ego."""
    folder = tmp_path / "own"
    shutil.copytree(shipped.models()["rc"], folder)
    shutil.copytree(shipped.folder("models") / "parts", tmp_path / "parts")
    (folder / "rc.xml").rename(folder / "own.xml")
    return folder


def summary(folder, plant="mujoco"):
    return run(load("paper", [f"models.ego={folder}", "duration_s=0.2"]), plant, record=False).summary


def test_a_car_that_was_never_measured_is_named(own):
    (own / "acceptance.json").unlink(missing_ok=True)
    found = summary(own)
    assert found["acceptance"]["own"]["state"] == "missing"
    assert found["verdict_doubts"] == ["own has never passed acceptance tests"]


def test_a_car_that_was_edited_since_is_named(own):
    assert (own / "acceptance.json").exists()
    sheet = own / "datasheet.yaml"
    sheet.write_text(sheet.read_text() + "# edited\n")
    found = summary(own)
    assert found["acceptance"]["own"]["state"] == "stale"
    assert found["verdict_doubts"] == ["own was edited after its acceptance tests"]


@pytest.mark.parametrize("name", sorted(shipped.models()))
def test_the_shipped_cars_are_accepted(name):
    from mjmerge.vehicle.acceptance import acceptance

    assert acceptance(shipped.models()[name]).state == "passed"


def test_a_run_without_physical_cars_asks_for_no_acceptance(own):
    assert summary(own, "bicycle")["acceptance"] == {}
