"""Whether the recorded motion is one: positions, velocities, headings and steering from tick to tick."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from mjmerge.plant import make
from mjmerge.record.contents import Ticks
from mjmerge.record.read import Recorded
from mjmerge.review.check import Check, checked, compared
from mjmerge.simulation.trace import Trace
from mjmerge.state import G_MPS2, Array, Cars, Controls, Mask, norm

_RELATIVE = 1e-9
_AXLE = 1.6
"""A front axle may accelerate by this times what its tyres could give the whole car: it also turns it."""
_SPARE_MPS2 = 3.0
"""What suspension, air and a bump add to that."""
_JERK = 2.0
"""Times the change of acceleration from tick to tick: how unsteady it may be within one."""
_UNSTEADY_MPS2 = 1.0
_DRIFT_TICKS = 60.0
"""Of h^2 by 1 m/s^2: what positions and integrated velocities may be apart over the whole run."""
_ALONG_MPS = 0.03
"""Of the front axle along the car against the rear axle: they are on one body, but it pitches."""
_SLIDES_MPS, _SLIDES, _GRIPS = 0.4, 0.05, 0.3
"""Of the rear axle across the car: so much, or this part of the speed; until it was accelerated by the last
number times what the road gives, or hit. After that it may slide as fast as it is."""
_STEERS_RAD = 0.04
"""How far from its servo's course a steering angle may be after a tick: tyres push back."""
_STEERS = 0.6


def motion(found: Recorded, trace: Trace, cars: Cars) -> Iterator[Check]:
    """The checks of the motion, by what moved the cars.

    Args:
        found: the file as read.
        trace: the run in it.
        cars: its motion, (T, C).
    """
    if trace.plant == "mujoco":
        yield _physical(found, trace)
    elif trace.continuous:
        yield _smooth(found, trace)
    else:
        yield _equation(found, trace, cars)


def _pairs(found: Recorded) -> Ticks:
    """Rows whose next row is the next tick."""
    rows: Ticks = np.flatnonzero(np.diff(found.ticks) == 1)
    return rows


def _equation(found: Recorded, trace: Trace, cars: Cars) -> Check:
    """Every tick is the one before, moved on by the plant's equation under the recorded commands."""
    c, scenario = found.columns, trace.scenario
    plant = make(trace.plant, [scenario.model_copy(update={"mismatch": trace.mismatch[0]})], None, threads=0)
    ideal = trace.plant == "double_integrator"
    nothing = np.full((1, len(found.roster.cars), 2), np.nan)
    running: Mask = np.ones(1, bool)
    names = ("front_m", "velocity_mps", "heading_rad", "speed_mps", "steer_rad")
    seen: list[Cars] = []
    wheelbase_m = np.array([sheet.wheelbase_m for sheet in scenario.sheets or ()])
    for k in range(len(found.ticks) - 1):
        if ideal:
            state = np.concatenate([c["front_m"][k], c["velocity_mps"][k]], axis=-1)
        else:
            heading = c["heading_rad"][k]
            rear = c["front_m"][k] - wheelbase_m[:, None] * np.stack(
                [np.cos(heading), np.sin(heading)], axis=-1
            )
            rest = (heading, c["speed_mps"][k], c["steer_rad"][k])
            state = np.concatenate([rear, np.stack(rest, axis=-1)], axis=-1)
        plant.put(state[None])  # type: ignore[attr-defined]  # plants that are equations have it
        plant.step(
            Controls(
                u_mps2=c["u_mps2"][k : k + 1],
                a_mps2=c["a_mps2"][k : k + 1],
                omega_radps=c["omega_radps"][k : k + 1],
                steer_rad=c["steer_command_rad"][k : k + 1],
                wheel_steer_rad=nothing,
                torque_n_m=c["torque_n_m"][k : k + 1],
                torque_clipped_n_m=c["torque_clipped_n_m"][k : k + 1],
                steer_clipped_rad=c["steer_clipped_rad"][k : k + 1],
            ),
            running,
        )
        seen.append(plant.observe())
    rows = _pairs(found)
    if not rows.size:
        return Check("motion", None, "not checked: a single tick does not move")
    expected = {name: np.concatenate([getattr(s, name) for s in seen])[rows] for name in names}
    columns = {name: c[name][rows + 1] for name in names}
    time_s: Any = found.ticks[rows + 1] * found.step_s
    wrong, most = compared(columns, expected, time_s, _RELATIVE, _RELATIVE)
    bodies = [
        n for n in ("clearance_m", "contact_impulse_n_s", "contact_speed_mps") if (~np.isnan(c[n])).any()
    ]
    wrong += [f"{name} has numbers, and this plant has no bodies" for name in bodies]
    del cars
    return checked("motion", wrong, f"every tick from the one before and its commands: off by {most:.1g}")


