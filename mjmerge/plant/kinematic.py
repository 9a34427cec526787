"""What the two ideal plants share: initial arrays, and what a fault is without bodies."""

from __future__ import annotations

import numpy as np

from mjmerge.actuation import ackermann
from mjmerge.plant.base import Fault
from mjmerge.scenario import CARS, Scenario
from mjmerge.state import PAIRS, Array, Cars, Mask
from mjmerge.world import World

_BEYOND = 1e9  # m, m/s, rad: the loop has diverged, and would overflow before it is infinite


def start(scenario: Scenario, runs: int) -> tuple[Array, Array]:
    """Front-axle centres, m, (N, C, 2), and speeds along the road, m/s, (N, C), at t = 0."""
    cars = [getattr(scenario.initial, car) for car in CARS]
    front = np.tile(np.array([c.front_m for c in cars], dtype=np.float64), (runs, 1, 1))
    speed = np.tile(np.array([c.speed_mps for c in cars], dtype=np.float64), (runs, 1))
    return front, speed


def standing(world: World | None, cars: Cars) -> Array:
    """The cars of the composed world where the plant has its points or bicycles, (N, nq), to draw them."""
    assert world is not None, "drawing takes a world"
    wheelbase, track, radius = (
        np.array([getattr(sheet, name) for sheet in world.sheets])
        for name in ("wheelbase_m", "track_m", "wheel_radius_m")
    )
    steer = np.nan_to_num(cars.steer_rad)
    return world.qpos(
        cars.front_m, cars.heading_rad, ackermann(steer, wheelbase, track), cars.front_m[..., 0] / radius
    )


def no_clearance(runs: int) -> Array:
    """Clearance of a plant without bodies: unknown, (N, P)."""
    return np.full((runs, len(PAIRS)), np.nan)


def runaway(state: Array) -> list[Fault]:
    """Faults of simulations whose state, (N, C, K), is NaN or beyond all bounds."""
    bad: Mask = ~np.all(np.abs(state) < _BEYOND, axis=2)  # true for NaN
    found = []
    for run in np.flatnonzero(np.any(bad, axis=1)):
        car = int(np.argmax(bad[run]))
        finite = np.all(np.isfinite(state[run, car]))
        found.append(Fault(int(run), car, "it ran away" if finite else "its state is not finite"))
    return found
