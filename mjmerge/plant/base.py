"""What every plant does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from mjmerge.state import Array, Cars, Controls, Mask


@dataclass(frozen=True)
class Fault:
    """A simulation that cannot go on.

    Attributes:
        run: which simulation.
        car: index of the car.
        reason: what happened, in words.
        touched: whether it is that d_j reached 0, as far as can be told.
        crossing: whether it then closed in undiminished.
    """

    run: int
    car: int
    reason: str
    touched: bool = False
    crossing: bool = False


class Plant(Protocol):
    """N simulations of the same cars; the only thing besides recorders that holds state."""

    limited: bool
    """Whether commands are limited to what the car can do; the ideal plants know no limits."""

    def observe(self) -> Cars:
        """The true motion of all cars now."""

    def step(self, controls: Controls, running: Mask) -> None:
        """One control step further, for the simulations that still run, (N,)."""

    def contacts(self) -> tuple[Array, Array]:
        """How hard the bodies hit each other over the control step that ended, pair by pair, each (N, P).

        The impulse between them, N s, and how fast they moved against each other when they touched first in
        it, m/s; both 0 where they did not, and NaN where the plant has no bodies.
        """

    def faults(self) -> list[Fault]:
        """Simulations whose state is no longer a state of cars on wheels."""

    def qpos(self) -> Array:
        """Generalised positions of the composed world as the cars are now, (N, nq)."""


class Smooth(Plant, Protocol):
    """A plant that is also a differential equation, which continuous time integrates."""

    def state(self) -> Array:
        """Its state now, (N, C, K)."""

    def put(self, state: Array) -> None:
        """Another state in place of that, (N, C, K)."""

    def rate(self, command: Array) -> Array:
        """Derivative of the state under the command that the plant understands, (N, C, 2) -> (N, C, K)."""
