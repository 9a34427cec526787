"""A patch: a stretch of the road where the tyres have other friction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjmerge.scenario.mismatch import Mismatch, column
from mjmerge.state import Array


class Patch:
    """A stretch of the road with other friction, its own in each simulation."""

    def __init__(self, start_m: Array, end_m: Array, friction: Array) -> None:
        """Args: where it starts and ends along the road, m, and its friction, 1, each (N, 1, 1)."""
        self._start_m, self._end_m, self._friction = start_m, end_m, friction

    @classmethod
    def of(cls, mismatch: Sequence[Mismatch]) -> Patch:
        """Where it is by one mismatch per simulation; nowhere where its friction is null."""
        start, length, friction = (
            column(mismatch, f"patch_{name}")[:, None, None] for name in ("start_m", "length_m", "friction")
        )
        return cls(np.where(np.isnan(friction), np.inf, start), start + length, friction)

    def friction(self, along_m: Array, elsewhere: Array) -> Array:
        """Under wheels that are so far along the road, m, (N, C, 4); elsewhere it is as given, 1."""
        on = (along_m >= self._start_m) & (along_m < self._end_m)  # none of no length
        return np.where(on, self._friction, elsewhere)
