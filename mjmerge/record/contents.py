"""What the readers of recordings gather from a file, the same for every format.

No format is known here, and nothing is judged: ``read.py`` makes a recording of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmerge.state import Array

Ticks = NDArray[np.int64]
Said = tuple[int, str, str]


@dataclass
class Found:
    """What a reader gathers, series by series: ticks, times and values.

    ``fault`` is why reading ended before the end of the file; ``flaws`` are what is there and cannot be.
    """

    schema_version: int | None = None
    finished: bool = False
    fault: str = ""
    flaws: list[str] = field(default_factory=list)
    manifest: dict[str, Any] = field(default_factory=dict)
    properties: dict[str, dict[str, Any]] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    verdict: str | None = None
    sha256: dict[str, str] = field(default_factory=dict)
    said: list[Said] = field(default_factory=list)
    states: list[Said] = field(default_factory=list)
    series: dict[str, tuple[Ticks, Ticks, Array]] = field(default_factory=dict)

    def complete(self) -> None:
        """Leaves no series where one is missing that every tick needs, or is there that the run has not."""
        from mjmerge.record import schema

        wanted = schema.Wire.of(self.manifest).kinds
        if not self.series or self.series.keys() == wanted.keys():
            return
        lacks = ", ".join(sorted(wanted.keys() - self.series.keys()))
        odd = ", ".join(sorted(self.series.keys() - wanted.keys()))
        if odd:
            self.flaws.append(f"{odd} in it, and the run has none")
        if lacks and self.finished:
            self.flaws.append(f"nothing in it of {lacks}")
        if lacks:  # without it when it was cut off within the first tick, or block
            self.series.clear()
        for topic in self.series.keys() - wanted.keys():
            del self.series[topic]
