"""The paper's proof: front axles that are point masses, p'' = u (eq. double integrator)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.plant.base import Fault
from mjmerge.plant.kinematic import Arrivals, mismatches, no_bodies, runaway, standing, start
from mjmerge.scenario.schema import Scenario
from mjmerge.state import Array, Cars, Controls, Mask, norm

if TYPE_CHECKING:
    from mjmerge.world.model import World


class DoubleIntegrator:
    """Exact for a command held over the step. It has no wheels: steering angles are NaN."""

    limited = False

    def __init__(self, front_m: Array, velocity_mps: Array, arrivals: Arrivals, world: World | None) -> None:
        self._p, self._v, self._arrivals = front_m, velocity_mps, arrivals
        self._nothing = np.full(front_m.shape[:2], np.nan)
        self._world = world
        self._no_bodies = no_bodies(*front_m.shape[:2])

    def observe(self) -> Cars:
        """See :meth:`Plant.observe`; the heading is where the point is going."""
        return Cars(
            front_m=self._p,
            velocity_mps=self._v,
            heading_rad=np.arctan2(self._v[..., 1].copy(), self._v[..., 0].copy()),
            speed_mps=norm(self._v),
            steer_rad=self._nothing,
            steer_command_rad=self._nothing,
            clearance_m=self._no_bodies,
        )

    def step(self, controls: Controls, running: Mask) -> None:
        """See :meth:`Plant.step`."""
        for duration_s, u in self._arrivals(controls.u_mps2):
            t = duration_s[..., None]
            moves = running[:, None, None] & (t > 0)
            self._p = np.where(moves, self._p + t * self._v + (t * t / 2) * u, self._p)
            self._v = np.where(moves, self._v + t * u, self._v)

    def state(self) -> Array:
        """See :meth:`Smooth.state`: p and v."""
        return np.concatenate([self._p, self._v], axis=-1)

    def put(self, state: Array) -> None:
        """See :meth:`Smooth.put`."""
        self._p, self._v = state[..., :2], state[..., 2:]

    def rate(self, command: Array) -> Array:
        """See :meth:`Smooth.rate`; the command is u, m/s^2."""
        return np.concatenate([self._v, command], axis=-1)

    def contacts(self) -> tuple[Array, Array]:
        """See :meth:`Plant.contacts`."""
        return self._no_bodies, self._no_bodies

    def faults(self) -> list[Fault]:
        """See :meth:`Plant.faults`."""
        return runaway(self.state())

    def qpos(self) -> Array:
        """See :meth:`Plant.qpos`."""
        return standing(self._world, self.observe())


def make(scenarios: Sequence[Scenario], world: World | None, threads: int) -> DoubleIntegrator:
    """At t = 0; see :func:`mjmerge.plant.make`."""
    del threads
    front_m, speed_mps = start(scenarios)
    velocity = np.stack([speed_mps, np.zeros_like(speed_mps)], axis=-1)
    arrivals = Arrivals(mismatches(scenarios), scenarios[0].control_step_s)
    return DoubleIntegrator(front_m, velocity, arrivals, world)
