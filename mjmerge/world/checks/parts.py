"""What every car's MJCF holds by name: the contract between a car's file, the world and the plant."""

from __future__ import annotations

from mjmerge.roster import WHEELS

STEERED = WHEELS[:2]
DRIVEN = {"all": (0, 1, 2, 3), "front": (0, 1), "rear": (2, 3)}
"""Driven wheels by what a data sheet calls them."""
DRIVE = tuple(f"drive_{w}" for w in WHEELS)
BRAKE = tuple(f"brake_{w}" for w in WHEELS)
STEER = tuple(f"steer_{w}" for w in STEERED)
NUMBERS = {
    "spin_limit_radps": 1,  # the wheel speed beyond which the motors give no torque
    "power_limit_w": 1,  # what all motors together can give
    "steer_rate_limit_radps": 1,  # fastest change of the angle that the steering servos are told
    "drag_area_m2": 1,  # drag coefficient times frontal area
    "rolling_resistance": 1,  # over weight
    "cornering_stiffness_n_per_rad": 2,  # of the front and the rear axle, both tyres
}
"""Custom numbers of every car, with how many each has: its truth where MJCF has no place for it."""
RESISTANCE = "resistance"
"""Actuator that pushes a car back with the force of air and rolling resistance."""
SENSORS = {
    "front_position": 3,
    "front_velocity": 3,
    "forward_axis": 3,
    "up_axis": 3,
    "rear_velocity": 3,
    "steer_left": 1,
    "steer_right": 1,
}
"""Sensors every car has, with their sizes."""
SITES = ("front_axle", "rear_axle", "centre")
"""Sites on the chassis of every car."""


def names(drive: str) -> list[tuple[str, str]]:
    """Kind and name of everything that a car must have, for what its data sheet says is driven."""
    motors = [DRIVE[i] for i in DRIVEN[drive]]
    return (
        [("body", "chassis"), ("geom", "hull"), ("material", "paint")]
        + [("numeric", name) for name in NUMBERS]
        + [("site", name) for name in SITES]
        + [("body", f"wheel_{w}") for w in WHEELS]
        + [("geom", f"tyre_{w}") for w in WHEELS]
        + [("joint", f"spin_{w}") for w in WHEELS]
        + [("joint", f"steer_{w}") for w in STEERED]
        + [("actuator", name) for name in (*STEER, *motors, *BRAKE, RESISTANCE)]
        + [("sensor", name) for name in SENSORS]
    )
