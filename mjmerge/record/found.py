"""What the readers of recordings gather from a file, the same for every format.

No format is known here, and nothing is judged: ``read.py`` makes a recording of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmerge.trace import Array

NS_PER_S = 1_000_000_000
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
