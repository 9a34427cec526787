"""What passes between plant, law, drivers and actuation: constants, units, frames and shapes in one place.

N simulations, C cars (ego first). Vectors are in the road frame: x along the road, y to its left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

G_MPS2 = 9.81
"""Gravity, m/s^2, which is also MuJoCo's."""
NS_PER_S = 1_000_000_000
"""Nanoseconds in a second; files count time in them."""


def nanoseconds(time_s: ArrayLike) -> NDArray[np.int64]:
    """Times in whole nanoseconds, the nearest ones."""
    found: NDArray[np.int64] = np.rint(np.asarray(time_s, float) * NS_PER_S).astype(np.int64)
    return found


@dataclass(frozen=True)
class Cars:
    """Motion of all cars at one instant, as it truly is.

    Attributes:
        front_m: front-axle centres p, (N, C, 2).
        velocity_mps: of those points, (N, C, 2).
        heading_rad: theta, from the road's direction to the left, (N, C).
        speed_mps: v_r, rear-axle speed along the car, (N, C).
        steer_rad: delta of the equivalent bicycle, positive to the left, (N, C).
        steer_command_rad: the angle last commanded, (N, C); the plant may lag behind it.
        clearance_m: between bodies, pairs as in the roster, (N, P); NaN where the plant has no bodies.
    """

    front_m: Array
    velocity_mps: Array
    heading_rad: Array
    speed_mps: Array
    steer_rad: Array
    steer_command_rad: Array
    clearance_m: Array


@dataclass(frozen=True)
class Controls:
    """What all cars are told to do over the next control step; each plant takes the level it understands.

    Attributes:
        u_mps2: front-axle acceleration (double integrator), (N, C, 2).
        a_mps2: rear-axle acceleration a (bicycle), before limits, (N, C).
        omega_radps: steering rate omega (bicycle), before limits, (N, C).
        steer_rad: steering angle command within limits, equivalent bicycle, (N, C).
        wheel_steer_rad: Ackermann angles of the front wheels, left and right, (N, C, 2).
        torque_n_m: wheel torques, front left, front right, rear left, rear right, (N, C, 4).
        torque_clipped_n_m: torque per car asked for and not given, signed, (N, C).
        steer_clipped_rad: steering angle asked for and not given over this step, signed, (N, C).
    """

    u_mps2: Array
    a_mps2: Array
    omega_radps: Array
    steer_rad: Array
    wheel_steer_rad: Array
    torque_n_m: Array
    torque_clipped_n_m: Array
    steer_clipped_rad: Array


def limit(a: Array, bound: Array | float) -> Array:
    """``a`` kept within plus and minus ``bound``, in a third of the time of ``np.clip``."""
    return np.minimum(np.maximum(a, -bound), bound)


LEAST = 1e-300
"""Smallest size of what is divided by: no number above it feels it, and no quotient of a car's overflows."""


def nonzero(a: Array) -> Array:
    """``a``, moved away from zero by ``LEAST``."""
    return a + np.copysign(LEAST, a)


def dot(a: Array, b: Array) -> Array:
    """Inner product of 2-vectors over the last axis: the same bits for any batch size, unlike BLAS."""
    product: Array = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    return product


def norm(a: Array) -> Array:
    """Length of 2-vectors over the last axis."""
    return np.sqrt(dot(a, a))
