"""Parts of a sweep, for job arrays: each does every n-th shard of the same plan, in any order."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from mjmerge.errors import MjmergeError
from mjmerge.sweep.shards import Shard


@dataclass(frozen=True)
class Part:
    """One of several parts of a plan's shards.

    Attributes:
        number: which, from 1.
        of: how many there are.
    """

    number: int = 1
    of: int = 1

    @classmethod
    def parse(cls, text: str) -> Part:
        """A part as it is written, ``2/3``.

        Raises:
            MjmergeError: it is none.
        """
        found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
        if found is None:
            raise MjmergeError(f"--part is {text!r}; it must be K/N, such as 1/3")
        part = cls(int(found[1]), int(found[2]))
        if not 1 <= part.number <= part.of:
            raise MjmergeError(f"--part is {text}; K/N must have K from 1 to N, such as 1/{max(part.of, 1)}")
        return part

    def among(self, shards: Sequence[Shard]) -> list[Shard]:
        """Its shards."""
        return [shard for shard in shards if self.has(shard)]

    def has(self, shard: Shard) -> bool:
        """Whether a shard is its own."""
        return shard.number % self.of == self.number - 1

    def others(self, shards: Iterable[Shard]) -> list[Part]:
        """Which parts some shards are of."""
        numbers = sorted({shard.number % self.of + 1 for shard in shards})
        return [Part(number, self.of) for number in numbers]

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


WHOLE = Part()
"""Everything."""


def ranges(numbers: Iterable[int]) -> str:
    """Whole numbers in words, those in a row as one: ``0 to 3, 8``."""
    found: list[list[int]] = []
    for number in sorted(numbers):
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in found)
