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
from functools import partial
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field

from mjmerge.config.acts import BODIES, EVERY, LIMITS, WHEELS
from mjmerge.config.frozen import Frozen
from mjmerge.scenario.axis import Axis, axes, three
from mjmerge.state import Array

Tyre = Literal["slip", "ideal"]
Friction = Annotated[float, Field(gt=0, le=2)]
Ratio = Annotated[float, Field(ge=0.1, le=10)]
Delay = Annotated[float, Field(ge=0, le=2)]
Noise = Annotated[float, Field(ge=0)]


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
    return "no_u1" not in getattr(scenario.law, "variant", "").split("+")


def _told(scenario: Any) -> bool:
    return _listens(scenario) and scenario.mismatch.leader_acceleration == "known"


_road = partial(Axis, part="the road", on=BODIES)
_air = partial(Axis, part="the air", on=BODIES)
_ego = partial(Axis, part="the ego", on=BODIES)
_measured = partial(Axis, part="what the ego measures", on=EVERY)
_patch = partial(
    _road,
    when=_patched,
    only="with mismatch.patch_friction and mismatch.patch_length_m, where that differs from the road around",
)
_load = partial(_ego, when=_loaded, only="with mismatch.load_kg")
_slipping = partial(_ego, when=_slips, only="on tyres that slip (mismatch.tyres)")


