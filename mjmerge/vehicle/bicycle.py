"""The kinematic bicycle, its front axle, and the inverse from a front-axle acceleration to (a, omega).

In the car's own frame, with u' = u - drift and t = tan(delta), the paper's 2x2 inverse is

    a     = u'_x                                       never singular
    omega = cos(delta)^2 / v_r (u'_y - t u'_x)         v_r -> sign(v_r) eps_v below eps_v, sign(0) = +1
    drift = v_r^2/L (-t^2, t)
"""

from __future__ import annotations

import numpy as np

from mjmerge.state import Array


def front_velocity(heading_rad: Array, speed_mps: Array, steer_rad: Array) -> Array:
    """Velocity of the front-axle centre, m/s, (..., 2).

    v_r (cos th - sin th tan delta, sin th + cos th tan delta): d/dt of the paper's front-axle position.
    """
    c, s, t = np.cos(heading_rad), np.sin(heading_rad), np.tan(steer_rad)
    velocity: Array = speed_mps[..., None] * np.stack([c - s * t, s + c * t], axis=-1)
    return velocity


def derivative(wheelbase_m: Array, state: Array, a_mps2: Array, omega_radps: Array) -> Array:
    """Right-hand side of the kinematic bicycle (eq. bicycle_model), (..., 5).

    Args:
        wheelbase_m: L, m, broadcast against (...,).
        state: x_r, y_r, theta, v_r, delta, (..., 5).
        a_mps2: acceleration of v_r, (...,).
        omega_radps: steering rate, (...,).
    """
    theta, v, delta = state[..., 2], state[..., 3], state[..., 4]
    return np.stack(
        [v * np.cos(theta), v * np.sin(theta), v * np.tan(delta) / wheelbase_m, a_mps2, omega_radps], axis=-1
    )


def inverse(
    u_mps2: Array,
    heading_rad: Array,
    speed_mps: Array,
    steer_rad: Array,
    wheelbase_m: Array,
    eps_v_mps: float,
) -> tuple[Array, Array]:
    """(a, omega) that give the front axle the acceleration u (eq. controlH2B), m/s^2 and rad/s, each (...,).

    Args:
        u_mps2: wanted front-axle acceleration in the road frame, (..., 2).
        heading_rad: theta, (...,).
        speed_mps: v_r, (...,).
        steer_rad: delta, (...,).
        wheelbase_m: L, broadcast against (...,).
        eps_v_mps: eps_v.
    """
    c, s, t = np.cos(heading_rad), np.sin(heading_rad), np.tan(steer_rad)
    centripetal = speed_mps * speed_mps / wheelbase_m * t
    forward = c * u_mps2[..., 0] + s * u_mps2[..., 1] + centripetal * t
    left = c * u_mps2[..., 1] - s * u_mps2[..., 0] - centripetal
    return forward, (left - t * forward) / (_rolling(speed_mps, eps_v_mps) * (1 + t * t))  # cos^2 = 1/(1+t^2)


def front_acceleration(
    a_mps2: Array,
    omega_radps: Array,
    heading_rad: Array,
    speed_mps: Array,
    steer_rad: Array,
    wheelbase_m: Array,
    eps_v_mps: float,
) -> Array:
    """The front-axle acceleration u that :func:`inverse` turns into (a, omega), m/s^2, (..., 2).

    Args:
        a_mps2: acceleration of v_r, (...,).
        omega_radps: steering rate, (...,).
        heading_rad: theta, (...,); it and what follows as in :func:`inverse`.
        speed_mps: v_r, (...,).
        steer_rad: delta, (...,).
        wheelbase_m: L, broadcast against (...,).
        eps_v_mps: eps_v.
    """
    c, s, t = np.cos(heading_rad), np.sin(heading_rad), np.tan(steer_rad)
    centripetal = speed_mps * speed_mps / wheelbase_m * t
    forward = a_mps2 - centripetal * t
    left = t * a_mps2 + omega_radps * _rolling(speed_mps, eps_v_mps) * (1 + t * t) + centripetal
    return np.stack([c * forward - s * left, s * forward + c * left], axis=-1)


def _rolling(speed_mps: Array, eps_v_mps: float) -> Array:
    """v_r, and sign(v_r) eps_v where it is slower than that, m/s, (...,)."""
    slow = np.abs(speed_mps) < eps_v_mps
    if not slow.any():
        return speed_mps
    return np.where(slow, np.where(speed_mps < 0, -eps_v_mps, eps_v_mps), speed_mps)
