"""What every driver is."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmerge.frozen import Frozen

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Along:
    """A car's motion along the road.

    Attributes:
        position_m: front axle, (N,).
        speed_mps: of the front axle along the road, (N,).
        acceleration_mps2: intended, (N,).
    """

    position_m: Array
    speed_mps: Array
    acceleration_mps2: Array


class Driver(Frozen):
    """What a neighbour intends. Frozen: all that is random is drawn before t = 0."""

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

    def switches(self, drawn: Array | None) -> Array:
        """When its acceleration may jump though the cars' motion does not, s, (K,): none by default.

        Continuous time stops there and starts anew, so that no jump is integrated over; a jump that is not
        named costs accuracy. From the named time on, the new intention holds.

        Args:
            drawn: one simulation's row of what :meth:`draw` returned.
        """
        del drawn
        return np.zeros(0)

    @abstractmethod
    def acceleration_mps2(self, time_s: float, own: Along, leader: Along, drawn: Array | None) -> Array:
        """Intended acceleration along the road, m/s^2, (N,).

        Args:
            time_s: simulated time, s.
            own: this car; its ``acceleration_mps2`` is not yet decided and reads zero.
            leader: the car ahead (for Vehicle 1 itself: the same as ``own``).
            drawn: what :meth:`draw` returned.
        """
