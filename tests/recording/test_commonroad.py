"""A recording as a CommonRoad file: read again by other means, it says what the recording does."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

from mjmerge.cli import main
from mjmerge.drivers.recorded import curve
from mjmerge.errors import MjmergeError, OutputError, UnreadableError
from mjmerge.record.read import Recorded, read
from mjmerge.review.commonroad import commonroad, lanes, motion, write
from mjmerge.run import run
from mjmerge.scenario.load import load
from mjmerge.simulation.loop import simulate
from mjmerge.traffic.commonroad import read_commonroad
from mjmerge.traffic.excerpt import Excerpt, excerpt

EGO, LEADER, FOLLOWER = "1", "2", "3"
CORNERS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) / 2


@pytest.fixture(scope="module")
def ideal(tmp_path_factory) -> Recorded:
    """The ego beside a wavering follower, on the double integrator: 101 ticks of 0.02 s."""
    folder = tmp_path_factory.mktemp("ideal") / "run"
    keys = ["duration_s=2", "control_step_s=0.02", "drivers.vehicle_2.sway.period_s=2.5"]
    run(load("paper", keys).settled(), "double_integrator", folder=folder)
    return read(folder / "run.mcap")


@pytest.fixture(scope="module")
def cars(tmp_path_factory) -> Recorded:
    """The ego steers hard towards two cars on physics: 31 ticks of 0.02 s."""
    folder = tmp_path_factory.mktemp("cars") / "run"
    keys = ["duration_s=0.6", "control_step_s=0.02", "law.k_p=8", "initial.z=1", "physics_step_s=0.002"]
    run(load("charge", keys).settled(), "mujoco", folder=folder)
    return read(folder / "run.mcap")


def obstacles(text: str) -> dict[str, SimpleNamespace]:
    """Obstacles of a file by id: size, and position, heading, velocity and acceleration of each state."""
    found = {}
    for one in ElementTree.fromstring(text).iterfind("dynamicObstacle"):
        states = [one.find("initialState"), *one.iterfind("trajectory/state")]
        assert [int(s.findtext("time/exact")) for s in states] == list(range(len(states)))

        def of(path, states=states):
            return np.array([float(state.findtext(path)) for state in states])

        found[one.get("id")] = SimpleNamespace(
            size_m=np.array([float(one.findtext(f"shape/rectangle/{side}")) for side in ("length", "width")]),
            centre_m=np.stack([of("position/point/x"), of("position/point/y")], axis=1),
            heading_rad=of("orientation/exact"),
            speed_mps=of("velocity/exact"),
            acceleration_mps2=of("acceleration/exact"),
        )
    return found


def outline(one, k, time_s=0.0):
    """Corners of a rectangle at a time step, a while later if it goes on as it goes, (4, 2)."""
    c, s = np.cos(one.heading_rad[k]), np.sin(one.heading_rad[k])
    gone = time_s * one.speed_mps[k] * np.array([c, s])
    return one.centre_m[k] + gone + (CORNERS * one.size_m) @ np.array([[c, s], [-s, c]])


def apart_m(a, b):
    """Distance of two rectangles that do not overlap: of a corner of one from a side of the other."""
    least = np.inf
    for points, sides in ((a, b), (b, a)):
        for p, (start, end) in product(points, zip(sides, np.roll(sides, -1, axis=0), strict=True)):
            along = np.clip((p - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
            least = min(least, np.linalg.norm(start + along * (end - start) - p))
    return least


def until_contact_s(one, other, k):
    """Time to collision: on by no more than cannot close what is left, until little is left."""
    closing = one.speed_mps[k] + other.speed_mps[k]
    time_s, left = 0.0, np.inf
    while time_s < 20:
        left = apart_m(outline(one, k, time_s), outline(other, k, time_s))
        if left < 1e-7:
            return time_s
        time_s += left / closing
    return np.inf


def contact_s(trace, sheets, k, other):
    """The same of a recorded tick, by separating axes: each is left free for so long."""
    gap, rate, reach, axes = [], [], [], []
    for c in (0, other):
        theta = trace.heading_rad[0, k, c]
        axes += [np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])]
        back_m = sheets[c].length_m / 2 - sheets[c].front_overhang_m
        gap.append(trace.front_m[0, k, c] - back_m * axes[-2])
        rate.append((trace.velocity_mps[0, k, c] @ axes[-2]) * axes[-2])
        reach.append((axes[-2] * sheets[c].length_m / 2, axes[-1] * sheets[c].width_m / 2))
    first, last = 0.0, np.inf
    for axis in axes:
        free = sum(abs(axis @ side) for sides in reach for side in sides)
        at, v = axis @ (gap[1] - gap[0]), axis @ (rate[1] - rate[0])
        if v == 0 and abs(at) > free:
            return np.inf
        times = sorted((side * free - at) / v for side in (-1, 1)) if v else (0.0, np.inf)
        first, last = max(first, times[0]), min(last, times[1])
    return first if first <= last else np.inf


def test_every_car_is_where_the_recording_has_it_at_every_tick(cars):
    trace, sheets = cars.run(), cars.sheets()
    there = obstacles(commonroad(cars))
    assert list(there) == [EGO, LEADER, FOLLOWER]
    for c, (one, sheet) in enumerate(zip(there.values(), sheets, strict=True)):
        assert one.size_m == pytest.approx([sheet.length_m, sheet.width_m])
        forwards = np.stack([np.cos(one.heading_rad), np.sin(one.heading_rad)], axis=1)
        nose_m = one.centre_m + sheet.length_m / 2 * forwards
        assert nose_m - sheet.front_overhang_m * forwards == pytest.approx(trace.front_m[0, :, c], abs=1e-8)
        assert one.heading_rad == pytest.approx(trace.heading_rad[0, :, c], abs=1e-9)
        gone_m = np.sum(np.diff(one.centre_m, axis=0) * (forwards[1:] + forwards[:-1]) / 2, axis=1)
        mean_mps = (one.speed_mps[1:] + one.speed_mps[:-1]) / 2
        assert gone_m / 0.02 == pytest.approx(mean_mps, abs=0.02)
        inner = np.diff(one.speed_mps)
        assert one.acceleration_mps2[1:-1] * 0.04 == pytest.approx(inner[1:] + inner[:-1], abs=1e-7)


def test_least_distances_by_other_means_are_the_clearances_of_the_bodies(cars):
    trace, there = cars.run(), obstacles(commonroad(cars))
    assert np.ptp(there[EGO].heading_rad) > 0.2  # it has turned
    for j, other in enumerate((LEADER, FOLLOWER)):
        found = [apart_m(outline(there[EGO], k), outline(there[other], k)) for k in range(31)]
        assert found == pytest.approx(trace.clearance_m[0, :, j], abs=1e-3)  # bodies roll and pitch


def test_times_to_collision_by_other_means_are_those_of_the_recording(cars):
    trace, there = cars.run(), obstacles(commonroad(cars))
    ends = 0
    for k, j in product(range(0, 31, 2), (1, 2)):
        mine = contact_s(trace, cars.sheets(), k, j)
        theirs = until_contact_s(there[EGO], there[str(1 + j)], k)
        assert theirs == pytest.approx(mine, abs=1e-4)
        ends += mine < 20
    assert 3 < ends < 32  # some meet, and some do not


def test_a_recorded_driver_gives_the_follower_of_the_file_back_within_a_millimetre(ideal):
    back = obstacles(commonroad(ideal, 0.1))[FOLLOWER]
    sheet = ideal.sheets()[2]
    front_m = back.centre_m[:, 0] + sheet.length_m / 2 - sheet.front_overhang_m
    time_s, way_m = 0.1 * np.arange(len(front_m)), np.maximum.accumulate(front_m - front_m[0])
    keys = {"kind": "recorded", "time_s": time_s.tolist(), "travelled_m": way_m.tolist()}
    first_mps = curve(tuple(time_s.tolist()), tuple(way_m.tolist())).at(0.0)[1]
    again = simulate(
        load(
            "paper",
            [f"drivers.vehicle_2={keys}", f"initial.vehicle_2.speed_mps={first_mps}", "duration_s=2"],
        ),
        "double_integrator",
    )
    assert again.front_m[0, ::10, 2, 0] == pytest.approx(front_m, abs=1e-3)
    assert ideal.run().front_m[0, ::5, 2, 0] == pytest.approx(front_m, abs=1e-8)


def test_what_was_written_is_read_as_traffic_whose_cars_drive_as_in_the_recording(ideal, tmp_path):
    path = tmp_path / "back.xml"
    write(ideal, path, 0.1)
    assert [*read_commonroad(path).tracks] == [EGO, LEADER, FOLLOWER]
    for j, name in ((1, LEADER), (2, FOLLOWER)):
        found = excerpt(Excerpt(file=str(path), car=name, smoothing_s=0.0), None)
        front_m = ideal.run().front_m[0, ::5, j, 0]
        np.testing.assert_allclose(found["travelled_m"], front_m - front_m[0], atol=1e-3)


def test_the_head_says_what_ran_and_nothing_of_today(ideal):
    root = ElementTree.fromstring(commonroad(ideal, 0.04))
    assert re.fullmatch(r"mjmerge \S+: paper on double_integrator, seed 0", root.get("source"))
    assert root.attrib | {"source": ""} == {
        "timeStepSize": "0.04", "commonRoadVersion": "2020a", "author": "mjmerge", "affiliation": "",
        "source": "", "benchmarkID": "ZAM_Paper-1_1_T-1", "date": "1970-01-01",
    }  # fmt: skip
    assert commonroad(ideal) == commonroad(ideal)
    ids = [one.get("id") for one in root if one.get("id")]
    assert ids == ["101", "102", "1", "2", "3", "201"]


def test_the_lanes_are_those_of_the_cars_side_by_side_and_long_enough(ideal):
    root = ElementTree.fromstring(commonroad(ideal))
    right, left = root.iterfind("lanelet")

    def bound(lanelet, side):
        points = lanelet.iterfind(f"{side}Bound/point")
        return np.array([[float(p.findtext(c)) for c in "xy"] for p in points])

    assert bound(right, "left").tolist() == bound(left, "right").tolist()
    assert set(bound(right, "left")[:, 1]) == {0.7285}  # half way between 0 and 1.457
    assert (set(bound(right, "right")[:, 1]), set(bound(left, "left")[:, 1])) == ({-0.6}, {2.057})
    assert right.find("adjacentLeft").attrib == {"ref": "102", "drivingDir": "same"}
    assert left.find("adjacentRight").attrib == {"ref": "101", "drivingDir": "same"}
    for one in obstacles(commonroad(ideal)).values():
        assert (one.centre_m[:, 0].min() > bound(right, "left")[0, 0]) & (
            one.centre_m[:, 0].max() < bound(right, "left")[-1, 0]
        )


@pytest.mark.parametrize(
    ("ego_y", "third_y", "bounds"),
    [
        (1.457, 1.4, [(-0.6, 0.7), (0.7, 2.0)]),  # two cars of one lane: where its first is
        (3.0, None, [(-0.6, 0.6), (2.4, 3.6)]),  # too far apart for a bound in common
        (-1.3, 1.3, [(-1.9, -0.65), (-0.65, 0.65), (0.65, 1.9)]),
    ],
)
def test_cars_that_are_beside_each_other_have_lanes_of_their_own(ego_y, third_y, bounds):
    keys = [f"initial.ego.front_m=[-1.5, {ego_y}]"]
    if third_y is not None:
        keys += [f"initial.vehicle_3={{front_m: [9, {third_y}], speed_mps: 2.0}}"]
        keys += ["drivers.vehicle_3={kind: steady, speed_mps: 2.0}"]
    found = lanes(load("paper", keys))
    assert [one.id for one in found] == [101 + i for i in range(len(bounds))]
    assert [(one.right_m, one.left_m) for one in found] == [pytest.approx(pair) for pair in bounds]


def test_the_ego_is_asked_to_be_in_the_leaders_lane_by_the_end(ideal):
    root = ElementTree.fromstring(commonroad(ideal, 0.04))
    problem, ego = root.find("planningProblem"), obstacles(commonroad(ideal, 0.04))[EGO]
    start = problem.find("initialState")
    assert [float(start.findtext(f"position/point/{c}")) for c in "xy"] == ego.centre_m[0].tolist()
    named = {name: start.findtext(f"{name}/exact") for name in ("velocity", "orientation", "time")}
    assert named == {"velocity": "2", "orientation": "0", "time": "0"}
    assert problem.find("goalState/position/lanelet").get("ref") == "101"
    assert problem.findtext("goalState/time/intervalEnd") == "50"


def test_a_point_that_stands_or_creeps_back_does_not_turn_about(make_trace):
    x = np.array([[2.0, 0.2], [0.0, 0.0], [1e-9, -1e-9], [-1e-9, 0.0], [-0.5, 0.0]])
    trace = make_trace(
        ticks=5, plant="double_integrator", velocity_mps=np.repeat(x[None, :, None], 3, axis=2),
        heading_rad=np.arctan2(x[:, 1], x[:, 0])[None, :, None], front_m=0.0,
    )  # fmt: skip
    found = motion(trace, 0, trace.sheets[0], 1, 5)
    assert found.heading_rad == pytest.approx([np.arctan2(0.2, 2.0)] * 4 + [0.0])
    assert found.speed_mps == pytest.approx([np.hypot(2.0, 0.2), 0, 0, 0, -0.5], abs=1e-8)
    assert found.centre_m[-1] == pytest.approx([0.125 - 0.29, 0.0])


def test_a_run_that_ended_early_is_written_up_to_there_and_a_hole_is_refused(ideal, monkeypatch):
    whole = ideal.run()
    short = {n: getattr(whole, n).copy() for n in ("front_m", "velocity_mps", "heading_rad")}
    for values in short.values():
        values[:, 40:] = np.nan
    cut = SimpleNamespace(**(vars(whole) | short))
    monkeypatch.setattr(Recorded, "run", lambda _: cut)
    assert len(obstacles(commonroad(ideal))[EGO].speed_mps) == 40
    assert len(obstacles(commonroad(ideal, 0.1))[EGO].speed_mps) == 8
    with pytest.raises(UnreadableError, match="it has 40 ticks: no two time steps"):
        commonroad(ideal, 0.8)
    short["velocity_mps"][:, 60:] = 1.0
    short["front_m"][:, 60:] = 1.0
    short["heading_rad"][:, 60:] = 0.0
    with pytest.raises(UnreadableError, match=r"the tick at 0\.8 s is missing"):
        commonroad(ideal)


@pytest.mark.parametrize("step_s", [0.03, 0.0, -0.02, 0.001, float("inf"), float("nan")])
def test_a_time_step_that_is_no_multiple_of_the_control_step_is_refused(ideal, step_s):
    with pytest.raises(MjmergeError, match=r"whole multiple of the control step, 0\.02 s, got"):
        commonroad(ideal, step_s)


def test_it_is_written_whole_and_in_no_files_place(ideal, tmp_path, monkeypatch):
    path = tmp_path / "run.xml"
    write(ideal, path)
    before = path.read_bytes()
    assert ElementTree.fromstring(before).get("commonRoadVersion") == "2020a"
    assert before.startswith(b'<?xml version="1.0" encoding="UTF-8"?>\n<commonRoad ')
    with pytest.raises(OutputError, match="exists, and nothing is overwritten"):
        write(ideal, path)

    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OutputError, match="No space left"):
        write(ideal, tmp_path / "other.xml")
    assert [one.name for one in tmp_path.iterdir()] == ["run.xml"]
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ([], 0, "run.xml"),
        (["--step", "0.1"], 0, "run.xml"),
        (["--step", "0.05"], 2, "a whole multiple of the control step, 0.02 s, got 0.05 s"),
    ],
)
def test_the_command_names_the_file_that_it_wrote(ideal, tmp_path, capsys, arguments, code, words):
    with pytest.raises(SystemExit) as ended:
        main(["traffic", "--export", str(ideal.path.parent), str(tmp_path / "run.xml"), *arguments])
    said = capsys.readouterr()
    assert (ended.value.code, (tmp_path / "run.xml").exists()) == (code, code == 0)
    assert words in said.out + said.err


def test_what_is_no_xml_file_is_not_written_to(ideal, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["traffic", str(tmp_path / "run.mcap"), "--export", str(ideal.path)])
    assert (ended.value.code, list(tmp_path.iterdir())) == (2, [])
    assert "ends with .xml" in capsys.readouterr().err
