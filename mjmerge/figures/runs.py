"""Figures of traces, as the paper draws them: functions from traces to matplotlib figures, or into axes.

A figure of one run, or of a run beside the ideal one: then the ideal is a broad pale line below, and a panel
shows the difference. Lengths in m, time in s; nothing here opens a window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.figures.overview import draw_each_d, near_the_road, ran, ran_both
from mjmerge.figures.style import (
    COLOURS,
    LINE,
    MU,
    OPINION,
    PALE,
    End,
    Panels,
    ends,
    head,
    length,
    limits,
    sheet,
    words,
)
from mjmerge.law import of_paper
from mjmerge.roster import colour
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array
from mjmerge.verdict.metrics import shared_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def opinion(trace: Trace, ideal: Trace | None = None, axes: Panels = None) -> Figure:
    """Opinion and lateral position of the ego, with the lane of the vehicles in red; simulation 0.

    Args:
        trace: what happened.
        ideal: the same on the plant of the proof, to be drawn beside it.
        axes: two panels to draw into, four with the ideal, in place of a figure of its own.

    Returns:
        The figure: its own, or that of the panels.

    Raises:
        MjmergeError: it is another number of panels.
    """
    heights, height_in = ((3, 3), 5.4) if ideal is None else ((3, 1, 3, 1), 7.2)
    figure, panels = sheet(heights, height_in, axes=axes)
    top, bottom = (panels[0], panels[1]) if ideal is None else (panels[0], panels[2])
    t, law, lateral_m = trace.time_s, trace.scenario.law, trace.front_m[0, :, 0, 1]
    _shade_closing(top, trace, told=True)
    _shade_closing(bottom, trace)
    paper = of_paper(law)
    most, lane_m = paper.k_s / paper.k_mu, trace.front_m[0, 0, 1 + law.j_1, 1]
    top.axhline(most, color=MU, linestyle=":")
    bottom.axhline(lane_m, color=LINE)
    if ideal is not None:
        top.plot(t, ideal.opinion[0], color=OPINION, **PALE)
        bottom.plot(t, ideal.front_m[0, :, 0, 1], color=COLOURS["ego"], **PALE)
    top.plot(t, trace.opinion[0], color=OPINION)
    bottom.plot(t, lateral_m, color=COLOURS["ego"])
    top.set_ylabel("opinion $z$")
    limits(top, np.append(trace.opinion[0], (0.0, 1.1 * most)))
    limits(bottom, np.append(lateral_m[near_the_road(trace, 0)], lane_m))
    ends(top, [End("$z$", trace.opinion[0], OPINION), End("$1/k_\\mu$", np.full_like(t, most), MU)])
    lane = End(f"lane of {law.j_1 + 1} and {law.j_2 + 1}", np.full_like(t, lane_m), LINE)
    ends(bottom, [lane, End("ego", lateral_m, COLOURS["ego"])])
    bottom.set_ylabel("lateral position $\\eta^{\\!\\top}\\!p$ (m)")
    if ideal is not None:
        difference(panels[1], t, {"": (trace.opinion[0] - ideal.opinion[0], OPINION)}, "$\\Delta z$", "")
        off = trace.front_m[0, :, 0, 1] - ideal.front_m[0, :, 0, 1]
        difference(panels[3], t, {"": (off, COLOURS["ego"])}, "$\\Delta\\eta^{\\!\\top}\\!p$", "m")
    panels[-1].set_xlabel("time $t$ (s)")
    _head(figure, top, trace, ideal, axes)
    return figure


def distances(trace: Trace, ideal: Trace | None = None, axes: Panels = None) -> Figure:
    """Every d_j, with the margin in red; simulation 0.

    Args:
        trace: what happened.
        ideal: the same on the plant of the proof, to be drawn beside it.
        axes: a panel to draw into, two with the ideal, in place of a figure of its own.

    Returns:
        The figure: its own, or that of the panels.

    Raises:
        MjmergeError: it is another number of panels.
    """
    heights, height_in = ((3,), 3.9) if ideal is None else ((3, 1), 5.6)
    figure, panels = sheet(heights, height_in, axes=axes)
    top, t = panels[0], trace.time_s
    _shade_closing(top, trace, told=True)
    shown = [np.zeros(1), trace.distance_m[0, near_the_road(trace, 0)].ravel()]
    if ideal is not None:
        shown.append(ideal.distance_m[0].ravel())
        for j, car in enumerate(ideal.roster.neighbours):
            top.plot(t, ideal.distance_m[0, :, j], color=colour(car), **PALE)
    each = draw_each_d(top, trace, 0)
    top.axhline(0, color=LINE, linewidth=1)
    top.set_ylabel("distance $d_j$ (m)")
    touching = np.flatnonzero(trace.touching_ego[0].any(axis=1))
    if touching.size:
        top.axvline(t[touching[0]], color=LINE, linestyle="--", linewidth=1)
        _above(top, float(t[touching[0]]), "bodies touch\n", LINE)
    limits(top, np.concatenate(shown))
    ends(top, each)
    if ideal is not None:
        off = trace.distance_m[0] - ideal.distance_m[0]
        lines = {end.label.partition(",")[0]: (off[:, j], end.own) for j, end in enumerate(each)}
        difference(panels[1], t, lines, "$\\Delta d_j$", "m")
    panels[-1].set_xlabel("time $t$ (s)")
    _head(figure, top, trace, ideal, axes)
    return figure


def comparison(a: Trace, b: Trace, labels: Sequence[str], axes: Panels = None) -> Figure:
    """Opinion, lateral position and distances of two runs, the first broad and pale, and how they differ.

    Args:
        a: what happened in one; simulation 0.
        b: what happened in the other, likewise.
        labels: what they are called.
        axes: four panels to draw into, in place of a figure of its own.

    Returns:
        The figure: its own, or that of the panels.

    Raises:
        MjmergeError: it is another number of panels.
    """
    figure, (opinion, lateral, distance, apart) = sheet((2, 2, 3, 1.5), 9.6, axes=axes)
    in_a, in_b = shared_ticks(a, b)
    style: tuple[dict[str, Any], ...] = (PALE, {})
    with_z = not any(np.isnan(trace.opinion[0]).all() for trace in (a, b))
    for trace, label, how in zip((a, b), "AB" if axes is None else labels, style, strict=True):
        shown = trace.opinion[0] if with_z else trace.u_mps2[0, :, 0, 0]
        opinion.plot(trace.time_s, shown, color=OPINION, label=words(label), **how)
        lateral.plot(trace.time_s, trace.front_m[0, :, 0, 1], color=COLOURS["ego"], **how)
    for trace, how in zip((a, b), style, strict=True):
        for j, car in enumerate(trace.roster.neighbours):
            distance.plot(trace.time_s, trace.distance_m[0, :, j], color=colour(car), **how)
    opinion.set_ylabel("opinion $z$" if with_z else "command along (m/s²)")
    lateral.set_ylabel("ego's $\\eta^{\\!\\top}\\!p$ (m)")
    distance.set_ylabel("distance $d_j$ (m)")
    distance.axhline(0, color=LINE, linewidth=1)
    both = min((a.roster, b.roster), key=lambda there: len(there.cars)).neighbours
    off = b.distance_m[0, in_b, : len(both)] - a.distance_m[0, in_a, : len(both)]
    lines = {f"$d_{j + 1}$": (off[:, j], colour(car)) for j, car in enumerate(both)}
    difference(apart, a.time_s[in_a], lines, "$\\Delta d_j$", "m")
    apart.set_xlabel("time $t$ (s)")
    ends(lateral, [End("ego", b.front_m[0, :, 0, 1], COLOURS["ego"])])
    more = b if len(b.roster.cars) >= len(a.roster.cars) else a
    named = [b if j < len(both) else more for j in range(len(more.roster.neighbours))]
    each = zip(more.roster.neighbours, named, strict=True)
    ends(
        distance,
        [End(f"$d_{{{j}}}$", of.distance_m[0, :, j - 1], colour(car)) for j, (car, of) in enumerate(each, 1)],
    )
    opinion.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, ncols=2, borderaxespad=0.2)
    if axes is None:
        said = [
            f"{letter}: " + "; ".join(dict.fromkeys((label.removeprefix(f"{letter}: "), *ran(one))))
            for letter, label, one in zip("AB", labels, (a, b), strict=True)
        ]
        head(figure, *said)
    return figure


def difference(axes: Axes, t: Array, lines: Mapping[str, tuple[Array, str]], of: str, unit: str) -> None:
    """A panel of differences, and the largest in words; of lengths in mm where all are small.

    Args:
        axes: the panel.
        t: times, s, (T,).
        lines: each difference by its name, (T,), and its colour.
        of: of what.
        unit: ``m``, or none.
    """
    largest = max(np.nanmax(np.abs(values)) for values, _ in lines.values())
    said = length(largest) if unit == "m" else f"{largest:.3g}"
    scale = 1e3 if said.endswith(" mm") else 1.0
    for values, own in lines.values():
        axes.plot(t, scale * values, color=own, linewidth=1)
    axes.set_ylabel(f"{of} ({said.split()[1]})" if unit else of)
    axes.set_title(f"at most {said}", loc="right", fontsize=9, pad=3)
    ends(axes, [End(name, scale * values, own) for name, (values, own) in lines.items() if name])


def _shade_closing(axes: Axes, trace: Trace, *, told: bool = False) -> None:
    """Marks when the follower does not yield: when it comes closer to the leader; says so above the first."""
    speed, law = trace.velocity_mps[0, :, 1:, 0], trace.scenario.law
    closing = speed[:, law.j_2] - speed[:, law.j_1] > 0.005
    edges = np.flatnonzero(np.diff(np.concatenate([[False], closing, [False]]).astype(int)))
    t, own = trace.time_s, colour(law.follower)
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(t[start], t[end - 1], color=own, alpha=0.12, linewidth=0)
    if told and edges.size:
        who = f"{law.follower.replace('_', ' ')} closes the gap"
        _above(axes, float(t[edges[0]]), who, own)


def _above(axes: Axes, time_s: float, text: str, own: str) -> None:
    """Says above a panel what is from a time on; a line higher where a line is left empty."""
    axes.text(time_s, 1.01, text, transform=axes.get_xaxis_transform(), color=own, va="bottom", fontsize=9)


def _head(figure: Figure, top: Axes, trace: Trace, ideal: Trace | None, axes: Panels) -> None:
    """What ran, and which of two it is that is broad and pale; in a panel that was given, above that."""
    said = ran(trace) if ideal is None else ran_both(trace, ideal)
    if axes is None:
        head(figure, *said)
    else:
        top.set_title(words("\n".join(said)), loc="left", fontsize=9, pad=14)
