"""What every driver is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from mjmerge.config.frozen import Frozen
from mjmerge.state import Array, Mask

if TYPE_CHECKING:
    from mjmerge.drivers.several import Rows

FASTEST_MPS = 1000.0
"""Nothing on a road is faster: a speed beyond it is a mistake."""
Forwards = Annotated[float, Field(ge=0, le=FASTEST_MPS)]
"""A speed of a car that does not reverse, m/s."""


Number = float | Array
"""One, or one for each simulation, (N,)."""


def each(function: Callable[[float], float], of: Number) -> Number:
    """A function of one number, of each: Python's own has the same bits for one number as for many."""
    if isinstance(of, np.ndarray) and of.ndim:
        return np.array([function(one) for one in of.tolist()])
    return function(float(of))


def overlap(end_s: float, start_s: float) -> bool:
    """Whether what starts then does so before what went before ended, by more than rounding."""
    return end_s - start_s > 1e-9 * end_s


@dataclass(frozen=True)
class Along:
    """A car along the road: its motion, and how far its body reaches.

    Attributes:
        position_m: front axle, (N,).
        speed_mps: of the front axle along the road, (N,).
        acceleration_mps2: intended, (N,).
        nose_m: how far the body reaches ahead of the front axle, by its data sheet; 0 for a point.
        tail_m: how far it reaches behind the front axle, likewise.
        start_m: where its front axle was at t = 0, (N,).
    """

    position_m: Array
    speed_mps: Array
    acceleration_mps2: Array
    nose_m: float = 0.0
    tail_m: float = 0.0
    start_m: Number = 0.0

    @property
    def travelled_m(self) -> Array:
        """How far it has come since t = 0, m, (N,)."""
        return self.position_m - self.start_m

    def of(self, rows: Rows) -> Along:
        """The same in some simulations."""
        if isinstance(rows, slice):  # in all of them
            return self
        own = self.position_m[rows], self.speed_mps[rows], self.acceleration_mps2[rows]
        start_m = self.start_m[rows] if isinstance(self.start_m, np.ndarray) else self.start_m
        return replace(self, position_m=own[0], speed_mps=own[1], acceleration_mps2=own[2], start_m=start_m)

    def clear_to_m(self, ahead: Along) -> Array:
        """Free road from this car's nose to the tail of the one ahead, m, (N,); negative if they overlap."""
        return ahead.position_m - ahead.tail_m - self.position_m - self.nose_m


class Driver(Frozen):
    """What a neighbour intends. Frozen: all that is random is drawn before t = 0."""

    can_lead: ClassVar[bool] = False
    """Whether it can drive with nobody ahead of it. A kind says so itself; the others are followers, and
    refused for the car that is first in its lane."""

    stacks: ClassVar[bool] = False
    """Whether its code takes, for any number among its fields, an array (N,) with one for each simulation, to
    the same bits: then simulations that differ in these numbers are asked together. Of shipped kinds."""

    kind: Any

    def problems(self) -> Iterator[tuple[str, str]]:
        """What its fields, each valid by itself, get wrong together: key below the driver, and message."""
        yield from ()

    def draw(self, rngs: Sequence[np.random.Generator], duration_s: float) -> Array | None:
        """Random numbers of the whole run, one row per simulation, (N, ...); ``None`` if there are none.

        Args:
            rngs: one generator per simulation; draw the same count from each, whatever N is.
            duration_s: how long the run is, s.
        """
        del rngs, duration_s
        return None

    def random(self, duration_s: float) -> bool:
        """Whether another seed drives otherwise: whether :meth:`draw` draws, and not the same from each."""
        drawn = self.draw([np.random.default_rng(seed) for seed in (0, 1)], duration_s)
        return drawn is not None and not np.array_equal(*drawn)

    def switches(self, drawn: Array | None) -> Array:
        """When its acceleration may jump though the cars' motion does not, s, (K,): none by default.

        Continuous time stops there and starts anew, so that no jump is integrated over; a jump that is not
        named costs accuracy. From the named time on, the new intention holds.

        Args:
            drawn: one simulation's row of what :meth:`draw` returned.
        """
        del drawn
        return np.zeros(0)

    def stands(self, time_s: float, own: Along, hold_s: float = 0.0) -> Mask:
        """Whether it means to stand now, (N,), of bool: then it makes up for a slope that its car rolls down.

        Args:
            time_s: simulated time, s.
            own: this car, with the acceleration that it intends.
            hold_s: as of :meth:`acceleration_mps2`.
        """
        del time_s, hold_s
        return np.zeros(len(own.speed_mps), dtype=bool)

    @abstractmethod
    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """Intended acceleration along the road, m/s^2, (N,).

        Args:
            time_s: simulated time, s.
            own: this car; its ``acceleration_mps2`` is not yet decided and reads zero.
            leader: the neighbour ahead in the lane, which has decided already; ``None`` if there is none,
                and only kinds that ``can_lead`` are asked then. Nobody is shown the ego.
            drawn: what :meth:`draw` returned.
            hold_s: how long the answer is held, s: the control step; 0 in continuous time.
        """
