"""Fingerprints of what was recorded, column by column: what is changed in a file afterwards shows."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping

import numpy as np

from mjmerge.simulation.log import TickBlock
from mjmerge.state import Array


class Digest:
    """SHA-256 of every column of a run, fed block by block: of the float64 as they are, little-endian."""

    def __init__(self, texts: Mapping[str, str], columns: Iterable[str]) -> None:
        """Args: texts that go with the run, by name; names of its columns."""
        self._texts = of_texts(texts)
        self._hashes = {name: hashlib.sha256() for name in ("time_s", *columns)}

    def add(self, block: TickBlock) -> None:
        """Adds consecutive ticks."""
        self._add({"time_s": block.time_s, **block.columns})

    def _add(self, columns: Mapping[str, Array]) -> None:
        for name, fed in self._hashes.items():
            fed.update(np.ascontiguousarray(columns[name], "<f8").tobytes())

    def hex(self) -> dict[str, str]:
        """What it comes to so far, by column, and of each text."""
        return {name: fed.hexdigest() for name, fed in self._hashes.items()} | self._texts


def of_texts(texts: Mapping[str, str]) -> dict[str, str]:
    """SHA-256 of each text, by name."""
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}


def digests(columns: Mapping[str, Array], texts: Mapping[str, str]) -> dict[str, str]:
    """Of whole columns, each (T, ...), ``time_s`` among them, and of the texts that go with them, by name."""
    whole = Digest(texts, [name for name in columns if name != "time_s"])
    whole._add(columns)
    return whole.hex()
