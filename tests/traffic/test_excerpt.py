"""A driver can name a road user in a file: its motion is read when the scenario is, and stays in it."""

import json

import numpy as np
import pytest

import mjmerge
from mjmerge.errors import ScenarioError
from mjmerge.scenario.load import dump, json_schema, load
from tests.traffic.files import LANE_M, changing, commonroad, ngsim, steady

KEYS = """\
duration_s: 2
initial:
  ego: {front_m: [-20.0, 4.0], speed_mps: 10.0}
  vehicle_1: {front_m: [0.0, 0.0], speed_mps: 10.0}
  vehicle_2: {front_m: [-40.0, 0.0], speed_mps: 10.0}
law: {r_m: 4.9, r_rho_m: -10, r_eta_m: 4.0}
drivers:
  vehicle_1: {kind: steady, speed_mps: 10.0}
  vehicle_2:
    kind: recorded
    file: a.xml
    car: 12
"""


@pytest.fixture
def folder(tmp_path):
    cars = [steady("12", 30.0, 10.0, first=5, steps=40), changing("13", 0.0, 10.0, 0.0, LANE_M, first=5)]
    (tmp_path / "a.xml").write_text(commonroad(cars), encoding="utf-8")
    (tmp_path / "a.csv").write_text(ngsim(cars), encoding="utf-8")
    (tmp_path / "s.yaml").write_text(KEYS)
    return tmp_path


def driver(folder, *overrides):
    return mjmerge.load(folder / "s.yaml", list(overrides)).drivers.vehicle_2


def test_the_motion_is_that_of_the_file_from_the_time_that_is_asked_for(folder):
    whole, later = driver(folder), driver(folder, "drivers.vehicle_2.from_s=1.5")
    np.testing.assert_allclose(whole.time_s, np.arange(40) * 0.1, atol=1e-9)
    np.testing.assert_allclose(whole.travelled_m, np.arange(40.0), atol=1e-5)
    np.testing.assert_allclose(later.travelled_m, np.arange(30.0), atol=1e-5)
    assert whole.source == "a.xml, car 12, from 0.50 s; as it stands there"
    smooth = driver(folder, "drivers.vehicle_2.smoothing_s=1.5")
    assert smooth.source == "a.xml, car 12, from 0.50 s; smoothed over 1.5 s, moved by 0.00 m at most"


def test_a_table_gives_the_same_motion_as_a_commonroad_file(folder):
    of_table = driver(folder, "drivers.vehicle_2.file=a.csv", "drivers.vehicle_2.map=ngsim")
    np.testing.assert_allclose(of_table.travelled_m, driver(folder).travelled_m, atol=1e-5)


def test_a_car_that_changes_lanes_comes_along_the_lane_that_it_was_in(folder):
    found = driver(folder, "drivers.vehicle_2.car=13")
    np.testing.assert_allclose(found.travelled_m, np.arange(80.0), atol=1e-5)


def test_the_file_is_not_needed_once_the_scenario_is_read(folder):
    found = mjmerge.load(folder / "s.yaml")
    (folder / "a.xml").unlink()
    (folder / "resolved.yaml").write_text(dump(found))
    assert mjmerge.load(folder / "resolved.yaml") == found


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("car=120", "drivers.vehicle_2.car: '120' is not in the file: did you mean '12'?"),
        ("from_s=0.1", "there is no motion of '12' from 0.1 s on: it is seen from 0.5 s to 4.4 s"),
        ("from_s=0.55", "drivers.vehicle_2.from_s: there is no motion of '12' from 0.55 s on"),
        ("from_s=4.4", "drivers.vehicle_2.from_s: there is no motion of '12' from 4.4 s on"),
        ("from_s=3", "the record ends at 1.4 s, and the run at 2 s"),
        ("smoothing_s=-1", "drivers.vehicle_2.smoothing_s: must be at least 0"),
        ("fil=b", "drivers.vehicle_2.fil: unknown key"),
        ("travelled_m=[0, 1]", "drivers.vehicle_2.travelled_m: is made from the file: give one of them"),
        ("file=b.xml", "b.xml: cannot be read: No such file"),
        ("map=ngsim", "is no table: it takes no map of columns"),
    ],
)
def test_what_is_wrong_is_told_at_its_key(folder, given, said):
    with pytest.raises(mjmerge.MjmergeError) as refused:
        driver(folder, f"drivers.vehicle_2.{given}")
    assert said in str(refused.value)


def test_what_is_wrong_in_the_scenario_and_in_the_file_is_told_at_once_with_lines(folder):
    text = (folder / "a.xml").read_text(encoding="utf-8")
    (folder / "a.xml").write_text(text.replace("<length>4.7", "<length>x", 1), encoding="utf-8")
    (folder / "s.yaml").write_text(KEYS.replace("duration_s: 2", "duration_s: -2"))
    with pytest.raises(ScenarioError) as refused:
        driver(folder)
    line = text[: text.index("<shape>")].count("\n") + 1
    assert {(p.source is None, p.line) for p in refused.value.problems} == {(True, 1), (False, line)}


def test_a_scenario_that_comes_from_a_recording_reads_no_file(folder):
    with pytest.raises(ScenarioError, match=r"drivers.vehicle_2.file: unknown key"):
        load(folder / "s.yaml", code=False)


def test_editors_know_both_ways_to_write_it():
    points, named = json.loads(json_schema())["$defs"]["Recorded"]["anyOf"]
    assert {"time_s", "travelled_m"} <= {*points["required"]}
    assert {*named["required"]} == {"kind", "file", "car"}
    assert {"from_s", "smoothing_s", "map", "bandwidth_radps"} <= {*named["properties"]}
