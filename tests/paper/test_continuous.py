"""Continuous time: as exact as it says, without jumps integrated over, and clear about where it ends."""

import numpy as np
import pytest

from mjmerge import MjmergeError, judge, load, simulate
from mjmerge.drivers import Along, kinds
from mjmerge.drivers.recorded import Recorded
from mjmerge.simulation import continuous
from mjmerge.simulation.trace import COLUMNS
from tests.paper.reference import solve


def flip_times(scenario, seed):
    """When the ``flips`` driver of Vehicle 2 changes its mind in the run with this seed."""
    return scenario.drivers.vehicle_2.draw([np.random.default_rng([seed, 1])], scenario.duration_s)[
        0
    ].tolist()


def random_scenario(seed, vehicle_2):
    """Cars and gains all over the place, with everybody at a distance."""
    rng = np.random.default_rng(seed)
    gap, duration_s = rng.uniform(1.7, 3.0), 6.0
    changes = {
        "duration_s": duration_s,
        "initial.ego.front_m": [rng.uniform(-2, 0.5), rng.uniform(1.0, 2.0)],
        "initial.ego.speed_mps": rng.uniform(1.5, 2.5),
        "initial.vehicle_2.front_m": [-gap, 0.0],
        "initial.z": 10 ** rng.uniform(-3, -0.5),
        "initial.mu": rng.uniform(-0.2, 0.2),
        "law.k_p": rng.uniform(0.3, 1.5),
        "law.k_v": rng.uniform(1.0, 3.0),
        "law.k_o": rng.uniform(0.5, 2.0),
        "law.eps": rng.uniform(0.03, 0.2),
        "law.k": rng.uniform(5, 30),
        "law.k_mu": rng.uniform(2, 8),
        "law.r_rho_m": -rng.uniform(0.65, gap - 0.65),
        "drivers.vehicle_2": vehicle_2(rng, gap),
    }
    return load("paper", [f"{key}={value}" for key, value in changes.items()])


def wavering(rng, gap):
    a, T, start = rng.uniform(0.05, 0.3), rng.uniform(4, 12), rng.uniform(1, 4)
    return (
        f"{{kind: gap, gap_m: {gap}, sway: {{amplitude_m: {a}, period_s: {T}}}, moves: ["
        f"{{start_s: {start}, duration_s: 2.0, gap_m: {gap + 0.5}, step: cubic}},"
        f"{{start_s: {start + 2.5}, duration_s: 1.5, gap_m: {gap}}}]}}"
    )


def flipping(rng, gap):
    return f"{{kind: flips, closed_gap_m: {gap}, open_gap_m: {gap + rng.uniform(0.3, 1.0)}}}"


CASES = [
    *((load(name), 0) for name in ("paper", "charge")),
    (load("flips", ["duration_s=10"]), 3),
    *((random_scenario(seed, wavering), 0) for seed in range(3)),
    *((random_scenario(seed, flipping), seed) for seed in range(3)),
]


@pytest.mark.parametrize(("scenario", "seed"), CASES, ids=range(len(CASES)))
def test_it_is_the_solution_of_the_papers_equations(scenario, seed):
    flips = flip_times(scenario, seed) if scenario.drivers.vehicle_2.kind == "flips" else ()
    ego_m, second_m, z = solve(scenario, flips, step_s=2e-3)
    trace = simulate(scenario, "double_integrator", seed=seed, continuous=True)
    assert not trace.stops
    front = trace.front_m[0]
    assert np.abs(front[:, 0] - front[:, 1] - ego_m).max() < 2e-7  # the reference steps over kinks of flips
    assert np.abs(front[:, 2, 0] - front[:, 1, 0] - second_m).max() < 2e-7
    assert np.abs(trace.opinion[0] - z).max() < 1e-8


@pytest.mark.parametrize(("scenario", "seed"), CASES[1::2], ids=range(1, len(CASES), 2))
def test_the_bicycle_is_the_double_integrator_while_it_rolls(scenario, seed):
    points, bicycles = (
        simulate(scenario, plant, seed=seed, continuous=True) for plant in ("double_integrator", "bicycle")
    )
    rolling = np.all(np.abs(bicycles.speed_mps[0]) >= scenario.law.eps_v_mps, axis=1)
    until = len(rolling) if rolling.all() else int(np.argmin(rolling))
    assert until > 100
    for name in ("front_m", "velocity_mps", "opinion", "mu"):
        off = getattr(points, name)[0, :until] - getattr(bicycles, name)[0, :until]
        assert np.abs(off).max() < 1e-8, name


def test_every_column_is_there():
    trace = simulate(load("charge", ["duration_s=1"]), "bicycle", continuous=True)
    discrete = simulate(load("charge", ["duration_s=1"]), "bicycle")
    for column in COLUMNS:
        there, expected = (np.isfinite(getattr(t, column.name)) for t in (trace, discrete))
        assert np.array_equal(there, expected), column.name
    assert np.gradient(trace.velocity_mps[0, :, 0], 0.01, axis=0)[1:-1] == pytest.approx(
        trace.u_mps2[0, 1:-1, 0], abs=1e-3
    )


