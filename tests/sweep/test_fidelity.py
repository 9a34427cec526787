"""Larger steps of the physics where they are enough: who is run again, and to which row."""

import shlex
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

import mjmerge
from mjmerge.sweep import campaign, tally
from mjmerge.sweep.fidelity import Fidelity, first, near
from mjmerge.sweep.folder import identity
from mjmerge.sweep.sweep import measured
from mjmerge.sweep.workers import HERE

WITHIN = 0.05


def plan(fidelity, plants=("mujoco",), **keys):
    keys = {"duration_s": 0.4, "initial.ego.front_m": [-1.2, 1.3]} | keys
    axes = {"mismatch.command_delay_s": {"uniform": [0.0, 0.1]}}
    if "mujoco" in plants:
        axes["mismatch.friction"] = {"uniform": [0.2, 1.0]}
    block = {
        "scenarios": ["charge"],
        "plants": list(plants),
        "set": keys,
        "random": {"draws": 6, "axes": axes},
    }
    return campaign.plan({"blocks": [block]} | ({"fidelity": fidelity} if fidelity else {}))


@pytest.fixture(scope="module")
def tables():
    """Rows in steps of 1 ms, of 2 ms, and of both; a decision is near to half of those of 2 ms."""
    fine = measured(plan(None), HERE).to_pylist()
    rough = measured(plan(None, physics_step_s=0.002), HERE).to_pylist()
    floor_m = sorted(row["min_distance_m"] for row in rough)[2] - 1e-4
    within_r = 2e-4 / 0.6
    fidelity = {"step_s": 0.002, "within_r": within_r}
    asked = plan(fidelity, **{"expect.min_distance_m.at_least": floor_m})
    return fine, rough, asked, measured(asked, HERE)


RUN = (
    "min_distance_m",
    "min_d_1_m",
    "min_d_2_m",
    "min_clearance_m",
    "merged_at_s",
    "rms_jerk_mps3",
    "verdict",
)


def test_what_is_near_a_decision_has_the_row_of_its_own_step_and_all_else_that_of_the_larger(tables):
    fine, rough, asked, found = tables
    steps = [row["physics_step_s"] for row in found.to_pylist()]
    assert 0 < steps.count(0.001) < len(steps)
    for i, row in enumerate(found.to_pylist()):
        same = fine[i] if row["physics_step_s"] == 0.001 else rough[i]
        assert [row[name] for name in RUN] == [same[name] for name in RUN]
        scenario = asked.cases[i].batch.scenario
        again = near(rough[i] | {"floor_held": None}, scenario, asked.cases[i].batch.fidelity.within_r)
        assert again == (row["physics_step_s"] == 0.001)
    assert fine[0]["min_distance_m"] != rough[0]["min_distance_m"]


def test_it_is_told_and_the_command_of_a_row_has_its_step(tables):
    *_, asked, found = tables
    rows = found.to_pylist()
    again = sum(row["physics_step_s"] == 0.001 for row in rows)
    (line,) = [line for line in tally.notes(asked, found) if "steps of 2 ms" in line]
    assert line.startswith(f"6 runs were made in steps of 2 ms; {again} of them came within")
    assert tally.summary(asked, found)["physics_step_s"] == {"0.001": again, "0.002": 6 - again}
    for row in rows:
        words = shlex.split(tally.command(asked, row))
        assert ("physics_step_s=0.002" in words) == (row["physics_step_s"] == 0.002)


def test_without_it_every_run_is_at_its_own_step_and_rows_of_ideal_plants_have_none(tables):
    fine, rough, *_ = tables
    assert {row["physics_step_s"] for row in fine} == {0.001}
    assert {row["physics_step_s"] for row in rough} == {0.002}
    ideal = plan({"within_r": 0.1}, plants=["bicycle"])
    assert ideal.batches[0].begun is None
    assert [row["physics_step_s"] for row in measured(ideal, HERE).to_pylist()] == [None] * 6


def test_rows_of_another_fidelity_are_not_those_of_this_sweep():
    digests = [identity(plan(f))["scenarios"] for f in (None, {"within_r": 0.1}, {"within_r": 0.2})]
    assert len(set(digests)) == 3


