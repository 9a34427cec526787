"""CommonRoad files: every road user is accounted for, and what is wrong is told with its line."""

import os
import time
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjmerge.errors import ScenarioError
from mjmerge.traffic.changes import lane_changes
from mjmerge.traffic.commonroad import read_commonroad
from tests.traffic.files import Car, bound, commonroad, lanelet, merging, obstacle, state, steady

GOOD = commonroad(merging(steps=12))


def written(folder, text, encoding="utf-8", name="traffic.xml"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return path


def read(folder, text, encoding="utf-8"):
    return read_commonroad(written(folder, text, encoding))


def without(text, steps):
    """An obstacle without its states at some times, each of which is a line."""
    gone = [f"<time><exact>{step}</exact>" for step in steps]
    return "".join(line for line in text.splitlines(True) if not any(one in line for one in gone))


def line_of(text, part):
    return text[: text.index(part)].count("\n") + 1


def test_positions_times_sizes_and_lanes_are_those_of_the_file(tmp_path):
    cars = [*merging(), steady("late", 0.0, 10.0, y_m=1.0, steps=5, first=30, length_m=12.5, kind="truck")]
    found = read(tmp_path, commonroad(cars))
    assert [*found.tracks] == ["7", "8", "9", "late"]
    for car in cars:
        one = found.tracks[car.id]
        np.testing.assert_array_equal(one.centre_m, np.stack([car.x_m, car.y_m], axis=1))
        np.testing.assert_array_equal(one.step, car.first + np.arange(len(car.x_m)))
        assert (one.length_m, one.width_m, one.kind) == (car.length_m, car.width_m, car.kind)
        assert one.lane.tolist() == ["100" if y < 1.75 else "101" for y in car.y_m]
    assert found.tracks["late"].sees(30, 34)
    assert not found.tracks["late"].sees(29, 34)


def test_every_road_user_is_a_track_or_has_a_reason_why_not(tmp_path):
    holed = without(obstacle(steady("11", 0.0, 10.0, steps=30)), [12])
    long_hole = without(obstacle(steady("12", 0.0, 10.0, steps=30)), range(10, 20))
    users = [
        *merging(steps=12),
        holed,
        long_hole,
        '<staticObstacle id="13"><type>parkedVehicle</type></staticObstacle>',
        '<phantomObstacle id="14"/>',
        obstacle(steady("15", 50.0, 10.0)).replace("rectangle", "polygon"),
    ]
    found = read(tmp_path, commonroad(users))
    assert [*found.tracks] == ["7", "8", "9", "11"]
    why = {one.id: one.why for one in found.unused}
    assert why == {
        "12": "not seen from 0.90 s to 2.00 s",
        "13": "stands for the whole record",
        "14": "is a phantomObstacle",
        "15": "its shape is no rectangle (polygon)",
    }
    assert found.road_users == len(users)
    np.testing.assert_allclose(found.tracks["11"].centre_m[:, 0], np.arange(30.0))
    assert any("11: 1 states filled in" in note for note in found.notes)


def test_a_state_that_comes_twice_counts_once_and_is_told(tmp_path):
    text = obstacle(steady("1", 0.0, 10.0))
    text = text.replace("<trajectory>\n", "<trajectory>\n" + state("state", 0, 0.5, 0.0, 10.0))
    found = read(tmp_path, commonroad([text]))
    np.testing.assert_allclose(found.tracks["1"].centre_m[:, 0], np.arange(80.0), atol=1e-12)
    assert (
        "dynamicObstacle 1: 1 states at times that it had already left out, up to 0.5 m apart" in found.notes
    )


BAD = {
    "not XML": ("mcap\x89 nothing", "not a whole XML file", 1),
    "empty": ("  \n ", "empty", None),
    "truncated": (GOOD[: len(GOOD) // 2], "not a whole XML file", GOOD[: len(GOOD) // 2].count("\n") + 1),
    "another root": ("<html>\n</html>", "its root is <html>", 1),
    "another version": (GOOD.replace("2020a", "2018b"), "version '2018b'; only 2020a", 2),
    "no version": (GOOD.replace('commonRoadVersion="2020a"', ""), "version None; only 2020a", 2),
    "no time step": (GOOD.replace("timeStepSize", "step"), "must be the seconds between two time steps", 2),
    "a time step of NaN": (GOOD.replace('"0.1"', '"nan"'), "must be the seconds", 2),
    "nobody": (commonroad([]), "there is no road user in it", None),
    "laughs": (
        '<?xml version="1.0"?>\n<!DOCTYPE c [<!ENTITY a "ha"><!ENTITY b "&a;&a;">]>\n<commonRoad>&b;</a>',
        "has a document type or entities",
        2,
    ),
    "entity from elsewhere": (
        '<!DOCTYPE c [<!ENTITY a SYSTEM "file:///etc/hostname">]>\n<commonRoad>&a;</commonRoad>',
        "has a document type or entities",
        1,
    ),
    "entity that is none": (GOOD.replace("Jörg", "&joerg;"), "not a whole XML file", 2),
    "NaN": (
        GOOD.replace("<x>103.0</x>", "<x>nan</x>"),
        "<x> must be a number",
        line_of(GOOD, "<x>103.0</x>"),
    ),
    "words": (GOOD.replace("<x>103.0</x>", "<x>far</x>"), "got 'far'", line_of(GOOD, "<x>103.0</x>")),
    "far away": (
        GOOD.replace("<x>103.0</x>", "<x>1e9</x>"),
        "must be a number",
        line_of(GOOD, "<x>103.0</x>"),
    ),
    "half a time": (
        GOOD.replace("<exact>3</exact>", "<exact>3.5</exact>", 1),
        "its time is 3.5",
        line_of(GOOD, "<exact>3</exact>"),
    ),
    "times go back": (
        GOOD.replace("<exact>3</exact>", "<exact>1</exact>", 1),
        "its times go back, to time step 1",
        line_of(GOOD, '"7"'),
    ),
    "two places at once": (
        GOOD.replace(state("state", 3, 104.5, 3.5, 15.0), state("state", 2, 164.5, 3.5, 15.0)),
        "is in two places at once, 61.5 m apart",
        line_of(GOOD, '"7"'),
    ),
    "no shape": (
        GOOD.replace("<shape>", "<form>", 1).replace("</shape>", "</form>", 1),
        "has no shape",
        line_of(GOOD, '"7"'),
    ),
    "no length": (
        GOOD.replace("<length>4.7</length>", "", 1),
        "<rectangle/length> is missing",
        line_of(GOOD, "<shape>"),
    ),
    "no size": (GOOD.replace("<length>4.7", "<length>0", 1), "its length is 0 m", line_of(GOOD, "<shape>")),
    "no trajectory": (
        commonroad([obstacle(steady("1", 0.0, 10.0)).split("<trajectory>")[0] + "</dynamicObstacle>"]),
        "one state at most",
        None,
    ),
    "one state": (
        commonroad([steady("1", 0.0, 10.0, steps=2)]).replace("<time><exact>1<", "<time><exact>0<"),
        "has one state",
        None,
    ),
    "no position": (GOOD.replace("position", "place"), "<position/point/x> is missing", None),
    "no time": (
        GOOD.replace("<time>", "<when>").replace("</time>", "</when>"),
        "<time/exact> is missing",
        None,
    ),
    "the same twice": (
        commonroad([*merging(steps=12), merging(steps=12)[0]]),
        "is there twice, first on line",
        None,
    ),
    "in feet": (
        commonroad([steady(str(k), 100.0 * k, 40.0, length_m=15.4) for k in range(3)]),
        "half of all vehicles are 15.4 m long",
        None,
    ),
    "too fast": (commonroad([steady("1", 0.0, 400.0)]), "moves at 400 m/s", None),
    "in km/h": (
        commonroad([obstacle(steady("1", 0.0, 10.0), np.full(80, 36.0))]),
        "speeds are 3.6 times what the positions say, as if in km/h",
        None,
    ),
    "half a lanelet": (
        commonroad([steady("1", 0.0, 10.0)], lanelet(5, [(0, 1)], [(0, 0), (9, 0)])),
        "its leftBound has 1 points",
        4,
    ),
    "a lanelet of NaN": (
        commonroad([steady("1", 0.0, 10.0)], lanelet(5, [(0, 1), (9, np.nan)], [(0, 0), (9, 0)])),
        "<y> must be a number",
        6,
    ),
    "another encoding": (GOOD.replace("UTF-8", "EBCDIC-CP-US"), "encoding 'ebcdic-cp-us' is not read", 1),
}


@pytest.mark.parametrize("name", BAD)
def test_a_file_that_is_wrong_is_refused_with_its_line(tmp_path, name):
    text, said, line = BAD[name]
    with pytest.raises(ScenarioError) as refused:
        read(tmp_path, text)
    assert said in str(refused.value)
    if line is not None:
        assert line in [problem.line for problem in refused.value.problems], str(refused.value)


def test_everything_that_is_wrong_is_told_at_once(tmp_path):
    text = GOOD.replace("<x>103.0</x>", "<x>nan</x>").replace("<length>4.7</length>", "<length>x</length>")
    with pytest.raises(ScenarioError) as refused:
        read(tmp_path, text)
    assert len(refused.value.problems) == 4
    assert [p.line for p in refused.value.problems] == sorted(p.line for p in refused.value.problems)


@settings(max_examples=25)
@given(st.integers(min_value=0, max_value=len(GOOD.rstrip()) - 1))
def test_a_file_that_ends_anywhere_before_its_end_is_refused(tmp_path_factory, end):
    with pytest.raises(ScenarioError):
        read(tmp_path_factory.getbasetemp(), GOOD[:end])


@settings(max_examples=40)
@given(st.data())
def test_a_file_that_was_damaged_anywhere_is_read_or_refused_and_nothing_else(tmp_path_factory, data):
    text = GOOD
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text) - 1))
        end = min(start + data.draw(st.integers(0, 60)), len(text))
        put = data.draw(
            st.sampled_from(["", "-1", "1e308", "nan", "<a>", "</", '"', "\0", "9" * 400, "\ud7ff", "&lt;"])
        )
        text = text[:start] + put + text[end:]
    with suppress(ScenarioError):
        found = read(tmp_path_factory.getbasetemp(), text)
        assert found.road_users >= 1
        list(lane_changes(found))


