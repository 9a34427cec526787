"""The loop: the paper's facts, the symmetries of a run, and what happens when a simulation fails."""

import json
from dataclasses import fields
from importlib import import_module

import numpy as np
import pytest

from mjmerge.law import Sensed
from mjmerge.plant import PLANTS
from mjmerge.plant.bicycle import Bicycle
from mjmerge.plant.double_integrator import DoubleIntegrator
from mjmerge.plant.mujoco import MuJoCo
from mjmerge.roster import roster
from mjmerge.scenario.cars import equipped
from mjmerge.scenario.load import load
from mjmerge.simulation.log import BLOCK_S
from mjmerge.simulation.loop import run, simulate, ticks
from mjmerge.simulation.trace import COLUMNS, OF_LEAST
from mjmerge.verdict.judge import judge
from mjmerge.verdict.metrics import lateral_error_m, merged_at_s
from mjmerge.verdict.summary import summary
from mjmerge.world.compose import build

CARS = roster().cars

every_plant = pytest.mark.parametrize("plant", sorted(PLANTS))


def at(trace, time_s):
    """Tick of a time."""
    return round(time_s / trace.scenario.control_step_s)


@pytest.fixture(scope="module")
def paper():
    """The paper's run in its own world."""
    return simulate(load("paper"), "double_integrator")


@pytest.fixture(scope="module")
def short_world():
    return build(load("paper", ["duration_s=2"]))


# the published figures, as facts


def test_the_opinion_stays_between_0_and_1_over_k_mu(paper):
    assert paper.opinion.min() > 0
    assert paper.opinion.max() <= 1 / paper.scenario.law.k_mu


def test_the_opinion_falls_to_almost_nothing_before_10_s_while_vehicle_2_wavers(paper):
    z = paper.opinion[0]
    assert z[0] > 0.1
    assert z[at(paper, 10)] < 1e-3
    assert (np.diff(z[at(paper, 5) : at(paper, 10)]) < 0).all()


def test_the_ego_merges_after_20_s_and_for_good(paper):
    assert 20 < merged_at_s(paper)[0] < 35
    error = np.abs(lateral_error_m(paper)[0])
    assert error[: at(paper, 20)].min() > 0.2
    assert error[at(paper, 25)] == pytest.approx(0.04, abs=0.005)
    assert error[at(paper, 30)] == pytest.approx(0.004, abs=0.0005)


def test_with_the_barrier_both_distances_stay_positive(paper):
    assert paper.min_distance_m[0] == pytest.approx([0.528, 0.134], abs=2e-3)


def test_without_the_barrier_the_ego_comes_too_close_to_vehicle_2_between_5_and_10_s():
    trace = simulate(load("paper", ["law.k_o=0", "duration_s=12"]), "double_integrator")
    d_2 = trace.distance_m[0, :, 1]
    inside = trace.time_s[d_2 < 0]
    assert 5 < inside.min() < inside.max() < 10
    assert d_2.min() == pytest.approx(-0.155, abs=2e-3)
    assert trace.time_s[d_2.argmin()] == pytest.approx(7.8, abs=0.05)
    assert (trace.distance_m[0, :, 0] > 0).all()


# exactness and symmetry


def test_the_kinematic_bicycle_is_the_double_integrator_up_to_the_hold(paper):
    """0.5 mm at 10 ms over the whole run, first order in the control step."""
    apart = np.abs(simulate(load("paper"), "bicycle").front_m - paper.front_m).max()
    half = load("paper", ["control_step_s=0.005", "duration_s=12"])
    finer = np.abs(simulate(half, "bicycle").front_m - simulate(half, "double_integrator").front_m).max()
    assert apart < 1e-3
    assert finer == pytest.approx(apart / 2, rel=0.1)


def mirrored(scenario):
    """The scenario on the other side of the road."""
    values = scenario.model_dump(mode="json")
    for car in CARS:
        x, y = values["initial"][car]["front_m"]
        values["initial"][car]["front_m"] = [x, -y]
    values["law"]["r_eta_m"] *= -1
    return load(values)


