"""Actuation: always within limits, and honest about what it clipped."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mjmerge.scenario.cars import believed_sheets, data_sheet
from mjmerge.scenario.load import load
from mjmerge.state import Cars, Controls
from mjmerge.vehicle.actuation import (
    CRAWL_MPS,
    BelievedCars,
    Feet,
    ackermann,
    actuate,
    bicycle_angle,
    of_points,
)

SHEET = data_sheet("rc")
H, EPS_V = 0.01, 0.1
LIMITED = BelievedCars.of([SHEET] * 3, limited=True)
UNLIMITED = BelievedCars.of([SHEET] * 3, limited=False)


def cars(heading=0.0, speed=2.0, steer=0.0, command=None):
    """One simulation whose three cars all move alike."""

    def three(x):
        return np.full((1, 3), x)

    return Cars(
        front_m=np.zeros((1, 3, 2)),
        velocity_mps=np.zeros((1, 3, 2)),
        heading_rad=three(heading),
        speed_mps=three(speed),
        steer_rad=three(steer),
        steer_command_rad=three(steer if command is None else command),
        clearance_m=np.full((1, 3), np.nan),
    )


def wanting(x, y):
    """The same wanted acceleration for all three cars."""
    return np.tile(np.array([x, y], dtype=float), (1, 3, 1))


states = st.builds(
    cars,
    heading=st.floats(-np.pi, np.pi),
    speed=st.floats(-5, 30),
    steer=st.floats(-0.6, 0.6),
    command=st.floats(-SHEET.steer_limit_rad, SHEET.steer_limit_rad),
)
wishes = st.builds(wanting, st.floats(-1e4, 1e4), st.floats(-1e4, 1e4))


@given(states, wishes)
def test_commands_stay_within_the_limits_whatever_is_wanted(state, u):
    controls = actuate(state, u, LIMITED, EPS_V, H)
    v = state.speed_mps[..., None]
    braking = (controls.torque_n_m * v < 0) & (np.abs(v) > CRAWL_MPS)
    brake = (
        SHEET.brake_torque_limit_n_m
        / 2
        * np.array([SHEET.brake_front_share] * 2 + [1 - SHEET.brake_front_share] * 2)
    )
    assert (
        np.abs(controls.torque_n_m) <= np.where(braking, brake, SHEET.torque_limit_n_m) * (1 + 1e-12)
    ).all()
    power = np.where(braking, 0, controls.torque_n_m * v / SHEET.wheel_radius_m).sum(axis=-1)
    assert power.max() <= SHEET.power_limit_w * (1 + 1e-12)
    assert np.abs(controls.steer_rad).max() <= SHEET.steer_limit_rad
    moved = controls.steer_rad - state.steer_command_rad
    assert np.abs(moved).max() <= SHEET.steer_rate_limit_radps * H + 1e-15


@given(states, wishes)
def test_what_is_clipped_is_what_was_wanted_less_what_is_given(state, u):
    controls, free = (actuate(state, u, believed, EPS_V, H) for believed in (LIMITED, UNLIMITED))
    torque = (free.torque_n_m - controls.torque_n_m).sum(axis=-1)
    assert controls.torque_clipped_n_m == pytest.approx(torque, rel=1e-12, abs=1e-12)
    assert controls.steer_clipped_rad == pytest.approx(
        free.steer_rad - controls.steer_rad, rel=1e-12, abs=1e-14
    )


@given(states, wishes)
def test_without_limits_nothing_is_clipped(state, u):
    controls = actuate(state, u, UNLIMITED, EPS_V, H)
    assert not controls.torque_clipped_n_m.any()
    assert not controls.steer_clipped_rad.any()
    moves = np.abs(state.speed_mps) > CRAWL_MPS  # who stands does not steer
    turned = np.where(moves, controls.omega_radps * H, 0.0)
    assert controls.steer_rad == pytest.approx(state.steer_command_rad + turned)


def test_small_wishes_are_not_clipped():
    controls = actuate(cars(), wanting(1.0, 0.5), LIMITED, EPS_V, H)
    assert not controls.torque_clipped_n_m.any()
    assert not controls.steer_clipped_rad.any()


def test_steering_goes_on_from_the_angle_last_commanded_so_a_lagging_servo_is_not_asked_twice():
    controls = actuate(cars(steer=0.05, command=0.1), wanting(0.0, 2.0), LIMITED, EPS_V, H)
    assert controls.steer_rad == pytest.approx(0.1 + controls.omega_radps * H)


def test_who_means_to_stand_makes_up_for_the_slope_that_his_car_rolls_down():
    """Asked for -2 v, its car slows down by 1 m/s^2 less; other drivers feel nothing."""
    feet, v, stands = Feet(H), np.full((1, 2), 1.0), np.array([[True, False]])
    for _ in range(round(3 / H)):
        asked = feet(v, -2 * v, stands)
        v = v + np.array([[asked[0, 0] + 1.0, 0.0]]) * H
    assert v[0, 0] < 0.02
    assert asked[0, 1] == -2.0


def test_who_means_to_stand_and_stands_asks_for_nothing():
    feet, v, stands = Feet(H), np.array([[0.0, 0.0]]), np.array([[True, False]])
    assert feet(v, np.array([[-0.5, -0.5]]), stands).tolist() == [[0.0, -0.5]]


def test_who_was_stopped_by_a_hill_presses_until_his_car_goes_as_meant_and_the_law_does_not():
    """Ego and neighbour ask for 0.5 m/s^2, where the slope takes 2 m/s^2; below that their brakes hold."""
    feet, v = Feet(H), np.zeros((1, 2))
    for _ in range(round(3 / H)):
        before = v
        asked = feet(v, np.array([[0.5, 0.5]]), np.zeros((1, 2), dtype=bool))
        v = np.maximum(v + (asked - 2.0) * H, 0.0)
    assert asked[0, 0] == 0.5
    assert v[0, 0] == 0.0
    assert (v - before)[0, 1] / H == pytest.approx(0.5, rel=1e-3)


@given(st.floats(-4, 4), st.floats(-2.5, 2.5))
def test_who_stands_never_presses_against_where_he_means_to_go(a_mps2, slope_mps2):
    """Reversing down a hill too."""
    feet, v, means = Feet(H), np.array([[0.0, 1.0]]), np.zeros((1, 2), dtype=bool)
    for _ in range(200):  # is stopped by the slope
        v = v + (feet(v, -v, means | [[False, True]]) + slope_mps2) * H
    asked = feet(np.zeros((1, 2)), np.full((1, 2), a_mps2), means)
    assert asked[0, 1] * a_mps2 >= 0


def road_load(sheet, speed):
    """What air and tyres take at that speed, N."""
    return 1.2 / 2 * sheet.drag_area_m2 * speed**2 + sheet.rolling_resistance * sheet.mass_kg * 9.81


@pytest.mark.parametrize("a", [1.0, 0.25, 0.0])
@pytest.mark.parametrize(
    ("drive", "driven"), [("all", [1, 1, 1, 1]), ("front", [1, 1, 0, 0]), ("rear", [0, 0, 1, 1])]
)
def test_the_driven_wheels_share_the_torque_of_the_effective_mass_and_of_the_road_load(a, drive, driven):
    sheet = SHEET.model_copy(update={"drive": drive})
    controls = actuate(cars(), wanting(a, 0.0), BelievedCars.of([sheet] * 3, limited=True), EPS_V, H)
    force = (sheet.mass_kg + sheet.rotating_mass_kg) * a + road_load(sheet, 2.0)
    total = force * sheet.wheel_radius_m
    assert controls.torque_n_m[0, 0] == pytest.approx(np.array(driven) * total / sum(driven), rel=1e-12)


@pytest.mark.parametrize("drive", ["all", "front", "rear"])
def test_the_brakes_of_all_wheels_give_what_air_and_tyres_do_not(drive):
    sheet = SHEET.model_copy(update={"drive": drive})
    controls = actuate(cars(), wanting(-2.0, 0.0), BelievedCars.of([sheet] * 3, limited=True), EPS_V, H)
    total = (-2.0 * sheet.effective_mass_kg + road_load(sheet, 2.0)) * sheet.wheel_radius_m
    front = sheet.brake_front_share
    shares = np.array([front, front, 1 - front, 1 - front]) / 2
    assert controls.torque_n_m[0, 0] == pytest.approx(shares * total, rel=1e-12)


def test_at_speed_the_power_is_the_limit():
    speed = 2 * SHEET.power_limit_w / (4 * SHEET.torque_limit_n_m / SHEET.wheel_radius_m)
    controls = actuate(cars(speed=speed), wanting(50.0, 0.0), LIMITED, EPS_V, H)
    assert controls.torque_n_m[0, 0] == pytest.approx(SHEET.torque_limit_n_m / 2)


def test_positive_lateral_acceleration_steers_left():
    controls = actuate(cars(), wanting(0.0, 1.0), LIMITED, EPS_V, H)
    assert (controls.steer_rad > 0).all()
    assert (controls.wheel_steer_rad > 0).all()


sizes = {"wheelbase_m": st.floats(0.2, 4), "track_m": st.floats(0.1, 2)}


@given(delta=st.floats(-0.7, 0.7), **sizes)
def test_both_front_wheels_roll_about_one_point_on_the_rear_axle_line(delta, wheelbase_m, track_m):
    assume(abs(delta) > 1e-3)
    assume(track_m * np.tan(abs(delta)) < wheelbase_m)  # or the turn centre is under the car
    left, right = ackermann(np.float64(delta), wheelbase_m, track_m)
    centre_left = track_m / 2 + wheelbase_m / np.tan(left)
    centre_right = -track_m / 2 + wheelbase_m / np.tan(right)
    assert centre_left == pytest.approx(centre_right, rel=1e-9)
    assert centre_left == pytest.approx(wheelbase_m / np.tan(delta), rel=1e-9)


@given(delta=st.floats(-0.7, 0.7), **sizes)
def test_the_bicycle_angle_undoes_ackermann(delta, wheelbase_m, track_m):
    assume(track_m * np.tan(abs(delta)) < 1.9 * wheelbase_m)  # or the turn centre is under the inner wheel
    back = bicycle_angle(ackermann(np.float64(delta), wheelbase_m, track_m), wheelbase_m, track_m)
    assert back == pytest.approx(delta, abs=1e-12)


def test_beliefs_change_what_is_believed_of_the_ego_and_of_nobody_else():
    scenario = load("paper", ["belief.mass_kg=5.5", "belief.wheelbase_m=0.4"])
    ego, *neighbours = believed_sheets(scenario)
    assert (ego.mass_kg, ego.wheelbase_m, ego.wheel_radius_m) == (5.5, 0.4, SHEET.wheel_radius_m)
    assert neighbours == [SHEET, SHEET]
    assert believed_sheets(load("paper")) == [SHEET] * 3


def test_a_heavier_belief_asks_for_more_torque():
    light, heavy = (
        BelievedCars.of(believed_sheets(load("paper", o)), limited=True)
        for o in ([], ["belief.mass_kg=7.48"])
    )
    one, two = (actuate(cars(), wanting(1.0, 0.0), b, EPS_V, H).torque_n_m[0, :, 0] for b in (light, heavy))
    more = 3.74 * (1.0 + SHEET.rolling_resistance * 9.81) * SHEET.wheel_radius_m / 4
    assert two[0] - one[0] == pytest.approx(more)
    assert np.array_equal(two[1:], one[1:])


def test_points_are_told_what_actuation_would_tell_them():
    """Nothing but u: their steering angle is NaN, and so is all that follows from it."""
    points = cars(steer=np.nan)
    u = wanting(1.0, 0.5)
    told, would = of_points(u), actuate(points, u, UNLIMITED, EPS_V, H)
    for field in fields(Controls):
        assert np.array_equal(getattr(told, field.name), getattr(would, field.name), equal_nan=True)
