"""How large each mismatch is: mild, realistic and severe, for cars of 1/10 and of full size.

The axes say it themselves (:mod:`mjmerge.scenario.mismatch`), and where each number comes from. Mild is what
a well-kept laboratory has, realistic what a car of that size must be expected to have, severe what it has on
a bad day.
"""

from __future__ import annotations

from mjmerge.scenario.axis import LEVEL_NAMES, levels
from mjmerge.scenario.mismatch import Mismatch

NAMES = LEVEL_NAMES
"""Names of the levels."""
LEVELS = levels(Mismatch)
"""By size of the cars and axis: its levels, in the order of :data:`NAMES`."""
