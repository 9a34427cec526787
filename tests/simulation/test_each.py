"""Cases with behaviour of their own run at once, each to the bits of ``mjmerge run``."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from mjmerge import load, simulate
from mjmerge.drivers.several import together
from mjmerge.errors import MjmergeError
from mjmerge.scenario.load import dump
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.each import alike, simulate_each
from mjmerge.simulation.trace import Trace

PLANTS = ("double_integrator", "bicycle", "bicycle_limited", "mujoco")
SHORT = ["duration_s=1.2"]


def drivers(dice: random.Random) -> list[str]:
    """Behaviour of both neighbours, of every kind that is shipped."""

    def number(low: float, high: float) -> float:
        return round(dice.uniform(low, high), 3)

    moves = []
    end = 0.0
    for _ in range(dice.choice([0, 1, 1, 2])):
        start, lasts = end + number(0.0, 0.4), number(0.1, 0.6)
        end = start + lasts
        step = dice.choice(["cubic", "quintic"])
        moves.append(
            f"{{start_s: {start:.3f}, duration_s: {lasts}, gap_m: {number(2.5, 3.6)}, step: {step}}}"
        )
    sway = (
        f"{{amplitude_m: {number(-0.2, 0.2)}, period_s: {number(1, 5)}}}" if dice.random() < 0.4 else "null"
    )
    changes = f"[{{start_s: {number(0, 1)}, rate_mps2: {number(1, 4)}, speed_mps: {number(0, 3)}}}]"
    leads = dice.choice(
        [
            f"{{kind: steady, speed_mps: {number(1.5, 2.5)}}}",
            f"{{kind: speeds, speed_mps: 2.0, changes: {changes}}}",
            f"{{kind: idm, desired_speed_mps: {number(1.5, 3)}, time_gap_s: 0.3, standstill_gap_m: 0.4}}",
        ]
    )
    follows = dice.choice(
        [
            f"{{kind: gap, gap_m: {number(3.2, 3.6)}, sway: {sway}, moves: [{', '.join(moves)}]}}",
            f"{{kind: flips, closed_gap_m: {number(2.5, 3.4)}, open_gap_m: 3.5, "
            f"hold_min_s: {number(0.05, 0.5)}}}",
            f"{{kind: idm, desired_speed_mps: {number(2, 3)}, time_gap_s: {number(0.2, 1)}, "
            f"standstill_gap_m: 0.4, exponent: {dice.choice([2.0, 4.0, 3.3])}}}",
        ]
    )
    return [f"drivers.vehicle_1={leads}", f"drivers.vehicle_2={follows}"]


def case(number: int) -> tuple[int, Scenario]:
    """A seed and a scenario that differ from all others in whatever a batch may differ in."""
    dice = random.Random(number)
    keys = [
        *SHORT,
        "physics_step_s=0.002",
        *drivers(dice),
        f"initial.ego.front_m=[{dice.uniform(-1.6, -1.4):.3f}, {dice.uniform(1.1, 1.3):.3f}]",
        f"initial.vehicle_2.speed_mps={dice.uniform(1.8, 2.2):.3f}",
        f"initial.z={dice.uniform(0, 0.3):.3f}",
        f"law.k_o={dice.choice([0.0, 0.6, 1.0])}",
        f"law.variant={dice.choice(['gated', 'literal', 'gated+one_sided'])}",
        f"mismatch.neighbour_position_noise_m={dice.choice([0.0, 0.005])}",
        f"mismatch.command_delay_s={dice.choice([0.0, 0.034])}",
        f"mismatch.friction={dice.choice([1.0, 0.6])}",
    ]
    return dice.choice([0, 1, 7, 2**40]), load("charge", keys).settled()


def same(a: Trace, b: Trace) -> bool:
    """Whether two traces are the same, bit for bit."""
    columns = [column.name for column in a.columns]
    return (
        a.scenario == b.scenario
        and a.stops == b.stops
        and a.mismatch == b.mismatch
        and all(a.column(name).tobytes() == b.column(name).tobytes() for name in columns)
    )


@pytest.mark.parametrize("plant", PLANTS)
def test_each_case_of_a_batch_has_the_bits_of_its_own_run_from_its_yaml(plant, tmp_path, long):
    cases = [case(i) for i in range(60 if long else 12)]
    traces = simulate_each(cases, plant)
    assert len({trace.front_m.tobytes() for trace in traces}) == len(traces)
    for i, ((seed, scenario), trace) in enumerate(zip(cases, traces, strict=True)):
        if long or i % 3 == 0:
            path = tmp_path / "case.yaml"
            path.write_text(dump(scenario))
            assert same(simulate(load(path), plant, seed=seed), trace), (i, drivers(random.Random(i)))


def test_what_differs_in_numbers_is_asked_once_and_what_differs_in_more_by_itself():
    gap = [load("charge", [f"drivers.vehicle_2.gap_m={g}"]).drivers.vehicle_2 for g in (3.4, 3.5, 3.6)]
    (one,) = together(gap)
    assert one.driver.gap_m.tolist() == [3.4, 3.5, 3.6]
    assert one.driver.moves == gap[0].moves
    (one,) = together([gap[0]] * 5)
    assert one.driver is gap[0]
    flips = load("flips").drivers.vehicle_2
    found = together([gap[0], flips, gap[1], flips])
    assert [part.rows.tolist() for part in found] == [[0, 2], [1, 3]]
    assert found[1].driver == flips


def test_a_driver_from_outside_is_asked_by_itself_whatever_it_is_derived_from(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        "from mjmerge.drivers.steady import Steady\n\nclass Mine(Steady):\n    kind: str\n\n"
        "    def acceleration_mps2(self, time_s, own, *more, **keys):\n"
        "        return own.speed_mps * 0 + (1.0 if self.speed_mps > 2 else -1.0)\n"
    )
    cases = [
        (0, load("charge", [*SHORT, f"drivers.vehicle_1={{kind: 'mine.py:Mine', speed_mps: {v}}}"]))
        for v in (1.5, 2.5, 1.5)
    ]
    traces = simulate_each(cases, "bicycle")
    assert all(same(simulate(s, "bicycle", seed=n), t) for (n, s), t in zip(cases, traces, strict=True))
    assert np.sign([trace.u_mps2[0, 0, 1, 0] for trace in traces]).tolist() == [-1, 1, -1]


def test_whatever_cannot_run_together_runs_apart_in_the_order_that_was_asked():
    cases = [
        (3, load("charge", SHORT)),
        (3, load("paper", SHORT)),
        (0, load("charge", ["duration_s=0.5"])),
        (3, load("charge", [*SHORT, "law.r_m=0.5"])),
        (1, load("flips", SHORT)),
        (3, load("charge", [*SHORT, "law.kind=nominal"])),
    ]
    assert len({alike(scenario)[:3] for _, scenario in cases}) == 2
    traces = simulate_each(cases, "bicycle")
    for (seed, scenario), trace in zip(cases, traces, strict=True):
        assert same(simulate(scenario, "bicycle", seed=seed), trace)


def test_in_continuous_time_too():
    cases = [(i, load("flips", ["duration_s=0.5", f"initial.z={z}"])) for i, z in enumerate((0.1, 0.2))]
    for (seed, scenario), trace in zip(cases, simulate_each(cases, "bicycle", continuous=True), strict=True):
        assert same(simulate(scenario, "bicycle", seed=seed, continuous=True), trace)


def test_a_run_that_stops_stops_alone():
    fine = load("charge", ["duration_s=2"])
    away = load("charge", ["duration_s=2", "law.k_v=9000", "law.k_p=9000"])
    traces = simulate_each([(0, fine), (0, away), (0, fine)], "double_integrator")
    assert [len(trace.stops) for trace in traces] == [0, 1, 0]
    assert traces[1].stops[0].run == 0
    assert same(traces[0], traces[2])


def test_no_cases_are_no_traces_and_what_is_no_case_is_refused():
    assert simulate_each([]) == []
    with pytest.raises(MjmergeError, match=r"a case must be a pair \(seed, scenario\)"):
        simulate_each([load("charge")])
    with pytest.raises(MjmergeError, match="expected a scenario"):
        simulate_each([(0, "charge")])
    with pytest.raises(MjmergeError, match="a seed is -1"):
        simulate_each([(-1, load("charge"))])
    with pytest.raises(MjmergeError, match=r"is without effect|acts on"):
        simulate_each([(0, load("charge", ["mismatch.friction=0.5"]))], "double_integrator")
