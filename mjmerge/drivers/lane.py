"""Lane keeping, the same for every driver."""

from __future__ import annotations

from mjmerge.state import Array

_K_Y, _K_VY = 4.0, 4.0  # 1/s^2 and 1/s: critically damped, 0.5 s


def keep_lane(lane_m: Array, y_m: Array, v_y_mps: Array) -> Array:
    """Acceleration across the road that brings a car back to its lane, m/s^2, in the shape of its inputs."""
    return -_K_Y * (y_m - lane_m) - _K_VY * v_y_mps
