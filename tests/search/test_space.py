"""The space of a search: its points are scenarios that a file could say, within the bounds that it states."""

from __future__ import annotations

import numpy as np
import pytest

from mjmerge import load, simulate
from mjmerge.config import shipped
from mjmerge.drivers.gap import Gap
from mjmerge.errors import MjmergeError, ScenarioError
from mjmerge.scenario.load import dump
from mjmerge.scenario.space import Distribution
from mjmerge.search.space import Ground, altered
from mjmerge.sweep.plan import MISMATCH

MAY = "search={neighbours: {vehicle_2: {changes: 3, acceleration_mps2: 5.0, gap_m: [1.4, 3.6]}}}"


def ground(name: str, *keys: str, plant: str = "mujoco") -> Ground:
    return Ground.around(load(name, keys), plant)


def points(of: Ground, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((count, of.size))


@pytest.mark.parametrize("name", sorted(shipped.scenarios()))
def test_every_scenario_has_a_space_whose_points_are_scenarios(name, tmp_path):
    there = ground(name)
    assert there.size > 5
    made = 0
    for point in points(there, 6):
        try:
            scenario = there.at(point)
        except ScenarioError:
            continue
        path = tmp_path / "case.yaml"
        path.write_text(dump(scenario))
        assert load(path).model_copy(update={"gate": scenario.gate}) == scenario
        made += 1
    assert made >= 5


def test_whatever_is_drawn_keeps_the_bounds_that_are_stated():
    there = ground("charge", MAY)
    for point in [*points(there, 50), np.zeros(there.size), np.ones(there.size)]:
        driver = there.at(point).drivers.vehicle_2
        assert isinstance(driver, Gap)
        assert len(driver.moves) == 3
        assert not list(driver.problems())
        times = np.linspace(0, 12, 1201)
        gap, _, peak = np.array([driver.profile(t) for t in times]).T
        assert np.abs(peak).max() <= 5.0 * 1.001
        assert gap.min() >= 1.4 - 1e-9
        assert gap.max() <= 3.6 + 1e-9


def test_a_point_stands_for_one_scenario_and_its_run_has_the_bits_of_its_yaml(tmp_path):
    level = "search={level: realistic, neighbours: {vehicle_2: {acceleration_mps2: 5, gap_m: [2, 3]}}}"
    there = ground("charge", "duration_s=1", level, plant="bicycle_limited")
    point = points(there, 1)[0]
    assert there.at(point) == there.at(point)
    (tmp_path / "case.yaml").write_text(dump(there.at(point)))
    ours = simulate(there.at(point), "bicycle_limited", seed=3)
    theirs = simulate(load(tmp_path / "case.yaml"), "bicycle_limited", seed=3)
    assert ours.front_m.tobytes() == theirs.front_m.tobytes()


def test_a_level_is_every_axis_that_acts_on_the_plant_and_nothing_that_is_left_out():
    own = ", axes: {mismatch.load_kg: {choice: [0, 1]}}"
    level = f"search={{level: realistic, leave_out: [command_delay_s]{own}}}"
    keys = {c.key for c in ground("charge", level).coordinates}
    assert {"mismatch.friction", "mismatch.steer_lag", "mismatch.load_kg"} <= keys
    assert "mismatch.command_delay_s" not in keys
    ideal = {c.key for c in ground("charge", level.replace(own, ""), plant="double_integrator").coordinates}
    assert ideal
    assert "mismatch.friction" not in ideal
    least = ground("charge", level).at(np.zeros(len(keys)))
    assert least.mismatch.friction == 1.0


def test_the_centre_of_a_two_sided_axis_is_nothing_and_its_ends_are_the_level():
    there = ground("charge", "search={level: realistic}")
    values = [there.values(np.full(there.size, part)) for part in (0.0, 0.5, 1.0)]
    grade = [value[MISMATCH + "grade_rad"] for value in values]
    assert grade == pytest.approx([-0.03, 0.0, 0.03])


@pytest.mark.parametrize(
    ("given", "at"),
    [
        ({"uniform": (2.0, 4.0)}, [2.0, 3.0, 4.0]),
        ({"log_uniform": (1.0, 100.0)}, [1.0, 10.0, 100.0]),
        ({"choice": ("a", "b")}, ["a", "b", "b"]),
        ({"normal": (5.0, 0.0)}, [5.0, 5.0, 5.0]),
    ],
)
def test_a_distribution_says_what_is_below_which_part(given, at):
    spread = Distribution(**given)
    assert not list(spread.problems())
    found = [spread.at(part) for part in (0.0, 0.5, 1.0)]
    assert found == (at if isinstance(at[0], str) else pytest.approx(at))


def test_normal_distributions_have_their_quantiles():
    assert Distribution(normal=(1.0, 2.0)).at(0.8413447) == pytest.approx(3.0, abs=1e-5)
    assert Distribution(lognormal=(2.0, 0.5)).at(0.5) == pytest.approx(2.0)
    assert np.isfinite([Distribution(normal=(0.0, 1.0)).at(part) for part in (0.0, 1.0)]).all()


def test_every_mistake_in_a_space_is_told_at_once_with_its_key():
    wrong = (
        "search={axes: {law.k_o: {uniform: [2, 1]}, mismatch.friction: {choice: [1], normal: [1, 1]}, "
        "mismatch.load_kg: {lognormal: [-1, 1]}}, neighbours: {vehicle_2: {acceleration_mps2: 4}, "
        "vehicle_3: {acceleration_mps2: 4, gap_m: [3, 2], from_s: 99}}}"
    )
    with pytest.raises(ScenarioError) as error:
        load("charge", [wrong])
    said = {problem.key: problem.message for problem in error.value.problems}
    assert said.keys() == {
        "search.axes.law.k_o.uniform",
        "search.axes.mismatch.friction",
        "search.axes.mismatch.load_kg.lognormal",
        "search.neighbours.vehicle_2",
        "search.neighbours.vehicle_3",
        "search.neighbours.vehicle_3.gap_m",
        "search.neighbours.vehicle_3.from_s",
    }


@pytest.mark.parametrize(
    ("keys", "plant", "says"),
    [
        ("search={axes: {law.k_0: {uniform: [1, 2]}}}", "mujoco", "search.axes.law.k_0.*k_o"),
        ("search={axes: {mismatch.friction: {uniform: [0, 1]}}}", "mujoco", "must be greater than 0"),
        ("search={axes: {mismatch.friction: {uniform: [0, 1]}}}", "bicycle", "must be greater than 0"),
        (
            "search={axes: {mismatch.friction: {uniform: [0.5, 1]}}}",
            "bicycle",
            "nothing may be different on bicycle: mismatch.friction acts on mujoco only",
        ),
        ("search={}", "mujoco", "nothing may be different on mujoco: its search names nothing"),
    ],
)
def test_a_space_that_is_none_on_a_plant_is_refused_before_anything_runs(keys, plant, says):
    with pytest.raises(MjmergeError, match=says):
        ground("charge", keys, plant=plant)


def test_axes_that_cannot_act_on_a_plant_are_left_out_and_said():
    there = ground("charge", plant="double_integrator")
    assert {"mismatch.command_delay_s", "mismatch.sensing_delay_s"} <= {c.key for c in there.coordinates}
    left_out = dict(there.left_out)
    assert left_out.keys() == {
        f"mismatch.{axis}" for axis in ("friction", "steer_lag", "drive_lag_s", "brake_limit", "load_kg")
    }
    assert left_out["mismatch.friction"] == "acts on mujoco only, not on double_integrator"
    assert ground("charge").left_out == ()
    differs = there.at(np.full(there.size, 0.9)).mismatch.model_dump(exclude_defaults=True)
    assert differs.keys() == {"command_delay_s", "sensing_delay_s"}
    assert there.digest != ground("charge").digest


def test_an_axis_that_acts_beside_another_one_is_kept():
    delay = "mismatch.leader_acceleration_delay_s: {uniform: [0.01, 0.1]}"
    alone = ground(
        "charge",
        f"search={{axes: {{{delay}, mismatch.sensing_delay_s: {{uniform: [0, 0.1]}}}}}}",
        "mismatch.leader_acceleration=unknown",
    )
    assert [key for key, _ in alone.left_out] == ["mismatch.leader_acceleration_delay_s"]
    both = ground(
        "charge",
        f"search={{axes: {{{delay}, mismatch.leader_acceleration: {{choice: [unknown, known]}}}}}}",
        "mismatch.leader_acceleration=unknown",
    )
    assert both.left_out == ()
    assert both.size == 2


def test_altering_a_scenario_keeps_all_else_and_refuses_what_no_file_could_say():
    scenario = load("charge")
    other = altered(scenario, {"law.k_o": 0.5, "initial.ego.speed_mps": 1.9, "mismatch.friction": 0.7})
    assert (other.law.k_o, other.initial.ego.speed_mps, other.mismatch.friction) == (0.5, 1.9, 0.7)
    assert other.name == "charge"
    assert (
        altered(other, {"law.k_o": 1.0, "initial.ego.speed_mps": 2.0, "mismatch.friction": 1.0}) == scenario
    )
    with pytest.raises(ScenarioError):
        altered(scenario, {"law.k_o": -1.0})
