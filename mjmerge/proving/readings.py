"""What is read from the logs of manoeuvres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mjmerge.proving.ground import MotionLog
from mjmerge.proving.manoeuvres import (
    Scale,
)
from mjmerge.state import G_MPS2, Array
from mjmerge.vehicle.actuation import AIR_KG_PER_M3
from mjmerge.vehicle.datasheet import DataSheet


@dataclass(frozen=True)
class SteadyTurns:
    """Steady turns, one entry per turn, (K,).

    Attributes:
        speed_mps: of the rear axle.
        yaw_rate_radps: of the car.
        lateral_mps2: v times the yaw rate.
        steer_rad: of the wheels.
        front_slip_rad: slip angle of the front axle, positive with a force to the left.
        rear_slip_rad: of the rear axle.
        front_n: side force of the front axle, across its wheels, from the balance of moments.
        rear_n: of the rear axle.
        front_drive_n: drive force of the front axle, along its wheels.
        unsteady: largest change of yaw rate over the time measured, as a part of it.
    """

    speed_mps: Array
    yaw_rate_radps: Array
    lateral_mps2: Array
    steer_rad: Array
    front_slip_rad: Array
    rear_slip_rad: Array
    front_n: Array
    rear_n: Array
    front_drive_n: Array
    unsteady: Array

    @property
    def front_stiffness_n_per_rad(self) -> Array:
        """Of the front axle."""
        return self.front_n / self.front_slip_rad

    @property
    def rear_stiffness_n_per_rad(self) -> Array:
        """Of the rear axle."""
        return self.rear_n / self.rear_slip_rad


def read_turns(sheet: DataSheet, log: MotionLog) -> SteadyTurns:
    """Slip angles and side forces of turns that have become steady, from the means of a log.

    The balance of moments about the rear axle, m a_y l_r = (F_f cos(delta) + D_f sin(delta)) L, gives the
    front force, D_f being its drive; about the front one it gives the rear's.
    """
    length, rear_m = sheet.wheelbase_m, sheet.wheelbase_m - sheet.com_behind_front_axle_m
    v, r, vy, steer = (
        x.mean(axis=1) for x in (log.speed_mps, log.yaw_rate_radps, log.lateral_mps, log.steer_rad)
    )
    a = v * r
    drive_n = log.torque_n_m[..., :2].sum(axis=2).mean(axis=1) / sheet.wheel_radius_m
    return SteadyTurns(
        speed_mps=v,
        yaw_rate_radps=r,
        lateral_mps2=a,
        steer_rad=steer,
        front_slip_rad=steer - np.arctan((vy + length * r) / v),
        rear_slip_rad=-np.arctan(vy / v),
        front_n=(sheet.mass_kg * a * rear_m / length - drive_n * np.sin(steer)) / np.cos(steer),
        rear_n=sheet.mass_kg * a * (1 - rear_m / length),
        front_drive_n=drive_n,
        unsteady=np.ptp(log.yaw_rate_radps, axis=1) / np.abs(r),
    )


def steering_beyond_rad(sheet: DataSheet, turns: SteadyTurns) -> Array:
    """How much more is steered than the kinematic bicycle needs, (K,).

    Driven front wheels pull the car into the turn, which saves D_f sin(delta)/C_f of steering; it is added.
    """
    kinematic = np.arctan(sheet.wheelbase_m * turns.yaw_rate_radps / turns.speed_mps)
    pull = turns.front_drive_n * np.sin(turns.steer_rad) / turns.front_stiffness_n_per_rad
    more: Array = turns.steer_rad - kinematic + pull
    return more


def measured_understeer_rad_s2_per_m(sheet: DataSheet, turns: SteadyTurns) -> float:
    """K from :func:`steering_beyond_rad` over the lateral acceleration."""
    a = turns.lateral_mps2
    return float(steering_beyond_rad(sheet, turns) @ a / (a @ a))


def yaw_wheelbase_m(turns: SteadyTurns) -> float:
    """The L of v tan(delta)/r = L + K v^2, fitted over all turns."""
    length = turns.speed_mps * np.tan(turns.steer_rad) / turns.yaw_rate_radps
    basis = np.stack([np.ones_like(length), turns.speed_mps**2], axis=1)
    return float(np.linalg.lstsq(basis, length)[0][0])


def braking_distance_m(log: MotionLog) -> Array:
    """From the start to where the car first stands, (N,)."""
    standing = np.argmax(log.speed_mps < 0.01 * log.speed_mps[:, :1], axis=1)
    return np.take_along_axis(log.x_m, standing[:, None], axis=1)[:, 0] - log.x_m[:, 0]


def braking_mps2(log: MotionLog) -> Array:
    """Mean deceleration between 80 % and 20 % of the first speed, (N,)."""
    found = []
    for v in log.speed_mps:
        begin, end = (int(np.argmax(v < part * v[0])) for part in (0.8, 0.2))
        found.append((v[begin] - v[end]) / (log.time_s[end] - log.time_s[begin]))
    return np.array(found)


def peak_lateral_mps2(sheet: DataSheet, log: MotionLog) -> Array:
    """Largest lateral acceleration of the centre of mass, as a mean over 2 sqrt(L/g), (N,)."""
    a = np.abs(log.lateral_mps2(sheet.wheelbase_m - sheet.com_behind_front_axle_m))
    width = max(round(2 * Scale.of(sheet).time_s / (log.time_s[1] - log.time_s[0])), 1)
    sums = np.cumsum(np.pad(a, ((0, 0), (1, 0))), axis=1)
    peak: Array = ((sums[:, width:] - sums[:, :-width]) / width).max(axis=1)
    return peak


def rise_s(log: MotionLog, part: float = 0.632) -> float:
    """Time in which the steering does that part of the first simulation's step."""
    done = log.steer_rad[0] / log.steer_command_rad[0, 0]
    rising = slice(int(np.argmax(done > part)) + 1)
    return float(np.interp(part, done[rising], log.time_s[rising]))


def _resistance_n(sheet: DataSheet, rolling: float, drag_m2: float, speed_mps: Array) -> Array:
    """Of road and air, c m g + rho A v^2/2."""
    return rolling * sheet.mass_kg * G_MPS2 + AIR_KG_PER_M3 / 2 * drag_m2 * speed_mps**2


def _resistances(sheet: DataSheet, log: MotionLog) -> tuple[float, float]:
    """Rolling resistance and drag area, from m_eff dv/dt = -c m g - rho A v^2/2 over both coastings."""
    part = log.between(2 * Scale.of(sheet).time_s, np.inf)
    v = part.speed_mps
    force = -sheet.effective_mass_kg * np.gradient(v, part.time_s, axis=1)
    basis = np.stack([np.ones(v.size), v.ravel() ** 2], axis=1)
    constant, square = np.linalg.lstsq(basis, force.ravel())[0]
    return float(constant / (sheet.mass_kg * G_MPS2)), float(2 * square / AIR_KG_PER_M3)
