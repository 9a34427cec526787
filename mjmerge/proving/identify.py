"""What a car really is, measured by driving it: manoeuvres, what is read from them, and the acceptance table.

Nothing here looks into the model's parameters: the car is driven through its actuators on the plant that
scenarios use, and what is measured is compared with its data sheet, or with physics from the data sheet's
numbers. Speeds and times of the manoeuvres scale with the car as sqrt(g L) and sqrt(L/g), L the wheelbase.

Signs and the understeer gradient K are those of ISO 8855: K = W_f/(C_f g) - W_r/(C_r g), and the steady yaw
rate of the single-track model is v delta/(L + K v^2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mjmerge.proving.ground import MotionLog, wheel_loads_n
from mjmerge.proving.manoeuvres import (
    STEPS_G,
    Scale,
    brake,
    coast,
    creep,
    steady_turns,
    steer_ramp,
    steer_step,
    torque_steps,
    understeer_rad_s2_per_m,
)
from mjmerge.proving.readings import (
    SteadyTurns,
    _resistance_n,
    _resistances,
    braking_distance_m,
    braking_mps2,
    measured_understeer_rad_s2_per_m,
    peak_lateral_mps2,
    read_turns,
    rise_s,
    yaw_wheelbase_m,
)
from mjmerge.roster import WHEELS
from mjmerge.state import G_MPS2, Array
from mjmerge.vehicle.acceptance import Measured
from mjmerge.vehicle.datasheet import DataSheet
from mjmerge.world.compose import single

FRICTION = 1.0
"""Of the proving ground, unless it says otherwise."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Identification:
    """What came of it.

    Attributes:
        model: the model's name.
        sheet: its data sheet.
        table: what was measured, row by row.
        loads_n: of the wheels at rest, (4,).
        still: parked, on the flat and on slopes.
        steps: steps of the torque.
        turns: steady turns over speed and lateral acceleration.
        coasting: coasting down.
        braking: full braking to a stop.
        ramp: steering slowly up to the limit of the grip.
        step: a step of the steering.
    """

    model: str
    sheet: DataSheet
    table: tuple[Measured, ...]
    loads_n: Array
    still: MotionLog
    steps: MotionLog
    turns: SteadyTurns
    coasting: MotionLog
    braking: MotionLog
    ramp: MotionLog
    step: MotionLog

    @property
    def passed(self) -> bool:
        """Whether all that is asked of the car holds."""
        return all(row.passed is not False for row in self.table)


def identify(model: str, progress: Progress | None = None) -> Identification:
    """Measures a car on dry road.

    Args:
        model: a shipped model's name, or the path of its folder.
        progress: called with the part that is done, 0 to 1.

    Raises:
        ModelError: it is not a car.
        UnknownNameError: there is no such model.
        ScenarioError: its data sheet is wrong.
    """
    report = progress or (lambda _: None)
    world = single(model, friction=FRICTION)
    sheet = world.sheets[0]
    loads_n, still = wheel_loads_n(world), creep(world)
    report(0.15)
    coasting, steps = coast(world), torque_steps(world)
    report(0.3)
    turns = read_turns(sheet, steady_turns(world))
    report(0.6)
    braking, ramp, step = brake(world), steer_ramp(world), steer_step(world)
    report(1.0)
    table = (
        *_weight(sheet, loads_n),
        *_stillness(still),
        *_along(sheet, coasting, steps),
        *_across(sheet, turns),
        *_limits(sheet, braking, ramp),
        *_steering(sheet, step),
    )
    return Identification(
        model=model,
        sheet=sheet,
        table=table,
        loads_n=loads_n,
        still=still,
        steps=steps,
        turns=turns,
        coasting=coasting,
        braking=braking,
        ramp=ramp,
        step=step,
    )


def _weight(sheet: DataSheet, loads_n: Array) -> list[Measured]:
    weight, front = sheet.mass_kg * G_MPS2, 1 - sheet.com_behind_front_axle_m / sheet.wheelbase_m
    shares = [front / 2, front / 2, (1 - front) / 2, (1 - front) / 2]
    how = "contact force of the standing car; m g split by the centre of mass"
    rows = [
        Measured(f"load {w.replace('_', ' ')}", "N", float(n), weight * part, 0.01 * weight * part, how)
        for w, n, part in zip(WHEELS, loads_n, shares, strict=True)
    ]
    total = float(loads_n.sum())
    return [
        Measured("load on all wheels", "N", total, weight, 1e-3 * weight, "their sum; m g of the data sheet"),
        *rows,
    ]


def _stillness(log: MotionLog) -> list[Measured]:
    later = log.between(2.0, np.inf)
    way = np.hypot(later.x_m - later.x_m[:, :1], later.y_m - later.y_m[:, :1])
    rate = 1e3 * way[:, -1] / (later.time_s[-1] - later.time_s[0])
    flat = 1e6 * max(float(way[0].max()), float(np.ptp(later.z_m[0])))
    slope = "mean over 10 s, parked with its brakes on"
    return [
        Measured("movement at rest", "um", flat, 0.0, 1.0, "largest in 10 s, on the flat"),
        Measured("creep up a slope of 10 %", "mm/s", float(rate[1]), 0.0, 0.1, slope),
        Measured("creep down a slope of 10 %", "mm/s", float(rate[2]), 0.0, 0.1, slope),
        Measured("creep across a slope of 10 %", "mm/s", float(rate[3]), 0.0, 0.1, slope),
    ]


