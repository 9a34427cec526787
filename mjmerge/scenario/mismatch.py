"""How the truth differs from what the law is told: every axis of mismatch, its unit, its range, its default.

The law and the actuation never see any of this. What is under "the road", "the air" and "the ego" changes the
physics (:mod:`mjmerge.plant.mujoco`), what is under "what the ego measures" changes what the law is told
(:mod:`mjmerge.simulation.sensing`). Every axis says which plants have it, and what else it needs to mean
anything; in continuous time there is no mismatch. What the ego believes of itself is ``belief`` in the
scenario, and the control rate is ``control_step_s``.

In a batch every simulation may have its own.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field

from mjmerge.config.acts import BODIES, WHEELS, Acts
from mjmerge.config.frozen import Frozen
from mjmerge.state import Array

Tyre = Literal["slip", "ideal"]
Friction = Annotated[float, Field(gt=0, le=2)]
Ratio = Annotated[float, Field(ge=0.1, le=10)]
Delay = Annotated[float, Field(ge=0, le=2)]
Noise = Annotated[float, Field(ge=0)]

_BODIES = Acts(on=BODIES)
_EVERY = Acts()
_NOISY = Acts(random=True)
_NOISY_WHEELS = Acts(on=WHEELS, random=True)


def _sides_differ(scenario: Any) -> bool:
    m = scenario.mismatch
    return bool(m.left_friction != m.friction)


def _patched(scenario: Any) -> bool:
    """There is a patch, and it is not as slippery as all around it."""
    m = scenario.mismatch
    around = {m.friction, m.friction if m.left_friction is None else m.left_friction}
    return m.patch_friction is not None and m.patch_length_m > 0 and around != {m.patch_friction}


def _loaded(scenario: Any) -> bool:
    return bool(scenario.mismatch.load_kg > 0)


def _slips(scenario: Any) -> bool:
    return bool(scenario.mismatch.tyres == "slip")


def _listens(scenario: Any) -> bool:
    """The law's variant takes the leader's acceleration for what it is told."""
    return "no_u1" not in scenario.law.variant.split("+")


def _told(scenario: Any) -> bool:
    return _listens(scenario) and scenario.mismatch.leader_acceleration == "known"


_PATCH = Acts(
    on=BODIES,
    when=_patched,
    only="with mismatch.patch_friction and mismatch.patch_length_m, where that differs from the road around",
)
_LOAD = Acts(on=BODIES, when=_loaded, only="with mismatch.load_kg")
_STIFFNESS = Acts(on=BODIES, when=_slips, only="on tyres that slip (mismatch.tyres)")


class Mismatch(Frozen):
    """How the truth differs from what the law is told; by default in nothing."""

    # the road
    friction: Annotated[Friction, _BODIES] = 1.0
    """Coulomb friction between all tyres and the road, 1. Dry asphalt 0.9, wet 0.5, snow 0.3, ice 0.1."""
    left_friction: Annotated[
        Friction | None, Acts(on=BODIES, when=_sides_differ, only="where it differs from mismatch.friction")
    ] = None
    """The same under the left wheels of all cars, 1; null: as under the right ones."""
    patch_friction: Annotated[Friction | None, _PATCH] = None
    """The same on a patch across the whole road, 1; null: there is none."""
    patch_start_m: Annotated[float, _PATCH] = 0.0
    """Where the patch begins along the road, m."""
    patch_length_m: Annotated[float, Field(ge=0), _PATCH] = 0.0
    """How long it is, m."""
    grade_rad: Annotated[float, Field(ge=-0.35, le=0.35), _BODIES] = 0.0
    """Slope of the road, rad; positive uphill."""
    bank_rad: Annotated[float, Field(ge=-0.35, le=0.35), _BODIES] = 0.0
    """Slope across the road, rad; positive where its left side is higher."""
    tyres: Annotated[Tyre, _BODIES] = "slip"
    """Tyres with the cornering stiffness of their cars, or such that do not slip below the limit."""

    # the air
    side_wind_n: Annotated[float, _BODIES] = 0.0
    """Force of the wind on the ego's body, N; positive to the left of the road."""

    # the ego
    load_kg: Annotated[float, Field(ge=0), _BODIES] = 0.0
    """Load that nobody told the ego of, kg."""
    load_ahead_m: Annotated[float, _LOAD] = 0.0
    """Where it is, ahead of the ego's centre of mass, m."""
    load_above_m: Annotated[float, _LOAD] = 0.0
    """The same above it, m."""
    com_raised_m: Annotated[float, _BODIES] = 0.0
    """How much higher the chassis's centre of mass is than the data sheet says, m."""
    yaw_inertia: Annotated[Ratio, _BODIES] = 1.0
    """Inertia of the chassis about the vertical over that of the data sheet, 1."""
    wheel_radius: Annotated[float, Field(ge=0.8, le=1.25), _BODIES] = 1.0
    """Rolling radius of all wheels over that of the data sheet, 1: pressure, wear."""
    front_stiffness: Annotated[Ratio, _STIFFNESS] = 1.0
    """Cornering stiffness of the front axle over that of the data sheet, 1."""
    rear_stiffness: Annotated[Ratio, _STIFFNESS] = 1.0
    """The same of the rear axle, 1."""
    suspension_stiffness: Annotated[Ratio, _BODIES] = 1.0
    """Spring rates over those of the model, 1; ride height and damping ratio stay."""
    torque_limit: Annotated[Ratio, _BODIES] = 1.0
    """Drive torque that the motors can give over that of the data sheet, 1."""
    brake_limit: Annotated[Ratio, _BODIES] = 1.0
    """The same of the brakes, 1."""
    steer_limit_rad: Annotated[Annotated[float, Field(gt=0, le=1.2)] | None, _BODIES] = None
    """Largest steering angle that the steering reaches, rad; null: that of the model."""
    steer_rate_limit: Annotated[Ratio, _BODIES] = 1.0
    """Fastest steering over that of the data sheet, 1."""
    steer_lag: Annotated[float, Field(ge=0.5, le=20), _BODIES] = 1.0
    """Time constant of the steering servo over that of the model, 1."""
    drive_lag_s: Annotated[Delay, _BODIES] = 0.0
    """Time constant with which torques follow their commands, s."""
    command_delay_s: Annotated[Delay, _EVERY] = 0.0
    """Dead time of the ego's steering, drive and brakes, s; see docs. Full size: 0.24 for the steering."""

    # what the ego measures
    sensing_delay_s: Annotated[Delay, _EVERY] = 0.0
    """Age of everything that the ego measures, s."""
    position_noise_m: Annotated[Noise, _NOISY] = 0.0
    """Standard deviation of its own position, each component, every control tick anew, m."""
    velocity_noise_mps: Annotated[Noise, _NOISY] = 0.0
    """The same of its velocity and speed, m/s."""
    heading_noise_rad: Annotated[Noise, _NOISY_WHEELS] = 0.0
    """The same of its heading, rad."""
    steer_noise_rad: Annotated[Noise, _NOISY_WHEELS] = 0.0
    """The same of its steering angle, rad."""
    neighbour_position_noise_m: Annotated[Noise, _NOISY] = 0.0
    """The same of the neighbours' positions, m."""
    neighbour_velocity_noise_mps: Annotated[Noise, _NOISY] = 0.0
    """The same of their velocities, m/s."""
    neighbour_position_bias_m: Annotated[float, _EVERY] = 0.0
    """How far ahead along the road the neighbours seem to be, m."""
    neighbour_reference_m: Annotated[float, _EVERY] = 0.0
    """How far behind their front axles the point lies that is measured of the neighbours, m."""
    neighbour_dropout: Annotated[float, Field(ge=0, lt=1), _NOISY] = 0.0
    """Probability that a neighbour is not seen in a control tick, 1; its last velocity carries it on."""
    neighbour_velocity_window_s: Annotated[Delay, _EVERY] = 0.0
    """Neighbours' velocities are differences of their measured positions over this long, s; 0: measured."""
    leader_acceleration: Annotated[
        Literal["known", "unknown"], Acts(when=_listens, only="under law variants without no_u1")
    ] = "known"
    """Whether Vehicle 1 tells the ego what acceleration it intends."""
    leader_acceleration_delay_s: Annotated[
        Delay,
        Acts(
            when=_told,
            only="while mismatch.leader_acceleration is known, and under law variants without no_u1",
        ),
    ] = 0.0
    """How late it does, s."""


SENSING = tuple(
    name
    for name in Mismatch.model_fields
    if name.startswith(("sensing_", "neighbour_", "leader_")) or "noise" in name
)
"""Keys that change what the ego measures; all others change what is."""


def column(mismatches: Iterable[Mismatch], name: str) -> Array:
    """One number of each simulation, (N,); NaN where it is null."""
    values = [getattr(m, name) for m in mismatches]
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def is_number(name: str) -> bool:
    """Whether an axis is a number, which can be drawn or bisected, and not a choice."""
    annotation: Any = Mismatch.model_fields[name].annotation
    return float in (annotation, *get_args(annotation))
