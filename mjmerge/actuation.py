"""From a front-axle acceleration to steering angles and wheel torques, within the car's limits.

A plain function of what each car can know: its own motion and its data sheet (or the ego's belief). What
was clipped, and by how much, comes out beside what is commanded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjmerge.bicycle import inverse
from mjmerge.datasheet import DataSheet
from mjmerge.loader import car_sheets
from mjmerge.scenario import Scenario
from mjmerge.state import Array, Cars, Controls, limit

_DRIVEN = {"all": (1, 1, 1, 1), "front": (1, 1, 0, 0), "rear": (0, 0, 1, 1)}


@dataclass(frozen=True)
class BelievedCars:
    """What the cars are believed to be, each (C,), SI units as in :class:`~mjmerge.datasheet.DataSheet`."""

    wheelbase_m: Array
    track_m: Array
    torque_per_acceleration: Array
    """Torque of one driven wheel per commanded acceleration, m_eff r_w / n, N m s^2/m."""
    torque_limit_n_m: Array
    steer_limit_rad: Array
    steer_rate_limit_radps: Array
    driven: Array
    """1 for a driven wheel, (C, 4)."""

    @classmethod
    def of(cls, sheets: Sequence[DataSheet], *, limited: bool) -> BelievedCars:
        """From one data sheet per car; without limits where the plant knows none."""
        no_limit = 1.0 if limited else np.inf

        def column(values: list[float]) -> Array:
            return np.array(values, dtype=np.float64)

        driven = np.array([_DRIVEN[s.drive] for s in sheets], dtype=np.float64)
        return cls(
            wheelbase_m=column([s.wheelbase_m for s in sheets]),
            track_m=column([s.track_m for s in sheets]),
            torque_per_acceleration=column(
                [s.effective_mass_kg * s.wheel_radius_m / sum(_DRIVEN[s.drive]) for s in sheets]
            ),
            torque_limit_n_m=no_limit * column([s.torque_limit_n_m for s in sheets]),
            steer_limit_rad=no_limit * column([s.steer_limit_rad for s in sheets]),
            steer_rate_limit_radps=no_limit * column([s.steer_rate_limit_radps for s in sheets]),
            driven=driven,
        )


def believed_sheets(scenario: Scenario) -> list[DataSheet]:
    """Data sheet of each car, the ego's with what the scenario's ``belief`` says otherwise."""
    sheets = car_sheets(scenario)
    sheets[0] = sheets[0].model_copy(update=scenario.belief.model_dump(exclude_none=True))
    return sheets


def actuate(cars: Cars, u_mps2: Array, believed: BelievedCars, eps_v_mps: float, step_s: float) -> Controls:
    """What to command over the next control step.

    The steering command moves from the angle last commanded at omega, so a lagging servo is not asked
    twice; torque is m_eff a r_w shared by the driven wheels, negative when braking.

    Args:
        cars: motion of all cars, (N, C).
        u_mps2: wanted front-axle accelerations, (N, C, 2).
        believed: limits and sizes, (C,).
        eps_v_mps: eps_v of the inverse.
        step_s: control step, s.
    """
    a, omega = inverse(
        u_mps2, cars.heading_rad, cars.speed_mps, cars.steer_rad, believed.wheelbase_m, eps_v_mps
    )
    rate = believed.steer_rate_limit_radps
    steer_wanted = cars.steer_command_rad + omega * step_s
    steer = cars.steer_command_rad + limit(omega, rate) * step_s
    steer = limit(steer, believed.steer_limit_rad)

    torque_wanted = believed.torque_per_acceleration * a
    torque = limit(torque_wanted, believed.torque_limit_n_m)
    return Controls(
        u_mps2=u_mps2,
        a_mps2=a,
        omega_radps=omega,
        steer_rad=steer,
        wheel_steer_rad=ackermann(steer, believed.wheelbase_m, believed.track_m),
        torque_n_m=torque[..., None] * believed.driven,
        torque_clipped_n_m=(torque_wanted - torque) * believed.driven.sum(axis=-1),
        steer_clipped_rad=steer_wanted - steer,
    )


def ackermann(steer_rad: Array, wheelbase_m: Array, track_m: Array) -> Array:
    """Angles of the left and right front wheel that roll about one centre, rad, (..., 2)."""
    t = np.tan(steer_rad)
    half = track_m / (2 * wheelbase_m) * t
    return np.arctan(np.stack([t / (1 - half), t / (1 + half)], axis=-1))


def bicycle_angle(wheel_steer_rad: Array, wheelbase_m: Array, track_m: Array) -> Array:
    """Steering angle of the equivalent bicycle from the two wheels' angles, rad, (...,).

    Inverse of :func:`ackermann` through the mean m of the two tangents, m = t/(1 - k^2 t^2) with
    k = track/(2 L): well-conditioned for straight wheels, where the mean of cotangents is not.
    """
    mean = (np.tan(wheel_steer_rad[..., 0]) + np.tan(wheel_steer_rad[..., 1])) / 2
    k = track_m / (2 * wheelbase_m)
    angle: Array = np.arctan(2 * mean / (1 + np.sqrt(1 + (2 * k * mean) ** 2)))
    return angle
