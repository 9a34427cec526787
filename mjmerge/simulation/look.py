"""A trace on a line, and on a page of a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjmerge.notebook.html import lines, page, table
from mjmerge.roster import colour
from mjmerge.state import Array

if TYPE_CHECKING:
    from mjmerge.simulation.trace import Trace

_MOST_ROWS = 10


def line(trace: Trace) -> str:
    """What was run, and the least that came of it."""
    many = f"{trace.runs} runs, " if trace.runs > 1 else ""
    first, last = int(trace.seeds.min()), int(trace.seeds.max())
    seeds = f"seed {first}" if trace.runs == 1 else f"seeds {first} to {last}"
    how = f"{trace.plant}{', continuous time' if trace.continuous else ''}"
    least = ", ".join(f"d_{j + 1} {_metres(m)}" for j, m in enumerate(_least(trace.min_distance_m)))
    stopped = f"; {len(trace.stops)} stopped" if trace.stops else ""
    size = f"{len(trace.time_s)} ticks to {trace.time_s[-1]:g} s" if len(trace.time_s) else "no ticks"
    return f"<Trace of {trace.scenario.name} on {how}: {many}{seeds}; {size}; least {least}{stopped}>"


def html(trace: Trace, worst: int) -> str:
    """A table with a row for each run, the worst first, and the distances of the worst over time."""
    neighbours = trace.roster.neighbours
    head = ["seed", *(f"min d_{j + 1}" for j in range(len(neighbours))), "clearance", "stopped"]
    stops = {stop.run: f"{stop.time_s:.2f} s: {stop.car}, {stop.reason}" for stop in trace.stops}
    clearance_m = _least(trace.min_clearance_m[:, : len(neighbours)].T)
    order = [worst, *(run for run in range(trace.runs) if run != worst)]
    rows = [
        [
            str(trace.seeds[run]),
            *map(_metres, trace.min_distance_m[run]),
            _metres(clearance_m[run]),
            stops.get(run, ""),
        ]
        for run in order[:_MOST_ROWS]
    ]
    if trace.runs > _MOST_ROWS:
        rows.append([f"and {trace.runs - _MOST_ROWS} more"])
    of = {f"d_{j + 1}": (trace.distance_m[worst, :, j], colour(car)) for j, car in enumerate(neighbours)}
    drawn = lines(trace.time_s, of, "distance d_j (m)", "time (s)")
    return page(line(trace).strip("<>"), table(head, rows), drawn)


def _least(values: Array) -> Array:
    """Minimum over the first axis that ignores NaN unless there is nothing else."""
    least: Array = np.where(np.isnan(values), np.inf, values).min(axis=0)
    return least


def _metres(value: float) -> str:
    return f"{value:.3f} m" if np.isfinite(value) else "-"
