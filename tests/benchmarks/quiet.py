"""Whether a machine is quiet enough to measure on."""

from __future__ import annotations

import os

BUSY = 0.3
"""Load, over a minute, from which on times are not those of a quiet machine."""


def warning() -> str:
    """What to say of the load before a benchmark; empty on a quiet machine."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    if load <= BUSY:
        return ""
    return f"load {load:.1f}: others are at work here, and times are not those of a quiet machine"