@every_plant
def test_a_mirrored_scenario_gives_the_mirrored_run(plant):
    """To the last bit in the ideal plants; 1e-9 m was measured in MuJoCo after 5 s."""
    scenario = load("flips", ["duration_s=5"])
    one, other = (simulate(s, plant, seed=2) for s in (scenario, mirrored(scenario)))
    assert np.abs(one.front_m[0, -1, 0, 1] - one.front_m[0, 0, 0, 1]) > 0.3  # it does move across
    within = 1e-7 if plant == "mujoco" else 0.0
    assert np.abs(one.front_m - other.front_m * [1, -1]).max() <= within
    assert np.abs(one.opinion - other.opinion).max() <= within


@every_plant
def test_equal_seeds_give_equal_bits_and_different_seeds_do_not(plant, short_world):
    scenario = load("flips", ["duration_s=2"])
    one, same, other = (simulate(scenario, plant, seed=s, world=short_world) for s in (3, 3, 4))
    for c in COLUMNS:
        assert getattr(one, c.name).tobytes() == getattr(same, c.name).tobytes(), c.name
    assert one.front_m.tobytes() != other.front_m.tobytes()


# what the trace holds


@every_plant
def test_every_tick_is_there_and_the_first_is_the_initial_state(plant, short_world):
    trace = simulate(load("paper", ["duration_s=0.2"]), plant, world=short_world)
    initial = trace.scenario.initial
    assert trace.time_s == pytest.approx(np.arange(21) * 0.01)
    assert trace.stops == ()
    assert (trace.opinion[0, 0], trace.mu[0, 0]) == (initial.z, initial.mu)
    for c, car in enumerate(CARS):
        assert trace.front_m[0, 0, c] == pytest.approx(getattr(initial, car).front_m, abs=1e-6)
    known = {c.name for c in COLUMNS if np.isfinite(getattr(trace, c.name)).all()}
    bodies = {"clearance_m", "contact_impulse_n_s", "contact_speed_mps"}
    without_bodies = bodies if plant != "mujoco" else set()
    without_wheels = {"steer_rad", "steer_command_rad", "steer_clipped_rad", "a_mps2", "omega_radps"} | {
        "torque_n_m",
        "torque_clipped_n_m",
        "sensed_steer_rad",
    }
    unknown = {c.name for c in COLUMNS} - known
    assert unknown <= without_bodies | (without_wheels if plant == "double_integrator" else set())


@every_plant
def test_a_longer_run_begins_as_the_shorter_one(plant, short_world):
    short, longer = (
        simulate(load("paper", [f"duration_s={t}"]), plant, world=short_world) for t in (0.3, 0.6)
    )
    for c in COLUMNS:
        one, other = getattr(short, c.name), getattr(longer, c.name)[:, :31]
        assert np.array_equal(one, other, equal_nan=True), c.name


# simulations that fail


def broken(monkeypatch, plant, breaks, at_step, run=1):
    """Lets one simulation's state be broken after so many steps."""
    cls = {"double_integrator": DoubleIntegrator, "bicycle": Bicycle, "mujoco": MuJoCo}[plant]
    step, count = cls.step, iter(range(10**6))

    def stepped(self, controls, running):
        if plant == "mujoco" and next(count) == at_step - 1:
            breaks(self, run)
            step(self, controls, running)
            return
        step(self, controls, running)
        if plant != "mujoco" and next(count) == at_step - 1:
            breaks(self, run)

    monkeypatch.setattr(cls, "step", stepped)


def on_its_roof(plant, run, car=2):
    each = plant._qpos.shape[1] // len(CARS)  # a free joint comes first: x, y, z and a quaternion
    plant._qpos[run, each * car + 2 : each * car + 7] = [0.3, 0, 1, 0, 0]


def set_to(value):
    def breaks(plant, run):
        state = plant._p if isinstance(plant, DoubleIntegrator) else plant._x
        state[run, 2, 0] = value

    return breaks


FAILURES = [
    ("double_integrator", set_to(np.nan), "its state is not finite"),
    ("double_integrator", set_to(np.inf), "its state is not finite"),
    ("bicycle", set_to(np.nan), "its state is not finite"),
    ("bicycle", set_to(-np.inf), "its state is not finite"),
    ("mujoco", on_its_roof, "it is off its wheels"),
]


