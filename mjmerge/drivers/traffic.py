"""The neighbours together: who drives whom, with everything random about them drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjmerge.drivers.base import Along, Array, Driver
from mjmerge.drivers.lane import keep_lane
from mjmerge.state import Cars


@dataclass(frozen=True)
class Traffic:
    """The neighbours of N simulations.

    Attributes:
        drivers: Vehicle 1's and Vehicle 2's; each follows the one before it.
        drawn: what each driver's ``draw`` gave.
        lanes_m: where each neighbour's lane is across the road, m, (N, 2).
    """

    drivers: tuple[Driver, ...]
    drawn: tuple[Array | None, ...]
    lanes_m: Array

    @classmethod
    def of(
        cls, drivers: tuple[Driver, ...], seeds: Sequence[int], duration_s: float, lanes_m: Array
    ) -> Traffic:
        """Draws what is random, from one generator per seed and driver."""
        drawn = tuple(
            driver.draw([np.random.default_rng([seed, j]) for seed in seeds], duration_s)
            for j, driver in enumerate(drivers)
        )
        return cls(drivers, drawn, lanes_m)

    def alone(self, run: int) -> Traffic:
        """The same in one of the simulations."""
        row = slice(run, run + 1)
        drawn = tuple(None if values is None else values[row] for values in self.drawn)
        return Traffic(self.drivers, drawn, self.lanes_m[row])

    def intend(self, cars: Cars, time_s: float) -> Array:
        """What the neighbours intend: their drivers decide along the road, lane keeping across it.

        Returns:
            u_j, m/s^2, (N, 2, 2), neighbour before component.
        """
        p, v = cars.front_m[:, 1:], cars.velocity_mps[:, 1:]
        u_j = np.zeros(p.shape)
        leader = None
        for j, driver in enumerate(self.drivers):
            own = Along(p[:, j, 0], v[:, j, 0], u_j[:, j, 0])  # a view: holds the acceleration once decided
            u_j[:, j, 0] = driver.acceleration_mps2(time_s, own, leader or own, self.drawn[j])
            leader = own
        u_j[..., 1] = keep_lane(self.lanes_m, p[..., 1], v[..., 1])
        return u_j

    def switches(self) -> Array:
        """When some intention may jump, in a single simulation, s, increasing."""
        times = [
            driver.switches(None if drawn is None else drawn[0])
            for driver, drawn in zip(self.drivers, self.drawn, strict=True)
        ]
        return np.unique(np.concatenate(times))