def _smooth(found: Recorded, trace: Trace) -> Check:
    """In continuous time: integrals of velocity and command over a tick, to how much those change in it."""
    c, h, rows = found.columns, found.step_s, _pairs(found)
    if not rows.size:
        return Check("motion", None, "not checked: a single tick does not move")
    p, v, u = c["front_m"], c["velocity_mps"], c["u_mps2"]
    wrong: list[str] = []
    time_s = found.ticks[rows + 1] * h
    swing = _swing(u, rows)
    _bounded(wrong, "front_m", _trapezoid(p, v, rows, h), h * h * (swing + 1e-6), time_s)
    if trace.plant == "double_integrator":
        _bounded(wrong, "velocity_mps", _trapezoid(v, u, rows, h), h * (swing + 1e-6), time_s)
    return checked("motion", wrong, "positions and velocities are the integrals of velocities and commands")


def _swing(values: Array, rows: Ticks) -> Array:
    """How much a vector changes around each tick, (R, C)."""
    step = norm(np.diff(values, axis=0))
    padded = np.pad(step, ((1, 1), (0, 0)), mode="edge")
    around: Array = (padded[:-2] + padded[1:-1] + padded[2:])[rows]
    return around


def _trapezoid(x: Array, rate: Array, rows: Ticks, step_s: float) -> Array:
    """How far a step of ``x`` is from the integral of its rate by the trapezoidal rule, (R, C)."""
    off: Array = norm(x[rows + 1] - x[rows] - step_s / 2 * (rate[rows] + rate[rows + 1]))
    return off


def _bounded(wrong: list[str], name: str, off: Any, bound: Any, time_s: Any) -> None:
    """Notes a column that is further off than may be; NaN is."""
    bad = ~(off <= bound)
    if bad.any():
        rows = np.flatnonzero(bad.any(axis=1))
        worst = float(np.max(np.where(bad, np.nan_to_num(off, nan=np.inf), 0)))
        wrong.append(
            f"{name} is off at {len(rows)} ticks, first at {time_s[rows[0]]:.2f} s, by up to {worst:.3g}"
        )


