"""The paper's vehicle: second-order kinematic bicycles (eq. bicycle_model), without limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.plant.base import Fault
from mjmerge.plant.kinematic import Arrivals, mismatches, no_bodies, runaway, standing, start
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.schema import Scenario
from mjmerge.state import Array, Cars, Controls, Mask
from mjmerge.vehicle.bicycle import derivative, front_velocity

if TYPE_CHECKING:
    from mjmerge.world.model import World


class Bicycle:
    """State x_r, y_r, theta, v_r, delta per car, (N, C, 5); (a, omega) held over a step, classical RK4."""

    limited = False

    def __init__(self, state: Array, wheelbase_m: Array, arrivals: Arrivals, world: World | None) -> None:
        self._x, self._L, self._arrivals = state, wheelbase_m, arrivals
        self._world = world
        self._no_bodies = no_bodies(*state.shape[:2])

    def observe(self) -> Cars:
        """See :meth:`Plant.observe`."""
        x_r, y_r, theta, v_r, delta = (self._x[..., i].copy() for i in range(5))
        front = np.stack([x_r + self._L * np.cos(theta), y_r + self._L * np.sin(theta)], axis=-1)
        return Cars(
            front_m=front,
            velocity_mps=front_velocity(theta, v_r, delta),
            heading_rad=theta,
            speed_mps=v_r,
            steer_rad=delta,
            steer_command_rad=delta,
            clearance_m=self._no_bodies,
        )

    def step(self, controls: Controls, running: Mask) -> None:
        """See :meth:`Plant.step`."""
        for duration_s, (a, omega) in self._arriving(controls):
            h, x = duration_s[..., None], self._x
            k_1 = derivative(self._L, x, a, omega)
            k_2 = derivative(self._L, x + h / 2 * k_1, a, omega)
            k_3 = derivative(self._L, x + h / 2 * k_2, a, omega)
            k_4 = derivative(self._L, x + h * k_3, a, omega)
            moves = running[:, None, None] & (h > 0)
            self._x = np.where(moves, x + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4), x)

    def _arriving(self, controls: Controls) -> Iterator[tuple[Array, tuple[Array, Array]]]:
        """What is in force in the coming control step: for how long, s, and (a, omega), all (N, C)."""
        for duration_s, told in self._arrivals(np.stack([controls.a_mps2, controls.omega_radps], axis=-1)):
            yield duration_s, (told[..., 0], told[..., 1])

    def state(self) -> Array:
        """See :meth:`Smooth.state`."""
        return self._x

    def put(self, state: Array) -> None:
        """See :meth:`Smooth.put`."""
        self._x = state

    def rate(self, command: Array) -> Array:
        """See :meth:`Smooth.rate`; the command is (a, omega), m/s^2 and rad/s."""
        return derivative(self._L, self._x, command[..., 0], command[..., 1])

    def contacts(self) -> tuple[Array, Array]:
        """See :meth:`Plant.contacts`."""
        return self._no_bodies, self._no_bodies

    def faults(self) -> list[Fault]:
        """See :meth:`Plant.faults`."""
        return runaway(self._x)

    def qpos(self) -> Array:
        """See :meth:`Plant.qpos`."""
        return standing(self._world, self.observe())


def make(scenarios: Sequence[Scenario], world: World | None, threads: int) -> Bicycle:
    """At t = 0; see :func:`mjmerge.plant.make`."""
    del threads
    arrivals = Arrivals(mismatches(scenarios), scenarios[0].control_step_s)
    return Bicycle(*upright(scenarios), arrivals, world)


def upright(scenarios: Sequence[Scenario]) -> tuple[Array, Array]:
    """State of N simulations at t = 0, (N, C, 5), and the wheelbases, m, (C,)."""
    front_m, speed_mps = start(scenarios)
    wheelbase = np.array([sheet.wheelbase_m for sheet in car_sheets(scenarios[0])])
    state = np.zeros((*speed_mps.shape, 5))
    state[..., 0] = front_m[..., 0] - wheelbase
    state[..., 1] = front_m[..., 1]
    state[..., 3] = speed_mps
    return state, wheelbase
