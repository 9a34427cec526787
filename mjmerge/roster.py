"""Who is there: the cars of every scenario, what moves them, and the axes of arrays about them."""

from __future__ import annotations

CARS = ("ego", "vehicle_1", "vehicle_2")
"""The cars of every scenario, in the order of every array's car axis."""
PAINT = {"ego": (0.16, 0.62, 0.33), "vehicle_1": (0.17, 0.38, 0.75), "vehicle_2": (0.85, 0.45, 0.13)}
"""Colour of each car, red, green and blue, 0 to 1; the paper draws the ego green and its neighbours blue."""
PLANTS = {
    "double_integrator": "front axles are point masses: the paper's proof",
    "bicycle": "kinematic bicycles without limits: the paper's vehicle model",
    "bicycle_limited": "kinematic bicycles with the mass and the limits of their cars",
    "mujoco": "physical cars with mass, tyres, suspension, servos and limits",
}
"""What moves the cars, by the name of its module, from the proof to physics: each has more of a car."""
NEIGHBOURS = CARS[1:]
"""All but the ego, in the order of every array's axis of neighbours."""
PAIRS = ((0, 1), (0, 2), (1, 2))
"""Who stands to whom, by index, in the order of every array's axis of pairs."""
PAIR_NAMES = ("ego_vehicle_1", "ego_vehicle_2", "vehicle_1_vehicle_2")
"""The same by name."""
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
"""The wheels of a car, in the order of every array's axis of wheels."""
XY = ("x", "y")
"""The components of a vector in the road frame."""
