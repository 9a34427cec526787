"""Laws. The paper's is in ``opinion_dynamics``, one file per part, and ``law.py``, which puts them together.

What each named reading of it is for stands in :data:`VARIANTS`; ``mjmerge list laws`` shows it.
"""

from __future__ import annotations

from mjmerge.law.opinion_dynamics.law import Decision, Geometry, Sensed, decide, geometry
from mjmerge.law.opinion_dynamics.opinion import advance, bifurcation_input
from mjmerge.law.opinion_dynamics.variants import VARIANTS

__all__ = ["VARIANTS", "Decision", "Geometry", "Sensed", "advance", "bifurcation_input", "decide", "geometry"]
