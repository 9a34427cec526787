"""The stepper is the loop: fed with what the law decides, it writes the bits of ``simulate``."""

import numpy as np
import pytest

from mjmerge import MjmergeError, load, simulate
from mjmerge.envs.stepper import Stepper
from mjmerge.plant import PLANTS
from mjmerge.scenario.mismatch import Mismatch

LATE = {"sensing_delay_s": 0.03, "position_noise_m": 0.01, "neighbour_dropout": 0.2, "command_delay_s": 0.015}
PLAIN = Mismatch()


def driven(stepper, commands, seeds, cases=None):
    """Steps to the end, and how many steps that were."""
    turn, k = stepper.reset(seeds, cases), 0
    while turn is not None:
        turn, k = stepper.step(None if commands is None else commands[:, k]), k + 1
    return stepper.trace, k


def same(one, other):
    """Every column of two traces, bit for bit, and why their simulations stopped."""
    assert one.stops == other.stops
    assert np.array_equal(one.seeds, other.seeds)
    for column in other.columns:
        mine, theirs = one.column(column.name), other.column(column.name)
        assert np.array_equal(mine, theirs, equal_nan=True), column.name
        assert np.array_equal(np.signbit(mine), np.signbit(theirs)), column.name


@pytest.mark.parametrize("plant", sorted(PLANTS))
@pytest.mark.parametrize("runs", [1, 3])
def test_the_laws_own_commands_give_the_bits_of_simulate_whatever_is_different_in_truth(plant, runs):
    scenario = load("paper", ["duration_s=0.5"])
    slips = {"friction": 0.4} if plant == "mujoco" else {}
    cases = [(3, Mismatch(**LATE, **slips)), (0, PLAIN), (9, Mismatch(**LATE))][:runs]
    expected = simulate(scenario, plant, cases=cases)
    stepper = Stepper(scenario, plant)
    found, steps = driven(stepper, expected.u_mps2[:, :, 0], *map(list, zip(*cases, strict=True)))
    same(found, expected)
    assert steps == scenario.ticks
    same(driven(stepper, None, *map(list, zip(*cases, strict=True)))[0], expected)


MORE = ["initial.vehicle_3={front_m: [-4, 0], speed_mps: 2}", "drivers.vehicle_3={kind: gap, gap_m: 2.1}"]


@pytest.mark.parametrize("settings", [[*MORE, "law.choice=largest"], ["road.ends_m=3"], ["law.kind=mpc"]])
def test_so_do_other_laws_and_roads(settings):
    scenario = load("paper", ["duration_s=0.3", *settings])
    expected = simulate(scenario, "bicycle", runs=2)
    same(driven(Stepper(scenario, "bicycle"), expected.u_mps2[:, :, 0], [0, 1])[0], expected)


@pytest.mark.parametrize("car", ["vehicle_1", "vehicle_2"])
def test_a_neighbour_that_is_told_what_its_driver_intends_gives_the_bits_of_simulate(car):
    scenario = load("paper", ["duration_s=1"])
    expected = simulate(scenario, "bicycle", runs=2)
    along = expected.u_mps2[:, :, expected.roster.cars.index(car), 0]
    same(driven(Stepper(scenario, "bicycle", drives=car), along, [0, 1])[0], expected)


def test_a_command_moves_a_point_as_it_moves_one_in_the_books():
    scenario = load("paper", ["duration_s=1"])
    u = np.random.default_rng(0).uniform(-5, 5, (1, scenario.ticks, 2))
    trace, _ = driven(Stepper(scenario, "double_integrator"), u, [0])
    h, v = scenario.control_step_s, trace.velocity_mps[0, :, 0]
    assert np.array_equal(trace.u_mps2[:, :, 0], u)
    assert np.diff(v, axis=0) == pytest.approx(h * u[0, :-1])
    moved = np.diff(trace.front_m[0, :, 0], axis=0)
    assert moved == pytest.approx(h * v[:-1] + h * h / 2 * u[0, :-1])


def test_a_simulation_that_is_ended_leaves_the_others_their_bits():
    scenario = load("paper", ["duration_s=0.3"])
    expected, stepper = simulate(scenario, "bicycle", runs=3), Stepper(scenario, "bicycle")
    turn, k = stepper.reset([0, 1, 2]), 0
    while turn is not None:
        turn.running[1] &= k < 10
        turn, k = stepper.step(None), k + 1
    front_m = stepper.trace.front_m
    assert np.array_equal(front_m[[0, 2]], expected.front_m[[0, 2]])
    assert np.array_equal(front_m[1, :10], expected.front_m[1, :10])
    assert np.isnan(front_m[1, 10:]).all()


def test_what_happened_is_there_at_any_time():
    scenario = load("paper", ["duration_s=0.3"])
    stepper = Stepper(scenario, "double_integrator")
    stepper.reset([0])
    for _ in range(7):
        stepper.step(None)
    distance_m = stepper.trace.distance_m[0]
    assert not np.isnan(distance_m[:7]).any()
    assert np.isnan(distance_m[7:]).all()


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ({"plant": "bicicle"}, "did you mean 'bicycle'"),
        ({"drives": "vehicle_4"}, "no car called 'vehicle_4': did you mean 'vehicle_1' or 'vehicle_2'"),
        ({"threads": -1}, "threads is -1"),
        ({"scenario": "paper"}, r"pass one that was loaded: mjmerge\.load\('paper'\)"),
        ({"scenario": load("paper", ["mismatch.friction=0.3"]), "plant": "bicycle"}, "friction"),
    ],
)
def test_what_cannot_run_is_refused_before_anything_does(how, says):
    with pytest.raises(MjmergeError, match=says):
        Stepper(**{"scenario": load("paper"), "plant": "double_integrator", **how})


def test_seeds_and_cases_that_are_none_are_refused_and_a_step_out_of_turn():
    stepper = Stepper(load("paper", ["duration_s=0.02"]), "double_integrator")
    with pytest.raises(MjmergeError, match="reset comes first"):
        stepper.step(None)
    with pytest.raises(MjmergeError, match="2 seeds, and 1 cases"):
        stepper.reset([0, 1], [PLAIN])
    with pytest.raises(MjmergeError, match="a seed is -1"):
        stepper.reset([-1])
    with pytest.raises(MjmergeError, match=r"cases\[1\].*friction"):
        stepper.reset([0, 1], [PLAIN, Mismatch(friction=0.3)])
    driven(stepper, None, [0])
    assert stepper.over
    with pytest.raises(MjmergeError, match="again after the last tick"):
        stepper.step(None)