class Mismatch(Frozen):
    """How the truth differs from what the law is told; by default in nothing."""

    # the road
    friction: Annotated[
        Friction,
        _road(
            changes="friction of all twelve wheel-road contacts",
            rc=three(0.8, 0.5, 0.25),
            full=three(0.8, 0.5, 0.25),
            source=(
                "dry asphalt 0.8-1.0, wet 0.5-0.7, snow 0.2-0.35, ice 0.05-0.15 (textbook tables); rubber "
                "on dusty tiles 0.4-0.6"
            ),
        ),
    ] = 1.0
    """Coulomb friction between all tyres and the road, 1. Dry asphalt 0.9, wet 0.5, snow 0.3, ice 0.1."""
    left_friction: Annotated[
        Friction | None,
        _road(
            when=_sides_differ,
            only="where it differs from mismatch.friction",
            changes="the same under the left wheels: braking yaws the car",
            rc=three(0.8, 0.5, 0.25),
            full=three(0.8, 0.5, 0.25),
            source="mu-split tests put one side on wet basalt or ice; same tables",
        ),
    ] = None
    """The same under the left wheels of all cars, 1; null: as under the right ones."""
    patch_friction: Annotated[
        Friction | None,
        _patch(
            changes="friction of a wheel while it is on the patch, set every control tick",
            rc=three(0.6, 0.3, 0.1, patch_start_m=6.0, patch_length_m=(1.0, 3.0, 6.0)),
            full=three(0.6, 0.3, 0.1, patch_start_m=60.0, patch_length_m=(10.0, 30.0, 60.0)),
            source="same tables; estimate for how long patches are",
        ),
    ] = None
    """The same on a patch across the whole road, 1; null: there is none."""
    patch_start_m: Annotated[
        float,
        _patch(
            changes="where the patch begins along the road",
            source="goes with `patch_friction`; no level of its own",
        ),
    ] = 0.0
    """Where the patch begins along the road, m."""
    patch_length_m: Annotated[
        float,
        Field(ge=0),
        _patch(
            changes="how long it is",
            source="goes with `patch_friction`",
        ),
    ] = 0.0
    """How long it is, m."""
    grade_rad: Annotated[
        float,
        Field(ge=-0.35, le=0.35),
        _road(
            changes="gravity along the road",
            rc=three(0.01, 0.03, 0.1),
            full=three(0.02, 0.05, 0.1),
            source=(
                "motorways up to 0.04-0.06, mountain roads 0.10-0.12 (road design codes); a floor that is "
                "not level 0.01"
            ),
        ),
    ] = 0.0
    """Slope of the road, rad; positive uphill."""
    bank_rad: Annotated[
        float,
        Field(ge=-0.35, le=0.35),
        _road(
            changes="gravity across the road",
            rc=three(0.01, 0.025, 0.06),
            full=three(0.01, 0.025, 0.06),
            source="crossfall for drainage 0.025, superelevation up to 0.06-0.08 (road design codes)",
        ),
    ] = 0.0
    """Slope across the road, rad; positive where its left side is higher."""
    tyres: Annotated[
        Tyre,
        _road(
            changes="`slip`: cornering stiffness of the car; `ideal`: no slip below the limit",
            source="a choice, for the ladder; no level",
        ),
    ] = "slip"
    """Tyres with the cornering stiffness of their cars, or such that do not slip below the limit."""

    # the air
    side_wind_n: Annotated[
        float,
        _air(
            changes="force at the centre of mass of the chassis, from the right",
            rc=three(0.1, 0.35, 1.5),
            full=three(150.0, 400.0, 1600.0),
            source=(
                "1/2 rho A v^2 with a side force coefficient of 1: 6.6 m^2 at 5, 10 and 20 m/s; 0.06 m^2 "
                "at 1.6, 3 and 6 m/s"
            ),
        ),
    ] = 0.0
    """Force of the wind on the ego's body, N; positive to the left of the road."""

    # the ego
    load_kg: Annotated[
        float,
        Field(ge=0),
        _ego(
            changes="a point mass on the chassis: mass, centre of mass, inertia, sag",
            rc=three(0.2, 0.5, 1.5, load_ahead_m=-0.1, load_above_m=0.05),
            full=three(75.0, 225.0, 450.0, load_ahead_m=-0.8, load_above_m=0.1),
            source=(
                "one, three and five people with luggage; a battery, a computer, all of that and a lidar"
            ),
        ),
    ] = 0.0
    """Load that nobody told the ego of, kg."""
    load_ahead_m: Annotated[
        float,
        _load(
            changes="where it is, ahead of the centre of mass",
            source="goes with `load_kg`: rear seats and boot",
        ),
    ] = 0.0
    """Where it is, ahead of the ego's centre of mass, m."""
    load_above_m: Annotated[
        float,
        _load(
            changes="the same above it",
            source="goes with `load_kg`",
        ),
    ] = 0.0
    """Where the load is, above the ego's centre of mass, m."""
    com_raised_m: Annotated[
        float,
        _ego(
            changes="height of the chassis's centre of mass: pitch, roll, load transfer",
            rc=three(0.005, 0.01, 0.03),
            full=three(0.03, 0.05, 0.2),
            source="estimate: spread of published heights 0.03-0.05 m; a roof load 0.2 m",
        ),
    ] = 0.0
    """How much higher the chassis's centre of mass is than the data sheet says, m."""
    yaw_inertia: Annotated[
        Ratio,
        _ego(
            changes="inertia of the chassis about the vertical",
            rc=three(1.05, 1.15, 1.3),
            full=three(1.05, 1.15, 1.3),
            source=(
                "estimate: formulas for yaw inertia are off by 5-15 %; beyond 1.3 no real body has the "
                "1/10 car's other two"
            ),
        ),
    ] = 1.0
    """Inertia of the chassis about the vertical over that of the data sheet, 1."""
    wheel_radius: Annotated[
        float,
        Field(ge=0.8, le=1.25),
        _ego(
            changes="radius of the wheels: force per torque, speed per wheel speed",
            rc=three(0.99, 0.97, 0.92),
            full=three(0.99, 0.98, 0.95),
            source=(
                "8 mm of tread in 320 mm 0.975; low pressure 0.98-0.99 and worn foam tyres 0.9-0.95 are "
                "estimates"
            ),
        ),
    ] = 1.0
    """Rolling radius of all wheels over that of the data sheet, 1: pressure, wear."""
    front_stiffness: Annotated[
        Ratio,
        _slipping(
            changes="cornering stiffness of the front axle",
            rc=three(0.9, 0.75, 0.5),
            full=three(0.9, 0.8, 0.5),
            source="estimate: pressure, temperature, wear and load move it by 10-25 %, snow halves it",
        ),
    ] = 1.0
    """Cornering stiffness of the front axle over that of the data sheet, 1."""
    rear_stiffness: Annotated[
        Ratio,
        _slipping(
            changes="the same of the rear axle; less of it oversteers",
            rc=three(0.9, 0.75, 0.5),
            full=three(0.9, 0.8, 0.5),
            source="as the front",
        ),
    ] = 1.0
    """Cornering stiffness of the rear axle over that of the data sheet, 1."""
    suspension_stiffness: Annotated[
        Ratio,
        _ego(
            changes=(
                "spring rates; dampers with their root, so that the damping ratio stays; ride height stays"
            ),
            rc=three(0.9, 0.7, 0.5),
            full=three(0.9, 0.8, 0.5),
            source="estimate: production tolerance 5-10 %, aged dampers and springs beyond",
        ),
    ] = 1.0
    """Spring rates over those of the model, 1; ride height and damping ratio stay."""
    torque_limit: Annotated[
        Ratio,
        _ego(
            changes="what the motors clip at",
            rc=three(0.9, 0.7, 0.3),
            full=three(0.9, 0.7, 0.3),
            source="estimate: battery sag and heat 70 %, limp mode 30 %",
        ),
    ] = 1.0
    """Drive torque that the motors can give over that of the data sheet, 1."""
    brake_limit: Annotated[
        Ratio,
        _ego(
            changes="what the brakes clip at",
            rc=three(0.9, 0.7, 0.3),
            full=three(0.9, 0.7, 0.3),
            source="estimate: hot brakes 70-80 %, fade or a lost circuit 30-50 %",
        ),
    ] = 1.0
    """Torque that the brakes can give over that of the data sheet, 1."""
    steer_limit_rad: Annotated[
        Annotated[float, Field(gt=0, le=1.2)] | None,
        _ego(
            changes="where the steering stops",
            rc=three(0.4, 0.3, 0.15),
            full=three(0.55, 0.45, 0.1),
            source="estimate: lock off by 10-25 %; lane keeping that may turn no further than 0.1",
        ),
    ] = None
    """Largest steering angle that the steering reaches, rad; null: that of the model."""
    steer_rate_limit: Annotated[
        Ratio,
        _ego(
            changes="fastest steering of the servo",
            rc=three(0.9, 0.7, 0.3),
            full=three(0.9, 0.7, 0.3),
            source="estimate: low battery 70 %, assistance failed 30 %",
        ),
    ] = 1.0
    """Fastest steering over that of the data sheet, 1."""
    steer_lag: Annotated[
        float,
        Field(ge=0.5, le=20),
        _ego(
            changes="time constant of the steering servo, over that of the model (16 ms, 80 ms)",
            rc=three(2.0, 4.0, 10.0),
            full=three(2.0, 3.4, 6.0),
            source=(
                "estimate: hobby servos 30-160 ms; published lag of a full-size car 0.27 s = 3.4 times "
                "the sedan's"
            ),
        ),
    ] = 1.0
    """Time constant of the steering servo over that of the model, 1."""
    steer_offset_rad: Annotated[
        float,
        Field(ge=-0.2, le=0.2),
        _ego(
            on=LIMITS,
            changes="front wheels stand to the left of where they are told; their angle is measured as it is",
            rc=three(0.01, 0.03, 0.1),
            full=three(0.002, 0.005, 0.02),
            source=(
                "estimate: a trimmed hobby servo is off by 0.5-2 deg, a knocked one by 6; a steering wheel "
                "that stands 2-5 deg askew at a ratio of 16, a bent tie rod 1 deg"
            ),
        ),
    ] = 0.0
    """How far to the left of where they are told the ego's front wheels stand, rad; measured as they are."""
    drive_lag_s: Annotated[
        Delay,
        _ego(
            changes="first-order lag of drive and brake torque, exact over a tick",
            rc=three(0.02, 0.05, 0.15),
            full=three(0.05, 0.2, 0.5),
            source="estimate: electric 0.02-0.05 s, engines and hydraulic brakes 0.1-0.5 s",
        ),
    ] = 0.0
    """Time constant with which torques follow their commands, s."""
    command_delay_s: Annotated[
        Delay,
        _ego(
            on=EVERY,
            changes=(
                "dead time of steering, drive and brakes; on every plant, on `mujoco` in whole physics steps"
            ),
            rc=three(0.01, 0.02, 0.1),
            full=three(0.05, 0.24, 0.4),
            source=(
                "published dead time of a full-size car's steering 0.24 s, and two control steps at 1/10 "
                "scale; the rest estimates"
            ),
        ),
    ] = 0.0
    """Dead time of the ego's steering, drive and brakes, s; see docs. Full size: 0.24 for the steering."""

    # what the ego measures
    sensing_delay_s: Annotated[
        Delay,
        _measured(
            changes="age of everything the ego measures",
            rc=three(0.01, 0.03, 0.1),
            full=three(0.03, 0.1, 0.25),
            source="estimate: one to three frames of a camera or lidar at 10-30 Hz",
        ),
    ] = 0.0
    """Age of everything that the ego measures, s."""
    position_noise_m: Annotated[
        Noise,
        _measured(
            random=True,
            changes="noise of the ego's own position",
            rc=three(0.002, 0.01, 0.05),
            full=three(0.01, 0.05, 0.3),
            source="motion capture 1-2 mm, particle filter 1-5 cm; RTK 1-2 cm, GNSS with inertial 5-30 cm",
        ),
    ] = 0.0
    """Standard deviation of its own position, each component, every control tick anew, m."""
    velocity_noise_mps: Annotated[
        Noise,
        _measured(
            random=True,
            changes="noise of its own velocity and speed",
            rc=three(0.01, 0.05, 0.2),
            full=three(0.02, 0.1, 0.5),
            source="GNSS Doppler 0.02-0.1; the rest estimates",
        ),
    ] = 0.0
    """Standard deviation of its own velocity and speed, every control tick anew, m/s."""
    heading_noise_rad: Annotated[
        Noise,
        _measured(
            on=WHEELS,
            random=True,
            changes="noise of its own heading",
            rc=three(0.002, 0.01, 0.05),
            full=three(0.001, 0.005, 0.02),
            source="dual-antenna GNSS 0.1-0.3 deg; magnetometer or scan matching 0.5-3 deg",
        ),
    ] = 0.0
    """Standard deviation of its own heading, every control tick anew, rad."""
    steer_noise_rad: Annotated[
        Noise,
        _measured(
            on=WHEELS,
            random=True,
            changes="noise of its own steering angle",
            rc=three(0.001, 0.005, 0.02),
            full=three(0.001, 0.003, 0.01),
            source="angle sensors 0.05-0.5 deg at the wheel; estimate",
        ),
    ] = 0.0
    """Standard deviation of its own steering angle, every control tick anew, rad."""
    neighbour_position_noise_m: Annotated[
        Noise,
        _measured(
            random=True,
            changes="noise of the neighbours' positions",
            rc=three(0.005, 0.02, 0.1),
            full=three(0.05, 0.15, 0.5),
            source="lidar clusters 5-20 cm, camera 0.5 m; at 1/10 an estimate between a tenth and a fifth",
        ),
    ] = 0.0
    """Standard deviation of the neighbours' positions, each component, every control tick anew, m."""
    neighbour_velocity_noise_mps: Annotated[
        Noise,
        _measured(
            random=True,
            changes="noise of the neighbours' velocities",
            rc=three(0.02, 0.1, 0.4),
            full=three(0.05, 0.15, 0.8),
            source="automotive radar 0.05-0.15; tracked camera 0.5-1",
        ),
    ] = 0.0
    """Standard deviation of the neighbours' velocities, each component, every control tick anew, m/s."""
    neighbour_position_bias_m: Annotated[
        float,
        _measured(
            changes="neighbours seem further along the road",
            rc=three(0.01, 0.03, 0.1),
            full=three(0.1, 0.3, 1.0),
            source="bounding boxes of half-seen cars; estimate",
        ),
    ] = 0.0
    """How far ahead along the road the neighbours seem to be, m."""
    neighbour_reference_m: Annotated[
        float,
        _measured(
            changes="the point measured of the neighbours lies behind their front axle",
            rc=three(0.05, 0.165, 0.455),
            full=three(0.3, 1.35, 3.8),
            source=(
                "middle of the wheelbase; rear bumper 0.455 and 3.8 m behind the front axle (data sheets)"
            ),
        ),
    ] = 0.0
    """How far behind their front axles the point lies that is measured of the neighbours, m."""
    neighbour_dropout: Annotated[
        float,
        Field(ge=0, lt=1),
        _measured(
            random=True,
            changes="probability per tick that a neighbour is not seen",
            rc=three(0.01, 0.05, 0.3),
            full=three(0.01, 0.05, 0.3),
            source="estimate: detection rates of 95-99 %, and occlusion",
        ),
    ] = 0.0
    """Probability that a neighbour is not seen in a control tick, 1; its last velocity carries it on."""
    neighbour_velocity_window_s: Annotated[
        Delay,
        _measured(
            changes="neighbours' velocities are differences of noisy positions",
            rc=three(0.05, 0.1, 0.1, neighbour_position_noise_m=(0.001, 0.005, 0.02)),
            full=three(0.1, 0.2, 0.2, neighbour_position_noise_m=(0.01, 0.05, 0.2)),
            source="estimate; noise of the velocity is sqrt(2) sigma over the window",
        ),
    ] = 0.0
    """Neighbours' velocities are differences of their measured positions over this long, s; 0: measured."""
    leader_acceleration: Annotated[
        Literal["known", "unknown"],
        _measured(
            when=_listens,
            only="under law variants without no_u1",
            changes="`unknown`: the ego is told that the leader does not accelerate",
            rc=three("unknown", "unknown", "unknown"),
            full=three("unknown", "unknown", "unknown"),
            source="without communication; `known` is the paper's assumption",
        ),
    ] = "known"
    """Whether Vehicle 1 tells the ego what acceleration it intends."""
    leader_acceleration_delay_s: Annotated[
        Delay,
        _measured(
            when=_told,
            only="while mismatch.leader_acceleration is known, and under law variants without no_u1",
            changes="how late the ego is told",
            rc=three(0.02, 0.1, 0.3),
            full=three(0.05, 0.1, 0.5),
            source="V2V messages 0.1 s; the rest estimates",
        ),
    ] = 0.0
    """How late it does, s."""


SENSING = tuple(name for name, axis in axes(Mismatch).items() if axis.part == "what the ego measures")
"""Keys that change what the ego measures; all others change what is."""


def column(mismatches: Iterable[Mismatch], name: str) -> Array:
    """One number of each simulation, (N,); NaN where it is null."""
    values = [getattr(m, name) for m in mismatches]
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def is_number(name: str) -> bool:
    """Whether an axis is a number, which can be drawn or bisected, and not a choice."""
    annotation: Any = Mismatch.model_fields[name].annotation
    return float in (annotation, *get_args(annotation))
