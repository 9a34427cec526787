"""How every car turns: the bicycle on ideal tyres, the single-track model on its own, and symmetries."""

from __future__ import annotations

import numpy as np
import pytest

from mjmerge.proving.ground import drive
from mjmerge.proving.manoeuvres import Scale, hold, steady_turns, turn, understeer_rad_s2_per_m
from mjmerge.proving.readings import read_turns
from mjmerge.state import G_MPS2
from mjmerge.world.compose import single
from tests.physics.setups import set_up, turning_inertia_kg_m2

SPEED_RANGES = {"sedan": (5.0, 30.0), "rc": (1.0, 5.0)}
"""In which the issue asks for constant cornering stiffness; other cars: as the sedan, by their size."""


def ahead(a_mps2):
    """Straight on, at an acceleration."""

    def driver(time_s, cars):
        return a_mps2, 0.0

    return driver


def test_straight_ahead_stays_straight(world, sheet):
    """The speed drifts as the road load is compensated a little too well: the tyres sink by 0.4 %."""
    speeds = Scale.of(sheet).speed_mps * np.array([0.5, 1.0, 3.0, 5.5])
    log = drive(world, ahead(0.0), 5.0, speeds)
    assert np.abs(log.y_m).max() < 1e-9
    assert np.abs(log.yaw_rate_radps).max() < 1e-9
    assert log.speed_mps[:, -1] == pytest.approx(speeds, rel=3e-3)


def test_ideal_tyres_turn_as_the_kinematic_bicycle_at_a_fifth_of_g(ideal, sheet):
    """To the left and to the right."""
    scale = Scale.of(sheet)
    speeds = scale.speed_mps * np.array([1.2, 2.0, 4.0, 1.2, 2.0, 4.0])
    side = np.array([1, 1, 1, -1, -1, -1])
    steer = side * np.arctan(0.2 * G_MPS2 * sheet.wheelbase_m / speeds**2)
    log = turn(ideal, speeds, steer, 12 * scale.time_s).between(10 * scale.time_s, np.inf)
    r, v = log.yaw_rate_radps.mean(axis=1), log.speed_mps.mean(axis=1)
    assert np.abs(r * v).min() > 0.17 * G_MPS2
    assert r == pytest.approx(v * np.tan(steer) / sheet.wheelbase_m, rel=0.01)


def test_slipping_tyres_turn_as_the_linear_single_track_model(world, sheet):
    """Within 3 %, at three speeds up to 0.3 g; the angle is the wheels' own, small as the model wants it."""
    speeds = Scale.of(sheet).speed_mps * np.array([2.0, 3.5, 5.0])
    turns = read_turns(sheet, steady_turns(world, speeds))
    gain = turns.speed_mps / (sheet.wheelbase_m + understeer_rad_s2_per_m(sheet) * turns.speed_mps**2)
    assert turns.lateral_mps2.max() > 0.28 * G_MPS2
    assert turns.yaw_rate_radps == pytest.approx(gain * turns.steer_rad, rel=0.03)


def test_cornering_stiffness_is_constant_within_one_percent_over_speed(car, world, sheet):
    low, high = SPEED_RANGES.get(car) or Scale.of(sheet).speed_mps * np.array([0.97, 5.83])
    turns = read_turns(sheet, steady_turns(world, np.geomspace(low, high, 6), np.array([0.05, 0.15])))
    for found, axle in zip(
        (turns.front_stiffness_n_per_rad, turns.rear_stiffness_n_per_rad),
        world.cornering_stiffness_n_per_rad()[0],
        strict=True,
    ):
        assert found == pytest.approx(axle, rel=0.01)


