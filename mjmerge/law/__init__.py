"""The paper's law, one file per part: opinion, barrier, tracking, and merge, which puts them together.

What each named reading of it is for stands in :data:`VARIANTS`; ``mjmerge list laws`` shows it.
"""

from __future__ import annotations

from mjmerge.law.merge import Decision, Sensed, decide
from mjmerge.law.opinion import advance, bifurcation_input

__all__ = ["VARIANTS", "Decision", "Sensed", "advance", "bifurcation_input", "decide"]

VARIANTS: dict[str, str] = {
    "literal": "the equations as printed, two-sided barrier, product of the three merge conditions",
}
"""Named readings of the law, with why each exists."""
