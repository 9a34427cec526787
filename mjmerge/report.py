"""What a person gets from a trace: the summary, the table, the figure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.contract import VERDICTS, Verdict
from mjmerge.metrics import MERGED_M, merged_at_s, saturated
from mjmerge.scenario import CARS
from mjmerge.state import Array
from mjmerge.trace import NEIGHBOURS, Trace

if TYPE_CHECKING:
    from rich.table import Table

_COLOURS = {"ego": "#2a9d55", "vehicle_1": "#2c61bf", "vehicle_2": "#d97321"}


def worst_run(trace: Trace) -> int:
    """The simulation that came closest to a neighbour; one without data is worse than any other."""
    least = trace.min_distance_m.min(axis=1)
    return int(np.argmin(np.where(np.isnan(least), -np.inf, least)))


def summary(trace: Trace, verdicts: Sequence[Verdict], wall_s: float) -> dict[str, Any]:
    """What ``--json`` prints and ``summary.json`` holds, but for the run folder and the versions.

    Distances are the smallest over all simulations; times, merge and clearance are those of the worst one.
    """
    run = worst_run(trace)
    distance_m = trace.distance_m[run]
    ends = [trace.time_s[np.flatnonzero(~np.isnan(row))[-1]] for row in trace.front_m[:, :, 0, 0]]
    worst = max(verdicts, key=lambda v: VERDICTS.index(v.verdict))
    clearance = trace.min_clearance_m[:, :2]
    return {
        "scenario": trace.scenario.name,
        "plant": trace.plant,
        "seed": int(trace.seeds[0]),
        "runs": trace.runs,
        "verdict": worst.verdict,
        "verdict_reason": worst.reason,
        "verdicts": dict(Counter(v.verdict for v in verdicts)),
        "floor_m": trace.scenario.expect.min_distance_m.at_least,
        "floor_held": all(v.floor_held for v in verdicts),
        "floor_held_runs": sum(v.floor_held for v in verdicts),
        "worst_seed": int(trace.seeds[run]),
        "min_distance_m": {
            car: _number(least) for car, least in zip(NEIGHBOURS, _least(trace.min_distance_m), strict=True)
        },
        "t_min_distance_s": {
            car: _number(trace.time_s[np.argmin(np.where(np.isnan(d), np.inf, d))])
            for car, d in zip(NEIGHBOURS, distance_m.T, strict=True)
        },
        "min_clearance_m": _number(_least(clearance.reshape(-1, 1))[0]),
        "merged_at_s": _number(merged_at_s(trace)[run]),
        "saturated_s": {
            car: _number(saturated(trace)[run, :, c].sum() * trace.scenario.control_step_s)
            for c, car in enumerate(CARS)
        },
        "peak_u_c_mps2": _number(np.nanmax(np.hypot(*trace.u_c_mps2[run].T))),
        "breaches": [{"hypothesis": b.hypothesis, "time_s": b.time_s} for b in verdicts[run].breaches],
        "stops": [
            {"seed": int(trace.seeds[s.run]), "time_s": s.time_s, "car": s.car, "reason": s.reason}
            for s in trace.stops
        ],
        "duration_s": _number(max(ends)),
        "real_time_factor": _number(sum(ends) / wall_s),
    }


def _least(values: Array) -> Array:
    """Minimum over simulations that ignores NaN unless there is nothing else."""
    least: Array = np.where(np.isnan(values), np.inf, values).min(axis=0)
    return np.where(np.isinf(least), np.nan, least)


def _number(value: float) -> float | None:
    """A JSON number; JSON has no NaN."""
    return None if math.isnan(value) else float(value)


def table(found: dict[str, Any]) -> Table:
    """The summary as a table for the terminal."""
    from rich.table import Table

    def metres(value: float | None) -> str:
        return "-" if value is None else f"{value:.3f} m"

    def seconds(value: float | None) -> str:
        return "-" if value is None else f"{value:.2f} s"

    good = found["floor_held"]
    grid = Table(show_header=False, box=None, pad_edge=False)
    grid.add_column(style="bold")
    grid.add_column()
    for j, car in enumerate(NEIGHBOURS):
        least, at = found["min_distance_m"][car], found["t_min_distance_s"][car]
        grid.add_row(f"min d_{j + 1}", f"{metres(least)} at {seconds(at)}  (to {car})")
    clearance = found["min_clearance_m"]
    grid.add_row("body clearance", "- (no bodies)" if clearance is None else metres(clearance))
    merged = found["merged_at_s"]
    grid.add_row(
        "merged", f"at {seconds(merged)} (lateral error < {MERGED_M} m)" if merged is not None else "no"
    )
    busy = [f"{car} {seconds(s)}" for car, s in found["saturated_s"].items() if s]
    grid.add_row("saturated", ", ".join(busy) or "never")
    grid.add_row("verdict", f"{found['verdict']}: {found['verdict_reason']}")
    if found["runs"] > 1:
        grid.add_row("verdicts", ", ".join(f"{n} {v}" for v, n in found["verdicts"].items()))
        grid.add_row("worst run", f"seed {found['worst_seed']}")
    for stop in found["stops"][:5]:
        grid.add_row(
            "stopped", f"seed {stop['seed']} at {seconds(stop['time_s'])}: {stop['car']}, {stop['reason']}"
        )
    floor = f"{found['floor_m']:.3f} m " + ("held" if good else "BROKEN")
    if found["runs"] > 1:
        floor += f" in {found['floor_held_runs']} of {found['runs']} runs"
    grid.add_row("safety floor", f"[{'green' if good else 'red'}]{floor}[/]")
    grid.add_row("real time", f"x {found['real_time_factor']:.1f}")
    return grid


def figure(trace: Trace, path: Path, run: int = 0) -> None:
    """Opinion, lateral position and distances over time, as the paper draws them."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(8, 8.5), layout="constrained")
    FigureCanvasAgg(sheet)
    opinion, lateral, distance = sheet.subplots(3, 1, sharex=True)
    t = trace.time_s
    opinion.plot(t, trace.opinion[run], color="#7b3fa0", label="$z$")
    opinion.plot(t, trace.mu[run], color="#999999", linewidth=0.8, label="$\\mu$")
    opinion.set_ylabel("opinion")
    for c, car in enumerate(CARS):
        lateral.plot(t, trace.front_m[run, :, c, 1], color=_COLOURS[car], label=car.replace("_", " "))
    lateral.set_ylabel("lateral position $\\eta^\\top p$ (m)")
    for j, car in enumerate(NEIGHBOURS):
        distance.plot(
            t,
            trace.distance_m[run, :, j],
            color=_COLOURS[car],
            label=f"$d_{j + 1}$ to {car.replace('_', ' ')}",
        )
    distance.axhline(0, color="#c00000", linewidth=1)
    distance.set_ylabel("distance (m)")
    distance.set_xlabel("time (s)")
    for axes in (opinion, lateral, distance):
        axes.legend(loc="upper right", frameon=False)
        axes.grid(alpha=0.25)
        axes.margins(x=0)
    sheet.suptitle(f"{trace.scenario.name} on {trace.plant}, seed {trace.seeds[run]}")
    sheet.savefig(path, dpi=110, metadata={"Software": None})
