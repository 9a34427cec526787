"""Between which two neighbours the ego means to merge: named in the scenario, or chosen as it goes.

The paper assumes that the two are known. A law decides about two, its leader and its follower; where others
than the named ones are chosen, it is shown the neighbours with the chosen two in the places of the named, so
that any law can merge into any gap. The gaps are those between neighbours one behind the other in the lane of
the named leader.

A choice changes only where another gap is better by more than r, and no more once the ego is within r of
that lane. Every state with all d_j > 0 can be the theorem's beginning, so changing keeps what it promises
about the barrier; about the merge it speaks of two that stay.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mjmerge.law.base import OWN_DISTANCES, Decision, Law, Signal
from mjmerge.law.sensed import Places, Sensed
from mjmerge.roster import PER_NEIGHBOUR
from mjmerge.state import Array, Mask

LEADER = Signal("leader_number", "number of the neighbour behind which it means to merge", "leader")
FOLLOWER = Signal("follower_number", "number of the neighbour ahead of which it means to merge", "follower")
PAIR = (LEADER.name, FOLLOWER.name)
"""What is remembered of a choice, by name."""
_SHUT = 1e6
"""What a gap that is not open is worse than any that is, m."""


@dataclass(frozen=True)
class Two:
    """Who leads and who follows, as :func:`~mjmerge.law.sensed.geometry` takes them.

    Attributes:
        r_m: the margin r, m.
        j_1: where the leader is along the axis of neighbours; of each simulation, (N,), where it is chosen.
        j_2: where the follower is, likewise.
    """

    r_m: float
    j_1: Places
    j_2: Places
    _orders: dict[int, NDArray[np.intp]] = field(default_factory=dict, repr=False, compare=False)

    def of(self, rows: slice) -> Two:
        """The same of some simulations."""
        j_1, j_2 = (j if isinstance(j, int) else j[rows] for j in (self.j_1, self.j_2))
        return Two(self.r_m, j_1, j_2)

    def arranged(self, law: Law, seen: Sensed) -> Sensed:
        """What is seen, with the two in the places of those that the law names."""
        order = self._order(law, seen.p_j.shape[1])
        if order is None:
            return seen
        rows = _rows(order)
        return replace(seen, p_j=seen.p_j[rows, order], v_j=seen.v_j[rows, order])

    def put_back(self, law: Law, decision: Decision) -> Decision:
        """A decision about what was :meth:`arranged`, with each neighbour in its own place, and the two."""
        if law.choice == "named":
            return decision
        signals = dict(decision.signals)
        each = {*OWN_DISTANCES, *(s.name for s in law.signals if s.axes[:1] == (PER_NEIGHBOUR,))}
        for name in signals.keys() & each:
            order = self._order(law, signals[name].shape[1])
            if order is not None:
                own = np.empty_like(signals[name])
                own[_rows(order), order] = signals[name]
                signals[name] = own
        return replace(decision, signals=signals | kept(self))

    def _order(self, law: Law, neighbours: int) -> NDArray[np.intp] | None:
        """Who stands in each place, (N, C-1); ``None`` where all stand in their own."""
        if isinstance(self.j_1, int) or isinstance(self.j_2, int):
            return None
        if (self.j_1 == law.j_1).all() and (self.j_2 == law.j_2).all():
            return None
        if neighbours in self._orders:
            return self._orders[neighbours]
        rows = np.arange(len(self.j_1))
        order = np.broadcast_to(np.arange(neighbours), (len(rows), neighbours)).copy()
        for place, wanted in ((law.j_1, self.j_1), (law.j_2, self.j_2)):
            now = np.argmax(order == wanted[:, None], axis=1)
            order[rows, now] = order[:, place]
            order[rows, place] = wanted
        self._orders[neighbours] = order
        return order


def _rows(order: NDArray[np.intp]) -> NDArray[np.intp]:
    """The simulation of each place, (N, 1)."""
    return np.arange(len(order))[:, None]


def records(law: Law) -> tuple[Signal, ...]:
    """What a law records beside the columns of every trace: its own signals, and whom it has chosen."""
    chosen_ones = () if law.choice == "named" else (LEADER, FOLLOWER)
    return (*(s for s in law.signals if s.name not in PAIR or not chosen_ones), *chosen_ones)


def chosen(law: Law, seen: Sensed, before: Two | None = None, neighbours: int | None = None) -> Two:
    """The two that a law means to merge between from now on.

    Args:
        law: with its ``choice``, and the lane of its named leader.
        seen: what the ego senses.
        before: who they are so far; ``None`` at the start, when there is nothing to keep.
        neighbours: how many there are, before what else is seen; ``None``: all that is.
    """
    if law.choice == "named":
        return Two(law.r_m, law.j_1, law.j_2)
    p, p_j, rows = seen.p, seen.p_j[:, :neighbours], np.arange(len(seen.p))
    lane_m = p_j[:, law.j_1, 1]
    away = np.abs(p[:, 1] - lane_m) > law.r_m
    if before is not None and not away.any():
        return before
    within: Mask = np.abs(p_j[..., 1] - lane_m[:, None]) < law.r_m
    along = np.where(within, p_j[..., 0], -np.inf)
    queue = np.argsort(-along, axis=1, kind="stable")  # from the first one on; who is not in the lane is last
    j_1, j_2 = queue[:, :-1], queue[:, 1:]
    cost = np.where(within[rows[:, None], j_2], _cost_m(law, seen, j_1, j_2), np.inf)
    best = np.argmin(cost, axis=1)
    anew: Mask = np.isfinite(cost[rows, best])
    one, two = (law.j_1, law.j_2) if before is None else (before.j_1, before.j_2)
    if before is not None:
        same = (j_1 == np.asarray(one)[:, None]) & (j_2 == np.asarray(two)[:, None])
        there = same.any(axis=1)  # unless somebody has come between them
        anew &= away & ~(there & (cost[rows, best] >= cost[rows, np.argmax(same, axis=1)] - law.r_m))
    return Two(law.r_m, np.where(anew, j_1[rows, best], one), np.where(anew, j_2[rows, best], two))


def _cost_m(law: Law, seen: Sensed, j_1: NDArray[np.intp], j_2: NDArray[np.intp]) -> Array:
    """How bad each gap is, m, (N, C-2)."""
    x, rows = seen.p_j[..., 0], np.arange(len(j_1))[:, None]
    one, two = x[rows, j_1], x[rows, j_2]
    if law.choice == "largest":
        return two - one
    away: Array = np.abs((one + two) / 2 - seen.p[:, :1])
    if law.choice == "nearest":
        return away
    return away + np.where(one - two > 3 * law.r_m, 0.0, _SHUT)  # dbar > 2 r


def carried(memory: Mapping[str, Array], law: Law) -> Two:
    """The two as a loop remembers them."""
    if law.choice == "named":
        return Two(law.r_m, law.j_1, law.j_2)
    j_1, j_2 = (memory[name].astype(np.intp) - 1 for name in PAIR)
    return Two(law.r_m, j_1, j_2)


def kept(two: Two) -> dict[str, Array]:
    """What a loop remembers of the two: nothing where they are named."""
    if isinstance(two.j_1, int):
        return {}
    return {
        name: np.asarray(j + 1, dtype=np.float64) for name, j in zip(PAIR, (two.j_1, two.j_2), strict=True)
    }