@pytest.mark.parametrize(("plant", "breaks", "reason"), FAILURES)
def test_a_simulation_that_fails_stops_alone_and_says_when_and_which_car(
    plant, breaks, reason, monkeypatch, short_world
):
    scenario = load("flips", ["duration_s=0.5"])
    whole = simulate(scenario, plant, runs=3, world=short_world)
    broken(monkeypatch, plant, breaks, at_step=20)
    trace = simulate(scenario, plant, runs=3, world=short_world)
    (stop,) = trace.stops
    assert (stop.run, stop.car, stop.reason) == (1, "vehicle_2", reason)
    assert stop.time_s == pytest.approx(0.2)
    for c in COLUMNS:
        was, now = getattr(whole, c.name), getattr(trace, c.name)
        assert was[[0, 2]].tobytes() == now[[0, 2]].tobytes(), c.name
        assert was[1, :20].tobytes() == now[1, :20].tobytes(), c.name
        assert np.isnan(now[1, 20:]).all(), c.name


@every_plant
def test_a_law_that_diverges_stops_the_run_without_a_warning(plant, short_world):
    trace = simulate(load("paper", ["law.k_p=1e6", "duration_s=2"]), plant, world=short_world)
    if plant in ("bicycle_limited", "mujoco"):  # limits keep cars on the ground
        assert np.isfinite(trace.front_m).all()
    else:
        assert trace.stops[0].car in CARS
        assert 0 < trace.stops[0].time_s < 2


# what a sink gets


class Kept:
    """A sink that keeps copies of what it gets."""

    def __init__(self):
        self.blocks = []

    def write(self, block):
        self.blocks.append(
            (
                block.ticks.copy(),
                block.time_s.copy(),
                {n: v.copy() for n, v in block.columns.items()},
                block.qpos,
            )
        )

    def __getitem__(self, name):
        return np.concatenate([columns[name] for _, _, columns, _ in self.blocks])


def same_rows(sink, trace, rows):
    assert np.array_equal(np.concatenate([b[0] for b in sink.blocks]), np.arange(rows))
    assert np.array_equal(np.concatenate([b[1] for b in sink.blocks]), trace.time_s[:rows])
    for c in COLUMNS:
        assert sink[c.name].tobytes() == getattr(trace, c.name)[0, :rows].tobytes(), c.name


@pytest.mark.parametrize("runs", [1, 2])
def test_a_sink_gets_exactly_the_first_runs_rows_in_blocks(runs, short_world):
    sink = Kept()
    trace = simulate(
        load("paper", ["duration_s=12"]), "double_integrator", runs=runs, sink=sink, world=short_world
    )
    same_rows(sink, trace, 1201)
    assert [len(b[0]) for b in sink.blocks] == [round(BLOCK_S / 0.01)] * 24 + [1]
    assert [b[3].shape for b in sink.blocks] == [(len(b[0]), short_world.model.nq) for b in sink.blocks]


@pytest.mark.parametrize("runs", [1, 2])
def test_a_sink_gets_every_row_of_a_run_that_ends_early(runs, short_world, monkeypatch):
    broken(monkeypatch, "double_integrator", set_to(np.nan), at_step=700, run=0)
    sink = Kept()
    trace = simulate(
        load("paper", ["duration_s=12"]), "double_integrator", runs=runs, sink=sink, world=short_world
    )
    assert trace.stops[0].time_s == pytest.approx(7.0)
    same_rows(sink, trace, 700)


def test_a_sink_is_not_told_of_other_runs_failures(short_world, monkeypatch):
    broken(monkeypatch, "double_integrator", set_to(np.nan), at_step=50, run=1)
    sink = Kept()
    trace = simulate(
        load("paper", ["duration_s=2"]), "double_integrator", runs=2, sink=sink, world=short_world
    )
    assert [s.run for s in trace.stops] == [1]
    same_rows(sink, trace, 201)


def test_watching_a_run_does_not_change_it(short_world):
    scenario = load("paper", ["duration_s=1"])
    watched = simulate(scenario, "mujoco", sink=Kept(), world=short_world)
    unwatched = simulate(scenario, "mujoco", world=short_world)
    for c in COLUMNS:
        assert getattr(watched, c.name).tobytes() == getattr(unwatched, c.name).tobytes(), c.name


def test_progress_tells_simulated_time_in_order():
    told = []
    simulate(load("paper", ["duration_s=2"]), "double_integrator", progress=told.append)
    assert told == sorted(told)
    assert told[0] == 0
    assert 1.5 < told[-1] <= 2


# belief and truth


