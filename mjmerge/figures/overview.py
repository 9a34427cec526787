"""The figure of one run: what ran, what came of it and when, beside the curves of the paper."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.config.bounds import whole
from mjmerge.figures.style import LINE, MU, OPINION, End, Panels, ends, fold, head, limits, sheet, words
from mjmerge.roster import colour
from mjmerge.scenario.ran import ran as what_ran
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array
from mjmerge.verdict.judge import Verdict
from mjmerge.verdict.metrics import chosen_anew, merged_at_s

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TOGETHER = 0.025
"""Part of the time axis within which what happens has one number between its first and its last."""
_LINE_IN = 0.17
"""Height of a line below the panels, inches."""
_PALE = "0.45"
_FAR_LANES = 10
"""A car that is so many lanes beside where it started has run away: panels show what was before."""
_ALIKE_LANES = 0.01
"""Curves that are no further apart cover each other."""
_MOST_CHOICES = 8
"""Of a gap, that are told one by one."""


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
    for panel in panels:
        for time_s, _ in happened:
            panel.axvline(time_s, color=_PALE, linewidth=0.6, linestyle=(0, (2, 2)), zorder=1)
        for touch in () if verdict is None else verdict.collisions:
            panel.axvline(touch.time_s, color=LINE, linewidth=2, alpha=0.5)
    distance.set_xlabel("time $t$ (s)")
    if axes is not None:
        opinion.set_title(words("\n".join(ran(trace, run))), loc="left", fontsize=9, pad=14)
        return figure
    head(figure, *ran(trace, run))
    if verdict is not None:
        said, unsafe = _said(trace, verdict), verdict.unsafe_at_s is not None
        opinion.set_title(said, loc="left", fontsize=9, pad=14, color=LINE if unsafe else "black")
    if happened:
        _number(opinion, [time_s for time_s, _ in happened], float(trace.time_s[-1]))
        told = [f"{i}  {time_s:.2f} s  {text}" for i, (time_s, text) in enumerate(happened, 1)]
        figure.supxlabel(words("\n".join(told)), x=0.01, ha="left", fontsize=9, color=_PALE)
        figure.set_figheight(figure.get_figheight() + _LINE_IN * len(told))
    return figure


def ran(trace: Trace, run: int = 0) -> list[str]:
    """Lines of a title: what ran, every mismatch, and whatever else was given beside the file."""
    seed, mismatch = int(trace.seeds[run]), trace.mismatch[run]
    said = what_ran(trace.scenario, trace.plant, seed, continuous=trace.continuous, mismatch=mismatch)
    return [part for line in said for part in fold(line)]


def ran_both(trace: Trace, ideal: Trace) -> list[str]:
    """A line each of two runs over each other, of which the second is broad and pale."""
    return [f"{how}: {'; '.join(ran(one))}" for how, one in (("line", trace), ("broad, pale", ideal))]


def _said(trace: Trace, verdict: Verdict) -> str:
    floor_m = trace.scenario.expect.min_distance_m.at_least
    floor = f"safety floor {floor_m:g} m {'held' if verdict.floor_held else 'BROKEN'}"
    return words("\n".join(fold(f"{verdict.verdict}: {verdict.reason}; {floor}")))


def _happened(trace: Trace, run: int, verdict: Verdict | None) -> list[tuple[float, str]]:
    """Which gaps it chooses, what a verdict stands on, and the end of the merge, in order of time, s."""
    found = list(_choices(trace, run))
    if verdict is None:
        return found
    found += [(breach.time_s, f"hypothesis broken: {breach.hypothesis}") for breach in verdict.breaches]
    found += [(touch.time_s, touch.sentence.partition(" at ")[0]) for touch in verdict.collisions]
    if verdict.ran_off is not None:
        found.append((verdict.ran_off.time_s, "the ego runs off the end of its lane"))
    merged_s = float(merged_at_s(trace)[run])
    if not np.isnan(merged_s):
        found.append((merged_s, "merged"))
    found += [(stop.time_s, f"the run ends: {stop.reason}") for stop in trace.stops if stop.run == run]
    return sorted(found)


def _choices(trace: Trace, run: int) -> Iterator[tuple[float, str]]:
    """From when on it goes for which gap, under a law that chooses; of many, how many and the last."""
    found = chosen_anew(trace, run)
    many = len(found) > _MOST_CHOICES
    goes = f"the ego, for the last of {len(found)} times, goes" if many else "the ego goes"
    for k in found[-1:] if many else found:
        one, two = (1 + int(np.broadcast_to(j, trace.front_m.shape[:2])[run, k]) for j in trace.two)
        yield float(trace.time_s[k]), f"{goes} for the gap between vehicles {one} and {two}"


def _number(panel: Axes, times_s: Sequence[float], end_s: float) -> None:
    """Above the panel the numbers of what happened there."""
    first = 0
    for i, time_s in enumerate(times_s):
        last = i + 1 == len(times_s) or times_s[i + 1] - time_s > _TOGETHER * end_s
        if last:
            text = str(i + 1) if first == i else f"{first + 1}\N{EN DASH}{i + 1}"
            where = ((times_s[first] + time_s) / 2, 1.01)
            style: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": 9, "color": _PALE}
            panel.text(*where, text, transform=panel.get_xaxis_transform(), **style)
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
    axes.set_ylabel("lateral position $\\eta^{\\!\\top}\\!p$ (m)")
    near, ramp = near_the_road(trace, run), trace.ramp
    shown = trace.front_m[run, near, :, 1].ravel()
    limits(axes, shown if ramp is None else np.append(shown, (ramp.inner_m[0], ramp.outer_m[0])))
    each = [
        End(
            _names([trace.roster.cars[c] for c in of]),
            trace.front_m[run, :, of[0], 1],
            colour(trace.roster.cars[of[0]]),
        )
        for of in _covering(trace, run, near)
    ]
    ends(axes, each)


def near_the_road(trace: Trace, run: int) -> Array:
    """When no car of a simulation has run away yet, (T,)."""
    lateral_m = trace.front_m[run, :, :, 1]
    far = np.abs(lateral_m - lateral_m[0]) > _FAR_LANES * trace.scenario.road.lane_width_m
    return ~np.logical_or.accumulate(far.any(axis=1))


def _covering(trace: Trace, run: int, near: Array) -> list[list[int]]:
    """Cars by their places on the roster, those together whose curves across the road cover each other."""
    lateral_m = trace.front_m[run, near, :, 1]
    found: list[list[int]] = []
    for c in range(len(trace.roster.cars)):
        for of in found:
            off = np.abs(lateral_m[:, c] - lateral_m[:, of[0]])
            if of[0] and (off <= _ALIKE_LANES * trace.scenario.road.lane_width_m).all():
                of.append(c)
                break
        else:
            found.append([c])
    return found


def _draw_distances(axes: Axes, trace: Trace, run: int) -> None:
    """Every d_j with the least of it, the floor, and between which bodies is how much room."""
    t, near = trace.time_s, near_the_road(trace, run)
    each = draw_each_d(axes, trace, run)
    clearance_m = trace.clearance_m[run, :, : len(each)]
    shown = [np.zeros(1), trace.distance_m[run, near].ravel(), clearance_m[near].ravel()]
    bodies = not np.isnan(clearance_m).all()
    for j, end in enumerate(each):
        if bodies:
            axes.plot(t, clearance_m[:, j], color=end.own, linewidth=0.9, linestyle=(0, (4, 2)))
    if trace.edge_distance_m is not None:
        edge_m = trace.edge_distance_m[run]
        axes.plot(t, edge_m, color="0.4", linestyle=(0, (1, 1)))
        each.append(End(f"edge{_least(edge_m)}", edge_m, "0.4"))
        shown.append(edge_m[edge_m < np.fmax.reduce(shown[1])])
    floor_m = trace.scenario.expect.min_distance_m.at_least
    axes.axhline(0, color=LINE, linewidth=1)
    if floor_m:
        axes.axhline(floor_m, color=LINE, linewidth=0.9, linestyle=(0, (6, 3)))
        each.append(End(f"floor {floor_m:g} m", np.full_like(t, floor_m), LINE))
        shown.append(np.array([floor_m]))
    limits(axes, np.concatenate(shown))
    others = [
        (bodies, "between bodies dashed"),
        (trace.edge_distance_m is not None, "body to the edge dotted"),
    ]
    axes.set_ylabel("\n".join(["distance $d_j$ (m)", *(text for there, text in others if there)]))
    ends(axes, each)


def draw_each_d(axes: Axes, trace: Trace, run: int) -> list[End]:
    """Every d_j of a simulation with a dot where it is least; what is to be written at their ends."""
    each = []
    for j, car in enumerate(trace.roster.neighbours):
        d_m, own = trace.distance_m[run, :, j], colour(car)
        axes.plot(trace.time_s, d_m, color=own)
        if not np.isnan(d_m).all():
            k = int(np.nanargmin(d_m))
            axes.plot(trace.time_s[k], d_m[k], "o", color=own, markersize=4)
        each.append(End(f"$d_{{{j + 1}}}${_least(d_m)}", d_m, own))
    return each


def _least(distance_m: Array) -> str:
    """The least of a curve, behind its name; nothing where it has none."""
    if np.isnan(distance_m).all():
        return ""
    value = float(np.nanmin(distance_m))
    return words(f", least {value:.3f} m" if abs(value) < 1e6 else f", least {value:.3g} m")


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
        axes.text(*where, " no road", va="center", fontsize=9, color="0.3")


def _names(cars: Sequence[str]) -> str:
    """``vehicle 3``, ``vehicles 1 to 6``, ``vehicles 1, 3``."""
    numbers = [car.rpartition("_")[2] for car in cars]
    if len(cars) == 1:
        return cars[0].replace("_", " ")
    row = len(cars) > 2 and int(numbers[-1]) - int(numbers[0]) == len(cars) - 1
    return f"vehicles {numbers[0]} to {numbers[-1]}" if row else f"vehicles {', '.join(numbers)}"
