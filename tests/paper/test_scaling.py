"""Similarity: the run at another size is the same run."""

import re
from math import sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjmerge import MjmergeError, load, simulate
from mjmerge.config.frozen import Frozen
from mjmerge.config.units import unit
from mjmerge.drivers import kinds
from mjmerge.errors import ModelError, ScenarioError
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.load import dump
from mjmerge.scenario.schema import Belief, Scenario
from mjmerge.scenario.space import Distribution
from mjmerge.simulation.trace import COLUMNS

NAMES = ("paper", "charge", "flips", "blocked", "leader_brakes", "stop_and_go")
SHIPPED = [load(name) for name in NAMES]
DIMENSIONLESS = {"k_w", "politeness", "z", "mu", "z_floor", "at_least", "at_most", "exponent"}
PHYSICAL = {
    "friction", "left_friction", "patch_friction", "side_wind_n", "load_kg", "yaw_inertia", "wheel_radius",
    "front_stiffness", "rear_stiffness", "suspension_stiffness", "torque_limit", "brake_limit",
    "steer_rate_limit", "steer_lag", "neighbour_dropout",
}  # fmt: skip
"""Ratios, and what is about physical cars, which come as they are."""

UNITS = {"_m": (1, 0), "_mps": (1, -1), "_mps2": (1, -2), "_rad": (0, 0), "_radps": (0, -1)}


def factor(column, length):
    """What a column is multiplied by."""
    metres, seconds = UNITS.get(re.search(r"_[a-z0-9]+$|$", column)[0], (0, 0))
    if column.endswith("_per_s"):
        metres, seconds = 0, -1
    return length**metres * sqrt(length) ** seconds


def assert_same_run(scenario, length, plant, tolerance, columns, **how):
    a, b = simulate(scenario, plant, **how), simulate(scenario.scaled(length), plant, **how)
    assert b.time_s == pytest.approx(sqrt(length) * a.time_s, rel=1e-12)
    for name in columns:
        expected = getattr(a, name) * factor(name, length)
        size = max(1.0, np.nanmax(np.abs(expected)))
        assert getattr(b, name) == pytest.approx(expected, abs=tolerance * size, nan_ok=True), name


BICYCLE = [c.name for c in COLUMNS if not re.match(r"torque|clearance|contact", c.name)]
POINTS = [name for name in BICYCLE if not re.match(r"(sensed_)?(a_|omega|steer|speed|heading)", name)]


@given(st.sampled_from(NAMES), st.floats(0.05, 100))
@settings(max_examples=12)
def test_the_double_integrator_runs_the_same_at_any_size(name, length):
    assert_same_run(load(name, ["duration_s=4"]), length, "double_integrator", 1e-11, POINTS)


@given(st.sampled_from(NAMES), st.floats(0.05, 100))
@settings(max_examples=4)
def test_so_it_does_in_continuous_time(name, length):
    scenario = load(name, ["duration_s=4"])
    assert_same_run(
        scenario, length, "double_integrator", 1e-9, ["front_m", "opinion", "mu"], continuous=True
    )


def test_and_so_does_the_front_axle_of_a_bicycle_there_whatever_its_wheelbase():
    scenario = load("charge", ["duration_s=6"])
    assert_same_run(scenario, 10.0, "bicycle", 1e-9, ["front_m", "opinion", "mu"], continuous=True)


@given(st.sampled_from(["paper", "charge", "flips", "leader_brakes"]), st.floats(0.05, 50))
@settings(max_examples=8)
def test_the_bicycle_runs_the_same_at_any_size_under_a_hold_too(name, length):
    scenario = load(name, ["duration_s=6", "belief.wheelbase_m=0.35"])
    assert_same_run(scenario, length, "bicycle", 1e-9, BICYCLE)


def test_physical_cars_come_as_they_are():
    with pytest.raises(ModelError, match=r"models.size is 10, but mujoco's cars come in their own size"):
        simulate(load("paper").scaled(10.0), "mujoco")


@pytest.mark.parametrize("variant", ["capped+guarded+one_sided", "gated+z_floor+no_u1"])
def test_variants_are_similar_too(variant):
    cap = ["law.d_cap_m=0.3"] if "capped" in variant else []
    scenario = load("charge", ["duration_s=6", f"law.variant={variant}", *cap])
    assert_same_run(scenario, 10.0, "double_integrator", 1e-10, POINTS)