@pytest.mark.parametrize(
    ("declared", "encoding"), [("UTF-8", "utf-8-sig"), ("ISO-8859-1", "latin-1"), ("UTF-16", "utf-16")]
)
def test_a_file_is_read_in_the_encoding_that_it_declares(tmp_path, declared, encoding):
    found = read(tmp_path, commonroad(merging(steps=12), declared=declared), encoding)
    assert [*found.tracks] == ["7", "8", "9"]


def test_a_file_in_another_encoding_than_it_declares_is_refused(tmp_path):
    with pytest.raises(ScenarioError, match=r"traffic.xml:2: not text in UTF-8"):
        read(tmp_path, GOOD, "latin-1")


def test_a_file_that_is_too_large_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "large.xml"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    began = time.process_time()
    with pytest.raises(ScenarioError, match="100 MB; a CommonRoad file may have 32 MB"):
        read_commonroad(path)
    assert time.process_time() - began < 0.1


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read: No such file"):
        read_commonroad(tmp_path / "none.xml")


def test_a_folder_or_a_pipe_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.xml")
    (tmp_path / "folder.xml").mkdir()
    for name in ("pipe.xml", "folder.xml"):
        with pytest.raises(ScenarioError, match="is no file"):
            read_commonroad(tmp_path / name)


