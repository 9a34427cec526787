"""Campaign files: every mistake named with its line, every run a valid one, and the same list every time."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.config import shipped
from mjmerge.config.document import parse
from mjmerge.errors import MjmergeError, ScenarioError
from mjmerge.scenario.load import json_schema, load
from mjmerge.sweep import plan as plans
from mjmerge.sweep.campaign import GRID, RANDOM, Campaign, plan
from mjmerge.sweep.plan import NONE, Batches, written

WRONG = """\
description: everything wrong
blocks:
  - scenarios: [paper, chargee]
    plants: [double_integrater]
    variants: [gaited]
    mismatches:
      a: {mismatch.frictoin: 0.2}
      b: {mismatch.position_noise_m: -1, law.k_oo: 3}
    grid:
      mismatch.position_noise_m: [0, x]
      duration_s: [-1]
    random:
      draws: 2
      axes: {law.k_o: {uniform: [1, 2], choice: [1]}, law.k_v: {log_uniform: [0, 1]}}
  - scenarios: [paper]
    set: {duration_s: 8, control_step_s: 0.0025}
"""


def block(**keys) -> dict:
    return {"blocks": [{"scenarios": ["paper"], "plants": ["double_integrator"], **keys}]}


def test_every_mistake_of_a_campaign_is_named_with_its_line_and_the_nearest_right_name(tmp_path):
    file = tmp_path / "wrong.yaml"
    file.write_text(WRONG)
    with pytest.raises(ScenarioError) as error:
        plan(file)
    found = {(p.line, p.key.removeprefix("blocks.0.")) for p in error.value.problems}
    assert found >= {
        (3, "scenarios.1"),
        (4, "plants.0"),
        (14, "random.axes.law.k_o"),
        (14, "random.axes.law.k_v.log_uniform"),
        (16, "blocks.1.set.control_step_s"),
    }
    assert "did you mean 'charge'?" in str(error.value)

    file.write_text(WRONG.replace("double_integrater", "bicycle"))  # now its runs can be listed
    with pytest.raises(ScenarioError) as error:
        plan(file)
    found = {(p.line, p.key.removeprefix("blocks.0.")) for p in error.value.problems}
    assert found >= {
        (5, "variants.0"),
        (7, "mismatches.a.mismatch.frictoin"),
        (8, "mismatches.b.mismatch.position_noise_m"),
        (8, "mismatches.b.law.k_oo"),
        (10, "grid.mismatch.position_noise_m.1"),
        (11, "grid.duration_s.0"),
    }
    assert "did you mean 'friction'?" in str(error.value)


@pytest.mark.parametrize(
    "text",
    ["", "blocks: []", "blocks: 3", "blocks: [{}]", "blocks: [{scenarios: []}]", "blocks: [{random: 3}]"],
)
def test_what_is_no_campaign_is_an_error_and_no_traceback(tmp_path, text):
    file = tmp_path / "c.yaml"
    file.write_text(text)
    with pytest.raises(ScenarioError):
        plan(file)


def test_runs_are_the_product_of_scenarios_plants_variants_points_and_seeds():
    found = plan(
        {
            "blocks": [
                {
                    "scenarios": ["paper", "charge"],
                    "plants": ["double_integrator", "bicycle"],
                    "variants": ["literal", "gated"],
                    "mismatches": {"none": {}, "off": {"law.k_o": 0}},
                    "grid": {
                        "mismatch.sensing_delay_s": [0, 0.1],
                        "mismatch.neighbour_dropout": [0, 0.1, 0.2],
                    },
                    "seeds": 3,
                    "first_seed": 7,
                }
            ]
        }
    )
    assert len(found.cases) == 2 * 2 * 2 * (2 + 6) * 3
    assert found.axes == ("law.k_o", "mismatch.sensing_delay_s", "mismatch.neighbour_dropout")
    assert {c.seed for c in found.cases} == {7, 8, 9}
    assert {c.point for c in found.cases} == {"none", "off", GRID}
    assert {c.batch.scenario.law.variant for c in found.cases} == {"literal", "gated"}


def test_a_block_without_points_runs_the_scenario_as_it_is():
    (case,) = plan(block()).cases
    assert (case.point, case.overrides, case.batch.scenario) == (NONE, (), load("paper"))


def test_runs_that_differ_in_mismatch_and_seed_alone_share_a_batch():
    found = plan(block(grid={"mismatch.sensing_delay_s": [0, 0.1], "law.k_o": [1, 2]}, seeds=2))
    assert len({id(c.batch) for c in found.cases}) == 2


def test_draws_are_the_same_every_time_within_their_range_and_do_not_depend_on_how_many_there_are():
    axes = {
        "mismatch.neighbour_position_noise_m": {"log_uniform": [0.001, 0.1]},
        "mismatch.sensing_delay_s": {"uniform": [0.0, 0.2]},
        "mismatch.leader_acceleration": {"choice": ["known", "unknown"]},
    }
    few, many = (plan(block(random={"draws": n, "seed": 5, "axes": axes}, seeds=2)).cases for n in (5, 50))
    assert few == many[:10]
    assert len({c.seed for c in many}) == 100  # every draw has seeds of its own
    assert all(c.point == RANDOM for c in many)
    assert all(0.001 <= c.mismatch.neighbour_position_noise_m <= 0.1 for c in many)
    assert {c.mismatch.leader_acceleration for c in many} == {"known", "unknown"}
    other = plan(block(random={"draws": 5, "seed": 6, "axes": axes})).cases
    assert [c.mismatch for c in other] != [c.mismatch for c in few[::2]]


def test_draws_of_ranges_and_choices_are_those_of_the_published_tables_and_normal_ones_can_be_said():
    axes = {
        "mismatch.sensing_delay_s": {"uniform": [0.0, 0.2]},
        "mismatch.neighbour_position_noise_m": {"log_uniform": [0.001, 0.1]},
        "mismatch.leader_acceleration": {"choice": ["known", "unknown"]},
        "mismatch.neighbour_position_bias_m": {"normal": [0.1, 0.02]},
        "mismatch.command_delay_s": {"lognormal": [0.04, 0.5]},
    }
    found = plan(block(random={"draws": 400, "seed": 3, "axes": axes})).cases
    rng = np.random.default_rng([3, 7])
    seventh = found[7].mismatch
    assert seventh.sensing_delay_s == rng.uniform(0.0, 0.2)
    assert seventh.neighbour_position_noise_m == np.exp(rng.uniform(np.log(0.001), np.log(0.1)))
    assert seventh.leader_acceleration == ("known", "unknown")[rng.integers(2)]
    bias = np.array([case.mismatch.neighbour_position_bias_m for case in found])
    delay = np.log([case.mismatch.command_delay_s for case in found])
    assert (bias.mean(), bias.std()) == pytest.approx((0.1, 0.02), rel=0.1)
    assert (delay.mean(), delay.std()) == pytest.approx((np.log(0.04), 0.5), rel=0.1)


def test_what_a_run_sets_loads_as_the_same_scenario():
    keys = {"mismatch.tyres": "ideal", "law.k_o": 1e-5, "mismatch.load_kg": 1}
    found = plan(block(plants=["mujoco"], mismatches={"m": keys}))
    (case,) = found.cases
    scenario = load("paper", case.overrides)
    assert scenario.mismatch == case.mismatch
    assert scenario.model_copy(update={"mismatch": case.batch.scenario.mismatch}) == case.batch.scenario
    assert case.value("mismatch.tyres") == "ideal"
    assert case.value("law.k_o") == 1e-5
    assert case.value("drivers.vehicle_2.nonsense") is None


def test_scenarios_are_found_beside_the_campaign(tmp_path):
    (tmp_path / "mine.yaml").write_text((shipped.folder("scenarios") / "paper.yaml").read_text())
    (tmp_path / "c.yaml").write_text("blocks: [{scenarios: [mine.yaml]}]")
    (case,) = plan(tmp_path / "c.yaml").cases
    assert case.batch.scenario.name == "mine"
    assert load(case.batch.source, case.overrides) == load("paper")


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(10**9), 10**9)
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "Z"))),
        lambda inner: st.lists(inner, max_size=3),
        max_leaves=5,
    )
)  # fmt: skip
def test_what_is_written_on_a_command_line_reads_as_the_same_value(value):
    again = parse(written(value))
    assert not again.problems
    assert again.value == value
    assert type(again.value) is type(value)


def test_settings_on_the_command_line_are_read_like_a_file():
    assert plans.given(["law.k_o=0", "mismatch.tyres=ideal"]) == {"law.k_o": 0, "mismatch.tyres": "ideal"}
    with pytest.raises(MjmergeError, match="KEY=VALUE"):
        plans.given(["law.k_o"])


def test_a_case_from_the_command_line_is_checked():
    with pytest.raises(ScenarioError, match=r"mismatch\.frictoin: unknown key; did you mean 'friction'"):
        Batches().case("paper", "bicycle", {"mismatch.frictoin": 1})


@pytest.mark.parametrize("name", shipped.campaigns())
def test_shipped_campaigns_are_valid_and_described(name):
    found = plan(name)
    assert found.description
    assert found.cases


def test_the_schema_for_editors_is_that_of_the_code(written):
    written(shipped.folder("scenarios") / "campaigns" / "schema.json", json_schema(Campaign))
    assert json.loads(json_schema(Campaign))["title"] == "Campaign"
    for file in shipped.campaigns().values():
        assert file.read_text().startswith("# yaml-language-server: $schema=schema.json\n"), Path(file).name
