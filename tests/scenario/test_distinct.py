"""A sample is a distinct run: copies are said, and counted once; scenarios are told apart by their files."""

from __future__ import annotations

import json

import pytest

import mjmerge
from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.gate import gate
from mjmerge.scenario.distinct import SAME, labels, random
from mjmerge.scenario.load import load
from mjmerge.search import report as breaking_report
from mjmerge.search.breaking import ranged, search
from mjmerge.sweep import campaign, tally
from mjmerge.sweep import report as sweep_report
from mjmerge.sweep.sweep import sweep
from mjmerge.sweep.workers import Workers

BRAKES = "drivers.vehicle_1.speed_mps=1"
FLIPS = ["drivers.vehicle_2.hold_min_s=0.1", "drivers.vehicle_2.hold_max_s=0.4", "duration_s=1"]


def planned(*scenarios, **keys):
    block = {"scenarios": [*map(str, scenarios)], "plants": ["double_integrator"], "set": {"duration_s": 0.2}}
    return campaign.plan({"blocks": [{**block, **keys}]})


def bits(scenario, plant, seed, continuous=False):
    trace = mjmerge.simulate(scenario, plant, seed=seed, continuous=continuous)
    return [getattr(trace, name).tobytes() for name in ("front_m", "velocity_mps", "sensed_distance_m")]


@pytest.mark.parametrize(
    ("name", "given", "plant", "continuous"),
    [
        ("charge", [], "mujoco", False),
        ("charge", ["mismatch.command_delay_s=0.05"], "double_integrator", False),
        ("charge", [BRAKES, "mismatch.neighbour_dropout=0.3"], "double_integrator", False),
        ("charge", ["mismatch.position_noise_m=0.01"], "double_integrator", False),
        ("charge", ["mismatch.neighbour_velocity_noise_mps=0.1"], "mujoco", False),
        ("charge", ["mismatch.heading_noise_rad=0.01"], "bicycle", False),
        ("charge", ["mismatch.heading_noise_rad=0.01"], "double_integrator", False),
        ("charge", ["mismatch.neighbour_position_noise_m=0.01"], "double_integrator", True),
        ("charge", ["mismatch.sensing_delay_s=0.1", "mismatch.neighbour_reference_m=0.1"], "bicycle", False),
        ("flips", FLIPS, "double_integrator", False),
        ("flips", FLIPS, "double_integrator", True),
        ("flips", [*FLIPS, "drivers.vehicle_2.hold_min_s=0.4"], "double_integrator", False),
        ("flips", [*FLIPS, "drivers.vehicle_2.open_gap_m=1.7"], "double_integrator", False),
        ("flips", ["duration_s=0.9"], "double_integrator", False),  # over before anybody flips
    ],
)  # fmt: skip
def test_another_seed_is_another_run_exactly_where_something_is_random(name, given, plant, continuous):
    scenario = load(name, ["duration_s=0.3", *given]).settled()
    differ = bits(scenario, plant, 0, continuous) != bits(scenario, plant, 1, continuous)
    assert random(scenario, plant, continuous=continuous) == differ


