"""The laws of many simulations, asked together: those of one kind that differ in their own keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjmerge.law.asked import decided, remembered
from mjmerge.law.base import Decision, Law, Memory
from mjmerge.law.choice import PAIR, Two, carried, chosen, kept
from mjmerge.law.sensed import Sensed
from mjmerge.state import Array

COMMON = ("leader", "follower", "choice", "r_m", "eps_v_mps")
"""Keys of every law that are the same in laws that are asked together: what distances are measured by."""


@dataclass(frozen=True)
class Laws:
    """The laws of N simulations; each is asked once for those simulations that it is the law of.

    Attributes:
        parts: each law, and its simulations, (M,).
        runs: how many simulations, N.
        neighbours: how many each has, C - 1.
    """

    parts: tuple[tuple[Law, NDArray[np.intp]], ...]
    runs: int
    neighbours: int

    @classmethod
    def of(cls, laws: Sequence[Law], neighbours: int) -> Laws:
        """From the law of each simulation, (N,); all of a kind, alike in ``COMMON``."""
        found: list[tuple[Law, list[int]]] = []
        for run, law in enumerate(laws):
            for other, members in found:
                if law is other or law == other:
                    members.append(run)
                    break
            else:
                found.append((law, [run]))
        return cls(tuple((law, np.array(members)) for law, members in found), len(laws), neighbours)

    @property
    def first(self) -> Law:
        """The first of them, which stands for what all have in common."""
        return self.parts[0][0]

    def start(self, initial: Sequence[Mapping[str, float]], seen: Sensed) -> Memory:
        """What they remember at t = 0, and between whom they mean to merge; see :meth:`Law.start`.

        Args:
            initial: ``z`` and ``mu`` of each simulation.
            seen: what there is to see then.
        """
        return {**self._start(initial), **kept(chosen(self.first, seen))}

    def two(self, memory: Memory) -> Two:
        """Between whom they mean to merge."""
        return carried(memory, self.first)

    def _start(self, initial: Sequence[Mapping[str, float]]) -> Memory:
        if len(self.parts) == 1 and all(one == initial[0] for one in initial):
            return self.first.start(self.runs, initial[0])
        rows: list[Memory] = [{}] * self.runs
        for law, members in self.parts:
            for run in members.tolist():
                rows[run] = law.start(1, initial[run])
        return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """What they decide, and remember a control step later."""
        if self.first.choice == "named":
            return self._decide(seen, memory, step_s)
        two, own = self.two(memory), {name: v for name, v in memory.items() if name not in PAIR}
        decision = two.put_back(self.first, self._decide(two.arranged(self.first, seen), own, step_s))
        after = {
            **remembered(self.first, own, decision, step_s),
            **kept(chosen(self.first, seen, two, self.neighbours)),
        }
        return replace(decision, after=after)

    def _decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        if len(self.parts) == 1:
            return decided(self.first, seen, memory, step_s)
        made: list[Decision] = []
        after: list[Memory] = []
        failed: dict[int, str] = {}
        for (law, members), mine in zip(self.parts, self._places, strict=True):
            own = {name: values[mine] for name, values in memory.items()}
            one = decided(law, Sensed(**{n: v[mine] for n, v in vars(seen).items()}), own, step_s)
            made.append(one)
            after.append(remembered(law, own, one, step_s))
            failed |= {int(members[run]): why for run, why in one.failed.items()}
        joined = self._joined
        u, signals = joined([{"u": one.u} for one in made])["u"], joined([one.signals for one in made])
        return Decision(u, signals, after=joined(after), failed=failed)

    @cached_property
    def _places(self) -> list[slice | NDArray[np.intp]]:
        """Of each law, where its simulations are; simulations in a row as a slice, which copies nothing."""
        ends = ((int(members[0]), int(members[-1]) + 1) for _, members in self.parts)
        return [
            slice(first, end) if end - first == len(members) else members
            for (first, end), (_, members) in zip(ends, self.parts, strict=True)
        ]

    @cached_property
    def _order(self) -> NDArray[np.intp] | None:
        """Where each simulation is among those of all laws, one after the other; ``None`` if where it was."""
        order = np.argsort(np.concatenate([members for _, members in self.parts]))
        return None if np.array_equal(order, np.arange(self.runs)) else order

    def _joined(self, parts: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
        """Arrays of all simulations from those of each law; NaN where a law has none of that name."""
        found = {}
        for name in dict.fromkeys(name for part in parts for name in part):
            (like, *_) = (part[name] for part in parts if name in part)
            rows = np.concatenate(
                [
                    part[name] if name in part else _nothing(like, len(members))
                    for part, (_, members) in zip(parts, self.parts, strict=True)
                ]
            )
            found[name] = rows if self._order is None else rows[self._order]
        return found

    def remembered(self, memory: Memory, decision: Decision, step_s: float) -> Memory:
        """What they remember a control step later."""
        return remembered(self.first, memory, decision, step_s)


def _nothing(like: Array, rows: int) -> Array:
    """NaN in rows like these."""
    return np.full((rows, *like.shape[1:]), np.nan, like.dtype)
