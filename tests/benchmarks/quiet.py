"""Whether a machine is quiet enough to measure on: every benchmark asks first, unless it is ``--anyway``."""

from __future__ import annotations

import os
import sys

BUSY = 0.3
"""Load, over a minute, from which on times are not those of a quiet machine."""
_ANYWAY = "--anyway"
anyway = _ANYWAY in sys.argv
sys.argv = [word for word in sys.argv if word != _ANYWAY]  # what is left is the benchmark's


def look() -> None:
    """Says that the machine is busy, if it is, and refuses to measure on it: exit code 2.

    Raises:
        SystemExit: it is, and nobody said ``--anyway``.
    """
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    if load <= BUSY:
        return
    said = f"load {load:.1f}: others are at work here, and times are not those of a quiet machine"
    print(said if anyway else f"{said}; {_ANYWAY} measures nevertheless", file=sys.stderr)
    if not anyway:
        raise SystemExit(2)