def _physical(found: Recorded, trace: Trace) -> Check:
    """Physical cars: everything is some body's motion, to bounds from the physics."""
    c, h, rows = found.columns, found.step_s, _pairs(found)
    if not rows.size:
        return Check("motion", None, "not checked: a single tick does not move")
    scenario, mismatch = trace.scenario, trace.scenario.mismatch
    p, v = c["front_m"], c["velocity_mps"]
    heading, speed = c["heading_rad"], c["speed_mps"]
    time_s = found.ticks[rows + 1] * h
    wrong: list[str] = []
    dt = scenario.physics_step_s
    change = v[rows + 1] - v[rows]
    mass_kg = np.array([sheet.mass_kg for sheet in scenario.sheets or ()])
    hits = np.nan_to_num(c["contact_impulse_n_s"][rows + 1])
    hit = np.zeros((len(hits), len(mass_kg)))
    for i, pair in enumerate(found.roster.pairs):
        hit[:, pair] += hits[:, i, None]
    kick = 3 * hit / mass_kg

    others = (mismatch.left_friction, mismatch.patch_friction)
    frictions = [mismatch.friction, *(f for f in others if f is not None)]
    most = (
        _AXLE * max(frictions) * G_MPS2
        + 2 * G_MPS2 * (abs(mismatch.grade_rad) + abs(mismatch.bank_rad))
        + 2 * abs(mismatch.side_wind_n) / mass_kg
        + _SPARE_MPS2
    )
    wheelbase_m = np.array([sheet.wheelbase_m for sheet in scenario.sheets or ()])
    turned = np.abs(np.angle(np.exp(1j * (heading[rows + 1] - heading[rows]))))
    spins_mps2 = wheelbase_m * (turned / h) ** 2  # of an axle around the middle of a car that spins
    _bounded(wrong, "velocity_mps", norm(change), h * (most + spins_mps2) + kick, time_s)

    # MuJoCo moves positions by the velocity at the end of each of its steps
    off = p[rows + 1] - p[rows] - h / 2 * (v[rows] + v[rows + 1]) - dt / 2 * change
    jerk = _swing(v, rows) / h
    bound = h * h * (_UNSTEADY_MPS2 + _JERK * jerk) + h * kick
    _bounded(wrong, "front_m", norm(off), bound, time_s)
    drift = norm(np.cumsum(off, axis=0))
    allowed = h * h * _DRIFT_TICKS + np.cumsum(np.where(hit > 0, h * (kick + norm(change)), 0.0), axis=0)
    _bounded(wrong, "front_m", drift, allowed, time_s)

    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    along = v[..., 0] * ahead[..., 0] + v[..., 1] * ahead[..., 1]
    across = v[..., 1] * ahead[..., 0] - v[..., 0] * ahead[..., 1]
    spare = _ALONG_MPS + 0.01 * norm(v)
    every_s = found.ticks * h
    _bounded(wrong, "speed_mps", np.abs(along - speed), spare, every_s)

    turning = h * (np.abs(across[rows]) + np.abs(across[rows + 1])) / 2 / wheelbase_m
    fast = norm(v[rows])
    loose = (norm(change) > _GRIPS * min(frictions) * G_MPS2 * h) | (hit > 0)
    slid = np.logical_or.accumulate(loose, axis=0)
    slides = h / wheelbase_m * np.where(slid, _SLIDES_MPS + fast, np.maximum(_SLIDES_MPS, _SLIDES * fast))
    _bounded(wrong, "heading_rad", turned, turning + slides + h * kick / wheelbase_m, time_s)
    _bounded(wrong, "steer_rad", *_servo(found, trace, rows), time_s)
    return checked(
        "motion", wrong, "positions, velocities, headings and steering are one motion, within the physics"
    )


def _servo(found: Recorded, trace: Trace, rows: Ticks) -> tuple[Array, Array]:
    """How far steering angles are from where their servos take them in a tick, and how far they may be."""
    h, mismatch, sheets = found.step_s, trace.scenario.mismatch, trace.scenario.sheets or ()
    told, angle = found.columns["steer_command_rad"], found.columns["steer_rad"]
    lag_s = np.array([sheet.steer_lag_s for sheet in sheets])
    rate = np.array([sheet.steer_rate_limit_radps for sheet in sheets])
    most = np.array([sheet.steer_limit_rad for sheet in sheets])
    lag_s[0] *= mismatch.steer_lag
    rate[0] *= mismatch.steer_rate_limit
    if mismatch.steer_limit_rad is not None:
        most[0] = mismatch.steer_limit_rad
    aims = np.zeros_like(told)
    aim = np.zeros(told.shape[1])
    for k in range(len(told)):
        aim = aim + np.clip(told[k] - aim, -rate * h, rate * h)
        aims[k] = aim
    late = mismatch.command_delay_s / h
    whole = int(np.floor(late + 1e-9))
    older = np.concatenate([np.zeros(whole + 1), aims[:, 0]])
    part = late - whole
    aims[:, 0] = (1 - part) * older[1 : 1 + len(aims)] + part * older[: len(aims)]
    aims = np.clip(aims, -most, most)
    aims[:, 0] += mismatch.steer_offset_rad
    pull = (1 - np.exp(-h / lag_s)) * (aims[rows] - angle[rows])
    off: Array = np.abs(angle[rows + 1] - angle[rows] - pull)
    bound: Array = _STEERS_RAD * h / 0.01 + _STEERS * np.abs(pull)
    return off, bound
