"""The state that the ego's next command will meet, where commands and measurements are late by a known time.

What was commanded within the dead time has not shown yet in what is measured. ``predicted`` adds it:

    v^ = v + sum u_i h_i,    p^ = p + v tau + sum u_i h_i s_i,
    v_r^ = v_r + sum a_i h_i,    theta^ = theta + sum v_r^ tan(delta_i) h_i / L,    delta^ = delta_commanded

over the commands i of the last tau seconds, each in force for h_i and followed by s_i more seconds, counted
from its middle. What is measured stays: increments are added to it. Neighbours go on as they are seen to. By
the commanded steering angle alone, ``commanded``, the steering cancels and nothing must be known of the dead
time; by the measured one, ``measured``, as printed, the inverse makes a loop of its own and weaves (see
``verdict/loops.py``).
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Literal

import numpy as np

from mjmerge.state import Array, Cars, Controls

Inverse = Literal["measured", "commanded", "predicted"]


class Foresight:
    """What the law and the inverse are shown in place of what is measured; one for all N simulations."""

    def __init__(self, inverse: Inverse, dead_time_s: float, step_s: float, wheelbase_m: float) -> None:
        """Args: which inverse; its dead time, s; the control step, s; the ego's believed wheelbase, m."""
        self._inverse, self._step_s, self._wheelbase_m = inverse, step_s, wheelbase_m
        self._dead_time_s = dead_time_s if inverse == "predicted" else 0.0
        whole = int(np.ceil(self._dead_time_s / step_s - 1e-9))
        self._told: deque[Controls] = deque(maxlen=max(whole, 1))

    @property
    def looks_ahead(self) -> bool:
        """Whether it shows another time than now."""
        return self._dead_time_s > 0

    def __call__(self, cars: Cars) -> Cars:
        """The cars as the law and the inverse are to see them; the neighbours' own state as it is.

        Call it once per control step.
        """
        if self._inverse == "measured":
            return cars
        steer, command = cars.steer_rad.copy(), cars.steer_command_rad.copy()
        angle = self._told[-1].steer_rad[:, 0] if self._told else np.zeros(len(steer))
        steer[:, 0] = command[:, 0] = angle
        turned = replace(cars, steer_rad=steer, steer_command_rad=command)
        return turned if self._dead_time_s == 0 else self._ahead(turned)

    def told(self, controls: Controls) -> None:
        """Takes note of what the ego was told; call it once per control step."""
        self._told.append(controls)

    def _ahead(self, cars: Cars) -> Cars:
        tau = self._dead_time_s
        front_m = cars.front_m + tau * cars.velocity_mps
        velocity_mps, heading, speed = (
            values.copy() for values in (cars.velocity_mps, cars.heading_rad, cars.speed_mps)
        )
        if self._told:
            newest = list(reversed(self._told))
            ago_s = self._step_s * np.arange(len(newest))
            for_s = np.minimum(self._step_s, tau - ago_s)[:, None]  # of the oldest, what is left of it
            then_s = ago_s[:, None] + for_s / 2
            u = np.array([one.u_mps2[:, 0] for one in newest]) * for_s[..., None]
            gains = np.array([one.a_mps2[:, 0] for one in newest]) * for_s
            turn = np.tan(np.array([one.steer_rad[:, 0] for one in newest])) / self._wheelbase_m
            velocity_mps[:, 0] = _added(velocity_mps[:, 0], u)
            front_m[:, 0] = _added(front_m[:, 0], u * then_s[..., None])
            speed[:, 0] = _added(speed[:, 0], gains)
            heading[:, 0] = _added(heading[:, 0], speed[:, 0] * turn * for_s)
        return replace(cars, front_m=front_m, velocity_mps=velocity_mps, heading_rad=heading, speed_mps=speed)


def _added(start: Array, more: Array) -> Array:
    """One after the other, in the order given, (K, ...): the same bits for any batch size."""
    total: Array = np.add.accumulate(np.concatenate([start[None], more]))[-1]
    return total
