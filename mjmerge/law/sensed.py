"""What a law may see, and what follows from it: distances, their rates, and the gap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mjmerge.state import LEAST, Array, Cars, dot, norm

End = Callable[[Array, Array], tuple[Array, Array]]
"""From p and v of the ego to p and v of what it is told of the end of its lane, (N, 2) each."""


@dataclass(frozen=True)
class Sensed:
    """All the law ever sees of the world, of an ego and C - 1 neighbours.

    Where the ego's lane ends and the law is told so, the last of the neighbours is the nearest point of that
    end.

    Attributes:
        p: the ego's front axle, m, (N, 2).
        v: its velocity, m/s, (N, 2).
        p_j: the neighbours' front axles, m, (N, C-1, 2), neighbour before component.
        v_j: their velocities, m/s, (N, C-1, 2).
        u_1: acceleration that the leader intends, as if it told the ego, m/s^2, (N, 2).
    """

    p: Array
    v: Array
    p_j: Array
    v_j: Array
    u_1: Array

    @classmethod
    def of(cls, cars: Cars, u_1: Array, end: End | None = None) -> Sensed:
        """What there is to see.

        Args:
            cars: the motion of all cars.
            u_1: what the leader intends, m/s^2, (N, 2).
            end: gives the nearest point of the end of the ego's lane, and its velocity, (N, 2) each, from
                where the ego is and its velocity; where the law is told of one.
        """
        p, v = cars.front_m, cars.velocity_mps
        p_j, v_j = p[:, 1:], v[:, 1:]
        if end is not None:
            p_end, v_end = end(p[:, 0], v[:, 0])
            p_j = np.concatenate([p_j, p_end[:, None]], axis=1)
            v_j = np.concatenate([v_j, v_end[:, None]], axis=1)
        return cls(p=p[:, 0], v=v[:, 0], p_j=p_j, v_j=v_j, u_1=u_1)


@dataclass(frozen=True)
class Geometry:
    """Distances and gap, in the paper's letters.

    Attributes:
        g: unit vectors from the neighbours to the ego, (N, C-1, 2).
        d: distances d_j, m, (N, C-1).
        d_dot: their rates, m/s, (N, C-1).
        dbar: gap between the leader and the follower less r, m, (N,).
        dbar_dot: its rate, m/s, (N,).
    """

    g: Array
    d: Array
    d_dot: Array
    dbar: Array
    dbar_dot: Array


Places = int | NDArray[np.intp]
"""Where a neighbour is along their axis: the same in all simulations, or in each, (N,)."""


class Terms(Protocol):
    """What distances are measured by: the margin, and who leads and who follows."""

    @property
    def r_m(self) -> float:
        """The margin r, m."""

    @property
    def j_1(self) -> Places:
        """Where the leader is along the axis of neighbours."""

    @property
    def j_2(self) -> Places:
        """Where the follower is."""


def of_each(values: Array, j: Places) -> Array:
    """Of one neighbour, (N, ...), in each simulation, from all of them, (N, C-1, ...)."""
    return values[:, j] if isinstance(j, int) else values[np.arange(len(values)), j]


def geometry(law: Terms, sensed: Sensed) -> Geometry:
    """Distances to every neighbour, and the gap between the two that the law names, with its margin r."""
    p_j, v_j, j_1, j_2 = sensed.p_j, sensed.v_j, law.j_1, law.j_2
    runs, others, _ = p_j.shape
    e, nu = np.empty(
        (2, runs, others + 1, 2)
    )  # from each neighbour to the ego, and last from leader to follower
    np.subtract(sensed.p[:, None], p_j, out=e[:, :-1])
    np.subtract(sensed.v[:, None], v_j, out=nu[:, :-1])
    np.subtract(of_each(p_j, j_2), of_each(p_j, j_1), out=e[:, -1])
    np.subtract(of_each(v_j, j_2), of_each(v_j, j_1), out=nu[:, -1])
    length = norm(e)
    g = e / np.maximum(length, LEAST)[..., None]  # from the neighbour to the ego; in the paper's text from it
    d, d_dot = length - law.r_m, dot(g, nu)
    return Geometry(g=g[:, :-1], d=d[:, :-1], d_dot=d_dot[:, :-1], dbar=d[:, -1], dbar_dot=d_dot[:, -1])