def test_a_run_is_the_same_bits_alone_and_among_others():
    scenario = load("flips", ["duration_s=3"])
    together = simulate(scenario, "double_integrator", runs=3, seed=5, continuous=True)
    alone = simulate(scenario, "double_integrator", seed=7, continuous=True)
    for column in COLUMNS:
        assert getattr(together, column.name)[2:].tobytes() == getattr(alone, column.name).tobytes(), column


def test_the_physical_plant_has_no_continuous_time():
    with pytest.raises(MjmergeError, match="mujoco has no continuous time; double_integrator and bicycle"):
        simulate(load("charge", ["duration_s=1"]), "mujoco", continuous=True)


def test_progress_runs_once_from_start_to_end():
    times = []
    simulate(
        load("flips", ["duration_s=2"]), "double_integrator", runs=2, continuous=True, progress=times.append
    )
    assert times == sorted(times)
    assert times[-1] == 2.0


def squeezed(gap_m, *more):
    """Vehicle 2 closes the gap to this while the ego is in it, in line."""
    vehicle_2 = f"{{kind: gap, gap_m: 3.436, moves: [{{start_s: 1.0, duration_s: 1.2, gap_m: {gap_m}}}]}}"
    line = ("initial.ego.front_m=[-1.524, 0.0]", "law.r_eta_m=0", "duration_s=4")
    return load("charge", [*line, f"drivers.vehicle_2={vehicle_2}", *more])


def test_where_two_margins_meet_the_run_stops_and_says_where():
    trace = simulate(squeezed(1.1), "double_integrator", continuous=True)
    (stop,) = trace.stops
    assert 1.5 < stop.time_s < 2.2
    assert (stop.touched, stop.reason[:17]) == (True, "d_2 goes through ")
    there = trace.time_s < stop.time_s
    assert (trace.distance_m[0, there] > 0).all()
    assert np.isnan(trace.distance_m[0, ~there]).all()
    (verdict,) = judge(trace)
    assert (verdict.verdict, verdict.unsafe_at_s) == ("assumption broken", stop.time_s)
    assert verdict.matters.hypothesis == "neighbours leave 2r"


def test_a_run_that_stops_leaves_the_others_alone(monkeypatch):
    right, started = continuous._steps, []

    def first_is_stuck(*args):
        started.append(args)
        for k, solver in enumerate(right(*args)):
            if len(started) == 1 and k == 10:
                raise continuous._StuckError("stuck")
            yield solver

    scenario = load("flips", ["duration_s=2"])
    alone = simulate(scenario, "double_integrator", seed=1, continuous=True)
    monkeypatch.setattr(continuous, "_steps", first_is_stuck)
    trace = simulate(scenario, "double_integrator", runs=2, continuous=True)
    assert [stop.run for stop in trace.stops] == [0]
    assert trace.stops[0].reason.startswith("stuck, with d_1 = ")
    assert np.isfinite(trace.front_m[0, : round(trace.stops[0].time_s / 0.01)]).all()
    assert trace.front_m[1].tobytes() == alone.front_m[0].tobytes()


@pytest.mark.parametrize("change", ["law.k_o=0", "law.variant=capped"])
def test_a_barrier_that_is_not_singular_goes_on_through_the_margin(change):
    trace = simulate(squeezed(1.1, change), "double_integrator", continuous=True)
    assert not trace.stops
    assert trace.min_distance_m.min() < -0.01


def test_pressed_against_the_margin_the_stiff_equation_is_solved_all_the_same():
    """The target is behind the leader, the ego ahead: d decays as exp(-k_p x/k_o), and k_o/d is the rate."""
    ahead = ["initial.ego.front_m=[1.5, 0.0]", "initial.vehicle_2.front_m=[-4.0, 0.0]"]
    changes = [
        "law.r_eta_m=0",
        "law.k_o=0.6",
        "drivers.vehicle_2={kind: steady, speed_mps: 2.0}",
        "duration_s=8",
    ]
    pressed = load("charge", [*ahead, *changes])
    trace = simulate(pressed, "double_integrator", continuous=True)
    assert not trace.stops
    law, d = pressed.law, trace.distance_m[0, :, 0]
    assert 0 < d[-1] < 1e-5
    e = trace.front_m[0, -200:, 0, 0] - trace.front_m[0, -200:, 1, 0]
    push = law.k_p * (e - law.r_rho_m)
    assert np.gradient(np.log(d[-200:]), 0.01) == pytest.approx(-push / law.k_o, rel=0.02)


