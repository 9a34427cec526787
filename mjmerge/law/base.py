"""What every law is: from what is sensed to the front-axle acceleration that the ego is asked for."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator

from mjmerge.config.acts import WHEELS, Acts
from mjmerge.config.frozen import Frozen, Positive
from mjmerge.law.sensed import Sensed
from mjmerge.roster import Axis, neighbour, slot
from mjmerge.state import Array

Memory = Mapping[str, Array]
"""What a law remembers from tick to tick, by name, each (N, ...)."""


VECTORS = ("target_m", "u_n_mps2", "u_c_mps2")
"""Columns of every trace that any law may fill: where it wants the ego, and the two parts of its command."""


OWN_DISTANCES = ("sensed_distance_m", "sensed_distance_rate_mps")
"""Columns of every trace that are what the ego is told, or, where a law gives them, what it makes of that."""
GIVEN = (*VECTORS, *OWN_DISTANCES, "weight", "mu_input_per_s")
"""Columns of every trace that a law can fill by its decisions; all others are not its own to say."""
REMEMBERED = ("opinion", "mu")
"""Columns of every trace that can be of what a law remembers."""


@dataclass(frozen=True)
class Signal:
    """A number of a law's own that is recorded at every tick.

    Attributes:
        name: as in recordings and tables, with its unit at the end.
        doc: what it is, in a line.
        symbol: a letter or a short word for legends; the name where it is empty.
        axes: nothing for a number, ``PER_NEIGHBOUR`` for one per neighbour, ``XY`` for a vector.
        asks: what it says of a hypothesis of the law, in a line: then it is 1 where that holds, and 0 where
            it does not. Empty for any other signal.
    """

    name: str
    doc: str
    symbol: str = ""
    axes: tuple[Axis, ...] = ()
    asks: str = ""


@dataclass(frozen=True)
class Decision:
    """What a law made of what it saw.

    Attributes:
        u: the command, m/s^2, (N, 2).
        signals: what is recorded of it beside the command and the memory, by name, each (N, ...).
        after: the memory one control step later, where it is known already; otherwise :meth:`Law.advance`
            makes it.
        failed: simulations that it has no command for, and why: they stop.
    """

    u: Array
    signals: Mapping[str, Array] = field(default_factory=dict)
    after: Memory | None = None
    failed: Mapping[int, str] = field(default_factory=dict)


def _a_neighbour(name: str) -> str:
    if slot(name) is None:
        raise ValueError("must be a neighbour, such as vehicle_1")
    return name


Neighbour = Annotated[str, AfterValidator(_a_neighbour)]


def _many(scenario: Any) -> bool:
    return len(scenario.roster.neighbours) > 2


class Law(Frozen):
    """What every law has: its keys, which are those of the section ``law``, and these methods.

    Frozen, and without any state: what a law remembers is handed from tick to tick. Every array has a leading
    axis of simulations, and what a law does in one of them must not depend on the others.
    """

    remembers: ClassVar[tuple[str, ...]] = ()
    """What of its memory is a column of every trace: ``opinion`` and ``mu`` of the paper's law."""
    gives: ClassVar[tuple[str, ...]] = ()
    """Columns of every trace that it fills, which are among the signals of its decisions: ``target_m``;
    where u is their sum, ``u_n_mps2`` without and ``u_c_mps2`` by what keeps it clear; and, to be held
    against the truth, ``sensed_distance_m`` and ``sensed_distance_rate_mps`` as it computes them itself."""
    needs: ClassVar[Mapping[str, str]] = {}
    """Modules of others without which it decides nothing, each with the extra of mjmerge that brings it."""
    guard: ClassVar[str] = "its guard"
    """What keeps it away from the neighbours, in words."""

    kind: Any
    leader: Neighbour = neighbour(0)
    """The paper's Vehicle 1, behind which the ego is to be: the target is seen from it."""
    follower: Neighbour = neighbour(1)
    """The paper's Vehicle 2: the gap is between it and the leader. The barrier is against every neighbour."""
    choice: Annotated[
        Literal["named", "nearest", "largest", "first_open"],
        Acts(when=_many, only="among more than two neighbours"),
    ] = "named"
    """Which two it merges between: leader and follower as named, or as it goes those at the nearest gap in
    the leader's lane, at the largest, or at the nearest one with room for it (dbar > 2 r)."""
    r_m: Positive = 0.6
    """Safe margin r between front axles, m; the scenario's, whatever the law: all are judged by it."""
    eps_v_mps: Annotated[Positive, Acts(on=WHEELS, continuous=True)] = 0.1
    """Speed below which the bicycle inverse uses sign(v_r) eps_v in place of v_r, m/s (sign(0) = +1)."""

    @property
    def j_1(self) -> int:
        """Where the leader is along the axis of neighbours."""
        return slot(self.leader) or 0

    @property
    def j_2(self) -> int:
        """Where the follower is along the axis of neighbours."""
        return slot(self.follower) or 0

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Whatever else of it is recorded: each is among those of a :class:`Decision`."""
        return ()

    @property
    def label(self) -> str:
        """What it is called in tables: its kind, without the folder of a file."""
        place, colon, name = str(self.kind).rpartition(":")
        return f"{place.rpartition('/')[2]}{colon}{name}"

    def problems(self) -> Iterator[tuple[str, str]]:
        """What its keys, each valid by itself, get wrong together: key below ``law``, and message."""
        yield from ()

    def start(self, runs: int, initial: Mapping[str, float]) -> Memory:
        """Its memory at t = 0.

        Args:
            runs: number of simulations N.
            initial: ``z`` and ``mu``, as the scenario has them.
        """
        del runs, initial
        return {}

    @abstractmethod
    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """The command, from what is seen now and what is remembered; both are left as they are.

        Args:
            seen: what the ego senses.
            memory: what it remembers.
            step_s: how long the command is held, s: the control step; 0 in continuous time.
        """

    def advance(self, memory: Memory, decision: Decision, step_s: float) -> Memory:
        """The memory one control step later, the decision held meanwhile.

        Args:
            memory: as it is now.
            decision: what was decided with it.
            step_s: the control step h, s.
        """
        del decision, step_s
        return memory

    def unguarded(self) -> Self | None:
        """The same law without what keeps it away from the neighbours; itself, if it has nothing of the kind.

        ``None`` where nobody knows how to take it out, and so never what it was worth.
        """
        return None

    @property
    def singular(self) -> bool:
        """Whether its command grows without bound as d_j falls to zero: no motion goes on from there."""
        return False

    def flow(self) -> Flow | None:
        """Its memory in continuous time; ``None`` if it has a memory and nobody says how that changes."""
        return Flow() if type(self).start is Law.start else None


def lacking(law: Law | type[Law]) -> Iterator[str]:
    """What a law needs and is not installed, each in a line that says how it comes."""
    for module, extra in law.needs.items():
        try:
            there = find_spec(module) is not None
        except (ImportError, ValueError):  # what it is part of is not there, or it is no name
            there = False
        if not there:
            yield f"the law needs {module}: pip install 'mjmerge[{extra}]'"


class Flow:
    """A law's memory as part of a differential equation: coordinates and their rates. Here of none."""

    size = 0
    """Number of coordinates M."""

    def start(self, initial: Mapping[str, float]) -> Array:
        """Coordinates at t = 0, (M,)."""
        del initial
        return np.zeros(0)

    def memory(self, coordinates: Array) -> Memory:
        """What is remembered, (T, M) -> each (T,)."""
        del coordinates
        return {}

    def rates(self, coordinates: Array, decision: Decision) -> Array:
        """Rates of the coordinates of one simulation, (M,), under what it decides."""
        del coordinates, decision
        return np.zeros(0)
