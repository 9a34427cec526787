"""The laws of many simulations, asked together: those of one kind that differ in their own keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

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
        u = np.empty((self.runs, 2))
        signals: dict[str, Array] = {}
        after: dict[str, Array] = {}
        failed: dict[int, str] = {}
        for law, members in self.parts:
            mine = {name: values[members] for name, values in memory.items()}
            one = decided(law, Sensed(**{n: v[members] for n, v in vars(seen).items()}), mine, step_s)
            u[members] = one.u
            _put(signals, one.signals, members, self.runs)
            _put(after, remembered(law, mine, one, step_s), members, self.runs)
            failed |= {int(members[run]): why for run, why in one.failed.items()}
        return Decision(u, signals, after=after, failed=failed)

    def remembered(self, memory: Memory, decision: Decision, step_s: float) -> Memory:
        """What they remember a control step later."""
        return remembered(self.first, memory, decision, step_s)


def _put(whole: dict[str, Array], part: Mapping[str, Array], members: NDArray[np.intp], runs: int) -> None:
    """Puts rows of some simulations into arrays of all."""
    for name, values in part.items():
        if name not in whole:
            whole[name] = np.full((runs, *values.shape[1:]), np.nan, dtype=values.dtype)
        whole[name][members] = values
