"""Contacts: how hard and how fast the bodies of the cars meet."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from mujoco.batch import Batch

from mjmerge.state import Array
from mjmerge.world.model import World


class Contacts:
    """Forces between the bodies of the cars, of every time step of the last control step.

    They come from MuJoCo's contact sensors, which keep a history as long as a control step.
    """

    def __init__(self, world: World, batch: Batch, substeps: int) -> None:
        """With no contact yet.

        Args:
            world: the compiled world of C cars, in P pairs.
            batch: its N simulations.
            substeps: physics steps per control step.

        Raises:
            ValueError: the world was built for control steps of another length.
        """
        model, cars = world.model, world.cars
        self._pairs = [*combinations(range(len(cars)), 2)]
        self._step_s = model.opt.timestep
        self._none = np.zeros((len(batch.state), len(self._pairs)))
        self._impulse = self._speed = self._none
        if not self._pairs:
            return
        sensors = [model.sensor(f"contact_{cars[a]}_{cars[b]}").id for a, b in self._pairs]
        kept = model.sensor_history[sensors, 0]
        if (kept != substeps).any():
            raise ValueError(f"the world was built for control steps of {kept[0]} time steps, not {substeps}")
        # a buffer is two numbers of MuJoCo's own, the times, then the samples: force and position, 6 each
        self._history = batch.bind("history")
        first = model.sensor_historyadr[sensors] + 2 + substeps
        self._at = first[:, None, None] + np.arange(6 * substeps).reshape(substeps, 6)
        self._force_at = np.ascontiguousarray(self._at[..., :3])

    def before(self, now: Mapping[str, Array], yaw_rate_radps: Array) -> None:
        """How the cars move at the beginning of a control step.

        Args:
            now: sensors by name, (N, C, size); read are front_position, m, and front_velocity, m/s.
            yaw_rate_radps: yaw rates, rad/s, (N, C).
        """
        self._front_m, self._velocity_mps = now["front_position"], now["front_velocity"]
        self._yaw_rate_radps = yaw_rate_radps

    def after(self) -> None:
        """Reads what happened in that step."""
        if not self._pairs:
            return
        force_n = self._history.take(self._force_at, axis=1)
        if not force_n.any():
            self._impulse = self._speed = self._none
            return
        hit = force_n.any(axis=-1)
        self._impulse, self._speed = np.zeros_like(self._none), np.zeros_like(self._none)
        for run, pair in np.argwhere(hit.any(axis=-1)).tolist():
            self._impulse[run, pair] = np.linalg.norm(force_n[run, pair].sum(axis=0)) * self._step_s
            self._speed[run, pair] = self._closing(run, pair, int(np.argmax(hit[run, pair])))

    def _closing(self, run: int, pair: int, sample: int) -> float:
        """How fast the two bodies move against each other where they touch, m/s."""
        at_m = self._history[run, self._at[pair, sample, 3:5]]
        moving = []
        for car in self._pairs[pair]:
            arm = at_m - self._front_m[run, car, :2]
            turning = self._yaw_rate_radps[run, car] * np.array([-arm[1], arm[0]])
            moving.append(self._velocity_mps[run, car, :2] + turning)
        return float(np.hypot(*(moving[0] - moving[1])))

    def __call__(self) -> tuple[Array, Array]:
        """Impulse, N s, and relative speed, m/s, pair by pair, (N, P) each."""
        return self._impulse, self._speed
