"""The paper's proof: front axles that are point masses, p'' = u (eq. double integrator)."""

from __future__ import annotations

import numpy as np

from mjmerge.plant.base import Fault
from mjmerge.plant.kinematic import no_clearance, not_finite, standing, start
from mjmerge.scenario import Scenario
from mjmerge.state import Array, Cars, Controls, Mask, norm
from mjmerge.world import World


class DoubleIntegrator:
    """Exact for a command held over the step. It has no wheels: steering angles are NaN."""

    limited = False

    def __init__(self, front_m: Array, velocity_mps: Array, step_s: float, world: World | None) -> None:
        self._p, self._v, self._h = front_m, velocity_mps, step_s
        self._nothing = np.full(front_m.shape[:2], np.nan)
        self._world = world
        self._clearance_m = no_clearance(len(front_m))

    def observe(self) -> Cars:
        """See :meth:`Plant.observe`; the heading is where the point is going."""
        return Cars(
            front_m=self._p,
            velocity_mps=self._v,
            heading_rad=np.arctan2(self._v[..., 1].copy(), self._v[..., 0].copy()),
            speed_mps=norm(self._v),
            steer_rad=self._nothing,
            steer_command_rad=self._nothing,
            clearance_m=self._clearance_m,
        )

    def step(self, controls: Controls, running: Mask) -> None:
        """See :meth:`Plant.step`."""
        h, u = self._h, np.where(running[:, None, None], controls.u_mps2, 0.0)
        self._p = self._p + h * self._v + (h * h / 2) * u
        self._v = self._v + h * u

    def faults(self) -> list[Fault]:
        """See :meth:`Plant.faults`."""
        return not_finite(self._p + self._v)

    def qpos(self) -> Array:
        """See :meth:`Plant.qpos`."""
        return standing(self._world, self.observe())


def make(scenario: Scenario, world: World | None, runs: int, threads: int) -> DoubleIntegrator:
    """At t = 0; see :func:`mjmerge.plant.make`."""
    del threads
    front_m, speed_mps = start(scenario, runs)
    velocity = np.stack([speed_mps, np.zeros_like(speed_mps)], axis=-1)
    return DoubleIntegrator(front_m, velocity, scenario.control_step_s, world)
