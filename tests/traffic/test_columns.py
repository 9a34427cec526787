"""Tables: the same traffic is the same in every format, and what is wrong is told with its line."""

import re
import time
from pathlib import Path

import numpy as np
import pytest

from mjmerge.errors import MjmergeError, ScenarioError, UnknownNameError
from mjmerge.traffic.changes import Change, lane_changes
from mjmerge.traffic.columns import column_map, maps, read_columns
from mjmerge.traffic.read import read
from tests.traffic.files import commonroad, highd, merging, ngsim, steady

PAGE = (Path(__file__).parents[2] / "docs" / "traffic.md").read_text(encoding="utf-8")
OWN = re.search(r"<!-- map -->\n```yaml\n(.*?)```", PAGE, re.DOTALL).group(1)


def own(cars):
    lines = ["lane;name;ms;s;d;long;wide;comment"]
    for car in cars:
        for i, (x, y) in enumerate(zip(car.x_m, car.y_m, strict=True)):
            lane = 1 if y < 1.75 else 2
            lines.append(
                f"{lane};{car.id};{(car.first + i) * 100};{float(x - car.length_m / 2)};{float(y)};4.7;1.8;x"
            )
    return "\n".join(lines) + "\n"


def put(folder, name, text):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_the_same_traffic_is_the_same_in_every_format(tmp_path):
    cars = merging()
    (tmp_path / "own.yaml").write_text(OWN)
    every = [
        read(put(tmp_path, "a.xml", commonroad(cars))),
        read(put(tmp_path, "ngsim.csv", ngsim(cars))),
        read(put(tmp_path, "own.csv", own(cars)), str(tmp_path / "own.yaml")),
    ]
    changes = []
    for found in every:
        for car in cars:
            np.testing.assert_allclose(
                found.tracks[car.id].centre_m, np.stack([car.x_m, car.y_m], axis=1), atol=1e-9
            )
            assert found.tracks[car.id].length_m == pytest.approx(car.length_m)
        changes.append(
            [(c.three, c.crossed, c.first, c.last) for c in lane_changes(found) if isinstance(c, Change)]
        )
    assert changes[0] == changes[1] == changes[2] == [(("7", "8", "9"), 36, 0, 79)]


@pytest.mark.parametrize("back", [False, True])
def test_highd_is_read_by_its_corner_at_25_hertz_in_both_directions(tmp_path, back):
    cars = merging()
    found = read(put(tmp_path, "tracks.csv", highd(cars, back)))
    assert found.step_s == 0.04
    sign = -1 if back else 1
    for car in cars:
        expected = np.stack([sign * car.x_m, sign * car.y_m], axis=1)
        np.testing.assert_allclose(found.tracks[car.id].centre_m, expected, atol=1e-9)
    (change,) = lane_changes(found)
    assert isinstance(change, Change)
    assert change.three == ("7", "8", "9")
    along = change.frame.place(found.tracks["7"].centre_m)
    assert (np.diff(along[:, 0]) > 0).all()
    assert along[0, 1] == pytest.approx(3.5, abs=0.1)  # it comes from the left whichever way they drive


def test_a_name_that_is_used_again_is_another_road_user_and_one_seen_once_is_told(tmp_path):
    cars = [*merging(), steady("7", 0.0, 10.0, first=400), steady("78", 0.0, 10.0, steps=2)]
    text = ngsim(cars)
    rows = text.splitlines()
    text = "\n".join(rows[:-1]) + "\n"  # the last road user has one row left
    found = read(put(tmp_path, "a.csv", text))
    assert [*found.tracks] == ["7", "7#2", "8", "9"]
    assert [one.id for one in found.unused] == ["78"]
    assert any("1 road users have a name that was used before" in note for note in found.notes)
    assert any("1 road users are seen once only" in note for note in found.notes)


GOOD = ngsim(merging(steps=12))
BAD = {
    "empty": ("", "empty", None),
    "no rows": (GOOD.splitlines()[0], "has no rows", None),
    "no header": ("\n".join(GOOD.splitlines()[1:]), "has no header", 1),
    "another header": (GOOD.replace("Vehicle_ID", "Car"), "no shipped map of columns fits its header", 1),
    "a column is missing": (GOOD.replace("Lane_ID", "Lane"), "for ngsim it lacks Lane_ID", 1),
    "two columns of a name": (GOOD.replace("v_Acc", "v_Vel"), "two columns are called 'v_Vel'", 1),
    "NaN": (GOOD.replace("7,3,", "7,nan,"), "Frame_ID: must be a number, got 'nan'", 5),
    "words": (GOOD.replace("7,3,", "7,?,"), "Frame_ID: must be a number, got '?'", 5),
    "too few values": (GOOD.replace(",2,", ",", 1), "not a whole table: CSV parse error", None),
    "truncated": (GOOD[:-40], "not a whole table", None),
    "bytes": ("\0" * 50, "not text: it has zero bytes", 1),
    "in metres": (
        ngsim([steady("1", 0, 10.0, length_m=1.4), steady("2", 50, 10.0, length_m=1.4)]),
        "half of all vehicles are 1.4 m long",
        None,
    ),
    "half a frame": (GOOD.replace("7,3,", "7,3.5,"), "Frame_ID: is no whole number of steps of 0.1 s", 5),
    "too fast": (ngsim([steady("1", 0.0, 400.0)]), "moves at 400 m/s", None),
    "several places": (
        "\n".join(
            f"{row},{'Location' if not k else 'us-101' if k < 9 else 'i-80'}"
            for k, row in enumerate(GOOD.splitlines())
        ),
        "has several places (i-80, us-101)",
        None,
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_table_that_is_wrong_is_refused_with_its_line(tmp_path, name):
    text, said, line = BAD[name]
    with pytest.raises(ScenarioError) as refused:
        read_columns(put(tmp_path, "a.csv", text))
    assert said in str(refused.value)
    if line is not None:
        assert line in [problem.line for problem in refused.value.problems], str(refused.value)


def test_a_table_that_is_too_large_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "a.csv").open("wb") as file:
        file.truncate(100_000_000)
    began = time.process_time()
    with pytest.raises(ScenarioError, match="100 MB; a table of traffic may have 64 MB"):
        read_columns(tmp_path / "a.csv")
    assert time.process_time() - began < 0.1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("unit_m: 1", "unit_m: -1"), "own.yaml:8: unit_m"),
        (("reference: rear", "reference: middle"), "own.yaml:9: reference"),
        (("lane: lane", "lain: lane"), "did you mean 'lane'?"),
        (("along: s", "along: x"), "no column 'x'"),
    ],
)
def test_a_map_that_is_wrong_is_told_with_its_line(tmp_path, change, said):
    (tmp_path / "own.yaml").write_text(OWN.replace(*change))
    with pytest.raises(ScenarioError) as refused:
        read_columns(put(tmp_path, "a.csv", own(merging(steps=3))), str(tmp_path / "own.yaml"))
    assert said in str(refused.value)


def test_a_map_or_format_that_is_none_is_refused_with_the_nearest(tmp_path):
    with pytest.raises(UnknownNameError, match=r"did you mean 'ngsim'\?"):
        column_map("ngsym")
    with pytest.raises(MjmergeError, match="is no table"):
        read(put(tmp_path, "a.xml", commonroad(merging())), "ngsim")
    with pytest.raises(MjmergeError, match=r"traffic is read from CommonRoad .xml"):
        read(tmp_path / "a.rrd")
    assert all(column_map(name).description for name in maps())
