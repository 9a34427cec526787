"""Each car its own length and width: what becomes of its data sheet, and what mujoco makes of it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.errors import ModelError, ScenarioError
from mjmerge.plant import check
from mjmerge.review.replay import replay
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.cars import car_sheets, data_sheet, equipped
from mjmerge.scenario.load import dump, load
from mjmerge.simulation.loop import simulate

SEDAN = data_sheet("sedan")  # 4.7 m and 1.82 m
ALONG = ("front_overhang_m", "wheelbase_m", "com_behind_front_axle_m")


def highway(*keys):
    return load("highway", ["duration_s=0.1", *keys]).settled()


@given(st.floats(0.1, 30.0), st.floats(0.1, 5.0))
def test_a_sheet_is_stretched_in_proportion_and_its_mass_stays(length_m, width_m):
    sheet = SEDAN.stretched(length_m, width_m)
    assert (sheet.length_m, sheet.width_m) == (length_m, width_m)
    for name in ALONG:
        assert getattr(sheet, name) / length_m == pytest.approx(getattr(SEDAN, name) / 4.7)
    assert sheet.track_m / width_m == pytest.approx(SEDAN.track_m / 1.82)
    changed = {name for name, value in sheet if value != getattr(SEDAN, name)}
    assert changed <= {"length_m", "width_m", "track_m", "yaw_inertia_kg_m2", *ALONG}
    plate = (length_m**2 + width_m**2) / (4.7**2 + 1.82**2)
    assert sheet.yaw_inertia_kg_m2 == pytest.approx(plate * SEDAN.yaw_inertia_kg_m2)
    longer = SEDAN.stretched(length_m, None)
    assert (longer.width_m, longer.track_m) == (SEDAN.width_m, SEDAN.track_m)
    assert SEDAN.stretched(None, None) == SEDAN


def test_a_scenario_says_it_of_each_car_and_comes_back_from_its_file(tmp_path):
    scenario = highway("models.length_m={vehicle_1: 4.9}", "models.width_m.vehicle_2=1.9")
    ego, one, two = car_sheets(scenario)
    assert (ego, one.length_m, one.width_m) == (SEDAN, 4.9, 1.82)
    assert (two.length_m, two.width_m) == (4.7, 1.9)
    path = tmp_path / "again.yaml"
    path.write_text(dump(scenario))
    assert load(path) == scenario
    assert "length_m" not in dump(highway()).split("models:")[1].split("road:")[0]


def test_another_size_has_them_at_that_size():
    scenario = highway("models.length_m={vehicle_1: 4.9}").scaled(0.1)
    assert [sheet.length_m for sheet in car_sheets(scenario)] == pytest.approx([0.47, 0.49, 0.47])


@pytest.mark.parametrize(
    ("key", "where", "words"),
    [
        ("models.length_m.vehicle_3=4", "models.length_m.vehicle_3", "there is no vehicle_3 under initial"),
        ("models.width_m.vehicle_1=0", "models.width_m.vehicle_1", "must be greater than 0"),
        ("models.length_m.vehicle_02=4", "models.length_m.vehicle_02", "did you mean 'vehicle_2'"),
        ("models.length_m.vehicle_2=15", "initial.vehicle_2.front_m", "vehicle_1 and vehicle_2 overlap"),
    ],
)
def test_a_length_that_is_none_or_of_nobody_is_told(key, where, words):
    with pytest.raises(ScenarioError) as refused:
        highway(key, "initial.vehicle_2.front_m=[-4.75, 0]", "law.r_m=0.5", "law.r_rho_m=-2")
    assert any(p.key == where and words in p.message for p in refused.value.problems)


def test_on_an_ideal_plant_the_car_turns_as_one_of_that_length():
    trace = simulate(highway("models.length_m.ego=9.4"), "bicycle")
    assert trace.sheets[0].wheelbase_m == pytest.approx(2 * 2.7)
    tan, v = np.tan(trace.steer_rad[0, :, 0]), trace.speed_mps[0, :, 0]
    turned_rad = np.sum(v[:-1] * (tan[1:] + tan[:-1]) / 2) * 0.02 / 5.4
    assert trace.heading_rad[0, -1, 0] == pytest.approx(turned_rad, rel=0.01)


def test_a_recording_of_such_a_car_is_right(tmp_path):
    keys = ["models.length_m.ego=0.4", "models.width_m.ego=0.45", "duration_s=0.3", "control_step_s=0.02"]
    scenario = load("charge", [*keys, "law.k_p=30", "initial.z=1"]).settled()  # which steers hard
    assert run(scenario, "bicycle", folder=tmp_path / "run").trace.steer_rad[0, :, 0].min() < -0.3
    found = verify(tmp_path / "run" / "run.mcap")
    assert [one for one in found.checks if one.right is False] == []


def test_on_mujoco_the_car_is_stretched_and_stands_and_turns_as_one_of_that_length():
    keys = ["models.length_m.ego=6.1", "models.width_m.vehicle_2=1.6", "law.k_p=0.3"]
    trace = simulate(highway(*keys, "duration_s=2"), "mujoco")
    ego, _, two = trace.sheets
    assert (ego.length_m, two.width_m) == (6.1, 1.6)
    assert trace.stops == ()
    tan, v = np.tan(trace.steer_rad[0, :, 0]), trace.speed_mps[0, :, 0]
    turned_rad = np.sum(v[:-1] * (tan[1:] + tan[:-1]) / 2) * 0.02 / ego.wheelbase_m
    slow = simulate(highway("models.length_m.ego=6.1", "law.k_p=0.3", "duration_s=2"), "bicycle")
    assert abs(turned_rad) > 0.005
    assert trace.heading_rad[0, -1, 0] == pytest.approx(slow.heading_rad[0, -1, 0], abs=0.01)


def test_its_clearance_is_that_of_the_longer_body():
    longer, own = (simulate(highway(*keys), "mujoco") for keys in (["models.length_m.vehicle_1=6.0"], []))
    behind_m = longer.sheets[1].length_m - longer.sheets[1].front_overhang_m
    was_m = SEDAN.length_m - SEDAN.front_overhang_m
    between = own.roster.pair_names.index("vehicle_1_vehicle_2")
    clearance_m = [trace.clearance_m[0, 0, between] for trace in (own, longer)]
    assert clearance_m[0] - clearance_m[1] == pytest.approx(behind_m - was_m, abs=1e-3)


def test_a_recording_of_a_stretched_car_runs_again_to_its_bits(tmp_path):
    keys = ["models.length_m.ego=0.37", "models.width_m.vehicle_2=0.33", "duration_s=0.3"]
    run(load("charge", [*keys, "control_step_s=0.02"]).settled(), "mujoco", folder=tmp_path / "run")
    assert replay(tmp_path / "run" / "run.mcap").same
    found = verify(tmp_path / "run" / "run.mcap")
    assert [one for one in found.checks if one.right is False] == []


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("models.length_m={vehicle_1: 7.6}", "so not to 7.6 m; the nearest shipped model is van, 5.9 m"),
        ("models.length_m={vehicle_1: 2.9}", "so not to 2.9 m"),
        (
            "models.width_m={vehicle_1: 3.0}",
            "sedan is 1.82 m wide, and mujoco's cars are stretched by a factor",
        ),
        (
            "models.length_m={vehicle_1: 3.6};models.width_m={vehicle_1: 2.6}",
            "sedan would be 0.766 times as long and 1.43 times as wide; on mujoco these differ by 1.6 times",
        ),
    ],
)
def test_what_a_model_cannot_be_stretched_to_is_refused_on_mujoco_alone(keys, words):
    scenario = highway(*keys.split(";"))
    for plant in ("double_integrator", "bicycle", "bicycle_limited"):
        check(plant, scenario)
    with pytest.raises(ModelError) as refused:
        check("mujoco", scenario)
    (line,) = str(refused.value).splitlines()
    assert line.startswith(("models.length_m.vehicle_1: ", "models.width_m.vehicle_1: "))
    assert words in line
    assert "nearest shipped model is sedan" not in line


def test_every_plant_has_the_same_sheets():
    scenario = highway("models.length_m.vehicle_2=5.4")
    ideal, physical = (simulate(scenario, plant).sheets for plant in ("bicycle", "mujoco"))
    assert ideal == physical
    assert car_sheets(equipped(scenario))[2].length_m == 5.4
