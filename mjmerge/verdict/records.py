"""How far neighbours stray from the records that they follow: a car does not move as it is asked to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mjmerge.drivers.recorded import Recorded
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array

USUAL = 95.0
"""Of the ticks, the percentage in which a car strays no further than usual."""
USUAL_M, MOST_M = 0.3, 0.6
"""How far a car may stray usually and at most, m; what is told of more is not what was recorded."""
OF_LENGTH = 1 / 8
"""A car shorter than 4.8 m may stray at most by this part of its length, and usually by half of that."""


@dataclass(frozen=True)
class Strays:
    """How far one neighbour strays from its record, over all simulations.

    Attributes:
        usual_m: in 95 % of the ticks of the worst simulation no further than this, m; NaN if unknown.
        most_m: the furthest, m; likewise.
        within: whether both are within bounds.
    """

    usual_m: float
    most_m: float
    within: bool


def off_record_m(trace: Trace) -> dict[str, Array]:
    """How far ahead of its record each neighbour is that follows one, m, (N, T); NaN where it is unknown."""
    found = {}
    for c, driver in enumerate(trace.scenario.neighbours, 1):
        if isinstance(driver, Recorded):
            x_m = trace.front_m[:, :, c, 0]
            meant_m = np.array([driver.curve.at(t)[0] for t in trace.time_s.tolist()])
            found[trace.roster.cars[c]] = x_m - x_m[:, :1] - meant_m
    return found


def strays(trace: Trace) -> dict[str, Strays]:
    """How far each neighbour strays that follows a record; what came after a simulation's end is left out."""
    found = {}
    for car, off_m in off_record_m(trace).items():
        away_m = [np.abs(row[~np.isnan(row)]) for row in off_m]
        if not all(row.size for row in away_m):
            found[car] = Strays(np.nan, np.nan, within=False)
            continue
        usual_m = max(float(np.percentile(row, USUAL)) for row in away_m)
        most_m = max(float(row.max()) for row in away_m)
        part = min(1.0, OF_LENGTH * trace.sheets[trace.roster.cars.index(car)].length_m / MOST_M)
        found[car] = Strays(usual_m, most_m, usual_m <= part * USUAL_M and most_m <= part * MOST_M)
    return found


def sentence(car: str, found: Mapping[str, float | bool | None]) -> str:
    """It in words, of a summary's entry."""
    if found["most_m"] is None:
        return f"how far {car} strays from its record is not known"
    return f"{car} strays up to {found['most_m']:.2g} m from its record"
