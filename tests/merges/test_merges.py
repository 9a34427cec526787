"""Lane changes as scenarios: they replay what was recorded, are tightened as far as is allowed, and told."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mjmerge
from mjmerge.cli import main
from mjmerge.config.document import parse
from mjmerge.merges.event import GENTLE_MPS2, event, margin_m
from mjmerge.merges.judged import merges
from mjmerge.merges.margins import entered_s, margins
from mjmerge.merges.scenario import scenario, written
from mjmerge.merges.tighten import LEAST_GAP, tightened
from mjmerge.scenario.cars import data_sheet
from mjmerge.traffic.changes import Change, Skipped, lane_changes
from mjmerge.traffic.commonroad import read_commonroad
from tests.traffic.files import LANE_M, Car, changing, commonroad, lanelet, merging, steady


def wavering(id_, start_m, speed_mps, amplitude_m, phase, **more):
    t = np.arange(80) * 0.1
    x = start_m + speed_mps * t + amplitude_m * np.sin(0.9 * t + phase)
    return Car(id_, x, np.full(80, 0.3), **more)


def events(folder, cars):
    path = folder / "a.xml"
    path.write_text(commonroad(cars), encoding="utf-8")
    traffic = read_commonroad(path)
    return traffic, [event(traffic, one) for one in lane_changes(traffic) if isinstance(one, Change)]


THREE = [
    changing("7", 100.0, 15.0, LANE_M, 0.0),
    wavering("8", 124.0, 15.5, 1.5, 0.5, length_m=9.0),
    wavering("9", 78.0, 14.8, 1.0, 2.0),
]


def test_neighbours_of_a_scenario_drive_as_they_were_recorded(tmp_path):
    traffic, (one,) = events(tmp_path, THREE)
    loaded = mjmerge.load(scenario(one, traffic))
    trace = mjmerge.simulate(loaded, "double_integrator")
    at = np.round(one.time_s / loaded.control_step_s).astype(int)
    at = at[at < len(trace.time_s)]
    overhang_m = [data_sheet("van").front_overhang_m / 5.9 * 9.0, 0.9]
    sizes = [(sheet.length_m, sheet.width_m) for sheet in trace.sheets]
    assert sizes == [(car.length_m, car.width_m) for car in THREE]
    assert trace.sheets[1].front_overhang_m == pytest.approx(overhang_m[0])
    for j, (car, ahead_m) in enumerate(zip(THREE[1:], overhang_m, strict=True), 1):
        front_m = car.x_m + car.length_m / 2 - ahead_m
        expected = front_m - (THREE[1].x_m[0] + 4.5 - overhang_m[0])
        np.testing.assert_allclose(trace.front_m[0, at, j, 0], expected[: len(at)], atol=1e-3)
    np.testing.assert_allclose(trace.front_m[0, 0, 0], one.front_m[0, 0], atol=1e-4)
    assert loaded.duration_s == pytest.approx(one.time_s[-1])


@pytest.mark.parametrize("side", [1, -1])
def test_the_ego_starts_where_the_human_was_on_the_left_whichever_side_it_comes_from(tmp_path, side):
    cars = [changing("7", 100.0, 15.0, side * LANE_M, 0.0), *merging()[1:]]
    lanes = "".join(
        lanelet(k + 2, *([(x, k * LANE_M + up) for x in (-50, 400)] for up in (1.75, -1.75)))
        for k in (-1, 0, 1)
    )
    path = tmp_path / "a.xml"
    path.write_text(commonroad(cars, lanes), encoding="utf-8")
    traffic = read_commonroad(path)
    (one,) = [event(traffic, change) for change in lane_changes(traffic)]
    start = scenario(one, traffic)["initial"]["ego"]
    assert start["front_m"] == pytest.approx([-20.0, LANE_M], abs=1e-3)
    assert start["speed_mps"] == pytest.approx(15.0, abs=1e-3)
    assert one.mirrored == (side < 0)


@pytest.mark.parametrize(("peak_mps2", "model"), [(1.0, "van"), (4.0, "sedan")])
def test_a_car_gets_the_nearest_model_that_can_drive_like_its_record(tmp_path, peak_mps2, model):
    t = np.arange(80) * 0.1  # a pull of 3 s, as long as a van's
    hard = np.where((t >= 2) & (t < 5), peak_mps2 * (1 - np.cos(2 * np.pi * (t - 2) / 3)) / 2, 0.0)
    speed_mps = 12 + np.cumsum(hard) * 0.1
    leader = Car("8", 124 + np.cumsum(speed_mps) * 0.1, np.full(80, 0.0), length_m=5.8)
    _, (one,) = events(tmp_path, [changing("7", 100.0, 12.0, LANE_M, 0.0), leader, THREE[2]])
    assert one.models == ("sedan", model, "sedan")
    assert one.bodies[1].length_m == 5.8


def test_the_scenario_that_is_written_is_the_one_that_was_run(tmp_path):
    traffic, (one,) = events(tmp_path, THREE)
    keys = scenario(one, traffic)
    assert parse(written(keys)).value == keys
    (tmp_path / "a.yaml").write_text(written(keys))
    assert mjmerge.load(tmp_path / "a.yaml") == mjmerge.load(keys)


def body(length_m, width_m=1.8, overhang_m=None):
    sheet = data_sheet("sedan").stretched(length_m, width_m)
    return sheet if overhang_m is None else sheet.model_copy(update={"front_overhang_m": overhang_m})


@given(st.lists(st.floats(3.0, 20.0), min_size=3, max_size=3))
def test_r_is_more_than_bodies_reach_in_one_lane_and_grows_with_their_lengths(length_m):
    overhang_m = [0.9 / 4.7 * length for length in length_m]
    r_m = margin_m(list(map(body, length_m)))
    behind_leader_m = length_m[1] - overhang_m[1] + overhang_m[0]
    ahead_of_follower_m = length_m[0] - overhang_m[0] + overhang_m[2]
    assert r_m > max(behind_leader_m, ahead_of_follower_m)
    assert margin_m([body(2 * length) for length in length_m]) == pytest.approx(2 * r_m)
    assert margin_m([body(4.7)] * 3) == pytest.approx(4.86)  # of the shipped scenario


def asked_at_start_mps2(loaded):
    """What the barrier of a scenario asks for at t = 0 against its follower."""
    ego, _, follower = loaded.starts
    apart = np.subtract(ego.front_m, follower.front_m)
    rate_mps = apart[0] / np.hypot(*apart) * (ego.speed_mps - follower.speed_mps)
    return loaded.law.k_o * abs(rate_mps) / (np.hypot(*apart) - loaded.r_m)


@settings(max_examples=8)
@given(st.floats(60, 90), st.floats(13.5, 15.5), st.integers(1, 4))
def test_tightening_ends_at_the_least_gap_that_assumption_1_allows_and_each_step_is_a_scenario(
    tmp_path_factory, start_m, speed_mps, steps
):
    traffic, (one,) = events(
        tmp_path_factory.getbasetemp(), [*merging()[:2], steady("9", start_m, speed_mps)]
    )
    gaps = [one.gap_m.min()]
    for version in tightened(one, steps):
        gaps.append(version.gap_m.min())
        assert not version.breaks
        loaded = mjmerge.load(scenario(version, traffic))
        np.testing.assert_allclose(loaded.law.r_m, one.r_m, rtol=1e-4)
        assert asked_at_start_mps2(loaded) <= 1.01 * GENTLE_MPS2
        assert version.tightened in loaded.description
    assert (np.diff(gaps) < 0).all()
    if "drives 1.250 times" not in version.tightened:  # which is as much as a follower is driven faster
        assert gaps[-1] == pytest.approx(LEAST_GAP * one.r_m)
    np.testing.assert_array_equal(one.front_m[:, :2], version.front_m[:, :2])


def test_a_record_that_breaks_assumption_1_says_when_and_is_eased(tmp_path):
    closing = steady("9", 60.0, 21.5)
    traffic, (one,) = events(tmp_path, [*merging()[:2], closing])
    assert one.breaks.startswith(f"the gap is {one.gap_m.min():.2f} m at ")
    assert one.breaks.endswith(f"2r is {2 * one.r_m:.2f} m")
    (eased,) = tightened(one, 1)
    assert not eased.breaks
    assert eased.gap_m.min() == pytest.approx(LEAST_GAP * one.r_m)
    assert "further back" in eased.tightened
    (found,) = merges(traffic, "double_integrator").merges
    assert found.event.breaks


@pytest.mark.parametrize(
    ("cars", "why"),
    [
        ([steady("8", 108.0, 15.0), steady("9", 99.0, 15.0)], "to begin, the law needs more than 2r"),
        (
            [steady("8", 101.0, 15.0), steady("9", 80.0, 15.0)],
            "it is too near to one of them until it crosses",
        ),
    ],
)
def test_a_change_in_which_the_law_cannot_begin_is_skipped_and_says_so(tmp_path, cars, why):
    traffic, (one,) = events(tmp_path, [merging()[0], *cars])
    assert isinstance(one, Skipped)
    assert why in one.why
    found = merges(traffic, "double_integrator")
    assert (found.changes, found.merges, found.skipped) == (1, (), (one,))


def test_margins_are_those_of_three_cars_of_known_motion():
    t = np.linspace(0, 10, 501)
    ego = np.stack([20 * t, 3.5 - 0.7 * np.minimum(t, 5)], axis=1)
    leader = np.stack([40 + 18 * t, 0 * t], axis=1)
    follower = np.stack([-30 + 21 * t, 0 * t], axis=1)
    found = margins(
        t,
        np.stack([ego, leader, follower], axis=1),
        [body(5.0, 2.0, 1.0), body(4.0, 2.0, 0.8), body(6.0, 2.0, 1.2)],
        5.0,
        3.5,
    )
    enters = np.argmax(np.abs(ego[:, 1]) < 2.0)
    last_gap_m = (40 - 3.2) - 1.0 - 2 * t[-1]
    assert found.leader.bumper_m == pytest.approx(last_gap_m)
    assert found.leader.time_gap_s == pytest.approx(last_gap_m / 20)
    assert found.leader.ttc_s == pytest.approx(last_gap_m / 2)
    behind_m = -4.0 - (-30 + 1.2) - t[-1]
    assert found.follower.bumper_m == pytest.approx(behind_m)
    assert found.follower.time_gap_s == pytest.approx(behind_m / 21)
    assert found.follower.ttc_s == pytest.approx(behind_m / 1)
    assert found.leader.distance_m == pytest.approx(20.0 - 5.0)
    assert found.follower.distance_m == pytest.approx(20.0 - 5.0)
    assert found.entered_s == pytest.approx(2.5, abs=0.03)
    assert enters > 0
    assert entered_s(t, np.full(501, 2.0), 3.5) is None


def test_cars_that_never_close_in_have_no_time_to_collision_and_those_beside_have_no_gap():
    t = np.linspace(0, 4, 41)
    ego, leader, follower = (
        np.stack([x + 20 * t, y + 0 * t], axis=1) for x, y in ((0, 3.5), (30, 0), (-30, 0))
    )
    found = margins(t, np.stack([ego, leader, follower], axis=1), [body(5.0, 2.0, 1.0)] * 3, 5.0, 3.5)
    assert found.leader.bumper_m is None
    assert found.follower.time_gap_s is None
    nearer = np.stack([ego + [[1.0, 0.0]] * np.linspace(0, 20, 41)[:, None], leader, follower], axis=1)
    assert margins(t, nearer, [body(5.0, 2.0, 1.0)] * 3, 5.0, 3.5).leader.ttc_s is None
    ego[:, 1] = 0
    found = margins(t, np.stack([ego, leader, follower], axis=1), [body(5.0, 2.0, 1.0)] * 3, 5.0, 3.5)
    assert (found.leader.bumper_m, found.leader.ttc_s) == (pytest.approx(25.0), None)


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """One command on a file with a lane change that makes scenarios, one that does not, and a parked car."""
    folder = tmp_path_factory.mktemp("traffic")
    alone = changing("5", 250.0, 15.0, LANE_M, 0.0)
    parked = '<staticObstacle id="13"><type>parkedVehicle</type></staticObstacle>'
    (folder / "a.xml").write_text(commonroad([*merging(), alone, parked]), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        with pytest.raises(SystemExit) as ended:
            main(["traffic", "a.xml", "--tighten", "1"])
    return folder / "traffic" / "a-tighten_1", ended.value.code


def test_everything_in_a_file_is_accounted_for_and_its_scenarios_run(ran):
    folder, code = ran
    assert code == 0
    found = json.loads((folder / "traffic.json").read_text())
    assert (found["road_users"], found["tracks"], found["lane_changes"]) == (5, 4, 2)
    assert [(one["ego"], one["leader"], one["follower"]) for one in found["scenarios"]] == [
        ("7", "8", "9")
    ] * 2
    assert found["skipped"] == [
        {"id": "car 5 at 3.6 s", "why": "no leader is seen in lane 100 when it is entered"},
        {"id": "road user 13", "why": "stands for the whole record"},
    ]
    for one in found["scenarios"]:
        path = folder / one["path"].rpartition("/")[2]
        loaded = mjmerge.load(path)
        assert loaded.duration_s == one["duration_s"]
        assert not one["breaks_assumption"]
        assert one["smoothing_m"] < 1e-3
        trace = mjmerge.simulate(loaded, "double_integrator")
        assert mjmerge.judge(trace)[0].verdict == one["verdict"]
        assert one["law"]["leader"]["distance_m"] == pytest.approx(trace.min_distance_m[0, 0])
    alone, tight = found["scenarios"]
    assert alone["tightened"] is None
    assert tight["least_gap_m"] == pytest.approx(LEAST_GAP * tight["r_m"])
    assert alone["human"] == tight["human"]
    assert alone["human"]["entered_s"] == pytest.approx(3.6)


def test_the_report_has_the_law_beside_the_human_and_every_reason(ran):
    folder, _ = ran
    report = (folder / "report.md").read_text(encoding="utf-8")
    assert "5 road users: 4 tracks, 1 of no use; 2 lane changes: 1 make scenarios, 1 do not" in report
    assert report.count("| human |") == report.count("| law |") == 2
    assert "- car 5 at 3.6 s: no leader is seen in lane 100 when it is entered" in report
    for name in ("car-7-3.6s", "car-7-3.6s-tight-100"):
        assert f"![{name}]({name}.png)" in report
        assert (folder / f"{name}.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["a.xml", "--step", "0.1"], "--step goes with --export"),
        (["b.xml", "--export", "out", "--tighten", "2"], "--tighten is of traffic that is read"),
        (["none.xml"], "none.xml: cannot be read: No such file"),
        (["a.rrd"], "traffic is read from CommonRoad .xml"),
        (["a.xml", "--plant", "mujocco"], "did you mean 'mujoco'?"),
        (["a.xml", "--tighten", "-1"], "--tighten"),
        (["a.xml", "--map", "ngsim"], "is no table"),
        (["a.csv", "--map", "ngsym"], "did you mean 'ngsim'?"),
    ],
)
def test_what_cannot_be_read_ends_with_2_and_leaves_nothing(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.xml").write_text(commonroad(merging(steps=4)), encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SystemExit) as ended:
        main(["traffic", *arguments])
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before