def test_a_scenario_whose_own_step_is_as_large_or_that_has_bounds_of_its_own_metrics_keeps_its_step():
    fidelity = Fidelity(within_r=0.1)
    for name, own in (("highway", True), ("charge", False)):
        scenario = mjmerge.load(name)
        assert (first(scenario, "mujoco", fidelity) is scenario) == own
    bounded = SimpleNamespace(expect=SimpleNamespace(metrics={"a": 1}))
    assert first(bounded, "mujoco", fidelity) is bounded
    odd = mjmerge.load("charge", ["control_step_s=0.005"])
    assert first(odd, "mujoco", fidelity) is odd, "2 ms do not divide 5 ms"


def row(d_1, d_2, clearance, verdict="held", stopped=None, **more):
    least = {"min_d_1_m": d_1, "min_d_2_m": d_2, "min_clearance_m": clearance}
    others = {"without_barrier_m": -0.1, "contact_speed_mps": 0.0}
    return {"stopped": stopped, "verdict": verdict} | least | others | more


CHARGE = mjmerge.load("charge")  # r 0.6 m
NEAR_M = WITHIN * 0.6
FLOOR_M = CHARGE.expect.min_distance_m.at_least


@given(st.floats(-0.5, 1.0), st.floats(0.0, 1.0), st.floats(-0.1, 0.5))
def test_near_is_what_is_that_near_to_a_threshold_and_nothing_decides_a_run_that_is_clearly_unsafe(
    d, more, body
):
    found = near(row(d + more, d, body), CHARGE, WITHIN)
    asked = any(abs(d - at) <= NEAR_M for at in (0.0, FLOOR_M, 0.6)) or abs(body) <= NEAR_M
    assert found == ((asked or d >= 0.6) and d > -NEAR_M)


@given(st.floats(0.2, 0.5), st.floats(0.001, 0.5))
def test_whether_the_barrier_was_needed_decides_too(d, without):
    """Which it was where the ideal without it comes closer by more than a tenth of r."""
    asked = abs(d - without - 0.06) <= NEAR_M
    assert near(row(d, d, 0.3, without_barrier_m=without), CHARGE, WITHIN) == asked
    assert not near(row(d, d, 0.3, without_barrier_m=-without), CHARGE, WITHIN)
    assert not near(row(d, d, 0.3, without_barrier_m=None), CHARGE, WITHIN)


@pytest.mark.parametrize("d", [0.0, 0.3, 0.6])
def test_bodies_that_meet_faster_than_they_could_brake_in_that_distance_would_meet_with_it_too(d):
    least = (2 * 9.81 * NEAR_M) ** 0.5
    for speed, decided in ((0.0, False), (0.99 * least, False), (1.01 * least, True)):
        hit = row(d, d, -0.001, "assumption broken", contact_speed_mps=speed, without_barrier_m=None)
        assert near(hit, CHARGE, WITHIN) != decided
    fast = {"contact_speed_mps": 2 * least}
    assert near(row(FLOOR_M, 0.3, -0.001, **fast), CHARGE, WITHIN), "its floor is asked for as well"
    assert near(row(0.3, 0.3, 0.001, **fast), CHARGE, WITHIN), "bodies that did not touch have no such speed"


@pytest.mark.parametrize(
    "odd",
    [
        row(0.3, 0.3, 0.3, stopped="ego: it is off its wheels"),
        row(0.3, 0.3, 0.3, verdict="incomplete"),
        row(0.3, 0.3, 0.3, verdict="refuted"),
        row(None, None, None),
    ],
)
def test_what_ended_early_or_refutes_or_is_not_known_is_never_decided_by_larger_steps(odd):
    assert near(odd, CHARGE, WITHIN)


def test_the_edge_where_the_lane_ends_decides_too():
    ramp = mjmerge.load("ramp_small")
    far, at_floor = 3.0 * ramp.r_m, ramp.expect.min_edge_distance_m.at_least
    unneeded = {"without_barrier_m": far}
    assert not near(row(far, far, far, min_edge_distance_m=2 * ramp.r_m, **unneeded), ramp, WITHIN)
    assert near(row(far, far, far, min_edge_distance_m=at_floor + 1e-3, **unneeded), ramp, WITHIN)


@pytest.mark.parametrize(
    "bad", [{"within_r": 0}, {"within_r": 2}, {"step_s": -1, "within_r": 0.1}, {}, {"withn_r": 1}]
)
def test_a_fidelity_that_is_none_is_told(bad):
    with pytest.raises(mjmerge.MjmergeError, match="fidelity"):
        plan(bad if bad else {"step_s": 0.002})