def test_an_oversteering_set_up_spins_above_its_critical_speed_and_not_below(car, sheet):
    """v_c = sqrt(-L/K); beyond it a disturbance grows at the rate of the single-track model's mode.

    The tyres' contact adds 3 % of the mass that stands on it: the modes are a little slower.
    """
    scale = Scale.of(sheet)
    critical = 3.5 * scale.speed_mps
    weight, behind = sheet.mass_kg * G_MPS2, sheet.com_behind_front_axle_m / sheet.wheelbase_m
    front = sheet.cornering_stiffness_n_per_rad.front
    softer = weight * (1 - behind) / front + sheet.wheelbase_m * G_MPS2 / critical**2
    world = set_up(car, front, weight * behind / softer)
    speeds = critical * np.array([0.8, 1.2])

    def driver(time_s, cars):
        nudge = 1e-3 * (time_s < scale.time_s)
        return hold(world, cars, speeds), np.full(2, nudge)

    log = drive(world, driver, 16 * scale.time_s, speeds)
    early, late = (
        np.abs(log.between(t * scale.time_s, (t + 0.5) * scale.time_s).yaw_rate_radps).mean(axis=1)
        for t in (4.0, 12.0)
    )
    growth = np.log(late / early) / (8 * scale.time_s)
    modes = [np.linalg.eigvals(single_track(world.sheets[0], v)).real.max() for v in speeds]
    assert modes[0] < 0 < modes[1]
    assert growth == pytest.approx(modes, rel=0.1)


def single_track(sheet, v):
    """State matrix of the linear single-track model, states lateral speed and yaw rate."""
    a, axles = sheet.com_behind_front_axle_m, sheet.cornering_stiffness_n_per_rad
    b, cf, cr = sheet.wheelbase_m - a, axles.front, axles.rear
    m, inertia, moment = sheet.mass_kg, turning_inertia_kg_m2(sheet), b * axles.rear - a * axles.front
    return np.array(
        [
            [-(cf + cr) / (m * v), moment / (m * v) - v],
            [moment / (inertia * v), -(a**2 * cf + b**2 * cr) / (inertia * v)],
        ]
    )


def slalom_and_brake(sheet, side):
    """Weaving at up to 0.4 g, and braking out of a turn, to the sides (N,): all actuators at work."""
    scale = Scale.of(sheet)
    speed = 3 * scale.speed_mps
    angle = side * np.arctan(0.4 * G_MPS2 * sheet.wheelbase_m / speed**2)

    def driver(time_s, cars):
        t = time_s / scale.time_s
        steer = angle * (np.sin(0.6 * t) if t < 14 else 1.0)
        return 0.0 if t < 16 else -0.3 * G_MPS2, steer

    return driver, 20 * scale.time_s, np.full(len(side), speed)


def test_mirrored_input_gives_mirrored_motion(world, sheet):
    log = drive(world, *slalom_and_brake(sheet, np.array([1.0, -1.0])))
    left, right = log.y_m
    assert np.abs(left).max() > sheet.wheelbase_m
    assert np.abs(left + right).max() < 1e-6 * np.abs(left).max()
    assert np.abs(log.x_m[0] - log.x_m[1]).max() < 1e-6 * np.abs(left).max()


def test_motion_and_grip_do_not_depend_on_the_heading(car, world, sheet):
    """A pyramidal friction cone would give 0.73 of the grip at 45 degrees."""
    headings = np.radians([0.0, 22.5, 45.0, 110.0])
    scale = Scale.of(sheet)
    full = (ahead(-G_MPS2), 4 * scale.time_s, np.full(4, 2 * scale.speed_mps))
    for ground, drill in (
        (world, slalom_and_brake(sheet, np.ones(4))),
        (single(car, friction=0.3), full),
    ):
        log = drive(ground, *drill, heading_rad=headings)
        dx, dy = log.x_m[:, -1] - log.x_m[:, 0], log.y_m[:, -1] - log.y_m[:, 0]
        along = np.cos(headings) * dx + np.sin(headings) * dy
        across = np.cos(headings) * dy - np.sin(headings) * dx
        way = np.hypot(along[0], across[0])
        assert np.ptp(along) < 1e-3 * way
        assert np.ptp(across) < 1e-3 * way


def test_results_converge_with_the_time_step(car, sheet):
    """2 ms against 0.25 ms: within 0.1 % of the way after weaving and braking."""
    ends = []
    for step_s in (0.002, 0.00025):
        log = drive(single(car, physics_step_s=step_s), *slalom_and_brake(sheet, np.ones(1)))
        ends.append(np.array([log.x_m[0, -1], log.y_m[0, -1]]))
    assert np.hypot(*(ends[0] - ends[1])) < 1e-3 * np.hypot(*ends[1])
