"""Columns spread over their components: the names that every table of a run has.

Columns are the trace's, units in their names: ``opinion``, ``distance_m.vehicle_1``, ``front_m.ego.x``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.config.bounds import whole
from mjmerge.errors import MjmergeError
from mjmerge.roster import Roster
from mjmerge.state import Array

if TYPE_CHECKING:
    import pandas as pd

    from mjmerge.simulation.trace import Column, Trace


def spread(columns: Iterable[Column], there: Roster, values: Mapping[str, Array]) -> dict[str, Array]:
    """Every component of every column by name, each (T,).

    Args:
        columns: which, in the order of the result.
        there: who is there.
        values: each column by its name, (T, ...).
    """
    found = {}
    for column in columns:
        names = column.names(there)
        for index in product(*map(range, column.shape(there))):
            parts = [axis[i] for axis, i in zip(names, index, strict=True)]
            where: tuple[slice | int, ...] = (slice(None), *index)
            found[".".join([column.name, *parts])] = np.ascontiguousarray(values[column.name][where])
    return found


def frame(trace: Trace, run: int = 0) -> pd.DataFrame:
    """See :meth:`mjmerge.Trace.frame`."""
    run = whole("run", run, 0, trace.runs - 1)
    try:
        import pandas as pd
    except ModuleNotFoundError:
        raise MjmergeError("a frame needs pandas: pip install 'mjmerge[notebook]'") from None
    values = {column.name: trace.column(column.name)[run] for column in trace.columns}
    return pd.DataFrame(
        spread(trace.columns, trace.roster, values), index=pd.Index(trace.time_s, name="time_s")
    )
