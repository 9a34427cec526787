"""What the words mean, on runs: the counterfactual, the loop that is there, laws that are not the paper's."""

from dataclasses import replace

import numpy as np
import pytest

from mjmerge.law.opinion_dynamics import barrier as barrier_module
from mjmerge.law.opinion_dynamics import law as merge
from mjmerge.scenario.load import load
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.simulation.loop import simulate, ticks
from mjmerge.verdict import counterfactual
from mjmerge.verdict.counterfactual import ideals_m, unguarded, without_barrier_m
from mjmerge.verdict.hypotheses import HYPOTHESES
from mjmerge.verdict.judge import BROKEN, HELD, REFUTED, UNRESOLVED, VACUOUS, judge
from mjmerge.verdict.metrics import merged_at_s, turned_rad

IDEAL = "double_integrator"
PUSHED = {
    "description": "The ego stands in front of Vehicle 1, its target is behind it: a steady pull towards it.",
    "duration_s": 20,
    "initial": {
        "ego": {"front_m": [1.5, 0.0], "speed_mps": 2.0},
        "vehicle_1": {"front_m": [0.0, 0.0], "speed_mps": 2.0},
        "vehicle_2": {"front_m": [-4.0, 0.0], "speed_mps": 2.0},
    },
    "law": {"r_rho_m": -1.2, "r_eta_m": 0.0},
    "drivers": {
        "vehicle_1": {"kind": "steady", "speed_mps": 2.0},
        "vehicle_2": {"kind": "steady", "speed_mps": 2.0},
    },
}
WIDE = PUSHED | {
    "description": "A merge into a gap of 6 m: nothing is near.",
    "initial": {
        "ego": {"front_m": [-1.5, 3.0], "speed_mps": 2.0},
        "vehicle_1": {"front_m": [0.0, 0.0], "speed_mps": 2.0},
        "vehicle_2": {"front_m": [-6.0, 0.0], "speed_mps": 2.0},
    },
    "law": {"r_rho_m": -1.2, "r_eta_m": 3.0},
}


def verdict_of(scenario, *overrides, plant=IDEAL, **options):
    (verdict,) = judge(simulate(load(scenario, overrides), plant, **options))
    return verdict


@pytest.mark.parametrize("k_o", [0.001, 0.01, 0.05])
def test_a_barrier_so_weak_that_a_tick_jumps_over_it_is_no_refutation(k_o):
    verdict = verdict_of("paper", f"law.k_o={k_o}", "duration_s=12")
    assert (verdict.verdict, verdict.matters.hypothesis) == (BROKEN, "hold small against d")


def test_a_law_that_is_told_wrong_speeds_is_no_refutation():
    noise = "mismatch.neighbour_velocity_noise_mps=2"
    verdict = verdict_of("charge", noise)
    assert (verdict.verdict, verdict.matters.hypothesis) == (BROKEN, "closing speeds known")


@pytest.mark.parametrize("plant", [IDEAL, "bicycle"])
def test_a_distance_that_fades_in_continuous_time_is_unresolved_and_no_pass(plant):
    verdict = verdict_of(PUSHED, plant=plant, continuous=True)
    assert (verdict.verdict, verdict.floor_held, verdict.unsafe_at_s) == (UNRESOLVED, False, None)
    assert "too little to tell from 0" in verdict.reason


def test_a_barrier_too_weak_for_the_solver_is_unresolved_in_continuous_time():
    verdict = verdict_of("paper", "law.k_o=0.01", "duration_s=12", continuous=True)
    assert verdict.verdict == UNRESOLVED


@pytest.mark.parametrize("scenario", ["paper", "charge"])
@pytest.mark.parametrize("plant", [IDEAL, "bicycle", "mujoco"])
def test_with_the_barrier_off_nothing_is_held(scenario, plant):
    assert verdict_of(scenario, "law.k_o=0", "duration_s=9", plant=plant).verdict in (BROKEN, VACUOUS)


def flipped(*args):
    return -barrier_module.barrier(*args)


@pytest.mark.parametrize("scenario", ["paper", "charge", "blocked", "flips", WIDE])
@pytest.mark.parametrize("continuous", [False, True], ids=["held command", "continuous"])
def test_a_barrier_with_the_wrong_sign_holds_nothing(monkeypatch, scenario, continuous):
    monkeypatch.setattr(merge, "barrier", flipped)
    assert verdict_of(scenario, "duration_s=10", continuous=continuous).verdict != HELD


