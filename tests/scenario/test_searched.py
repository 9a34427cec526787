"""What a search names is there: told wherever a scenario is read, with line and nearest right name."""

from __future__ import annotations

import json

import pytest

from mjmerge import load
from mjmerge.cli import main
from mjmerge.config.document import parse
from mjmerge.errors import ScenarioError
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.load import dump

CHANGED = {"charge": (), "platoon_8": (), "ramp": ("law={kind: mpc, r_m: 1.9, r_rho_m: -9.0}",)}
"""Scenarios, and what is set, so that cars, law and road are of several kinds."""
LAW = """
from mjmerge.law import Decision, Law

class Mine(Law):
    kind: str = "mine.py:Mine"
    gain_per_s: float = 1.0

    def decide(self, seen, memory, step_s):
        return Decision(-self.gain_per_s * seen.v)
"""


def wrong(source, *keys, **how):
    """What is wrong with a scenario, by key."""
    try:
        load(source, keys, **how)
    except ScenarioError as error:
        return {one.key: one.message for one in error.problems}
    return {}


def axes(*keys):
    """A search along these keys, for ``--set``."""
    return f"search={{axes: {{{', '.join(f'{key}: {{uniform: [0.5, 1]}}' for key in keys)}}}}}"


def keys_of(value, at=""):
    """Every key below a value but in lists and of metrics, which are called as one likes."""
    for name, below in value.items():
        if isinstance(below, dict) and name not in ("metrics", "search"):
            yield from keys_of(below, f"{at}{name}.")
        else:
            yield at + name


@pytest.mark.parametrize("name", CHANGED)
def test_every_key_of_a_scenario_can_be_an_axis_and_none_of_which_a_letter_is_wrong(name):
    there = parse(dump(load(name, CHANGED[name]))).value
    every = [*keys_of(there)]
    assert len(every) > 80
    assert wrong(there, axes(*every)) == {}
    off = [f"{key}q" for key in every]
    as_axes, as_keys = wrong(there, axes(*off)), wrong(there, *(f"{key}=1" for key in off))
    assert as_axes == {f"search.axes.{key}": message for key, message in as_keys.items()}
    assert as_axes.keys() == {f"search.axes.{key}" for key in off}


def test_a_misspelt_axis_is_told_by_every_command_with_its_line_beside_all_else(tmp_path, capsys):
    text = dump(load("charge")).partition("search:")[0].replace("control_step_s", "control_stepp_s")
    lines = [
        "search:", "  level: mild", "  leave_out:", "  - mismatch.load_kg", "  - fricton", "  axes:",
        "    mismatch.fricton: {uniform: [0.5, 1]}", "    friction: {uniform: [0.5, 1]}",
    ]  # fmt: skip
    (tmp_path / "mine.yaml").write_text(text + "\n".join(lines))
    n = text.count("\n")
    for command in ("run", "falsify", "check", "export"):
        with pytest.raises(SystemExit) as end:
            main([command, str(tmp_path / "mine.yaml")])
        assert end.value.code == 2
        said = capsys.readouterr().err
        assert "load_kg" not in said
        assert "control_stepp_s: unknown key; did you mean 'control_step_s'?" in said
        at = f"mine.yaml:{n + 5}: search.leave_out.1: no axis of mismatch called 'fricton': "
        assert f"{at}did you mean 'friction'?" in said
        assert (
            f"mine.yaml:{n + 7}: search.axes.mismatch.fricton: unknown key; did you mean 'friction'?" in said
        )
        assert (
            f"mine.yaml:{n + 8}: search.axes.friction: unknown key; did you mean 'mismatch.friction'?" in said
        )


def test_a_key_of_another_kind_is_right_as_the_kind_may_be_another():
    other = axes("law.horizon_s", "drivers.vehicle_2.time_gap_s", "drivers.vehicle_8.gap_m", "law.kind")
    assert wrong("charge", other) == {}
    assert wrong("charge", axes("initial.ego.front_m.0", "gate.0.set", "expect.metrics.mine.at_least")) == {}
    assert [*wrong("charge", axes("drivers.vehicle_0.gap_m"))] == ["search.axes.drivers.vehicle_0.gap_m"]


def test_keys_of_a_law_from_outside_are_known_and_nothing_is_said_of_them_under_another(tmp_path):
    (tmp_path / "mine.py").write_text(LAW)
    value = parse(dump(load("charge"))).value
    value["law"] = {"kind": "mine.py:Mine", "r_m": value["law"]["r_m"]}
    value["search"] = {"axes": {"law.gain_per_s": {"uniform": [0.5, 1]}}}
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(value))
    assert wrong(path) == {}
    assert wrong(path, axes("law.gain_pr_s")) == {
        "search.axes.law.gain_pr_s": "unknown key; did you mean 'gain_per_s'?"
    }
    assert [*wrong(path, "law.r_m=wide")] == ["law.r_m"]  # it is not read, and nobody knows its keys
    paper = [f"law.{key}={value}" for key, value in load("charge").law if key in ("r_rho_m", "r_eta_m")]
    assert wrong(path, "law.kind=opinion_dynamics", *paper, "law.k_o=1", "law.k_v=2") == {}


def test_a_recording_is_read_whatever_it_looked_for():
    assert wrong("charge", axes("law.k_oo")) != {}
    assert wrong("charge", axes("law.k_oo"), code=False) == {}
    assert wrong("charge", axes("law.k_oo"), sheets=car_sheets(load("charge"))) == {}
