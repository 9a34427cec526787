"""The mirror image: an agent drives a neighbour, within Assumption 1, against the ego's law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mjmerge.envs.parts import FAR_M, FAST_MPS, Part
from mjmerge.envs.stepper import Stepper
from mjmerge.envs.task import Score, State, Task
from mjmerge.errors import UnknownNameError
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import Turn
from mjmerge.simulation.trace import COLUMNS, Trace
from mjmerge.state import Array, Mask
from mjmerge.verdict.hypotheses import OBEYS_WINDOW_S, broken
from mjmerge.verdict.judge import COMFORTABLE

BRAKES_MPS2 = 4.0
"""How hard a neighbour accelerates and brakes where the scenario says nothing: hard, and people do."""


class Adversary(Task):
    """Drives a neighbour along its lane, so that the ego comes too close to somebody; the law drives the ego.

    It accelerates and brakes no harder than the scenario's section ``search`` lets that neighbour
    (``acceleration_mps2``; :data:`BRAKES_MPS2` where it says nothing), never reverses, and stays in its lane.

    The reward of a tick is by how much the least d_j so far becomes less, over r. It counts only where the
    run would not be excused: where no hypothesis is broken, and none has been since every neighbour was at
    r/2 or further: that is how runs are judged. So an episode has (d_j(0) - least d_j)/r in all, and the
    theorem says that it never comes to d_j <= 0, where the episode ends.
    """

    def __init__(self, scenario: Scenario, plant: str, car: str | None = None) -> None:
        """Args: what to run; what moves the cars; the neighbour, the law's follower if none is named.

        Raises:
            UnknownNameError: there is no such neighbour.
        """
        super().__init__(scenario, plant)
        self.drives = scenario.law.follower if car is None else car
        if self.drives not in scenario.roster.neighbours:
            raise UnknownNameError("neighbour", self.drives, scenario.roster.neighbours)
        self._car = scenario.roster.cars.index(self.drives)
        may = None if scenario.search is None else scenario.search.neighbours.of(self.drives)
        most = BRAKES_MPS2 if may is None else may.acceleration_mps2
        self.acts = (Part("a_mps2", "m/s^2", f"acceleration of {self.drives} along its lane", (1,), most),)
        others = len(scenario.roster.cars) - 1
        self.sees = (
            Part(
                "offset_m", "m", "front axle of each other car, the ego's first, from its own", (others, 2),
                FAR_M, self._from("front_m"),
            ),
            Part(
                "relative_velocity_mps", "m/s", "its velocity less its own", (others, 2), FAST_MPS,
                self._from("velocity_mps"),
            ),
            Part(
                "speed_mps", "m/s", "its own, along the road", (1,), FAST_MPS,
                lambda turn: turn.cars.velocity_mps[:, self._car, 0],
            ),
        )  # fmt: skip

    def _from(self, name: str) -> Callable[[Turn], Array]:
        """What the others have more of than it has."""
        at, others = self._car, [c for c in range(len(self.scenario.roster.cars)) if c != self._car]

        def read(turn: Turn) -> Array:
            values: Array = getattr(turn.cars, name)
            more: Array = values[:, others] - values[:, at : at + 1]
            return more

        return read

    def command(self, turn: Turn, given: Array) -> Array:
        """See :meth:`Task.command`."""
        speed_mps = turn.cars.velocity_mps[:, self._car, 0]
        least: Array = -np.maximum(speed_mps, 0.0) / self.scenario.control_step_s
        return np.maximum(given[:, 0], least)

    def begin(self, state: State) -> Score:
        """See :meth:`Task.begin`."""
        return _Score(state, self.scenario)


class _Score(Score):
    """See :class:`Adversary`."""

    def __init__(self, state: State, scenario: Scenario) -> None:
        self._r_m = scenario.r_m
        self._least_m = state.distance_m.min(axis=1)
        self._excused: Mask = np.zeros(len(self._least_m), dtype=bool)
        self._looked = 0  # ticks up to here
        self._window = max(1, round(OBEYS_WINDOW_S / scenario.control_step_s)) + 1
        self._ticks = 0

    def __call__(self, state: State, stepper: Stepper) -> Array:
        """See :meth:`Score.__call__`."""
        self._ticks += 1
        d: Array = state.distance_m.min(axis=1)
        closer = d < self._least_m
        if not closer.any():
            return np.zeros(len(d))
        self._look(stepper.trace)
        least = np.where(closer & ~self._excused, d, self._least_m)
        gained: Array = (self._least_m - least) / self._r_m
        self._least_m = least
        return gained

    def info(self) -> dict[str, Array | Mask]:
        """See :meth:`Score.info`."""
        return {"least_distance_m": self._least_m.copy()}

    def _look(self, trace: Trace) -> None:
        """Asks the hypotheses of all ticks since it did so last."""
        first = max(self._looked - self._window, 0)
        part = _between(trace, first, self._ticks)
        new = slice(self._looked - first, None)
        broke: Mask = np.any([marks[:, new] for marks in broken(part).values()], axis=0)
        apart: Mask = np.all(part.distance_m[:, new] >= COMFORTABLE * self._r_m, axis=2)
        ticks = np.arange(apart.shape[1])
        since = np.where(apart, ticks, -1).max(axis=1)  # the last tick at which all are far
        counts = broke & (ticks >= since[:, None])
        self._excused = counts.any(axis=1) | (self._excused & (since < 0))
        self._looked = self._ticks


def _between(trace: Trace, start: int, end: int) -> Trace:
    """Some ticks of a trace: views of its columns."""
    part = slice(start, end)
    return replace(
        trace,
        time_s=trace.time_s[part],
        **{column.name: getattr(trace, column.name)[:, part] for column in COLUMNS},
        signals={name: values[:, part] for name, values in trace.signals.items()},
    )