@pytest.mark.parametrize(
    ("keys", "runs", "distinct"),
    [
        ({"seeds": 3}, 3, 1),
        ({"seeds": 3, "grid": {"mismatch.position_noise_m": [0, 0.01]}}, 6, 4),
        ({"grid": {"mismatch.command_delay_s": [0, 0.0, 0.1]}}, 3, 2),
        ({"mismatches": {"none": {}, "nothing": {"mismatch.command_delay_s": 0}}}, 2, 1),
        ({"mismatches": {"a": {"law.k_o": 2}, "b": {"law.k_o": 2.0}}, "variants": ["gated", "capped"]}, 4, 2),
        ({"mismatches": {"as it is": {"law.k_o": 1.0}, "none": {}}}, 2, 1),
        ({"grid": {"road.lane_width_m": [1.2, 1.3]}}, 2, 1),
        ({"variants": ["literal", "capped"], "grid": {"law.d_cap_m": [0.1, 0.2]}}, 4, 3),
        ({"random": {"draws": 8, "axes": {"mismatch.sensing_delay_s": {"choice": [0.1, 0.2]}}}}, 8, 2),
        ({"plants": ["double_integrator", "bicycle"], "seeds": 2}, 4, 2),
        ({"variants": ["capped+gated", "gated+capped"]}, 2, 1),
        ({"plants": ["bicycle"], "mismatches": {"a": {}, "b": {"belief.wheelbase_m": 0.3302}}}, 2, 1),
        ({"plants": ["mujoco"], "grid": {"mismatch.command_delay_s": [0.0101, 0.0105, 0.012]}}, 3, 2),
        ({"plants": ["bicycle"], "grid": {"mismatch.command_delay_s": [0.0101, 0.0105, 0.012]}}, 3, 3),
        ({"mismatches": {"a": {}, "b": {"models.ego": str(shipped.models()["rc"])}}}, 2, 1),
    ],
)  # fmt: skip
def test_copies_are_found_however_they_come_about(keys, runs, distinct):
    plan = planned("charge", **keys)
    assert len(plan.cases) == runs
    assert len(set(plan.same_as)) == distinct
    assert all(same <= i and plan.same_as[same] == same for i, same in enumerate(plan.same_as))
    moves = []
    for case in plan.cases:
        scenario = case.batch.scenario.model_copy(update={"mismatch": case.mismatch})
        moves.append(bits(scenario, case.batch.plant, case.seed))
    assert all(moves[same] == moves[i] for i, same in enumerate(plan.same_as))


def test_a_scenario_listed_twice_or_under_another_name_with_the_same_content_is_a_copy(tmp_path):
    text = shipped.scenarios()["charge"].read_text()
    (tmp_path / "mine.yaml").write_text(text.replace("description: ", "description: My own. "))
    plan = planned("charge", "charge", tmp_path / "mine.yaml", shipped.scenarios()["charge"])
    assert plan.same_as == (0, 0, 0, 0)
    assert [plan.labels[case.batch.source] for case in plan.cases] == ["charge", "charge", "mine", "charge"]


def test_copies_are_equal_and_enter_no_interval(tmp_path):
    plan = planned(
        "charge", set={"duration_s": 6, "control_step_s": 0.02}, seeds=2, variants=["literal", "gated"]
    )
    found = sweep(plan, tmp_path / "out")
    rows = found.to_pylist()
    assert [row[SAME] for row in rows] == [0, 0, 2, 2]
    assert {**rows[0], "run": 1, "seed": 1} == rows[1]
    summary = tally.summary(plan, found)
    assert (summary["runs"], summary["distinct"], summary["failure_rate"]["of"]) == (4, 2, 2)
    assert [(g["runs"], g["distinct"], g["failure_rate"]["of"]) for g in summary["groups"]] == [(2, 1, 1)] * 2
    assert len(summary["worst"]) == 2
    sweep_report.write(plan, found, tmp_path / "out")
    report = (tmp_path / "out" / sweep_report.REPORT).read_text()
    assert "4 runs, 2 distinct" in report
    assert "2 of 4 runs are copies" in report
    assert "| charge | double_integrator | literal | 2 | 1 |" in report


def test_a_slice_along_an_axis_counts_each_run_once_whatever_else_there_is(tmp_path):
    keys = {"mismatch.command_delay_s": [0, 0.1], "road.lane_width_m": [1.2, 1.3]}
    plan = planned(
        "charge", set={"duration_s": 5, "control_step_s": 0.02}, mismatches={"none": {}}, grid=keys
    )
    found = sweep(plan, tmp_path / "out")
    sweep_report.write(plan, found, tmp_path / "out")
    report = (tmp_path / "out" / sweep_report.REPORT).read_text()
    assert "| mismatch.command_delay_s | 0 | 0/1 =" in report
    assert "| road.lane_width_m | 1.3 | 0/2 =" in report


