"""From a front-axle acceleration to steering angles and wheel torques, within the car's limits.

A plain function of what each car can know: its own motion and its data sheet (or the ego's belief). What
was clipped, and by how much, comes out beside what is commanded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjmerge.state import G_MPS2, Array, Cars, Controls, Mask, limit
from mjmerge.vehicle.bicycle import inverse
from mjmerge.vehicle.datasheet import DataSheet

AIR_KG_PER_M3 = 1.2
"""Density of air."""
CRAWL_MPS = 0.02
"""Below this speed there is nothing to brake: torque against it starts the car backwards."""
UNMOVED_MPS2 = 0.01
"""An acceleration that a car at rest does not start for: its brakes hold it."""
ROLLS_MPS = 0.1
"""Rolling resistance is all there from this speed on."""
FEEL_S = 0.2
"""Time in which a driver who means to stand notices that the car does not slow down as it should."""
MOST_FELT_MPS2 = 4.0
"""Most that such a driver makes up for: a slope of 0.35 rad, and some."""
_DRIVE_SHARES = {"all": (0.25, 0.25, 0.25, 0.25), "front": (0.5, 0.5, 0, 0), "rear": (0, 0, 0.5, 0.5)}


@dataclass(frozen=True)
class BelievedCars:
    """What the cars are believed to be, each (C,), SI units as in ``DataSheet``."""

    wheelbase_m: Array
    track_m: Array
    effective_mass_kg: Array
    wheel_radius_m: Array
    rolling_n: Array
    """Rolling resistance, N."""
    drag_n_per_mps2: Array
    """Drag over speed squared, N s^2/m^2."""
    torque_limit_n_m: Array
    """Of all driven wheels together."""
    power_limit_w: Array
    brake_limit_n_m: Array
    """Of all wheels together."""
    steer_limit_rad: Array
    steer_rate_limit_radps: Array
    drive_shares: Array
    """Part of the drive torque that each wheel gets, (C, 4)."""
    brake_shares: Array
    """Part of the brake torque that each wheel gets, (C, 4)."""

    @classmethod
    def of(cls, sheets: Sequence[DataSheet], *, limited: bool) -> BelievedCars:
        """From one data sheet per car; without limits where the plant knows none."""
        no_limit = 1.0 if limited else np.inf

        def column(name: str) -> Array:
            return np.array([getattr(s, name) for s in sheets], dtype=np.float64)

        drive = np.array([_DRIVE_SHARES[s.drive] for s in sheets], dtype=np.float64)
        front = column("brake_front_share")[:, None]
        return cls(
            wheelbase_m=column("wheelbase_m"),
            track_m=column("track_m"),
            effective_mass_kg=column("effective_mass_kg"),
            wheel_radius_m=column("wheel_radius_m"),
            rolling_n=column("rolling_resistance") * column("mass_kg") * G_MPS2,
            drag_n_per_mps2=AIR_KG_PER_M3 / 2 * column("drag_area_m2"),
            torque_limit_n_m=no_limit * column("torque_limit_n_m") / drive.max(axis=1),
            power_limit_w=no_limit * column("power_limit_w"),
            brake_limit_n_m=no_limit * column("brake_torque_limit_n_m"),
            steer_limit_rad=no_limit * column("steer_limit_rad"),
            steer_rate_limit_radps=no_limit * column("steer_rate_limit_radps"),
            drive_shares=drive,
            brake_shares=np.concatenate([front, front, 1 - front, 1 - front], axis=1) / 2,
        )


class Feet:
    """What drivers do who mean to stand, or have stood: they feel the slope, and hold and start on it.

    Where their cars do not move as asked, dv/dt = a + f, they ask for a - f, with f found within about
    :data:`FEEL_S`; without that a car rolls downhill for ever, where braking by -k v balances the slope, and
    one that is stopped by a hill never goes on. Once they stand they ask for nothing until they mean to go.
    All others, and the ego's law, ask for what they mean.
    """

    def __init__(self, step_s: float) -> None:
        """Args: control step, s."""
        self._step_s = step_s
        self._before: tuple[Array, Array] | None = None
        self._felt, self._feels = np.zeros(1), np.zeros(1, dtype=bool)

    def __call__(self, speed_mps: Array, a_mps2: Array, stands: Mask) -> Array:
        """What they ask of their cars, m/s^2, (N, C); call it once per control step.

        Args:
            speed_mps: of the cars, the ego's first, (N, C).
            a_mps2: acceleration that they mean, (N, C).
            stands: which of them mean to stand, (N, C), never the ego.
        """
        before, self._before = self._before, (speed_mps, a_mps2)
        rests = np.abs(speed_mps) <= CRAWL_MPS
        self._feels = self._feels | stands
        self._feels[:, 1:] |= rests[:, 1:]
        if not self._feels.any():
            return a_mps2
        if before is None:
            self._felt = np.zeros(stands.shape)
        else:
            off = (speed_mps - before[0]) / self._step_s - before[1]
            counts = np.abs(before[1]) < MOST_FELT_MPS2  # beyond, it is the car or the grip that limits
            more = min(self._step_s / FEEL_S, 1.0) * np.where(counts, off, 0.0)
            self._felt = np.where(self._feels, limit(self._felt + more, MOST_FELT_MPS2), 0.0)
        waits = rests & (stands | (np.abs(a_mps2) <= UNMOVED_MPS2))
        rolls = rests & (a_mps2 * self._felt > 0)  # to where it means to go
        pressed: Array = np.where(waits, 0.0, a_mps2 - np.where(rolls, 0.0, self._felt))
        return np.where(self._feels, pressed, a_mps2)


def actuate(
    cars: Cars,
    u_mps2: Array,
    believed: BelievedCars,
    eps_v_mps: float,
    step_s: float,
    feet: Feet | None = None,
    stands: Mask | None = None,
) -> Controls:
    """What to command over the next control step.

    The steering command moves from the angle last commanded at omega, so a lagging servo is not asked
    twice, and not at all while the car stands, when no angle can be right; for the torque see
    :func:`wheel_torques`.

    Args:
        cars: motion of all cars, (N, C).
        u_mps2: wanted front-axle accelerations, (N, C, 2).
        believed: limits and sizes, (C,).
        eps_v_mps: eps_v of the inverse.
        step_s: control step, s.
        feet: of the drivers, who else feel nothing.
        stands: which of them mean to stand, (N, C); with ``feet``.
    """
    a, omega = inverse(
        u_mps2, cars.heading_rad, cars.speed_mps, cars.steer_rad, believed.wheelbase_m, eps_v_mps
    )
    rate = believed.steer_rate_limit_radps
    turns = np.where(np.abs(cars.speed_mps) > CRAWL_MPS, omega, 0.0)
    steer_wanted = cars.steer_command_rad + turns * step_s
    steer = cars.steer_command_rad + limit(turns, rate) * step_s
    steer = limit(steer, believed.steer_limit_rad)

    asked = a if feet is None or stands is None else feet(cars.speed_mps, a, stands)
    torque, torque_clipped = wheel_torques(cars.speed_mps, asked, believed)
    return Controls(
        u_mps2=u_mps2,
        a_mps2=a,
        omega_radps=omega,
        steer_rad=steer,
        wheel_steer_rad=ackermann(steer, believed.wheelbase_m, believed.track_m),
        torque_n_m=torque,
        torque_clipped_n_m=torque_clipped,
        steer_clipped_rad=steer_wanted - steer,
    )


def of_points(u_mps2: Array) -> Controls:
    """What points are told, which have neither wheels nor a heading of their own: u alone, (N, C, 2)."""
    nothing = np.full(u_mps2.shape[:2], np.nan)
    of_wheels = np.full((*nothing.shape, len(_DRIVE_SHARES["all"])), np.nan)
    return Controls(
        u_mps2=u_mps2,
        a_mps2=nothing,
        omega_radps=nothing,
        steer_rad=nothing,
        wheel_steer_rad=of_wheels[..., :2],
        torque_n_m=of_wheels,
        torque_clipped_n_m=nothing,
        steer_clipped_rad=nothing,
    )


def command(cars: Cars, a_mps2: Array, steer_rad: Array, believed: BelievedCars) -> Controls:
    """Controls for an acceleration and a steering angle, as of a test driver: no law, no rate limit.

    Args:
        cars: motion of all cars, (N, C).
        a_mps2: wanted acceleration along the car, (N, C).
        steer_rad: wanted angle of the equivalent bicycle, (N, C).
        believed: limits and sizes, (C,).
    """
    torque, torque_clipped = wheel_torques(cars.speed_mps, a_mps2, believed)
    steer = limit(steer_rad, believed.steer_limit_rad)
    return Controls(
        u_mps2=np.full((*steer.shape, 2), np.nan),
        a_mps2=a_mps2,
        omega_radps=np.full(steer.shape, np.nan),
        steer_rad=steer,
        wheel_steer_rad=ackermann(steer, believed.wheelbase_m, believed.track_m),
        torque_n_m=torque,
        torque_clipped_n_m=torque_clipped,
        steer_clipped_rad=steer_rad - steer,
    )


def wheel_torques(speed_mps: Array, a_mps2: Array, believed: BelievedCars) -> tuple[Array, Array]:
    """Torque of each wheel for an acceleration, (N, C, 4), and what is missing of their sum, (N, C).

    The torque is r_w (m_eff a + resistance): drive torque, on the driven wheels, if it is along the motion,
    limited by torque and by power; brake torque, on all wheels, if it is against it.

    Args:
        speed_mps: v_r, (N, C).
        a_mps2: wanted acceleration, (N, C).
        believed: limits and sizes, (C,).
    """
    v, r = speed_mps, believed.wheel_radius_m
    speed = np.abs(v)
    moves = speed > CRAWL_MPS
    wanted = r * (believed.effective_mass_kg * a_mps2 + _resistance_n(v, speed, moves, believed))
    braking = (wanted * v < 0) & moves
    powered = believed.power_limit_w * r / np.maximum(speed, CRAWL_MPS)
    most = np.where(braking, believed.brake_limit_n_m, np.minimum(believed.torque_limit_n_m, powered))
    given = limit(wanted, most)
    shares = np.where(braking[..., None], believed.brake_shares, believed.drive_shares)
    return given[..., None] * shares, wanted - given


def resistance_n(speed_mps: Array, believed: BelievedCars) -> Array:
    """Force of air and rolling resistance against the motion, N, (N, C)."""
    speed = np.abs(speed_mps)
    return _resistance_n(speed_mps, speed, speed > CRAWL_MPS, believed)


def _resistance_n(v: Array, speed: Array, moves: Mask, believed: BelievedCars) -> Array:
    rolling = np.where(moves, believed.rolling_n * limit(v / ROLLS_MPS, 1.0), 0.0)
    resistance: Array = believed.drag_n_per_mps2 * v * speed + rolling
    return resistance


def ackermann(steer_rad: Array, wheelbase_m: Array, track_m: Array) -> Array:
    """Angles of the left and right front wheel that roll about one centre, rad, (..., 2)."""
    t = np.tan(steer_rad)
    half = track_m / (2 * wheelbase_m) * t
    tangents = np.empty((*t.shape, 2))
    np.divide(t, 1 - half, out=tangents[..., 0])
    np.divide(t, 1 + half, out=tangents[..., 1])
    angles: Array = np.arctan(tangents)
    return angles


def bicycle_angle(wheel_steer_rad: Array, wheelbase_m: Array, track_m: Array) -> Array:
    """Steering angle of the equivalent bicycle from the two wheels' angles, rad, (...,).

    Inverse of :func:`ackermann` through the mean m of the two tangents, m = t/(1 - k^2 t^2) with
    k = track/(2 L): well-conditioned for straight wheels, where the mean of cotangents is not.
    """
    mean = (np.tan(wheel_steer_rad[..., 0]) + np.tan(wheel_steer_rad[..., 1])) / 2
    k = track_m / (2 * wheelbase_m)
    angle: Array = np.arctan(2 * mean / (1 + np.sqrt(1 + (2 * k * mean) ** 2)))
    return angle
