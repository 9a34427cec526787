"""The inverse by the commanded angle, and by the foreseen state: late commands do not make them weave."""

from __future__ import annotations

import numpy as np
import pytest

from mjmerge.cli import main
from mjmerge.errors import ScenarioError
from mjmerge.review.replay import replay
from mjmerge.review.verify import verify
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.load import dump, load
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.simulation.loop import simulate
from mjmerge.state import Cars, Controls
from mjmerge.vehicle.foresight import Foresight
from mjmerge.verdict.hypotheses import broken
from mjmerge.verdict.judge import judge
from mjmerge.verdict.loops import foreseen_window_s, longest_delay_s

COMMANDED, PREDICTED = "actuation.inverse=commanded", "actuation.inverse=predicted"


def late(name, delay_s, *keys):
    return load(name, [COMMANDED, f"mismatch.command_delay_s={delay_s}", *keys])


@pytest.mark.parametrize("name", ["paper", "charge", "highway"])
def test_without_a_dead_time_it_is_the_printed_inverse_on_a_bicycle(name, long):
    short = [] if long else ["duration_s=8"]
    printed, commanded = (simulate(load(name, [*short, *keys]), "bicycle") for keys in ([], [COMMANDED]))
    assert commanded.front_m == pytest.approx(printed.front_m, abs=1e-9)
    assert commanded.distance_m == pytest.approx(printed.distance_m, abs=1e-9)


def test_on_physical_cars_it_keeps_the_margin_within_5_mm_without_a_dead_time(long):
    for name in ("charge", "paper", "highway") if long else ("charge",):
        keys = [] if long else ["physics_step_s=0.002", "duration_s=8"]
        printed, commanded = (
            simulate(load(name, [*keys, *more]), "mujoco").min_distance_m.min() for more in ([], [COMMANDED])
        )
        assert commanded == pytest.approx(printed, abs=5e-3)


def test_it_stands_dead_times_under_which_the_printed_one_touches(long):
    cases = [("charge", 0.24, 0.03), *([("paper", 0.28, 0.03), ("highway", 0.24, 0.95)] if long else [])]
    for name, delay_s, least_m in cases:
        trace = simulate(late(name, delay_s, *([] if long else ["physics_step_s=0.002"])), "mujoco")
        assert trace.min_distance_m.min() > least_m
        (verdict,) = judge(trace)
        assert verdict.verdict == "held"
        printed = simulate(load(name, [f"mismatch.command_delay_s={delay_s}"]), "mujoco")
        assert printed.min_distance_m.min() < trace.min_distance_m.min() - 0.05


@pytest.mark.parametrize("name", ["paper", "highway"])
def test_what_is_left_is_the_delayed_double_integrator_whatever_the_speed(name):
    """s^2 + e^(-tau s) (k_v s + k_p) = 0: it weaves from where that loses its stability, within 5 %."""
    gains = {"paper": [], "highway": ["law.k_v=2", "law.k_p=0.7"]}[name]
    calm = load(name, gains)
    law, x_1 = calm.law, calm.initial.vehicle_1.front_m[0]
    limit_s = float(longest_delay_s(np.array(law.k_v), law.k_p)) - calm.control_step_s / 2  # it is held, too
    start = [f"initial.ego.front_m=[{x_1 + law.r_rho_m}, {law.r_eta_m + 0.01}]", "initial.z=0", "law.k_o=0"]
    cases = [(0, Mismatch(command_delay_s=part * limit_s)) for part in (0.95, 1.0, 1.05)]
    trace = simulate(load(name, [COMMANDED, "duration_s=50", *gains, *start]), "bicycle", cases=cases)
    dies_down, stays, swings_up = _swings(trace)
    assert dies_down < 0.6
    assert stays == pytest.approx(1.0, abs=0.3)
    assert swings_up > 1.6


def test_a_limited_bicycle_whose_steering_is_askew_is_turned_by_so_much_more_than_it_is_told():
    """From the first tick on, however late commands are; and on no plant that is told no angle."""
    cases = [(0, Mismatch(steer_offset_rad=0.03, command_delay_s=delay_s)) for delay_s in (0.0, 0.05, 0.013)]
    trace = simulate(load("charge", ["duration_s=1"]), "bicycle_limited", cases=cases)
    for run, late_ticks in ((0, 0), (1, 5)):
        told = trace.steer_command_rad[run, : -1 - late_ticks, 0]
        assert trace.steer_rad[run, 1 + late_ticks :, 0] == pytest.approx(told + 0.03, abs=1e-12)
    assert trace.steer_rad[2, 1, 0] == pytest.approx(0.03)
    with pytest.raises(ScenarioError, match="steer_offset_rad: acts on bicycle_limited and mujoco only"):
        simulate(load("charge", ["mismatch.steer_offset_rad=0.03"]), "bicycle")


