"""The end of a lane through the house: who stops before it, who runs off it, and all that says so."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mjmerge.cli import main
from mjmerge.law import Sensed, decided, kinds, remembered
from mjmerge.review.replay import replay
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.distinct import same_as
from mjmerge.scenario.load import load
from mjmerge.scenario.ramp import Ramp
from mjmerge.search.margin import KINDS, margin
from mjmerge.simulation.each import simulate_each
from mjmerge.simulation.loop import simulate
from mjmerge.state import Cars
from mjmerge.sweep.plan import Batches
from mjmerge.sweep.rows import OF_THE_END, rows
from mjmerge.verdict.judge import BROKEN, HELD, REFUTED, judge
from mjmerge.verdict.metrics import events
from mjmerge.verdict.phases import phases
from mjmerge.verdict.summary import summary
from mjmerge.world.road import markings

IDEAL = "double_integrator"
COARSE = "control_step_s=0.02"
NOTHING = "road.told=nothing"


@pytest.fixture(scope="module")
def off():
    """A run that runs off: the law is told nothing of the end."""
    return simulate(load("ramp_blocked", [NOTHING, COARSE, "duration_s=9"]), IDEAL)


def test_nobody_runs_off_a_ramp_whatever_the_seed_and_every_seed_is_another_run(long):
    runs = 100 if long else 6
    scenario = load("ramp_small", [] if long else [COARSE])
    trace = simulate(scenario, IDEAL, runs=runs)
    assert not trace.off_the_end.any()
    assert np.all(trace.least_m.min(axis=0) > [0.1, 0.1, 0.3])
    assert len({front.tobytes() for front in trace.front_m}) == runs
    past = trace.front_m[:, -1, 0, 0] > scenario.road.ends_m
    merged = np.abs(trace.front_m[:, -1, 0, 1]) < 0.1
    assert np.all(past | (trace.velocity_mps[:, -1, 0, 0] < 0.7))  # as slow as the traffic, or slower
    assert merged.any()
    assert not merged.all()
    if long:
        untold = simulate(load("ramp_small", [NOTHING]), IDEAL, runs=runs)
        assert untold.off_the_end.any(axis=1).sum() > runs / 2


@pytest.mark.parametrize("plant", [IDEAL, "bicycle_limited"])
def test_a_blocked_ego_stops_with_the_margin_that_its_scenario_states(plant):
    scenario = load("ramp_blocked", [COARSE])
    trace = simulate(scenario, plant)
    (verdict,) = judge(trace)
    assert scenario.expect.min_edge_distance_m.at_least == 0.4
    assert 0.4 < trace.least_m[0, -1] < 0.45
    assert np.hypot(*trace.velocity_mps[0, -1, 0]) < 0.03
    assert (verdict.verdict, verdict.floor_held, verdict.ran_off) == (HELD, True, None)
    assert "without the barrier the ideal runs off the end of its lane" in verdict.reason
    assert verdict.without_barrier_m < 0
    stricter = load("ramp_blocked", [COARSE, "expect.min_edge_distance_m.at_least=0.45"])
    (other,) = judge(replace(trace, scenario=stricter), np.array([[1.0, 1.0, -1.0]]))
    assert (other.verdict, other.floor_held) == (HELD, False)


def test_running_off_is_a_failure_of_its_own_kind_and_said_everywhere(off):
    (verdict,) = judge(off)
    tick = int(np.argmax(off.edge_distance_m[0] <= 0))
    assert verdict.verdict == BROKEN
    assert verdict.matters.hypothesis == "end is told"
    assert (verdict.ran_off.time_s, verdict.unsafe_at_s) == (off.time_s[tick], off.time_s[tick])
    fast = np.hypot(*off.velocity_mps[0, tick, 0])
    sentence = f"the ego runs off the end of its lane at {off.time_s[tick]:.2f} s at {fast:.2f} m/s"
    assert verdict.reason.startswith(sentence)
    assert not verdict.floor_held
    said = summary(off, [verdict])
    assert said["ran_off"] == [{"seed": 0, "time_s": off.time_s[tick], "speed_mps": fast}]
    assert said["min_edge_distance_m"] == off.edge_distance_m.min()
    assert [e.text.partition(" at ")[0] for e in events(off) if e.level == "error"] == [
        "runs off the end of its lane"
    ]
    road = [(p.time_s, p.state) for p in phases(off) if p.subject == "road"]
    assert road[:2] == [(0.0, "on the road"), (off.time_s[tick], "off the end")]
    (row,) = rows(off, [verdict])
    assert [row[name] for name in OF_THE_END] == [off.edge_distance_m.min(), off.time_s[tick]]
    assert (row["outcome"], row["unsafe_at_s"]) == ("failed", off.time_s[tick])


def test_a_search_counts_what_is_left_to_the_edge_and_names_who_runs_off(off):
    found = margin(off)
    assert (found.kind, found.holds, found.unsafe_at_s) == ("end", False, judge(off)[0].unsafe_at_s)
    assert found.least_m == off.edge_distance_m.min() < 0 < found.min_distance_m
    assert KINDS["end"] == "the ego runs off the end of its lane"
    before = off.time_s < 6.0
    part = {c.name: off.column(c.name)[:, before] for c in off.columns}
    ends = {name: part.pop(name) for name in off.signals}
    safe = margin(replace(off, time_s=off.time_s[before], **part, signals=ends))
    assert (safe.kind, safe.least_m) == (None, min(safe.min_distance_m, ends["edge_distance_m"].min()))


def test_a_law_that_is_told_of_the_end_and_runs_off_all_the_same_is_refuted(off):
    """Whoever is told of the end, has a barrier against it and runs off all the same, refutes it."""
    told = replace(off, scenario=load("ramp_blocked", [COARSE, "duration_s=9"]))
    (verdict,) = judge(told)
    assert verdict.ran_off == judge(off)[0].ran_off
    assert verdict.verdict == REFUTED
    end, edge = off.signals["end_distance_m"][0], off.edge_distance_m[0]
    between = (end < 0.3) & (edge > 0.35) & (off.time_s < verdict.unsafe_at_s)
    assert between.any()
    misled = np.where(between[:, None], off.sensed_distance_m[0] + 0.1, off.sensed_distance_m[0])
    (excused,) = judge(replace(told, sensed_distance_m=misled[None]))
    assert (excused.verdict, excused.matters.hypothesis) == (BROKEN, "distances known")


def test_what_the_law_is_told_of_the_end_makes_another_run_and_the_width_of_a_lane_that_goes_on_does_not():
    made = Batches()
    told, untold = (made.case("ramp_blocked", IDEAL, {"road.told": of}) for of in ("obstacle", "nothing"))
    narrow, wide = (made.case("charge", IDEAL, {"road.lane_width_m": of}) for of in (1.0, 1.2))
    assert same_as([told, untold, narrow, wide]) == (0, 1, 2, 2)


def test_without_an_end_nothing_is_said_of_one():
    trace = simulate(load("charge", ["duration_s=0.5"]), IDEAL)
    verdicts = judge(trace)
    assert "ran_off" not in summary(trace, verdicts)
    assert not set(OF_THE_END) & rows(trace, verdicts)[0].keys()
    assert "end is told" not in summary(trace, verdicts)["hypotheses"]
    assert not trace.signals
    assert trace.least_m.shape == (1, 2)


def facing(law, told: bool, x_m: float = 0.0) -> np.ndarray:
    """What a law asks of an ego alone before the end of its lane, after a while of that, m/s^2."""
    front = np.array([[[x_m, 1.2], [8.0, 0.0], [-8.0, 0.0]]])
    still, v = np.zeros((1, 3)), np.tile([2.0, 0.0], (1, 3, 1))
    ramp = Ramp.of([load("ramp_blocked", ["road.ends_m=1.7", "initial.ego.front_m=[-0.85, 1.2]"])])
    seen = Sensed.of(Cars(front, v, *[still] * 5), np.zeros((1, 2)), ramp.obstacle if told else None)
    assert seen.p_j.shape == (1, 3 if told else 2, 2)
    memory = law.start(1, {"z": 0.15, "mu": 0.0})
    for _ in range(40):  # rss responds after its response time
        made = decided(law, seen, memory, 0.01)
        memory = remembered(law, memory, made, 0.01)
    return made.u[0]


@pytest.mark.parametrize("kind", sorted(set(kinds()) - {"nominal"}))
def test_every_law_that_keeps_clear_of_others_brakes_for_the_end(kind):
    law = load("ramp_blocked", [f"law.kind={kind}"]).law
    assert facing(law, told=True)[0] < facing(law, told=False)[0] - 0.5
    bare = law.unguarded()
    assert np.array_equal(facing(bare, told=True), facing(bare, told=False))


def test_a_function_of_ones_own_sees_the_end_as_the_last_of_the_others(tmp_path):
    text = "def law(seen, memory, dt):\n    return -seen.g[:, -1], {'near_m': seen.d, 'all': seen.d[:, -1]}\n"
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    keys = [f"law.kind={tmp_path / 'mine.py'}:law", "duration_s=0.1", COARSE]
    trace = simulate(load("ramp_blocked", keys), IDEAL)
    assert trace.signals["near_m"].shape == (1, 6, 3)
    assert np.array_equal(trace.signals["all"], trace.signals["end_distance_m"])
    names = {c.name: c.names(trace.roster) for c in trace.columns}
    assert names["near_m"] == (("vehicle_1", "vehicle_2", "end"),)
    assert names["distance_m"] == (("vehicle_1", "vehicle_2"),)


def test_a_run_has_the_same_bits_alone_in_a_batch_and_among_lanes_of_other_places():
    keys = [COARSE, "duration_s=1.2", "road.ends_m=4"]
    here, there = load("ramp_small", keys), load("ramp_small", [*keys, "initial.ego.front_m=[-0.85, 1.3]"])
    batch = simulate(here, IDEAL, runs=3)
    mixed = simulate_each([(2, here), (2, there)], IDEAL)
    for name in ("front_m", "end_distance_m", "edge_distance_m", "u_mps2"):
        alone = simulate(here, IDEAL, seed=2).column(name)
        assert alone.tobytes() == batch.column(name)[2:].tobytes() == mixed[0].column(name).tobytes()
        assert mixed[1].column(name).tobytes() == simulate(there, IDEAL, seed=2).column(name).tobytes()


def test_in_continuous_time_it_stops_at_the_same_place():
    keys = ["duration_s=2.4", "road.ends_m=4", "physics_step_s=0.001", "control_step_s=0.005"]
    sampled = simulate(load("ramp_blocked", keys), IDEAL)
    solved = simulate(load("ramp_blocked", keys), IDEAL, continuous=True)
    assert not solved.stops
    assert np.abs(solved.front_m - sampled.front_m).max() < 0.01
    assert solved.signals["end_distance_m"].min() < 0.15  # it had to brake


def test_a_recording_has_the_end_and_is_verified_and_run_again_to_the_bit(tmp_path):
    keys = ["law.kind=cbf_qp", "duration_s=1", COARSE, "road.ends_m=1.4"]
    run(load("ramp_blocked", keys), IDEAL, folder=tmp_path / "run")
    for kind in ("mcap", "rrd"):
        assert [c for c in verify(tmp_path / "run" / f"run.{kind}").checks if c.right is False] == []
    assert replay(tmp_path / "run" / "run.mcap").same
    written = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (written["ran_off"], written["edge_floor_m"]) == ([], 0.4)


def test_a_command_ends_with_1_where_the_ego_runs_off(capsys):
    keys = ["--set", NOTHING, "--set", COARSE, "--duration", "8", "--no-record"]
    with pytest.raises(SystemExit) as end:
        main(["run", "ramp_blocked", "--plant", IDEAL, *keys])
    said = " ".join(capsys.readouterr().out.split())
    assert end.value.code == 1
    assert "edge of the road RAN OFF at 7." in said


def test_the_edge_is_drawn_from_the_outer_side_over_the_taper_to_the_lane_that_goes_on():
    scenario = load("ramp_blocked")
    lines = {line.name: line for line in markings(scenario)}
    ends = {}
    for name in ("edge_left", "edge_left_taper", "edge_left_beyond"):
        line = lines[name]
        half = line.length_m / 2 * np.array([np.cos(line.yaw_rad), np.sin(line.yaw_rad)])
        ends[name] = [np.array([line.x_m, line.y_m]) + way * half for way in (-1, 1)]
    assert ends["edge_left"][1] == pytest.approx([10.7, 1.204 + 0.6])
    assert ends["edge_left_taper"][0] == pytest.approx(ends["edge_left"][1])
    assert ends["edge_left_taper"][1] == pytest.approx([11.5, 0.602])
    assert ends["edge_left_beyond"][0] == pytest.approx([11.5, 0.602])
    dashes = [line.x_m + line.length_m / 2 for name, line in lines.items() if name.startswith("dash")]
    assert max(dashes) <= 11.5 + 1.2
    assert lines["verge"].width_m == pytest.approx(0.602 + 0.6)


def test_nothing_is_drawn_of_an_end_where_there_is_none():
    names = {line.name for line in markings(load("charge")) if not line.name.startswith("dash")}
    assert names == {"edge_left", "edge_right"}