@pytest.mark.parametrize("continuous", [False, True], ids=["held command", "continuous"])
def test_a_barrier_with_the_wrong_sign_that_leads_to_a_violation_refutes_itself(monkeypatch, continuous):
    """The hold is no excuse for it: whatever crosses d = 0 in ticks passes one that can jump over it."""
    monkeypatch.setattr(merge, "barrier", flipped)
    assert verdict_of("charge", continuous=continuous).verdict == REFUTED


@pytest.mark.parametrize("bias", ["neighbour_reference_m=0.165", "neighbour_position_bias_m=0.1"])
@pytest.mark.parametrize("scenario", ["paper", "charge"])
def test_a_law_that_is_told_wrong_distances_holds_nothing(scenario, bias, long):
    short = [] if long else ["duration_s=12"]
    assert verdict_of(scenario, f"mismatch.{bias}", *short).verdict != HELD


def test_a_law_that_computes_wrong_distances_holds_nothing(monkeypatch, long):
    right = merge.geometry

    def wrong(law, sensed):
        seen = right(law, sensed)
        return replace(seen, d=seen.d + 0.1)

    monkeypatch.setattr(merge, "geometry", wrong)
    for scenario in ("paper", "charge"):
        assert verdict_of(scenario, *([] if long else ["duration_s=12"])).verdict != HELD


@pytest.mark.parametrize("plant", [IDEAL, "mujoco"])
def test_a_merge_into_a_gap_wide_open_is_vacuous(plant):
    verdict = verdict_of(WIDE, "duration_s=10", plant=plant)
    assert (verdict.verdict, verdict.needed) == (VACUOUS, False)
    assert "not because of the barrier" in verdict.reason


def test_a_run_that_something_else_kept_away_is_vacuous_and_one_that_a_strong_barrier_kept_away_is_held():
    slides = verdict_of("charge", "mismatch.friction=0.01", plant="mujoco")
    assert (slides.verdict, slides.needed) == (VACUOUS, False)
    assert "something else kept it away" in slides.reason
    strong = verdict_of("paper", "law.k_o=12", "duration_s=12", plant="bicycle")
    assert strong.verdict == HELD


def test_the_counterfactual_is_the_same_scenario_without_the_barrier_run_by_run():
    scenario = load("flips", ["duration_s=3", "physics_step_s=0.002"])
    noisy = Mismatch(neighbour_position_noise_m=0.01, command_delay_s=0.03)
    cases = [(5, Mismatch()), (6, noisy), (7, Mismatch(friction=0.5)), (7, Mismatch())]
    trace = simulate(scenario, "mujoco", cases=cases)
    ideal = [cases[0], cases[1], cases[3], cases[3]]  # a double integrator knows no friction
    alone = [simulate(unguarded(scenario), IDEAL, cases=[case]).min_distance_m[0] for case in ideal]
    assert without_barrier_m(trace, range(4)).tobytes() == np.stack(alone).tobytes()
    assert without_barrier_m(trace, [2]).tobytes() == alone[2].tobytes()


@pytest.fixture
def ideals(monkeypatch) -> list[list[str]]:
    """The law of each simulation of the ideal, by batch, as they are run."""
    found = []

    def noted(scenario, each, *given, **more):
        found.append([one.law.kind for one in each])
        return ticks(scenario, each, *given, **more)

    monkeypatch.setattr(counterfactual, "ticks", noted)
    return found


def test_what_is_known_already_of_a_run_without_the_barrier_is_not_run_again(ideals):
    scenario = load("charge", ["duration_s=0.7"])
    cases = [(seed, Mismatch(friction=friction)) for seed in (3, 4) for friction in (0.5, 1.0)]
    first = without_barrier_m(simulate(scenario, IDEAL, cases=[(s, Mismatch()) for s, _ in cases]), range(4))
    again = without_barrier_m(simulate(scenario, "mujoco", cases=cases), range(4))
    assert again.tobytes() == first.tobytes()
    assert [*map(len, ideals)] == [2]  # two seeds, that no friction makes a difference to
    without_barrier_m(simulate(scenario, IDEAL, runs=2, seed=4), range(2))
    without_barrier_m(simulate(load("charge", ["duration_s=0.7", "law.r_rho_m=-1"]), IDEAL, seed=3), [0])
    assert [*map(len, ideals)] == [2, 1, 1]


