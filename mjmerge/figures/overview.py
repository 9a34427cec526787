"""The figure of one run: what ran, what came of it and when, beside the curves of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.config.bounds import whole
from mjmerge.figures.style import LINE, MU, OPINION, End, Panels, ends, sheet, words
from mjmerge.roster import colour
from mjmerge.scenario.ran import ran as what_ran
from mjmerge.simulation.trace import Trace
from mjmerge.verdict.judge import Verdict
from mjmerge.verdict.metrics import chosen_anew, merged_at_s

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LETTERS = 100
"""In a line across the figure."""
_TOGETHER = 0.025
"""Part of the time axis within which what happens has one number between its first and its last."""
_LINE_IN = 0.17
"""Height of a line below the panels, inches."""
_PALE = "0.45"


def overview(trace: Trace, run: int = 0, axes: Panels = None, *, verdict: Verdict | None = None) -> Figure:
    """Opinion, lateral positions and distances of one run, with its verdict and what happened when.

    Args:
        trace: what happened.
        run: which of its simulations.
        axes: three panels to draw into, in place of a figure of its own.
        verdict: what is to be said of that simulation; by default nothing.

    Returns:
        The figure: its own, or that of the panels.

    Raises:
        MjmergeError: it is another number of panels, or there is no such simulation.
    """
    run = whole("run", run, 0, trace.runs - 1)
    figure, panels = sheet((1, 1, 1.25), 8.5, axes=axes)
    opinion, lateral, distance = panels
    _draw_opinion(opinion, trace, run)
    _draw_lateral(lateral, trace, run)
    _draw_distances(distance, trace, run)
    happened = _happened(trace, run, verdict)
    _number(panels, [time_s for time_s, _ in happened], float(trace.time_s[-1]))
    for panel in panels:
        for k in chosen_anew(trace, run):
            panel.axvline(trace.time_s[k], color=MU, linewidth=0.8, linestyle=":")
        for touch in () if verdict is None else verdict.collisions:
            panel.axvline(touch.time_s, color=LINE, linewidth=2, alpha=0.5)
    _write_choices(opinion, trace, run)
    title = words("\n".join(ran(trace, run)))
    distance.set_xlabel("time (s)")
    if axes is not None:
        opinion.set_title(title, loc="left", fontsize=9, pad=14)
        return figure
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    if verdict is not None:
        told = [f"{i}  {time_s:.2f} s  {text}" for i, (time_s, text) in enumerate(happened, 1)]
        said, unsafe = _said(trace, verdict), verdict.unsafe_at_s is not None
        opinion.set_title(said, loc="left", fontsize=9, pad=14, color=LINE if unsafe else "black")
        figure.supxlabel(words("\n".join(told)), x=0.01, ha="left", fontsize=8.5, color=_PALE)
        figure.set_figheight(figure.get_figheight() + _LINE_IN * len(told))
    return figure


def ran(trace: Trace, run: int = 0) -> list[str]:
    """Lines of a title: what ran, every mismatch, and whatever else was given beside the file."""
    seed, mismatch = int(trace.seeds[run]), trace.mismatch[run]
    said = what_ran(trace.scenario, trace.plant, seed, continuous=trace.continuous, mismatch=mismatch)
    return [part for line in said for part in wrap(line, LETTERS)]


def _said(trace: Trace, verdict: Verdict) -> str:
    floor_m = trace.scenario.expect.min_distance_m.at_least
    floor = f"safety floor {floor_m:g} m {'held' if verdict.floor_held else 'BROKEN'}"
    lines = wrap(f"{verdict.verdict}: {verdict.reason}; {floor}", LETTERS)
    return words("\n".join(lines))


def _happened(trace: Trace, run: int, verdict: Verdict | None) -> list[tuple[float, str]]:
    """What a verdict stands on, and the end of the merge, in order of time, s."""
    if verdict is None:
        return []
    found = [(breach.time_s, f"hypothesis broken: {breach.hypothesis}") for breach in verdict.breaches]
    found += [(touch.time_s, touch.sentence.partition(" at ")[0]) for touch in verdict.collisions]
    if verdict.ran_off is not None:
        found.append((verdict.ran_off.time_s, "the ego runs off the end of its lane"))
    merged_s = float(merged_at_s(trace)[run])
    if not np.isnan(merged_s):
        found.append((merged_s, "merged"))
    found += [(stop.time_s, f"the run ends: {stop.reason}") for stop in trace.stops if stop.run == run]
    return sorted(found)


def _number(panels: Sequence[Axes], times_s: Sequence[float], end_s: float) -> None:
    """A thin line at each time, and above the first panel the numbers of what happened there."""
    for time_s in times_s:
        for panel in panels:
            panel.axvline(time_s, color=_PALE, linewidth=0.6, linestyle=(0, (2, 2)), zorder=1)
    first = 0
    for i, time_s in enumerate(times_s):
        last = i + 1 == len(times_s) or times_s[i + 1] - time_s > _TOGETHER * end_s
        if last:
            text = str(i + 1) if first == i else f"{first + 1}\N{EN DASH}{i + 1}"
            where = ((times_s[first] + time_s) / 2, 1.01)
            transform = panels[0].get_xaxis_transform()
            panels[0].text(
                *where, text, transform=transform, ha="center", va="bottom", fontsize=8, color=_PALE
            )
            first = i + 1


def _draw_opinion(axes: Axes, trace: Trace, run: int) -> None:
    """Z and mu; under a law that has neither, its command."""
    t = trace.time_s
    if np.isnan(trace.opinion[run]).all():
        along, across = trace.u_mps2[run, :, 0].T
        curves = ((along, OPINION, "along"), (across, MU, "across"))
        axes.set_ylabel("command $u$ (m/s²)")
    else:
        curves = ((trace.opinion[run], OPINION, "$z$"), (trace.mu[run], MU, "$\\mu$"))
        axes.set_ylabel("opinion")
    for values, own, _ in reversed(curves):
        axes.plot(t, values, color=own, linewidth=0.9 if own == MU else None)
    ends(axes, [End(label, values, own) for values, own, label in curves])


def _draw_lateral(axes: Axes, trace: Trace, run: int) -> None:
    """Where the cars are across the road, and where there is no road any more."""
    _draw_end(axes, trace, run)
    for c, car in reversed([*enumerate(trace.roster.cars)]):
        axes.plot(trace.time_s, trace.front_m[run, :, c, 1], color=colour(car))
    axes.set_ylabel("lateral position $\\eta^\\top p$ (m)")
    each = [
        End(_name(car), trace.front_m[run, :, c, 1], colour(car)) for c, car in enumerate(trace.roster.cars)
    ]
    ends(axes, each)


def _draw_distances(axes: Axes, trace: Trace, run: int) -> None:
    """Every d_j with the least of it, the floor, and between which bodies is how much room."""
    t, neighbours = trace.time_s, trace.roster.neighbours
    each = []
    for j, car in enumerate(neighbours):
        d_m, own = trace.distance_m[run, :, j], colour(car)
        axes.plot(t, d_m, color=own)
        least = "" if np.isnan(d_m).all() else f", least {_metres(np.nanmin(d_m))}"
        each.append(End(f"$d_{{{j + 1}}}${least}", d_m, own))
        if not np.isnan(d_m).all():
            k = int(np.nanargmin(d_m))
            axes.plot(t[k], d_m[k], "o", color=own, markersize=4)
    clearance_m = trace.clearance_m[run, :, : len(neighbours)]
    bodies = not np.isnan(clearance_m).all()
    for j, car in enumerate(neighbours):
        if bodies:
            axes.plot(t, clearance_m[:, j], color=colour(car), linewidth=0.9, linestyle=(0, (4, 2)))
    if trace.edge_distance_m is not None:
        edge_m = trace.edge_distance_m[run]
        axes.plot(t, edge_m, color="0.4", linestyle="--")
        each.append(End("body to the edge", edge_m, "0.4"))
    floor_m = trace.scenario.expect.min_distance_m.at_least
    axes.axhline(0, color=LINE, linewidth=1)
    if floor_m:
        axes.axhline(floor_m, color=LINE, linewidth=0.9, linestyle=(0, (6, 3)))
        each.append(End(f"floor {floor_m:g} m", np.full_like(t, floor_m), LINE))
    axes.set_ylabel("distance $d_j$ (m)" + ("\nbetween bodies dashed" if bodies else ""))
    ends(axes, each)


def _metres(value: float) -> str:
    return (f"{value:.3f} m" if abs(value) < 1e6 else f"{value:.3g} m").replace("-", "\N{MINUS SIGN}")


def _draw_end(axes: Axes, trace: Trace, run: int) -> None:
    """Where there is no road any more beside an ego that is past the end of its lane; nothing elsewhere."""
    ramp = trace.ramp
    if ramp is None:
        return
    nose_m = trace.front_m[run, :, 0, 0] + ramp.sheet.front_overhang_m
    edge_m, outer_m = np.full_like(nose_m, ramp.inner_m[0]), ramp.outer_m[0]
    past = nose_m > ramp.ends_m
    axes.fill_between(trace.time_s, edge_m, outer_m, where=past, color="0.8", linewidth=0)
    if past.any():
        where = trace.time_s[int(np.argmax(past))], (edge_m[0] + outer_m) / 2
        axes.text(*where, " no road", va="center", fontsize=8, color=_PALE)


def _write_choices(axes: Axes, trace: Trace, run: int) -> None:
    """Which gap it goes for, beside the time from which it does."""
    for k in chosen_anew(trace, run):
        one, two = (1 + int(np.broadcast_to(j, trace.front_m.shape[:2])[run, k]) for j in trace.two)
        where, text = (trace.time_s[k], 0.98), f" between {one} and {two}"
        axes.text(*where, text, transform=axes.get_xaxis_transform(), rotation=90, va="top", fontsize=8)


def _name(car: str) -> str:
    return car.replace("_", " ")
