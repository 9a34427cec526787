"""Who is there: the cars of every scenario, and the axes of arrays about them."""

from __future__ import annotations

CARS = ("ego", "vehicle_1", "vehicle_2")
"""The cars of every scenario, in the order of every array's car axis."""
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
