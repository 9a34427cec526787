"""Shrinking and what counts, on a toy that says by its numbers how it fails: no car moves."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from mjmerge import load, simulate
from mjmerge.drivers.gap import Move
from mjmerge.search.margin import Margin, Pair, margin
from mjmerge.search.parts import Parts
from mjmerge.search.shrink import SPARES, shrink
from mjmerge.search.space import begins, driver
from mjmerge.verdict.judge import HELD, VACUOUS, Breach

NAN = float("nan")
SAFE = Margin(0.2, 0.2, NAN, None, True, (), verdict=HELD)
BREACH = (Breach("neighbours keep apart", 1.0),)


def came(kind, least_m=-0.05):
    return Margin(least_m, least_m, NAN, kind, False, ())


@dataclass
class Toy:
    """Stands for the simulations: which axes and how much of them it takes, and what comes of it."""

    kind: str = "d<=0"
    limit_s: float = 0.1
    verdict: str = HELD
    broken: tuple = ()
    at_half: bool = True
    milder: str | None = None
    together: bool = False
    runs: int = 0

    def __call__(self, cases, *_, **__):
        made = []
        for seed, scenario in cases:
            late_s = scenario.mismatch.command_delay_s
            if self.together:  # each of the three does its part
                m = scenario.mismatch
                late_s = (late_s / 0.35 + m.load_kg / 0.4 + (1 - m.friction) / 0.3) * self.limit_s / 2.5
            kind = self.kind if late_s > self.limit_s else None
            if self.milder and kind and late_s < 2 * self.limit_s:
                kind = self.milder
            if scenario.physics_step_s < 0.001 and not self.at_half:
                kind = None
            ideal = Margin(0.2, 0.2, NAN, None, True, self.broken, verdict=self.verdict)
            pair = Pair(scenario, seed, ideal, None)
            real = came(kind) if kind else SAFE
            made.append(Pair(scenario, seed, ideal, real if pair.fair else None))
            self.runs += pair.fair
        return made


@pytest.fixture
def toy(monkeypatch):
    toy = Toy()
    monkeypatch.setattr("mjmerge.search.shrink.pairs", toy)
    return toy


def failing(late_s=0.35):
    """A failure of three axes and two moves, of which it takes the dead time alone."""
    base = load("charge", ["search=null", "gate=[]", "physics_step_s=0.001"])
    moves = (
        Move(start_s=2.0, duration_s=1.3, gap_m=2.4),
        Move(start_s=5.0, duration_s=1.7, gap_m=1.9),
    )
    assert begins(base, "vehicle_2", lead=False) > 0
    axes = {"mismatch.command_delay_s": late_s, "mismatch.friction": 0.7, "mismatch.load_kg": 0.4}
    driven = {"vehicle_2": driver(base, "vehicle_2", moves, lead=False)}
    return Parts(base, axes, {"vehicle_2": moves}, driven)


def test_what_it_does_not_take_is_left_out_and_what_is_left_fails_with_some_to_spare(toy):
    small = shrink(failing(), 7, "mujoco")
    assert dict(small.parts.axes).keys() == {"mismatch.command_delay_s"}
    assert not any(small.parts.moves.values())
    late_s = small.parts.axes["mismatch.command_delay_s"]
    assert late_s * (1 - small.spare) > toy.limit_s
    assert late_s <= 0.2, "and as little of it as it takes"
    assert (small.spare, small.half, small.small) == (SPARES[0], True, True)
    assert small.runs <= 100
    assert small.pair.seed == 0, "its seed has no part in it"


def test_a_failure_stays_of_its_kind(toy):
    """With less of it, it only touches the margin: that is another failure."""
    toy.kind, toy.milder = "touch", "d<=0"
    small = shrink(failing(), 0, "mujoco")
    assert small.pair.real.kind == "touch"
    assert small.parts.axes["mismatch.command_delay_s"] * (1 - small.spare) >= 2 * toy.limit_s


def test_fewer_axes_that_go_further_are_tried_where_it_takes_many(toy):
    toy.together = True
    small = shrink(failing(), 0, "mujoco", ends={"mismatch.command_delay_s": 1.0, "mismatch.load_kg": 0.8})
    assert dict(small.parts.axes).keys() == {"mismatch.command_delay_s"}, "all three were needed as they were"
    assert small.parts.axes["mismatch.command_delay_s"] > 0.35 * 2.5
    alone = shrink(failing(), 0, "mujoco")
    assert len(alone.parts.axes) == 3, "without any room there are no fewer"
    assert not alone.small


def test_what_holds_at_half_the_step_is_no_finding_where_there_are_bodies(toy):
    toy.at_half = False
    assert shrink(failing(), 0, "mujoco") is None
    assert shrink(failing(), 0, "bicycle").half is None


def test_what_is_safe_where_it_is_compared_without_the_barrier_is_no_finding(toy):
    toy.verdict = VACUOUS
    assert shrink(failing(), 0, "mujoco") is None


def test_where_a_hypothesis_breaks_in_the_ideal_nothing_is_run_and_nothing_found(toy):
    toy.broken = BREACH
    assert shrink(failing(), 0, "mujoco") is None
    assert not toy.runs


def test_an_end_that_little_is_left_from_says_how_little(toy):
    toy.limit_s = 0.39
    small = shrink(failing(0.4), 0, "mujoco")
    assert (small.parts.axes["mismatch.command_delay_s"], small.spare) == (0.4, 0.02)


def pair(ideal=SAFE, real=None, *, strict=True):
    return Pair(load("charge"), 0, ideal, real, strict)


def test_it_is_fair_only_if_the_ideal_keeps_its_floor_with_every_hypothesis_true():
    broken = Margin(0.2, 0.2, NAN, None, True, BREACH)
    low = Margin(0.05, 0.05, NAN, None, False, ())
    assert pair().fair
    assert not pair(broken).fair
    assert not pair(low).fair
    assert pair(broken, strict=False).fair, "two laws in the same world: their hypotheses may break"
    assert not pair(broken, came("touch")).fails
    assert pair(SAFE, came("touch")).fails


def test_a_failure_costs_less_than_any_margin_however_far_away_it_ends():
    off, near = pair(SAFE, came("ran off", 3.0)), pair(SAFE, Margin(0.01, 0.01, NAN, None, False, ()))
    assert off.cost <= 0 - SAFE.least_m
    assert off.cost < near.cost
    assert near.cost < pair(SAFE, SAFE).cost < pair(Margin(0.0, 0.0, NAN, "d<=0", False, ()), None).cost


def test_what_is_judged_is_tested_only_if_the_barrier_was_needed():
    assert pair(SAFE).tested
    assert not pair(Margin(0.2, 0.2, NAN, None, True, (), verdict=VACUOUS)).tested


@pytest.fixture(scope="module")
def cars():
    return simulate(load("charge", ["duration_s=0.1"]))


@pytest.mark.parametrize(("clearance_m", "distance_m", "least_m"), [(0.03, 0.3, 0.03), (0.4, 0.2, 0.2)])
def test_a_margin_is_the_least_of_distances_and_the_egos_clearances(cars, clearance_m, distance_m, least_m):
    ego, others = len(cars.roster.neighbours), cars.roster.others
    clearance, distance = np.full_like(cars.clearance_m, 0.9), np.full_like(cars.distance_m, 0.9)
    clearance[0, 3, ego - 1], distance[0, 5, 0] = clearance_m, distance_m
    clearance[:, :, others] = 0.001
    found = margin(replace(cars, clearance_m=clearance, distance_m=distance))
    assert (found.least_m, found.min_clearance_m, found.min_distance_m) == (least_m, clearance_m, distance_m)
    assert found.kind is None