def test_the_ideals_without_and_with_the_barrier_run_together_each_to_the_bits_it_has_alone(ideals):
    scenario = load("charge", ["duration_s=1.5"])
    noisy = [(seed, Mismatch(neighbour_position_noise_m=0.02)) for seed in range(4)]
    trace = simulate(scenario, "bicycle", cases=noisy)
    without, with_it = ideals_m(trace, [0, 2, 3], [3, 1])
    assert [*map(len, ideals)] == [5]
    bare = scenario.settled().model_copy(update={"law": scenario.law.unguarded()})
    for law_of, runs, found in ((bare, [0, 2, 3], without), (scenario, [3, 1], with_it)):
        alone = [simulate(law_of, IDEAL, cases=[noisy[run]]).least_m[0] for run in runs]
        assert found.tobytes() == np.stack(alone).tobytes()
    assert not np.array_equal(without[2], with_it[0])
    larger = simulate(load("charge", ["duration_s=1.5", "physics_step_s=0.002"]), "mujoco", cases=noisy)
    again = ideals_m(larger, [0], [1])  # a step of the physics is nothing to the ideal
    assert (again[0].tobytes(), again[1].tobytes()) == (without[:1].tobytes(), with_it[1:].tobytes())
    assert [*map(len, ideals)] == [5]
    assert [rows.shape for rows in ideals_m(trace, [], [])] == [(0, 2), (0, 2)]


def test_a_law_whose_bare_form_is_of_another_kind_runs_by_itself(ideals, monkeypatch):
    scenario = load("charge", ["duration_s=0.5", "law.kind=cbf_qp"])
    monkeypatch.setattr(type(scenario.law), "unguarded", lambda _: load("charge").law.unguarded())
    trace = simulate(scenario, "bicycle", runs=2)
    without, with_it = ideals_m(trace, [0, 1], [1])
    assert ideals == [["opinion_dynamics"] * 2, ["cbf_qp"]]
    assert np.isfinite(without).all()
    assert np.isfinite(with_it).all()


def test_held_means_that_a_run_without_the_barrier_comes_out_worse(long):
    verdicts = judge(simulate(load("flips", [] if long else ["duration_s=15"]), IDEAL, runs=24))
    assert HELD in [verdict.verdict for verdict in verdicts]
    for verdict in verdicts:
        if verdict.verdict == HELD:
            assert verdict.without_barrier_m < 0.6
        assert (verdict.verdict == HELD) == (verdict.needed is True)


@pytest.mark.parametrize("plant", [IDEAL, "bicycle", "bicycle_limited", "mujoco"])
def test_a_neighbour_that_drives_into_the_other_is_said_on_every_plant(plant):
    verdict = verdict_of(
        "charge", "drivers.vehicle_2={kind: steady, speed_mps: 4}", "duration_s=4", plant=plant
    )
    assert "neighbours keep apart" in [b.hypothesis for b in verdict.breaches]
    bodies = [(c.a, c.b) for c in verdict.collisions]
    assert bodies == ([("vehicle_1", "vehicle_2")] if plant == "mujoco" else [])


def test_a_collision_comes_first_in_the_reason_before_the_margin():
    verdict = verdict_of("charge", "mismatch.command_delay_s=0.2", plant="mujoco")
    assert verdict.reason.startswith("the ego hits vehicle_1 at 5.1")
    assert verdict.collisions[0].speed_mps == pytest.approx(1.16, abs=0.1)
    assert verdict.matters.hypothesis == "delay small against d"


def test_an_ego_behind_a_standing_leader_that_turns_across_the_road_has_not_merged():
    changes = ["drivers.vehicle_1.speed_mps=0", "duration_s=20"]
    trace = simulate(load("charge", changes), "mujoco")
    assert np.isnan(merged_at_s(trace)[0])
    assert abs(turned_rad(trace)[0]) > 0.5


def test_a_violation_long_after_a_twitch_is_not_excused_by_it():
    """What broke and was over before the approach began: the theorem starts anew from there."""
    trace = simulate(load("charge", ["law.k_o=0"]), IDEAL)
    trace = replace(trace, scenario=load("charge"))  # as if the barrier had been on, and been no use
    (unexcused,) = judge(trace)
    assert (unexcused.verdict, unexcused.matters) == (REFUTED, None)
    trace.u_mps2[0, 20:25, 0] += 3.0  # for 0.05 s the ego does not move as commanded
    (twitched,) = judge(trace)
    assert "ego moves as commanded" in [b.hypothesis for b in twitched.breaches]
    assert (twitched.verdict, twitched.matters) == (unexcused.verdict, unexcused.matters)
    assert twitched.unsafe_at_s > 4


def test_every_hypothesis_says_what_it_asks():
    assert all(one.asks and one.reads for one in HYPOTHESES.values())
