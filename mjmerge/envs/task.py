"""What every task is: who is driven, what is seen, what is given, and what is rewarded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjmerge.envs.parts import Part, bounds, places, seen
from mjmerge.envs.stepper import Stepper
from mjmerge.roster import EGO
from mjmerge.scenario.ramp import EDGE_DISTANCE
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import Turn
from mjmerge.simulation.trace import COLUMNS, Trace
from mjmerge.state import Array, Mask, norm


@dataclass(frozen=True)
class State:
    """What a reward is about, at one tick of N simulations.

    Attributes:
        time_s: simulated time, s.
        front_m: front axles, (N, C, 2), as they truly are.
        distance_m: d_j, (N, C-1).
        unsafe: whether d_j <= 0, bodies touch the ego's, or it is off the end of its lane, (N,).
    """

    time_s: float
    front_m: Array
    distance_m: Array
    unsafe: Mask

    @classmethod
    def of(cls, turn: Turn, stepper: Stepper) -> State:
        """That of a turn."""
        front_m = turn.cars.front_m
        distance_m = norm(front_m[:, :1] - front_m[:, 1:]) - stepper.scenario.r_m
        unsafe: Mask = distance_m.min(axis=1) <= 0
        if stepper.plant == "mujoco":
            mine = slice(distance_m.shape[1])
            unsafe |= np.any(turn.cars.clearance_m[:, mine] <= 0, axis=1)
            unsafe |= np.any(turn.plant.contacts()[0][:, mine] > 0, axis=1)
        if stepper.ramp is not None:
            ego = front_m[:, 0], turn.cars.velocity_mps[:, 0], turn.cars.heading_rad[:, 0]
            unsafe |= stepper.ramp.columns(*ego)[EDGE_DISTANCE] <= 0
        return cls(turn.time_s, front_m, distance_m, unsafe)


class Score(ABC):
    """The rewards of N episodes that began together."""

    @abstractmethod
    def __call__(self, state: State, stepper: Stepper) -> Array:
        """The reward of one tick, (N,), once it is recorded.

        Args:
            state: as the command of that tick was given.
            stepper: what has happened up to it.
        """

    def info(self) -> dict[str, Array | Mask]:
        """What else there is to tell of that tick, each (N, ...)."""
        return {}


class Task(ABC):
    """A car that an agent drives in a scenario, and what for.

    Attributes:
        scenario: what runs.
        plant: what moves the cars.
        drives: the agent's car.
        sees: what the agent sees.
        acts: what it gives.
        failed: reward of a simulation that could not go on.
    """

    drives: str = EGO
    sees: tuple[Part, ...]
    acts: tuple[Part, ...]
    failed: float = 0.0

    def __init__(self, scenario: Scenario, plant: str) -> None:
        self.scenario, self.plant = scenario, plant

    @cached_property
    def most_seen(self) -> Array:
        """Bounds of what it sees, (K,)."""
        return bounds(self.sees)

    @cached_property
    def most_asked(self) -> Array:
        """Bounds of what it gives, (K,)."""
        return bounds(self.acts)

    @cached_property
    def where_seen(self) -> dict[Part, slice]:
        """Where each part of what it sees is."""
        return places(self.sees)

    def observe(self, turn: Turn) -> Array:
        """What agents see, (N, K)."""
        return seen(self.where_seen, self.most_seen, turn)

    @abstractmethod
    def begin(self, state: State) -> Score:
        """The rewards of episodes that begin."""

    @abstractmethod
    def command(self, turn: Turn, given: Array) -> Array:
        """What agents give, (N, K), as :meth:`Stepper.step` takes it."""

    def as_judged(self, trace: Trace) -> Trace:
        """What happened, as it is to be judged."""
        return trace


def only(trace: Trace, rows: NDArray[np.intp]) -> Trace:
    """Some of the simulations of a trace.

    Args:
        trace: of all.
        rows: which, in increasing order, (M,).
    """
    if len(rows) == trace.runs:
        return trace
    place = {run: i for i, run in enumerate(rows.tolist())}
    return replace(
        trace,
        seeds=trace.seeds[rows],
        mismatch=tuple(trace.mismatch[run] for run in place),
        stops=tuple(replace(stop, run=place[stop.run]) for stop in trace.stops if stop.run in place),
        **{column.name: getattr(trace, column.name)[rows] for column in COLUMNS},
        signals={name: values[rows] for name, values in trace.signals.items()},
    )
