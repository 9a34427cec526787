"""What an agent sees and does: named parts of one vector, each with its unit, its bounds and its meaning."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isnan, prod

import numpy as np

from mjmerge.errors import MjmergeError
from mjmerge.simulation.loop import Turn
from mjmerge.state import Array

FAR_M, FAST_MPS = 1000.0, 200.0
"""What is further away, or faster, is shown as so far and so fast."""


@dataclass(frozen=True)
class Part:
    """Some numbers of the vector that an agent sees, or of the one that it gives.

    Attributes:
        name: with the unit at its end.
        unit: of all of them.
        doc: what they are.
        shape: theirs, without the axis of simulations.
        most: bound of their size: they are within plus and minus that.
        read: gives them at a turn, (N, ...); of what an agent sees.
    """

    name: str
    unit: str
    doc: str
    shape: tuple[int, ...]
    most: float
    read: Callable[[Turn], Array] | None = None

    @property
    def size(self) -> int:
        """How many numbers."""
        return prod(self.shape)


def bounds(parts: Sequence[Part]) -> Array:
    """The bound of each number of a vector, (K,)."""
    return np.concatenate([np.full(part.size, part.most) for part in parts])


def places(parts: Sequence[Part]) -> dict[Part, slice]:
    """Where each part is in the vector."""
    ends = np.cumsum([part.size for part in parts]).tolist()
    return {part: slice(end - part.size, end) for part, end in zip(parts, ends, strict=True)}


def told(parts: Sequence[Part]) -> str:
    """A table of them for people, in Markdown."""
    head = "| part | numbers | unit | within | what it is |\n|---|---|---|---|---|\n"
    rows = [(f"`{p.name}`", " x ".join(map(str, p.shape)), p.unit, f"± {p.most:.4g}", p.doc) for p in parts]
    return head + "\n".join(f"| {' | '.join(row)} |" for row in rows)


def seen(parts: Mapping[Part, slice], most: Array, turn: Turn) -> Array:
    """The vector that an agent sees, (N, K): within its bounds, and 0 where there is no number.

    Args:
        parts: of it, and where each is in it.
        most: their :func:`bounds`.
        turn: now.
    """
    rows = len(turn.running)
    vector = np.empty((rows, len(most)))
    for part, at in parts.items():
        assert part.read is not None
        vector[:, at] = part.read(turn).reshape(rows, -1)
    np.minimum(vector, most, out=vector)
    np.maximum(vector, -most, out=vector)
    if not turn.running.all():
        vector[np.isnan(vector)] = 0.0
    return vector


def asked(parts: Sequence[Part], most: Array, actions: object, rows: int) -> Array:
    """What agents give, within its bounds, (N, K).

    Args:
        parts: of it.
        most: their :func:`bounds`.
        actions: what they gave.
        rows: how many agents there are, N.

    Raises:
        MjmergeError: these are no numbers, or not so many.
    """
    try:
        vector = np.asarray(actions, dtype=np.float64)
    except (TypeError, ValueError):
        raise MjmergeError(f"an action must be numbers: {_named(parts)}") from None
    if vector.shape != (rows, len(most)):
        must = f"{(rows, len(most))}: {_named(parts)}"
        raise MjmergeError(f"actions have the shape {vector.shape}; they must have {must}")
    within: Array = np.minimum(np.maximum(vector, -most), most)
    if isnan(within.sum()):
        raise MjmergeError(f"an action is no number; it must be: {_named(parts)}")
    return within


def _named(parts: Sequence[Part]) -> str:
    return ", ".join(f"{part.name} {part.shape}" for part in parts)