def test_by_the_commanded_angle_steering_that_is_askew_leaves_the_ego_beside_its_target():
    """By v^2 tan(askew) / (L k_p): it divides by an angle that is not there. By the measured one: not."""
    askew, at_m = 0.01, {}
    for keys in ([], [COMMANDED]):
        calm = load("paper", ["duration_s=20", *keys])
        law, x_1 = calm.law, calm.initial.vehicle_1.front_m[0]
        start = [f"initial.ego.front_m=[{x_1 + law.r_rho_m}, {law.r_eta_m}]", "initial.z=0", "law.k_o=0"]
        scenario = load("paper", ["duration_s=20", *keys, *start, f"mismatch.steer_offset_rad={askew}"])
        trace = simulate(scenario, "bicycle_limited")
        at_m[bool(keys)] = trace.front_m[0, -1, 0, 1] - law.r_eta_m
    left_m = 2.0**2 * np.tan(askew) / (car_sheets(calm)[0].wheelbase_m * law.k_p)
    assert at_m[True] == pytest.approx(left_m, rel=0.01)
    assert at_m[False] == pytest.approx(0, abs=1e-3)


def _swings(trace):
    """How wide the steering swings towards the end, over how wide it swung before."""
    steer = trace.steer_rad[:, :, 0]
    early, end = (np.ptp(steer[:, int(at * steer.shape[1]) :][:, :600], axis=1) for at in (0.4, 0.85))
    return end / early


def straight(x_m, speed_mps):
    """An ego along the road, and somebody 5 m ahead at 2 m/s."""
    v = np.array([[speed_mps, 2.0]])
    none = np.zeros((1, 2))
    return Cars(
        front_m=np.array([[[x_m, 0.0], [5.0, 0.0]]]),
        velocity_mps=np.stack([v, none], axis=-1),
        heading_rad=none,
        speed_mps=v,
        steer_rad=none,
        steer_command_rad=none,
        clearance_m=np.ones((1, 1)),
    )


def commands(u_mps2):
    """The ego told to accelerate straight on."""
    none = np.zeros((1, 2))
    return Controls(
        u_mps2=np.array([[[u_mps2, 0.0], [0.0, 0.0]]]),
        a_mps2=np.array([[u_mps2, 0.0]]),
        omega_radps=none,
        steer_rad=none,
        wheel_steer_rad=np.zeros((1, 2, 2)),
        torque_n_m=np.zeros((1, 2, 4)),
        torque_clipped_n_m=none,
        steer_clipped_rad=none,
    )


def predicted(name, delay_s, *keys, reckons_s=None):
    reckons_s = delay_s if reckons_s is None else reckons_s
    given = [PREDICTED, f"actuation.dead_time_s={reckons_s}", f"mismatch.command_delay_s={delay_s}"]
    return load(name, [*given, *keys]).settled()


def test_a_dead_time_that_is_known_is_made_up_for_where_the_commanded_angle_alone_swings_up():
    """The ego of the test above, at 1.5 times the delay at which it would weave."""
    calm = load("paper")
    law, x_1 = calm.law, calm.initial.vehicle_1.front_m[0]
    delay_s = 1.5 * float(longest_delay_s(np.array(law.k_v), law.k_p))
    start = [f"initial.ego.front_m=[{x_1 + law.r_rho_m}, {law.r_eta_m + 0.01}]", "initial.z=0", "law.k_o=0"]
    keys = "duration_s=20", *start
    known = simulate(predicted("paper", delay_s, *keys), "bicycle")
    unknown = simulate(late("paper", delay_s, *keys), "bicycle")
    ends = [float(np.abs(t.steer_rad[0, -300:, 0]).max()) for t in (known, unknown)]
    assert ends[0] < 1e-4
    assert ends[1] > 0.1


def test_with_another_dead_time_than_the_one_reckoned_with_it_weaves_where_its_equation_says(long):
    """Too long a one and, where there is room, too short a one; as the test above, within 5 %."""
    calm = load("paper")
    law, x_1, held_s = calm.law, calm.initial.vehicle_1.front_m[0], calm.control_step_s / 2
    start = [f"initial.ego.front_m=[{x_1 + law.r_rho_m}, {law.r_eta_m + 0.01}]", "initial.z=0", "law.k_o=0"]
    for foreseen_s in (0.15, 0.3, 1.2) if long else (1.2,):
        short_s, long_s = foreseen_window_s(np.array(law.k_v), law.k_p, foreseen_s)
        ends = [float(long_s) - held_s, *([float(short_s) + held_s] if short_s > 0 else [])]
        off = [(end_s, part) for end_s in ends for part in (0.95, 1.0, 1.05)]
        cases = [
            (0, Mismatch(command_delay_s=foreseen_s + part * (end_s - foreseen_s))) for end_s, part in off
        ]
        keys = [PREDICTED, f"actuation.dead_time_s={foreseen_s}", "duration_s=50", *start]
        for three in _swings(simulate(load("paper", keys), "bicycle", cases=cases)).reshape(-1, 3):
            dies_down, stays, swings_up = three
            assert dies_down < 0.8
            assert stays == pytest.approx(1.0, abs=0.3)
            assert swings_up > 1.25


