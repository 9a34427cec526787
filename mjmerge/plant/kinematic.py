"""What the plants without bodies share: how commands reach them, initial arrays, and what a fault is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.plant.base import Fault
from mjmerge.scenario.mismatch import Mismatch, column
from mjmerge.scenario.schema import Scenario
from mjmerge.state import Array, Cars, Mask
from mjmerge.vehicle.actuation import ackermann
from mjmerge.vehicle.delay import Age, Past

if TYPE_CHECKING:
    from mjmerge.world.model import World

_BEYOND = 1e9  # m, m/s, rad: the loop has diverged, and would overflow before it is infinite


class Arrivals:
    """The commands of N simulations as they reach the cars: the ego's late, the others' at once.

    A dead time of whole and broken control steps is kept exactly: within a step the older command is in
    force first, then the newer. Before the first one arrives the command is 0.
    """

    def __init__(self, mismatch: Sequence[Mismatch], step_s: float) -> None:
        """Args: what is different in truth in each simulation; the control step, s."""
        self.step_s = step_s
        delay_s = column(mismatch, "command_delay_s")
        self._past: Past | None = None
        self._any = bool(delay_s.any())
        if self._any:
            newer_s = np.floor(delay_s / step_s + 1e-9) * step_s
            self._ages = [Age.of(age_s, step_s) for age_s in (newer_s + step_s, newer_s)]
            self._longest_s = float(newer_s.max()) + step_s
            self._older_for_s = np.maximum(delay_s - newer_s, 0.0)

    def __call__(self, command: Array) -> list[tuple[Array, Array]]:
        """The commands of the coming control step, (N, C, K), each with how long it is in force, s, (N, C).

        Call it once per control step, with what the cars are told at its beginning.
        """
        if not self._any:
            return [(np.full((1, 1), self.step_s), command)]
        if self._past is None:
            self._past = Past(np.zeros_like(command[:, 0]), self._longest_s, self.step_s)
        self._past.push(command[:, 0])
        late = []
        for age in self._ages:
            late.append(command.copy())
            late[-1][:, 0] = self._past.ago(age)
        older_for_s = np.zeros(command.shape[:2])
        older_for_s[:, 0] = self._older_for_s
        return [(older_for_s, late[0]), (self.step_s - older_for_s, late[1])]


def start(scenarios: Sequence[Scenario]) -> tuple[Array, Array]:
    """Front-axle centres, m, (N, C, 2), and speeds along the road, m/s, (N, C), at t = 0."""
    starts = [scenario.starts for scenario in scenarios]
    front = np.array([[c.front_m for c in cars] for cars in starts], dtype=np.float64)
    speed = np.array([[c.speed_mps for c in cars] for cars in starts], dtype=np.float64)
    return front, speed


def mismatches(scenarios: Sequence[Scenario]) -> tuple[Mismatch, ...]:
    """What is different in truth in each simulation, N of them."""
    return tuple(scenario.mismatch for scenario in scenarios)


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


def no_bodies(runs: int, cars: int) -> Array:
    """What bodies would do to each other, of a plant that has none: unknown, (N, P)."""
    return np.full((runs, cars * (cars - 1) // 2), np.nan)


def runaway(state: Array) -> list[Fault]:
    """Faults of simulations whose state, (N, C, K), is NaN or beyond all bounds."""
    within: Mask = np.abs(state) <= _BEYOND  # false for NaN
    if within.all():
        return []
    bad: Mask = ~np.all(within, axis=2)
    found = []
    for run in np.flatnonzero(np.any(bad, axis=1)):
        car = int(np.argmax(bad[run]))
        finite = np.all(np.isfinite(state[run, car]))
        found.append(Fault(int(run), car, "it ran away" if finite else "its state is not finite"))
    return found