def test_what_is_deeper_than_any_parser_goes_is_refused(tmp_path):
    with pytest.raises(ScenarioError, match="not a whole XML file"):
        read(tmp_path, "<commonRoad>" + "<a>" * 5000 + "</a>" * 5000 + "</commonRoad>")


def test_a_lanelet_goes_on_only_where_another_one_starts_and_what_does_not_fit_is_told(tmp_path):
    def piece(id_, start, end, **links):
        return lanelet(id_, [(start, 2), (end, 2)], [(start, -2), (end, -2)], **links)

    lanes = piece(1, 0, 50, after=[1, 2, 4]) + piece(2, 50, 90) + piece(3, 90, 120, before=[2])
    found = read(tmp_path, commonroad([steady("1", 0.0, 10.0)], lanes))
    assert {name: lane.after for name, lane in found.lanes.items()} == {"1": ("2",), "2": ("3",), "3": ()}
    left_out = [note for note in found.notes if note.endswith("left out")]
    assert [note.split("goes on into ")[1].split(",")[0] for note in left_out] == ["1", "4"]


def test_bounds_of_different_numbers_of_points_make_a_lane(tmp_path):
    left, right = [(x, 2.0) for x in (0, 10, 50)], [(0, -2.0), (50, -2.0)]
    found = read(tmp_path, commonroad([steady("1", 0.0, 10.0)], lanelet(1, left, right)))
    np.testing.assert_allclose(found.lanes["1"].centre_m[:, 1], 0.0, atol=1e-12)
    assert bound("leftBound", left) != bound("rightBound", right)


def test_speeds_and_accelerations_that_the_positions_do_not_say_are_told(tmp_path):
    biased = obstacle(Car("1", np.arange(80.0), np.zeros(80)), np.full(80, 9.57))
    notes = read(tmp_path, commonroad([biased])).notes
    assert any("median -0.43 m/s" in note for note in notes)
    assert any("1 of 1 tracks have no accelerations" in note for note in notes)
