"""The neighbours together: who drives whom, with everything random about them drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mjmerge.drivers.base import Along, Driver
from mjmerge.drivers.lane import keep_lane
from mjmerge.drivers.outside import ask
from mjmerge.drivers.several import Together, together
from mjmerge.errors import MjmergeError
from mjmerge.state import Array, Cars, Mask
from mjmerge.vehicle.datasheet import DataSheet


def ahead(
    starts_m: Sequence[Sequence[float]], sheets: Sequence[DataSheet], two: tuple[int, int] = (0, 1)
) -> tuple[int | None, ...]:
    """Whom each neighbour follows: the nearest that starts ahead and in its way; ``None`` for nobody.

    In its way is whoever it would hit, straight on: their bodies overlap across the road. The law's follower
    has its leader ahead wherever else there is nobody: so the paper's two are one queue in two lanes, too.

    Args:
        starts_m: front axles at t = 0, x and y, m, (C-1, 2).
        sheets: data sheet of each neighbour.
        two: the law's leader and follower.
    """
    found: list[int | None] = []
    for j, (x, y) in enumerate(starts_m):
        in_way = [
            (other_x, i)
            for i, (other_x, other_y) in enumerate(starts_m)
            if other_x > x and abs(other_y - y) < (sheets[i].width_m + sheets[j].width_m) / 2
        ]
        leads = two[0] if j == two[1] and starts_m[two[0]][0] > x else None
        found.append(min(in_way)[1] if in_way else leads)
    return tuple(found)


@dataclass(frozen=True)
class Traffic:
    """The neighbours of N simulations.

    Attributes:
        drivers: of each neighbour, C-1 of them: those who are asked together, and what they drew.
        ahead: whom each follows, by its place among them; ``None`` for one that has nobody ahead.
        starts_m: where each neighbour's front axle is at t = 0, m, (N, C-1, 2): across the road, its lane.
        sheets: each neighbour's data sheet: what drivers can know of how long the cars are.
        hold_s: how long an intention is held, s: the control step; 0 in continuous time.
    """

    drivers: tuple[tuple[Together, ...], ...]
    ahead: tuple[int | None, ...]
    starts_m: Array
    sheets: tuple[DataSheet, ...]
    hold_s: float

    @classmethod
    def of(
        cls,
        drivers: Sequence[tuple[Driver, ...]],
        seeds: Sequence[int],
        duration_s: float,
        starts_m: Array,
        sheets: Sequence[DataSheet],
        hold_s: float,
        two: tuple[int, int] = (0, 1),
    ) -> Traffic:
        """Draws what is random, from one generator per seed and driver.

        Args:
            drivers: of each neighbour, in each simulation, (N, C-1).
            seeds: of each simulation.
            duration_s: how long a run is, s.
            starts_m: where the neighbours' front axles are at t = 0, m, (N, C-1, 2); who follows whom is the
                same in all.
            sheets: each neighbour's data sheet.
            hold_s: how long an intention is held, s.
            two: the law's leader and follower, see :func:`ahead`.

        Raises:
            MjmergeError: a driver follows, and has nobody to follow.
        """
        follows = ahead(starts_m[0].tolist(), sheets, two)
        asked = []
        for j, (of_one, leader) in enumerate(zip(zip(*drivers, strict=True), follows, strict=True)):
            found = together(of_one)
            for one in found:
                if leader is None and not one.driver.can_lead:
                    raise MjmergeError(
                        f"{one.driver.kind!r} follows the car ahead: it cannot drive one without any"
                    )
            rngs = np.array([np.random.default_rng([seed, j]) for seed in seeds], dtype=object)
            asked.append(
                tuple(
                    replace(one, drawn=ask(one.driver, "draw", list(rngs[one.rows]), duration_s))
                    for one in found
                )
            )
        return cls(tuple(asked), follows, starts_m, tuple(sheets), hold_s)

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Who decides after whom: each neighbour after the one it follows."""
        order: list[int] = []
        while len(order) < len(self.ahead):
            order += [j for j, a in enumerate(self.ahead) if j not in order and (a is None or a in order)]
        return tuple(order)

    def alone(self, run: int) -> Traffic:
        """The traffic of one of the simulations, all of which have the same drivers."""
        drivers = tuple(tuple(one.alone(run) for one in of_one) for of_one in self.drivers)
        return replace(self, drivers=drivers, starts_m=self.starts_m[run : run + 1])

    def intend(self, cars: Cars, time_s: float) -> Array:
        """What the neighbours intend: their drivers decide along the road, lane keeping across it.

        Returns:
            u_j, m/s^2, (N, C-1, 2), neighbour before component.
        """
        p, v = cars.front_m[:, 1:], cars.velocity_mps[:, 1:]
        u_j = np.zeros(p.shape)
        decided: dict[int, Along] = {}
        for j in self.order:
            sheet, leader = self.sheets[j], self.ahead[j]
            nose_m, tail_m = sheet.front_overhang_m, sheet.length_m - sheet.front_overhang_m
            intended = u_j[:, j, 0]  # a view: holds the acceleration once it is decided
            own = Along(p[:, j, 0], v[:, j, 0], intended, nose_m, tail_m, self.starts_m[:, j, 0])
            for one in self.drivers[j]:
                before = None if leader is None else decided[leader].of(one.rows)
                asked = time_s, own.of(one.rows), before, one.drawn, self.hold_s
                intended[one.rows] = ask(one.driver, "acceleration_mps2", *asked)
            decided[j] = own
        u_j[..., 1] = keep_lane(self.starts_m[..., 1], p[..., 1], v[..., 1])
        return u_j

    def stands(self, cars: Cars, time_s: float, u_j: Array) -> Mask:
        """Which of all cars' drivers mean to stand, (N, C), given what they intend; the ego has none."""
        p, v = cars.front_m[..., 0], cars.velocity_mps[..., 0]
        found = np.zeros(p.shape, dtype=bool)
        for j, one in self._may_stand:
            own = Along(p[:, j + 1], v[:, j + 1], u_j[:, j, 0], start_m=self.starts_m[:, j, 0]).of(one.rows)
            found[one.rows, j + 1] = ask(one.driver, "stands", time_s, own, self.hold_s)
        return found

    @cached_property
    def _may_stand(self) -> tuple[tuple[int, Together], ...]:
        """Whoever says when it means to stand, each with its neighbour's place: all others never do."""
        return tuple(
            (j, one)
            for j, of_one in enumerate(self.drivers)
            for one in of_one
            if type(one.driver).stands is not Driver.stands
        )

    def switches(self) -> Array:
        """When some intention may jump, in a single simulation, s, increasing."""
        times = [
            ask(one.driver, "switches", None if one.drawn is None else one.drawn[0])
            for of_one in self.drivers
            for one in of_one
        ]
        return np.unique(np.concatenate(times))
