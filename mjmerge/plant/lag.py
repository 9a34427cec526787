"""Lag: torques that come later than they are commanded."""

from __future__ import annotations

import numpy as np

from mjmerge.state import Array


class Lag:
    """Torques that follow their commands with a time constant: T y' = u - y, exact for a held u.

    What comes out is the mean of y over the control step, so that its impulse is exact too.
    """

    def __init__(self, time_constant_s: Array, step_s: float, wheels: int) -> None:
        """At rest.

        Args:
            time_constant_s: T, s, (N,); without a lag where it is 0.
            step_s: control step, s.
            wheels: wheels of the car.
        """
        t = np.where(time_constant_s > 0, time_constant_s, 1.0)[:, None, None]
        self._lags = time_constant_s[:, None, None] > 0
        self._left = np.exp(-step_s / t)
        self._mean = t / step_s * -np.expm1(-step_s / t)
        self._y = np.zeros((len(time_constant_s), 2, wheels))

    def __call__(self, drive: Array, brake: Array) -> tuple[Array, Array]:
        """Torques of motors and brakes over the coming step from those commanded, N m, (N, 4) each."""
        u = np.stack([drive, brake], axis=1)
        behind = self._y - u
        mean = np.where(self._lags, u + self._mean * behind, u)
        self._y = u + self._left * behind
        return mean[:, 0], mean[:, 1]