def test_scenarios_of_the_same_name_are_two_everywhere(tmp_path, capsys):
    text = shipped.scenarios()["charge"].read_text()
    for folder, old, new in (("a", "k_o", "k_o"), ("b", "r_eta_m: 1.204", "r_eta_m: 1.3")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "m.yaml").write_text(text.replace(old, new))
    (tmp_path / "c.yaml").write_text(
        "blocks: [{scenarios: [a/m.yaml, b/m.yaml], plants: [double_integrator], set: {duration_s: 0.4},"
        " mismatches: {none: {}, late: {mismatch.command_delay_s: 0.1}}}]"
    )
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as stop:
        main(["sweep", str(tmp_path / "c.yaml"), "--out", str(out), "--workers", "1", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert stop.value.code == 0
    assert [(g["scenario"], g["runs"], g["distinct"]) for g in found["groups"]] == [
        ("a/m", 2, 2),
        ("b/m", 2, 2),
    ]
    report = (out / sweep_report.REPORT).read_text()
    assert "| a/m | double_integrator |" in report
    assert "| b/m | double_integrator |" in report
    assert {p.name for p in out.glob("*.png")} == {f"margins_{x}-m_double_integrator.png" for x in "ab"}


def test_a_label_is_a_name_where_that_is_enough_and_never_the_same_for_two_files(tmp_path):
    paths = [
        tmp_path / p for p in ("a/m.yaml", "b/m.yaml", "b/n.yaml", "x/a/m.yaml", "charge.yaml", "b/m.yml")
    ]
    found = labels(["charge", *map(str, paths), str(tmp_path / "a/../b/n.yaml")])
    assert found["charge"] == "scenarios/charge"
    assert found[str(paths[2])] == found[str(tmp_path / "a/../b/n.yaml")] == "n"
    assert len(set(found.values())) == 7
    assert labels(["charge", "paper"]) == {"charge": "charge", "paper": "paper"}


def test_many_runs_of_what_is_not_random_say_so(capsys):
    for name, given, distinct in (("charge", [], 1), ("charge", ["mismatch.position_noise_m=0.01"], 3)):
        keys = [word for text in given for word in ("--set", text)]
        words = [
            "run",
            name,
            "--plant",
            "double_integrator",
            "--duration",
            "0.2",
            "--runs",
            "3",
            "--no-record",
        ]
        with pytest.raises(SystemExit):
            main([*words, *keys, "--json"])
        assert json.loads(capsys.readouterr().out)["distinct_runs"] == distinct
        with pytest.raises(SystemExit):
            main([*words, *keys])
        assert ("nothing is random here" in capsys.readouterr().out) == (distinct == 1)


def test_a_search_runs_seeds_only_where_they_are_other_runs_and_says_so():
    keys = {"duration_s": 0.1, "control_step_s": 0.02}
    axes = [
        ranged(axis, "charge", keys, "double_integrator")
        for axis in ("mismatch.command_delay_s", "mismatch.position_noise_m")
    ]
    found = search("charge", "double_integrator", axes, keys, Workers(1), seeds=range(3))
    assert [[t.runs for t in one.tried][:3] for one in found] == [[1, 1, 1], [1, 3, 3]]
    (note,) = breaking_report.seed_notes(found, 3)
    assert note.startswith("nothing is random along mismatch.command_delay_s: 3 seeds are one run")
    assert note[1:] in breaking_report.markdown(found, "charge", "unsafe", seeds=3)
    assert [line["distinct_seeds"] for line in breaking_report.as_json(found)] == [1, 3]


def test_a_gate_tells_scenarios_of_the_same_name_apart_and_reads_each_file_once(tmp_path):
    text = shipped.scenarios()["charge"].read_text(encoding="utf-8")
    for folder in "ab":
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "m.yaml").write_text(text, encoding="utf-8")
    a, b = tmp_path / "a", tmp_path / "b"
    rows = gate.rows([a, b / "m.yaml", a / ".." / "a" / "m.yaml", b])
    assert {row.label for row in rows} == {"a/m", "b/m"}
    assert len(rows) == 2 * len(load("charge").gate)
    assert {row.label for row in gate.rows([a])} == {"m"}