@pytest.mark.parametrize("delay_s", [0.1, 0.183])
def test_what_is_foreseen_is_what_comes_of_an_ego_that_does_as_told(delay_s):
    """Straight on, commands held over a control step: position and velocity a dead time later, exactly."""
    h, ticks, rng = 0.01, 60, np.random.default_rng(0)
    u = rng.uniform(-2, 2, ticks)
    steps = 1000 * h  # the truth is stepped so finely that a command begins and ends on a step
    fine = np.repeat(u, round(steps))
    came = np.concatenate([np.zeros(round(1000 * delay_s)), fine])
    v = 2.0 + np.concatenate([[0.0], np.cumsum(came) / 1000])
    x = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2000)])
    foresee = Foresight("predicted", delay_s, h, 0.26)
    for k in range(ticks):
        now, then = round(1000 * k * h), round(1000 * (k * h + delay_s))
        shown = foresee(straight(x[now], v[now]))
        assert shown.front_m[0, 0, 0] == pytest.approx(x[then], abs=1e-12)
        assert shown.velocity_mps[0, 0, 0] == pytest.approx(v[then], abs=1e-12)
        assert shown.front_m[0, 1, 0] == pytest.approx(5.0 + 2.0 * delay_s)  # who goes on as it does
        foresee.told(commands(u[k]))


def test_it_stands_more_than_the_commanded_angle_does(long):
    trace = simulate(predicted("charge", 0.3, "physics_step_s=0.002"), "mujoco")
    assert trace.min_distance_m.min() > 0.05
    assert judge(trace)[0].verdict == "held"
    if long:
        assert simulate(late("charge", 0.28), "mujoco").min_distance_m.min() < 0


def test_without_a_dead_time_of_its_own_it_is_the_commanded_angle():
    keys = "duration_s=3", "mismatch.command_delay_s=0.05"
    none = simulate(load("charge", [PREDICTED, *keys]), "bicycle")
    assert none.front_m.tobytes() == simulate(load("charge", [COMMANDED, *keys]), "bicycle").front_m.tobytes()


def test_what_it_does_not_reckon_with_is_what_the_contract_asks_about():
    for reckons_s, breaks in ((0.35, False), (0.1, True)):
        scenario = predicted("charge", 0.35, "duration_s=8", reckons_s=reckons_s)
        assert broken(simulate(scenario, "bicycle"))["delay small against d"].any() == breaks


def test_a_scenario_s_own_foresight_changes_nothing_where_nothing_steers():
    """On points, and so in the ideal run that a verdict is held against."""
    scenario = predicted("charge", 0.1, "duration_s=2")
    plain = load("charge", ["duration_s=2", "mismatch.command_delay_s=0.1"])
    ours, theirs = (simulate(s, "double_integrator") for s in (scenario, plain))
    assert ours.front_m.tobytes() == theirs.front_m.tobytes()


def test_a_dead_time_is_refused_where_nothing_reckons_with_it():
    with pytest.raises(ScenarioError, match=r"dead_time_s: acts only under actuation.inverse predicted"):
        simulate(load("charge", [COMMANDED, "actuation.dead_time_s=0.1"]), "bicycle")


def test_the_delay_that_the_contract_allows_is_that_of_the_loop_that_is_there():
    """0.17 s: too late for the printed inverse at 2 m/s, not for this one."""
    for keys, breaks in (([], True), ([COMMANDED], False)):
        trace = simulate(load("paper", ["duration_s=3", "mismatch.command_delay_s=0.17", *keys]), "bicycle")
        assert broken(trace)["delay small against d"].any() == breaks


@pytest.mark.parametrize(("by", "plant"), [(late, "bicycle"), (predicted, "mujoco")])
def test_its_recordings_verify_and_run_again(by, plant, tmp_path):
    scenario = by("charge", 0.053, "duration_s=0.8", "mismatch.steer_noise_rad=0.01")
    path, out = tmp_path / "s.yaml", tmp_path / "out"
    path.write_text(dump(scenario))
    with pytest.raises(SystemExit):
        main(["run", str(path), "--plant", plant, "--out", str(out)])
    for name in ("run.mcap", "run.rrd"):
        assert [check for check in verify(out / name).checks if check.right is False] == []
        assert replay(out / name).same


@pytest.mark.parametrize("plant", ["bicycle", "mujoco"])
@pytest.mark.parametrize("by", [late, predicted])
def test_a_run_is_the_run_alone(by, plant):
    scenario = by("charge", 0.08, "duration_s=0.6", "mismatch.neighbour_position_noise_m=0.005")
    together = simulate(scenario, plant, runs=3)
    alone = simulate(scenario, plant, seed=2)
    assert together.front_m[2].tobytes() == alone.front_m[0].tobytes()


def test_it_is_refused_where_nothing_steers_and_misspelt():
    with pytest.raises(ScenarioError, match=r"actuation\.inverse: acts on bicycle"):
        simulate(load("charge", [COMMANDED]), "double_integrator")
    with pytest.raises(ScenarioError, match=r"must be 'measured', 'commanded' or 'predicted'"):
        load("charge", ["actuation.inverse=command"])
