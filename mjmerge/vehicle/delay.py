"""Values of a while ago: how late a command is, and what something was at any age.

**What a dead time is.** A command that is late by tau is in force from tau after it was given, and until tau
after the next one was. Before the first one has arrived there is none: no torque, wheels straight ahead.

- On plants without bodies that is exact for every tau (:class:`mjmerge.plant.kinematic.Arrivals`).
- On ``mujoco`` a command holds for whole physics steps dt. The step that begins at t uses the newest command
  that was given at t - tau or before: the one of :func:`steps_late` steps ago. So the dead time is tau, where
  tau is whole physics steps, and otherwise the next whole one: longer by less than dt. Steering, motors and
  brakes agree, step by step.

**How MuJoCo is asked for it.** It keeps the commands of an actuator with the times they were given at, finds
the newest that is no younger than ``delay``, and clamps to the oldest it has. Times are sums of many dt, so a
``delay`` of whole steps falls on a stamp, or a rounding error beside it: in about every second step of a long
run it is the command before, unless the buffer has nothing older. :func:`asked_s` asks for half a step less.
That lies between two stamps, half a step from either, whatever the buffer's length: over n <= 2 s/dt steps
the clock wanders by n ulp(t)/2 at most: in an hour, with the shortest step of 1e-5 s, a hundredth of that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjmerge.state import Array

_WHOLE = 1e-9  # of a step: what is so near to a whole number of steps is that number


def steps_late(delay_s: ArrayLike, step_s: float) -> NDArray[np.int64]:
    """The least number of steps that is no shorter than a delay, in the shape of the delays."""
    steps: NDArray[np.int64] = np.ceil(np.asarray(delay_s) / step_s - _WHOLE).astype(np.int64)
    return steps


def asked_s(steps: ArrayLike, step_s: float) -> Array:
    """What to ask of MuJoCo as ``actuator_delay``, s, for commands of that many physics steps ago."""
    late = np.asarray(steps)
    asked: Array = np.where(late > 0, (late - 0.5) * step_s, 0.0)
    return asked


@dataclass(frozen=True)
class Age:
    """How long ago, for each of N simulations, in control ticks.

    Attributes:
        whole: whole ticks, (N,).
        part: what is left of each, in [0, 1), (N,); ``None`` where none of them has any.
    """

    whole: NDArray[np.int64]
    part: Array | None

    @classmethod
    def of(cls, age_s: Array, step_s: float) -> Age:
        """Args: the ages, s, (N,); the control step, s."""
        ticks = age_s / step_s
        whole = np.floor(ticks + _WHOLE)
        part = np.where(ticks - whole > _WHOLE, ticks - whole, 0.0)
        return cls(whole.astype(np.int64), part if part.any() else None)


class Past:
    """The last values of an array, one per control tick, read back at any age.

    Before the first tick lies what was there at the first tick.
    """

    def __init__(self, first: Array, longest_s: float, step_s: float) -> None:
        """Args: what was there at first, (N, ...); the greatest age, s; the control step, s."""
        self._values = np.repeat(first[None], int(steps_late(longest_s, step_s)) + 2, axis=0)
        self._runs = np.arange(len(first))
        self._at = 0

    def push(self, now: Array) -> None:
        """The value at the next tick."""
        self._at = (self._at + 1) % len(self._values)
        self._values[self._at] = now

    def ago(self, age: Age) -> Array:
        """What it was, linearly between ticks, (N, ...); an age of whole ticks reads them exactly."""
        at = self._at - age.whole
        newer: Array = self._values[at % len(self._values), self._runs]
        if age.part is None:
            return newer
        older = self._values[(at - 1) % len(self._values), self._runs]
        part = age.part.reshape(-1, *(1,) * (newer.ndim - 1))
        return np.where(part == 0, newer, (1 - part) * newer + part * older)
