"""The kinematic bicycle and its inverse: the paper's matrices, and what differentiation says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.vehicle.bicycle import derivative, front_acceleration, front_velocity, inverse

L, EPS_V = 0.33, 0.1
angle, steer = st.floats(-np.pi, np.pi), st.floats(-1.2, 1.2)
rolling = st.one_of(st.floats(EPS_V, 20), st.floats(-20, -EPS_V))
command = st.tuples(st.floats(-20, 20), st.floats(-20, 20)).map(np.array)


def front(state):
    """Front-axle centre of a bicycle x_r, y_r, theta, v_r, delta."""
    return state[..., :2] + L * np.stack([np.cos(state[..., 2]), np.sin(state[..., 2])], axis=-1)


def along(state, a, omega, h):
    """The state a short time h later, to second order."""
    middle = state + h / 2 * derivative(L, state, a, omega)
    return state + h * derivative(L, middle, a, omega)


def asked(u, theta, v, delta):
    """The inverse for one car, as floats."""
    a, omega = inverse(u, np.float64(theta), np.float64(v), np.float64(delta), L, EPS_V)
    return float(a), float(omega)


@given(angle, st.floats(-20, 20), steer, st.floats(-5, 5), st.floats(-3, 3))
def test_front_velocity_is_the_derivative_of_the_front_axle(theta, v, delta, a, omega):
    state = np.array([1.0, 2.0, theta, v, delta])
    h = 1e-5
    found = (front(along(state, a, omega, h)) - front(along(state, a, omega, -h))) / (2 * h)
    assert found == pytest.approx(front_velocity(*state[2:]), rel=1e-5, abs=1e-5)


@given(angle, rolling, steer, command)
def test_the_inverse_is_the_papers_matrix_inverse(theta, v, delta, u):
    c, s, t = np.cos(theta), np.sin(theta), np.tan(delta)
    sec_2 = 1 / np.cos(delta) ** 2
    matrix = np.array([[c - s * t, -v * s * sec_2], [s + c * t, v * c * sec_2]])
    drift = v * (v / L * t) * np.array([-(s + c * t), c - s * t])
    assert np.linalg.det(matrix) == pytest.approx(v * sec_2, rel=1e-9)
    wanted = np.linalg.solve(matrix, u - drift)
    assert asked(u, theta, v, delta) == pytest.approx(tuple(wanted), rel=1e-8, abs=1e-8)


@given(angle, rolling, steer, command)
def test_the_front_axle_of_the_bicycle_gets_the_acceleration_that_was_asked_for(theta, v, delta, u):
    a, omega = asked(u, theta, v, delta)
    state = np.array([0.0, 0.0, theta, v, delta])
    h = 1e-6 / (1 + abs(omega))
    ahead, behind = along(state, a, omega, h), along(state, a, omega, -h)
    found = (front_velocity(*ahead[2:]) - front_velocity(*behind[2:])) / (2 * h)
    assert found == pytest.approx(u, rel=1e-4, abs=1e-3 * (1 + v * v))


@given(angle, steer, command)
def test_at_standstill_the_drive_is_defined_and_the_steering_takes_the_positive_sign(theta, delta, u):
    a, omega = asked(u, theta, 0.0, delta)
    assert a == pytest.approx(np.cos(theta) * u[0] + np.sin(theta) * u[1], abs=1e-9)
    assert np.isfinite(omega)
    lateral = np.cos(theta) * u[1] - np.sin(theta) * u[0]
    assert omega == pytest.approx(np.cos(delta) ** 2 / EPS_V * (lateral - np.tan(delta) * a), abs=1e-8)


@pytest.mark.parametrize(("v", "stands_for"), [(0.01, EPS_V), (0.0, EPS_V), (-0.01, -EPS_V)])
def test_below_eps_v_the_steering_keeps_its_sign_and_its_size(v, stands_for):
    u = np.array([0.0, 1.0])
    assert asked(u, 0.0, v, 0.0)[1] == pytest.approx(1.0 / stands_for)


@given(angle, st.floats(-20, 20), steer, command)
def test_a_mirrored_car_is_steered_the_other_way(theta, v, delta, u):
    a, omega = asked(u, theta, v, delta)
    assert asked(u * [1, -1], -theta, v, -delta) == (a, -omega)


@given(angle, angle, rolling, steer, command)
def test_the_heading_of_the_road_does_not_matter(turn, theta, v, delta, u):
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([c * u[0] - s * u[1], s * u[0] + c * u[1]])
    assert asked(turned, theta + turn, v, delta) == pytest.approx(
        asked(u, theta, v, delta), rel=1e-8, abs=1e-8
    )


def test_a_constant_steering_angle_drives_a_circle_of_radius_l_over_tan_delta():
    delta, v, h = 0.2, 2.0, 1e-3
    radius = L / np.tan(delta)
    state = np.array([0.0, 0.0, 0.0, v, delta])
    for _ in range(2000):
        state = along(state, 0.0, 0.0, h)
    assert np.hypot(state[0], state[1] - radius) == pytest.approx(radius, rel=1e-5)


@given(angle, st.floats(-20, 20), steer, command, st.floats(-3, 3))
def test_the_acceleration_of_a_and_omega_is_the_one_that_the_inverse_takes_back_to_them(
    theta, v, delta, u, omega
):
    a, state = u[0], (np.float64(theta), np.float64(v), np.float64(delta), L, EPS_V)
    found = inverse(front_acceleration(a, omega, *state), *state)
    assert found == pytest.approx((a, omega), rel=1e-9, abs=1e-7)


@given(angle, rolling, steer, st.floats(-5, 5), st.floats(-3, 3))
def test_the_front_axle_accelerates_as_a_and_omega_say(theta, v, delta, a, omega):
    state, h = np.array([0.0, 0.0, theta, v, delta]), 1e-6 / (1 + abs(omega))
    ahead, behind = along(state, a, omega, h), along(state, a, omega, -h)
    found = (front_velocity(*ahead[2:]) - front_velocity(*behind[2:])) / (2 * h)
    said = front_acceleration(a, omega, theta, np.float64(v), delta, L, EPS_V)
    assert said == pytest.approx(found, rel=1e-4, abs=1e-3 * (1 + v * v))