def _along(sheet: DataSheet, coasting: MotionLog, steps: MotionLog) -> list[Measured]:
    rolling, drag = _resistances(sheet, coasting)
    radius = coasting.speed_mps[:, 100:] / coasting.spin_radps[:, 100:].mean(axis=2)
    part = steps.between(6 * Scale.of(sheet).time_s, np.inf)
    got = (part.speed_mps[:, -1] - part.speed_mps[:, 0]) / (part.time_s[-1] - part.time_s[0])
    force_n = part.torque_n_m.sum(axis=2) / sheet.wheel_radius_m - _resistance_n(
        sheet, rolling, drag, part.speed_mps
    )
    mass = float(np.polyfit(got, force_n[:, :-1].mean(axis=1), 1)[0])
    given = float(np.polyfit(STEPS_G * G_MPS2, got, 1)[0])
    return [
        _row(
            "rolling radius",
            "m",
            float(radius.mean()),
            sheet.wheel_radius_m,
            0.01,
            "speed over wheel speed, coasting",
        ),
        _row(
            "effective mass",
            "kg",
            mass,
            sheet.effective_mass_kg,
            0.01,
            "wheel force over acceleration, five torques at one speed",
        ),
        _row("acceleration given over asked", "", given, 1.0, 0.01, "two of these torques"),
        _row(
            "rolling resistance",
            "",
            rolling,
            sheet.rolling_resistance,
            0.05,
            "coasting down, part without the speed",
        ),
        _row(
            "drag area",
            "m^2",
            drag,
            sheet.drag_area_m2,
            0.05,
            "coasting down, part with the square of the speed",
        ),
    ]


def _across(sheet: DataSheet, turns: SteadyTurns) -> list[Measured]:
    rows = [
        _row(
            "wheelbase seen by yaw",
            "m",
            yaw_wheelbase_m(turns),
            sheet.wheelbase_m,
            0.01,
            "steady turns, v tan(delta)/r at no speed",
        ),
    ]
    if sheet.cornering_stiffness_n_per_rad is None:
        return rows
    given = sheet.cornering_stiffness_n_per_rad
    for axle, found, expected in (
        ("front", turns.front_stiffness_n_per_rad, given.front),
        ("rear", turns.rear_stiffness_n_per_rad, given.rear),
    ):
        spread = float(np.ptp(found) / np.mean(found) / 2)
        rows += [
            _row(
                f"cornering stiffness {axle}",
                "N/rad",
                float(found.mean()),
                expected,
                0.03,
                "side force over slip angle, mean of all steady turns",
            ),
            Measured(
                f"its spread {axle}",
                "",
                spread,
                0.0,
                0.01,
                "half of largest less smallest, over speed and lateral acceleration",
            ),
        ]
    degrees = np.degrees(1.0) * G_MPS2
    gradient = degrees * understeer_rad_s2_per_m(sheet)
    found_gradient = degrees * measured_understeer_rad_s2_per_m(sheet, turns)
    rows.append(
        _row(
            "understeer gradient",
            "deg/g",
            found_gradient,
            gradient,
            0.05,
            "steering beyond the kinematic bicycle's; W_f/C_f - W_r/C_r",
        )
    )
    return rows


def _limits(sheet: DataSheet, braking: MotionLog, ramp: MotionLog) -> list[Measured]:
    grip = FRICTION * G_MPS2
    rows = [
        _row(
            "peak lateral acceleration",
            "m/s^2",
            float(peak_lateral_mps2(sheet, ramp).max()),
            grip,
            0.05,
            "steering slowly beyond the grip; mu g",
        ),
        _row(
            "peak longitudinal acceleration",
            "m/s^2",
            float(braking_mps2(braking)[-1]),
            grip,
            0.05,
            "full braking between 80 and 20 % of the speed; mu g",
        ),
    ]
    for v, way in zip(braking.speed_mps[:, 0], braking_distance_m(braking), strict=True):
        rows.append(
            _row(
                f"braking distance from {v:.3g} m/s", "m", float(way), v**2 / (2 * grip), 0.05, "v^2/(2 mu g)"
            )
        )
    return rows


def _steering(sheet: DataSheet, step: MotionLog) -> list[Measured]:
    rate = np.abs(np.gradient(step.steer_rad[1], step.time_s)).max()
    return [
        _row("steering lag", "s", rise_s(step), sheet.steer_lag_s, 0.1, "to 63 % of a small step"),
        Measured(
            "fastest steering", "rad/s", float(rate), sheet.steer_rate_limit_radps, None, "in a large step"
        ),
    ]


def _row(name: str, unit: str, measured: float, expected: float, relative: float, how: str) -> Measured:
    return Measured(name, unit, measured, expected, relative * abs(expected), how)
