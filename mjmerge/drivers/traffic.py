"""The neighbours together: who drives whom, with everything random about them drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjmerge.drivers.base import Along, Driver
from mjmerge.drivers.lane import keep_lane
from mjmerge.drivers.outside import ask
from mjmerge.errors import MjmergeError
from mjmerge.state import Array, Cars, Mask
from mjmerge.vehicle.datasheet import DataSheet


@dataclass(frozen=True)
class Traffic:
    """The neighbours of N simulations.

    Attributes:
        drivers: Vehicle 1's and Vehicle 2's; each follows the one before it.
        drawn: what each driver's ``draw`` gave.
        lanes_m: where each neighbour's lane is across the road, m, (N, 2).
        sheets: each neighbour's data sheet: what drivers can know of how long the cars are.
        hold_s: how long an intention is held, s: the control step; 0 in continuous time.
    """

    drivers: tuple[Driver, ...]
    drawn: tuple[Array | None, ...]
    lanes_m: Array
    sheets: tuple[DataSheet, ...]
    hold_s: float

    @classmethod
    def of(
        cls,
        drivers: tuple[Driver, ...],
        seeds: Sequence[int],
        duration_s: float,
        lanes_m: Array,
        sheets: Sequence[DataSheet],
        hold_s: float,
    ) -> Traffic:
        """Draws what is random, from one generator per seed and driver.

        Raises:
            MjmergeError: the first neighbour's driver follows, and there is nobody to follow.
        """
        if not drivers[0].can_lead:
            raise MjmergeError(f"{drivers[0].kind!r} follows the car ahead: it cannot drive the first one")
        drawn = tuple(
            ask(driver, "draw", [np.random.default_rng([seed, j]) for seed in seeds], duration_s)
            for j, driver in enumerate(drivers)
        )
        return cls(drivers, drawn, lanes_m, tuple(sheets), hold_s)

    def alone(self, run: int) -> Traffic:
        """The same in one of the simulations."""
        row = slice(run, run + 1)
        drawn = tuple(None if values is None else values[row] for values in self.drawn)
        return replace(self, drawn=drawn, lanes_m=self.lanes_m[row])

    def intend(self, cars: Cars, time_s: float) -> Array:
        """What the neighbours intend: their drivers decide along the road, lane keeping across it.

        Returns:
            u_j, m/s^2, (N, 2, 2), neighbour before component.
        """
        p, v = cars.front_m[:, 1:], cars.velocity_mps[:, 1:]
        u_j = np.zeros(p.shape)
        leader = None
        for j, (driver, sheet) in enumerate(zip(self.drivers, self.sheets, strict=True)):
            nose_m, tail_m = sheet.front_overhang_m, sheet.length_m - sheet.front_overhang_m
            intended = u_j[:, j, 0]  # a view: holds the acceleration once it is decided
            own = Along(p[:, j, 0], v[:, j, 0], intended, nose_m, tail_m)
            intended[:] = ask(driver, "acceleration_mps2", time_s, own, leader, self.drawn[j], self.hold_s)
            leader = own
        u_j[..., 1] = keep_lane(self.lanes_m, p[..., 1], v[..., 1])
        return u_j

    def stands(self, cars: Cars, time_s: float, u_j: Array) -> Mask:
        """Which of all cars' drivers mean to stand, (N, C), given what they intend; the ego has none."""
        p, v = cars.front_m[..., 0], cars.velocity_mps[..., 0]
        found = np.zeros(p.shape, dtype=bool)
        for j, driver in enumerate(self.drivers):
            own = Along(p[:, j + 1], v[:, j + 1], u_j[:, j, 0])
            found[:, j + 1] = ask(driver, "stands", time_s, own, self.hold_s)
        return found

    def switches(self) -> Array:
        """When some intention may jump, in a single simulation, s, increasing."""
        times = [
            ask(driver, "switches", None if drawn is None else drawn[0])
            for driver, drawn in zip(self.drivers, self.drawn, strict=True)
        ]
        return np.unique(np.concatenate(times))
