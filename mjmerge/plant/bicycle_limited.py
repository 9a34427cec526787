"""Kinematic bicycles that are moved as cars are: by wheel torques and steering angles, within limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.plant.bicycle import Bicycle, upright
from mjmerge.plant.kinematic import Arrivals, mismatches
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.mismatch import column
from mjmerge.scenario.schema import Scenario
from mjmerge.state import Array, Cars, Controls
from mjmerge.vehicle.actuation import CRAWL_MPS, UNMOVED_MPS2, BelievedCars, resistance_n

if TYPE_CHECKING:
    from mjmerge.world.model import World


class LimitedBicycle(Bicycle):
    """A bicycle whose acceleration is (sum tau / r_w - resistance) / m_eff, by its car's data sheet.

    The steering reaches the commanded angle at the end of the control step, at a steady rate; what it is
    askew by, in the first.
    """

    limited = True

    def __init__(
        self,
        state: Array,
        wheelbase_m: Array,
        arrivals: Arrivals,
        world: World | None,
        cars: BelievedCars,
        steer_offset_rad: Array,
    ) -> None:
        """Args as of :class:`Bicycle`; what the cars are in truth; where the ego's steering goes, (N,)."""
        super().__init__(state, wheelbase_m, arrivals, world)
        self._cars = cars
        self._steer_command = np.zeros(state.shape[:2])
        self._askew = np.zeros(state.shape[:2])
        self._askew[:, 0] = steer_offset_rad

    def observe(self) -> Cars:
        """See :meth:`Plant.observe`."""
        return replace(super().observe(), steer_command_rad=self._steer_command)

    def _arriving(self, controls: Controls) -> Iterator[tuple[Array, tuple[Array, Array]]]:
        turned, self._steer_command = controls.steer_rad - self._steer_command, controls.steer_rad
        askew, self._askew = self._askew, np.zeros_like(self._askew)
        for duration_s, told in self._arrivals(np.stack([controls.torque_n_m.sum(axis=-1), turned], axis=-1)):
            cars, v = self._cars, self._x[..., 3]
            torque = told[..., 0]
            a = (torque / cars.wheel_radius_m - resistance_n(v, cars)) / cars.effective_mass_kg
            stops = (torque * v < 0) & ((v + a * duration_s) * v < 0)  # brakes do not start it backwards
            unmoved = UNMOVED_MPS2 * cars.effective_mass_kg * cars.wheel_radius_m
            stops |= (np.abs(v) <= CRAWL_MPS) & (np.abs(torque) < unmoved)
            a = np.where(stops, -v / np.where(duration_s > 0, duration_s, np.inf), a)
            yield duration_s, (a, (told[..., 1] + askew) / self._arrivals.step_s)


def make(scenarios: Sequence[Scenario], world: World | None, threads: int) -> LimitedBicycle:
    """At t = 0; see :func:`mjmerge.plant.make`."""
    del threads
    (state, wheelbase), mismatch = upright(scenarios), mismatches(scenarios)
    cars = BelievedCars.of(car_sheets(scenarios[0]), limited=True)
    arrivals, askew = Arrivals(mismatch, scenarios[0].control_step_s), column(mismatch, "steer_offset_rad")
    return LimitedBicycle(state, wheelbase, arrivals, world, cars, askew)