def test_the_law_is_given_what_is_sensed_and_its_memory_and_nothing_else(monkeypatch, short_world):
    asks = import_module("mjmerge.law.several")
    calls, decided = [], asks.decided
    monkeypatch.setattr(asks, "decided", lambda *given: calls.append(given) or decided(*given))
    scenario = load("paper", ["duration_s=0.1", "mismatch.friction=0.3"])
    trace = simulate(scenario, "mujoco", world=build(scenario))
    assert {f.name for f in fields(Sensed)} == {"p", "v", "p_j", "v_j", "u_1"}
    assert len(calls) == trace.time_s.size
    for k, (law, sensed, memory, step_s) in enumerate(calls):
        assert law is scenario.law
        assert type(sensed) is Sensed
        assert np.array_equal(sensed.p, trace.front_m[:, k, 0])
        assert np.array_equal(sensed.p_j, trace.front_m[:, k, 1:])
        assert np.array_equal(sensed.v, trace.velocity_mps[:, k, 0])
        assert np.array_equal(sensed.v_j, trace.velocity_mps[:, k, 1:])
        assert np.array_equal(sensed.u_1, trace.u_mps2[:, k, 1])
        assert memory.keys() == {"opinion", "mu"}
        assert all(np.array_equal(of, getattr(trace, name)[:, k]) for name, of in memory.items())
        assert step_s == scenario.control_step_s


COMMANDS = ("u_mps2", "u_n_mps2", "u_c_mps2", "a_mps2", "omega_radps", "steer_command_rad", "torque_n_m")


@pytest.mark.parametrize("truth", ["mismatch.friction=0.2", "mismatch.command_delay_s=0.1"])
def test_the_law_and_the_actuation_cannot_see_the_truth(truth):
    """Same state, other truth: the same commands to the last bit, until the truth has moved the cars."""
    plain, other = (
        simulate(load("charge", ["duration_s=0.5", "law.k_p=5", *t]), "mujoco") for t in ([], [truth])
    )
    for name in COMMANDS:
        assert getattr(plain, name)[:, 0].tobytes() == getattr(other, name)[:, 0].tobytes(), name
    assert plain.front_m.tobytes() != other.front_m.tobytes()


def test_a_run_that_stops_before_its_first_tick_still_has_a_summary_that_json_can_hold(monkeypatch):
    monkeypatch.setattr("mjmerge.plant.kinematic._BEYOND", 1.0)
    trace = simulate(load("paper", ["duration_s=0.1"]), "double_integrator", runs=2)
    assert len(trace.stops) == 2
    found = summary(trace, judge(trace))
    assert (found["verdict"], found["duration_s"], found["decision"]["least_z"]) == ("incomplete", 0.0, None)
    json.dumps(found, allow_nan=False)


def test_the_furthest_place_that_a_scenario_may_have_is_no_fault():
    far = ["initial.vehicle_2.front_m=[-1e9, 0]", "initial.vehicle_2.speed_mps=0"]
    steady = "drivers.vehicle_2={kind: steady, speed_mps: 0}"
    trace = simulate(load("paper", ["duration_s=0.1", *far, steady]), "double_integrator")
    assert not trace.stops


@pytest.mark.parametrize(
    ("name", "more"),
    [
        ("charge", ["mismatch.neighbour_position_noise_m=0.02"]),
        ("platoon_8_small", ["law.choice=nearest", "duration_s=4"]),
        ("ramp_small", []),
        ("ramp_blocked", ["road.told=nothing"]),
    ],
)
def test_the_columns_that_least_distances_follow_from_are_enough_for_them(name, more):
    scenario = equipped(load(name, ["duration_s=1.5", "control_step_s=0.02", *more]))

    def ran(**kept):
        return run(ticks(scenario, [scenario] * 3, [0, 1, 2], "double_integrator", **kept)).finish()

    few, whole = ran(kept=OF_LEAST), ran()
    assert np.isfinite(whole.least_m).all()
    assert few.least_m.tobytes() == whole.least_m.tobytes()
    assert few.gap_m.tobytes() == whole.gap_m.tobytes()
    for name in ("torque_n_m", "speed_mps", "u_mps2"):  # nothing, and it takes no room
        values = getattr(few, name)
        assert np.isnan(values).all()
        assert set(values.strides) == {0}
