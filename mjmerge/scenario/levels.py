"""How large each mismatch is: mild, realistic and severe, for cars of 1/10 and of full size.

``docs/mismatch.md`` says where each number comes from. Mild is what a well-kept laboratory has, realistic
what a car of that size must be expected to have, severe what it has on a bad day.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

Level = Mapping[str, float | str]
"""Keys of a mismatch and their values: the axis, and what it needs to mean anything."""

NAMES = ("mild", "realistic", "severe")
"""Names of the levels."""


def _three(axis: str, *values: float | str, **also: tuple[float, float, float] | float) -> tuple[Level, ...]:
    """The three levels of an axis, with keys that go with it: one value each, or one for all."""
    return tuple(
        MappingProxyType(
            {axis: value} | {key: v[i] if isinstance(v, tuple) else v for key, v in also.items()}
        )
        for i, value in enumerate(values)
    )


_RC = (
    _three("friction", 0.8, 0.5, 0.25),
    _three("left_friction", 0.8, 0.5, 0.25),
    _three("patch_friction", 0.6, 0.3, 0.1, patch_start_m=6.0, patch_length_m=(1.0, 3.0, 6.0)),
    _three("grade_rad", 0.01, 0.03, 0.1),
    _three("bank_rad", 0.01, 0.025, 0.06),
    _three("side_wind_n", 0.1, 0.35, 1.5),
    _three("load_kg", 0.2, 0.5, 1.5, load_ahead_m=-0.1, load_above_m=0.05),
    _three("com_raised_m", 0.005, 0.01, 0.03),
    _three("yaw_inertia", 1.05, 1.15, 1.3),
    _three("wheel_radius", 0.99, 0.97, 0.92),
    _three("front_stiffness", 0.9, 0.75, 0.5),
    _three("rear_stiffness", 0.9, 0.75, 0.5),
    _three("suspension_stiffness", 0.9, 0.7, 0.5),
    _three("torque_limit", 0.9, 0.7, 0.3),
    _three("brake_limit", 0.9, 0.7, 0.3),
    _three("steer_limit_rad", 0.4, 0.3, 0.15),
    _three("steer_rate_limit", 0.9, 0.7, 0.3),
    _three("steer_lag", 2.0, 4.0, 10.0),
    _three("drive_lag_s", 0.02, 0.05, 0.15),
    _three("command_delay_s", 0.01, 0.02, 0.1),
    _three("sensing_delay_s", 0.01, 0.03, 0.1),
    _three("position_noise_m", 0.002, 0.01, 0.05),
    _three("velocity_noise_mps", 0.01, 0.05, 0.2),
    _three("heading_noise_rad", 0.002, 0.01, 0.05),
    _three("steer_noise_rad", 0.001, 0.005, 0.02),
    _three("neighbour_position_noise_m", 0.005, 0.02, 0.1),
    _three("neighbour_velocity_noise_mps", 0.02, 0.1, 0.4),
    _three("neighbour_position_bias_m", 0.01, 0.03, 0.1),
    _three("neighbour_reference_m", 0.05, 0.165, 0.455),
    _three("neighbour_dropout", 0.01, 0.05, 0.3),
    _three("neighbour_velocity_window_s", 0.05, 0.1, 0.1, neighbour_position_noise_m=(0.001, 0.005, 0.02)),
    _three("leader_acceleration", "unknown", "unknown", "unknown"),
    _three("leader_acceleration_delay_s", 0.02, 0.1, 0.3),
)

_FULL = (
    _three("friction", 0.8, 0.5, 0.25),
    _three("left_friction", 0.8, 0.5, 0.25),
    _three("patch_friction", 0.6, 0.3, 0.1, patch_start_m=60.0, patch_length_m=(10.0, 30.0, 60.0)),
    _three("grade_rad", 0.02, 0.05, 0.1),
    _three("bank_rad", 0.01, 0.025, 0.06),
    _three("side_wind_n", 150.0, 400.0, 1600.0),
    _three("load_kg", 75.0, 225.0, 450.0, load_ahead_m=-0.8, load_above_m=0.1),
    _three("com_raised_m", 0.03, 0.05, 0.2),
    _three("yaw_inertia", 1.05, 1.15, 1.3),
    _three("wheel_radius", 0.99, 0.98, 0.95),
    _three("front_stiffness", 0.9, 0.8, 0.5),
    _three("rear_stiffness", 0.9, 0.8, 0.5),
    _three("suspension_stiffness", 0.9, 0.8, 0.5),
    _three("torque_limit", 0.9, 0.7, 0.3),
    _three("brake_limit", 0.9, 0.7, 0.3),
    _three("steer_limit_rad", 0.55, 0.45, 0.1),
    _three("steer_rate_limit", 0.9, 0.7, 0.3),
    _three("steer_lag", 2.0, 3.4, 6.0),
    _three("drive_lag_s", 0.05, 0.2, 0.5),
    _three("command_delay_s", 0.05, 0.24, 0.4),
    _three("sensing_delay_s", 0.03, 0.1, 0.25),
    _three("position_noise_m", 0.01, 0.05, 0.3),
    _three("velocity_noise_mps", 0.02, 0.1, 0.5),
    _three("heading_noise_rad", 0.001, 0.005, 0.02),
    _three("steer_noise_rad", 0.001, 0.003, 0.01),
    _three("neighbour_position_noise_m", 0.05, 0.15, 0.5),
    _three("neighbour_velocity_noise_mps", 0.05, 0.15, 0.8),
    _three("neighbour_position_bias_m", 0.1, 0.3, 1.0),
    _three("neighbour_reference_m", 0.3, 1.35, 3.8),
    _three("neighbour_dropout", 0.01, 0.05, 0.3),
    _three("neighbour_velocity_window_s", 0.1, 0.2, 0.2, neighbour_position_noise_m=(0.01, 0.05, 0.2)),
    _three("leader_acceleration", "unknown", "unknown", "unknown"),
    _three("leader_acceleration_delay_s", 0.05, 0.1, 0.5),
)

LEVELS: Mapping[str, Mapping[str, tuple[Level, ...]]] = MappingProxyType(
    {
        size: MappingProxyType({next(iter(levels[0])): levels for levels in axes})
        for size, axes in (("rc", _RC), ("full", _FULL))
    }
)
"""By size of the cars and axis: its levels, in the order of :data:`NAMES`."""
