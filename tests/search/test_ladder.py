"""The ladder: every rung is a run that anyone can repeat, and the costs add up."""

from __future__ import annotations

import json
import shlex

import pytest

from mjmerge.cli import main
from mjmerge.search.ladder import FILES, RUNGS, climb, markdown
from mjmerge.sweep.workers import Workers

KEYS = {"duration_s": 0.5, "initial.ego.front_m": [-1.2, 1.1]}


def test_every_rung_is_the_run_of_its_command_and_costs_add_up(capsys):
    ladder = climb("charge", {**KEYS, "mismatch.friction": 0.5}, Workers(1))
    assert tuple(rung.name for rung in ladder.rungs) == RUNGS
    assert ladder.delay_s == 0.02  # two control steps, because the scenario has none
    assert ladder.nominal
    title, _, below = markdown(ladder).splitlines()[:3]
    assert title == "# The ladder of charge"
    assert below.startswith("**mismatch: friction 0.5, command_delay_s 0.02; set: ")
    for rung in ladder.rungs:
        with pytest.raises(SystemExit):
            main([*shlex.split(rung.command)[1:], "--no-record", "--json"])
        found = json.loads(capsys.readouterr().out)["min_distance_m"]
        assert found == {"vehicle_1": rung.row["min_d_1_m"], "vehicle_2": rung.row["min_d_2_m"]}
    lost = ladder.rungs[0].row["min_distance_m"] - ladder.rungs[-1].row["min_distance_m"]
    assert sum(rung.cost_m for rung in ladder.rungs[1:]) == pytest.approx(lost, abs=1e-12)


def test_the_scenarios_own_mismatch_waits_for_the_last_rung_and_its_delay_is_kept():
    own = {"mismatch.friction": 0.5, "mismatch.tyres": "ideal", "mismatch.command_delay_s": 0.05}
    ladder = climb("charge", {**KEYS, **own}, Workers(1))
    mismatches = {rung.name: rung.case.mismatch for rung in ladder.rungs}
    assert not ladder.nominal
    assert mismatches["ideal"].command_delay_s == mismatches["held"].command_delay_s == 0
    assert {mismatches[name].command_delay_s for name in RUNGS[2:]} == {0.05}
    assert {mismatches[name].friction for name in RUNGS[:-1]} == {1.0}
    assert (mismatches["tyre slip"].tyres, mismatches["MuJoCo"].tyres) == ("slip", "ideal")
    assert (mismatches["mismatch"].tyres, mismatches["mismatch"].friction) == ("ideal", 0.5)


def test_without_a_mismatch_the_ladder_ends_with_the_tyres_and_leaves_plot_and_table(tmp_path, capsys):
    keys = [word for k, v in KEYS.items() for word in ("--set", f"{k}={v}")]
    with pytest.raises(SystemExit) as stop:
        main(["sweep", "--ladder", "charge", "--out", str(tmp_path / "l"), "--workers", "1", "--json", *keys])
    found = json.loads(capsys.readouterr().out)
    assert stop.value.code == 0
    assert [rung["name"] for rung in found["rungs"]] == list(RUNGS[:-1])
    assert {p.name for p in (tmp_path / "l").iterdir()} == set(FILES)
