"""The parts of what is seen and given as spaces of gymnasium."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjmerge.envs.parts import Part, bounds
from mjmerge.errors import MjmergeError

try:
    from gymnasium.spaces import Box
except ImportError as missing:
    raise MjmergeError("these environments need gymnasium: pip install 'mjmerge[envs]'") from missing


def box(parts: Sequence[Part], runs: int | None = None) -> Box:
    """The space of a vector of parts, (K,), or of N of them, (N, K)."""
    most = bounds(parts)
    most = most if runs is None else np.repeat(most[None], runs, axis=0)
    return Box(-most, most, dtype=np.float64)
