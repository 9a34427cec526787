"""The words over many runs: what is held is worse without the barrier, and no random merge is refuted."""

import numpy as np
import pytest

from mjmerge.paper.survey import TOGETHER, random_scenario
from mjmerge.paper.theorem import campaign
from mjmerge.scenario.effect import acting
from mjmerge.scenario.levels import LEVELS
from mjmerge.scenario.load import load
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.simulation.loop import simulate
from mjmerge.verdict.judge import HELD, REFUTED, judge

AXES = [*LEVELS["rc"]]
SCENARIOS = ("charge", "flips", "paper", "leader_brakes", "stop_and_go")
BATCH = 20


def mixed(rng, scenario):
    """Some axes of mismatch at once, each mild to severe, as far as they act together."""
    keys = {}
    for axis in rng.choice(AXES, size=rng.integers(1, 6), replace=False):
        keys |= LEVELS["rc"][axis][rng.integers(3)]
    if rng.random() < 0.5:
        keys["command_delay_s"] = float(rng.uniform(0, 0.25))
    drawn = scenario.model_copy(update={"mismatch": Mismatch(**keys)})
    return acting(drawn, "mujoco").mismatch


def test_held_runs_of_mixed_mismatch_come_out_worse_without_the_barrier_each_checked_by_running_it(long):
    rng = np.random.default_rng(9)
    held, runs = 0, 0
    for batch in range(25 if long else 1):
        size = BATCH if long else 6
        scenario = load(SCENARIOS[batch % len(SCENARIOS)], ["duration_s=12"])
        seed = int(rng.integers(1 << 40))
        cases = [(seed + i, mixed(rng, scenario)) for i in range(size)]
        verdicts = judge(trace := simulate(scenario, "mujoco", cases=cases))
        off, r = load(scenario.name, ["duration_s=12", "law.k_o=0"]), scenario.law.r_m
        for verdict, (seed, mismatch), kept in zip(verdicts, cases, trace.min_distance_m, strict=True):
            assert verdict.verdict != REFUTED, (batch, verdict, mismatch)
            runs += 1
            if verdict.verdict == HELD:
                held += 1
                there = acting(off.model_copy(update={"mismatch": mismatch}), "double_integrator").mismatch
                (bare,) = simulate(off, "double_integrator", cases=[(seed, there)]).min_distance_m
                assert bare.min() <= 0 or bare.min() < kept.min() - r / 10, (batch, verdict, mismatch)
    assert held > runs / 10


@pytest.mark.parametrize("variant", ["literal", "gated+one_sided"])
def test_no_random_merge_is_refuted_however_vehicle_2_behaves(long, variant):
    unsafe = 0
    for batch in range(-(-20_000 // TOGETHER) if long else 2):
        scenario = random_scenario(batch, variant)
        trace = simulate(scenario, "double_integrator", runs=TOGETHER, seed=batch * TOGETHER)
        for verdict in judge(trace):
            assert verdict.verdict != REFUTED, (batch, verdict)
            unsafe += verdict.unsafe_at_s is not None
    assert unsafe or not long


def test_no_world_in_which_every_hypothesis_holds_is_a_violation(long):
    found = [outcome for _, outcome in campaign(10_000 if long else 50, 0, 12.0 if long else 6.0)]
    assert not np.concatenate([outcome.violated for outcome in found]).any()
    unresolved = np.concatenate([outcome.unresolved for outcome in found])
    assert unresolved.mean() < 0.05