def test_an_opinion_of_zero_stays_zero_and_any_other_never_reaches_it_for_good():
    late = "{kind: gap, gap_m: 1.5, moves: [{start_s: 6.0, duration_s: 1.0, gap_m: 2.4}]}"
    changes = ["law.eps=0.0005", f"drivers.vehicle_2={late}", "duration_s=14"]
    scenario = load("blocked", changes)
    trace = simulate(scenario, "double_integrator", continuous=True)
    assert (trace.opinion[0] == 0).any()  # underflow, of what the trace shows
    assert trace.opinion[0, -1] == pytest.approx(trace.mu[0, -1], rel=1e-3)
    assert simulate(scenario, "double_integrator").opinion[0, -1] == 0  # with a held input it is lost
    none = simulate(load("blocked", [*changes, "initial.z=0"]), "double_integrator", continuous=True)
    assert not none.opinion.any()


def test_a_margin_that_is_touched_ends_the_run_at_that_time(monkeypatch):
    """The same run, with the solver's resolution at a distance that it does reach."""
    scenario = load("charge", ["duration_s=6"])
    whole = simulate(scenario, "double_integrator", continuous=True)
    monkeypatch.setattr(continuous, "resolution_m", lambda _law: 0.3)
    trace = simulate(scenario, "double_integrator", continuous=True)
    (stop,) = trace.stops
    d = whole.distance_m[0].min(axis=1)
    first = int(np.argmax(d <= 0.3))
    assert stop.time_s == whole.time_s[first]
    assert stop.reason.startswith("d_2 is below 0.3 m at 4.")
    assert (stop.touched, stop.crossing) == (True, False)
    assert trace.front_m[0, :first].tobytes() == whole.front_m[0, :first].tobytes()
    assert np.isnan(trace.front_m[0, first:]).all()


def test_a_floor_under_z_is_the_limit_of_the_one_under_every_step():
    changes = ["law.variant=z_floor", "duration_s=12"]
    exact = simulate(load("paper", changes), "double_integrator", continuous=True).opinion[0]
    assert exact.min() == 1e-3
    assert np.count_nonzero(exact == 1e-3) > 100
    errors = []
    for h in (0.01, 0.005):
        trace = simulate(load("paper", [*changes, f"control_step_s={h}"]), "double_integrator")
        errors.append(np.abs(trace.opinion[0, :: round(0.01 / h)] - exact).max())
    assert errors[0] < 3e-3
    assert errors[1] < 0.6 * errors[0]


@pytest.mark.parametrize("kind", sorted(kinds()))
def test_drivers_name_every_time_at_which_they_jump(kind):
    """Along a smooth motion, the intended acceleration jumps where the driver says and nowhere else."""
    driver = {
        "gap": load("paper").drivers.vehicle_2,
        "flips": load("flips").drivers.vehicle_2,
        "steady": load("paper").drivers.vehicle_1,
        "speeds": load("stop_and_go").drivers.vehicle_1,
        "idm": load("stop_and_go").drivers.vehicle_2,
        "recorded": Recorded(time_s=(0.0, 1.0, 4.0, 9.0, 30.0), travelled_m=(0.0, 2.0, 6.0, 6.0, 20.0)),
    }[kind]
    drawn = driver.draw([np.random.default_rng(1)], 30.0)
    own, leader = (Along(np.array([x]), np.array([v]), np.zeros(1)) for x, v in ((-2.0, 2.0), (0.0, 2.05)))
    named = driver.switches(None if drawn is None else drawn[0])
    assert (np.diff(named) > 0).all()

    def u(t):
        return driver.acceleration_mps2(t, own, leader, drawn)[0]

    times = np.arange(0, 30, 1e-3)
    jumps = np.flatnonzero(np.abs(np.diff([u(t) for t in times])) > 0.01)
    for at in times[jumps]:
        assert np.abs(named - at).min() <= 1.001e-3
    assert (len(jumps) > 0) == (kind not in ("steady", "idm"))


@pytest.mark.parametrize("plant", ["double_integrator", "bicycle"])
@pytest.mark.parametrize("name", ["leader_brakes", "stop_and_go"])
def test_braking_queues_are_the_limit_of_those_whose_commands_are_held(name, plant):
    changes = ["duration_s=12"]
    exact = simulate(load(name, changes), plant, continuous=True)
    off = []
    for h in (0.02, 0.01):
        trace = simulate(load(name, [*changes, f"control_step_s={h}"]), plant)
        every = round(0.02 / h)
        off.append(np.abs(trace.front_m[0, ::every] - exact.front_m[0, ::2]).max(axis=(0, 2)))
        assert trace.velocity_mps[0, :, 1:, 0].min() > -1e-9  # nobody reverses
        speed_off = trace.velocity_mps[0, ::every, 1] - exact.velocity_mps[0, ::2, 1]
        assert np.abs(speed_off).max() < 1e-9  # Vehicle 1 is on its profile, whatever the hold
    assert exact.velocity_mps[0, :, 1:, 0].min() > -1e-9
    assert off[1][1] <= 4 * 0.01**2 / 8 + 1e-9  # a change that ends between ticks
    assert off[1].max() < 0.02
    assert (off[1][[0, 2]] < 0.6 * off[0][[0, 2]]).all()