def test_the_gains_follow_the_rule_of_their_units():
    law, scaled = load("paper").law, load("paper").scaled(4.0).law
    rule = {
        "r_m": 4, "r_rho_m": 4, "r_eta_m": 4, "d_cap_m": 4, "k_o": 2, "eps_v_mps": 2, "eps": 2,
        "k_p": 1 / 4, "k_v": 1 / 2, "k_mu": 1 / 2, "eps_1": 1 / 2, "k_s": 1 / 2, "k": 1 / 2,
        "k_w": 1, "z_floor": 1,
    }  # fmt: skip
    assert {name: getattr(scaled, name) / getattr(law, name) for name in rule} == pytest.approx(rule)
    assert set(rule) | {"kind", "variant", "leader", "follower", "choice"} == set(type(law).model_fields)


@given(st.floats(0.05, 50))
@settings(max_examples=10)
def test_there_and_back_again_is_where_it_was(length):
    for scenario in SHIPPED:
        back = scenario.scaled(length).scaled(1 / length)
        update = {"gate": (), "search": None}  # floors by hand are for one size, and so is a space
        there = scenario.model_copy(update=update)
        assert leaves(back) == pytest.approx(leaves(there), rel=1e-12)


def leaves(model):
    """All numbers of a scenario, by path."""
    found = {}

    def walk(path, value):
        if isinstance(value, Frozen):
            for name in type(value).model_fields:
                walk(f"{path}.{name}", getattr(value, name))
        elif isinstance(value, tuple):
            for i, item in enumerate(value):
                walk(f"{path}.{i}", item)
        elif isinstance(value, float):
            found[path] = value

    walk("", model)
    return found


def models_in(annotation):
    if isinstance(annotation, type) and issubclass(annotation, Frozen):
        yield annotation
        for info in annotation.model_fields.values():
            yield from models_in(info.annotation)
    for part in getattr(annotation, "__args__", ()):
        yield from models_in(part)


def test_every_number_of_a_scenario_has_a_unit_or_is_known_to_have_none():
    models = {model for top in (Scenario, *kinds().values()) for model in models_in(top)} - {Belief}
    models -= {Distribution}  # which has the unit of its key
    assert len(models) > 12
    for model in models:
        for name, info in model.model_fields.items():
            if "float" in str(info.annotation):
                assert (unit(name, info) is None) == (name in DIMENSIONLESS | PHYSICAL), (
                    f"{model.__name__}.{name}"
                )


def test_the_cars_on_ideal_plants_take_the_size_and_so_does_what_is_believed_of_them():
    scenario = load("paper", ["belief.wheelbase_m=0.4", "belief.mass_kg=5", "mismatch.command_delay_s=0.1"])
    scaled = scenario.scaled(4.0)
    assert (scaled.belief.wheelbase_m, scaled.belief.mass_kg) == (1.6, 5)
    assert (scaled.models.ego, scaled.models.size) == (scenario.models.ego, 4.0)
    assert car_sheets(scaled)[0].wheelbase_m == 4 * car_sheets(scenario)[0].wheelbase_m
    assert car_sheets(scaled)[0].mass_kg == car_sheets(scenario)[0].mass_kg
    assert scaled.mismatch.command_delay_s == 0.2
    assert scaled.expect.min_distance_m.at_least == 0.2
    assert scaled.name == "paper"


def test_a_scaled_scenario_can_be_written_and_read(tmp_path):
    scaled = load("flips").scaled(10.0)
    file = tmp_path / "large.yaml"
    file.write_text(dump(scaled))
    assert load(file) == scaled


@pytest.mark.parametrize("length", [0.0, -1.0, float("inf"), float("nan")])
def test_a_size_that_is_none_is_refused(length):
    with pytest.raises(MjmergeError, match="the scale must be a positive number"):
        load("paper").scaled(length)


def test_a_key_that_leaves_its_bounds_is_named():
    with pytest.raises(ScenarioError, match=r"paper, scaled by 1e\+06: duration_s: .*3600"):
        load("paper").scaled(1e6)
