"""Figures of traces, as the paper draws them: functions from traces to matplotlib figures, or into axes.

A figure of one run, or of a run beside the ideal one: then the ideal is a broad pale line below, and a panel
shows the difference. Lengths in m, time in s; nothing here opens a window.
"""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.figures.overview import LETTERS, ran
from mjmerge.figures.style import COLOURS, LINE, MU, OPINION, PALE, End, Panels, ends, length, sheet, words
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
    t = trace.time_s
    _shade_closing(top, trace, f"{_vehicle(trace.scenario.law.follower)} closes the gap")
    _shade_closing(bottom, trace)
    paper = of_paper(trace.scenario.law)
    top.axhline(paper.k_s / paper.k_mu, color=MU, linestyle=":", label="$1/k_\\mu$")
    law = trace.scenario.law
    lane = f"lane of Vehicles {law.j_1 + 1} and {law.j_2 + 1}"
    bottom.axhline(trace.front_m[0, 0, 1 + law.j_1, 1], color=LINE, label=lane)
    if ideal is not None:
        top.plot(t, ideal.opinion[0], color=OPINION, label="$z$, ideal", **PALE)
        bottom.plot(t, ideal.front_m[0, :, 0, 1], color=COLOURS["ego"], label="ego, ideal", **PALE)
    top.plot(t, trace.opinion[0], color=OPINION, label=_label("$z$", trace, ideal))
    bottom.plot(t, trace.front_m[0, :, 0, 1], color=COLOURS["ego"], label=_label("ego", trace, ideal))
    top.set_ylabel("opinion $z$")
    top.set_ylim(-0.01, 0.235)
    bottom.set_ylabel("lateral position $\\eta^\\top p$ (m)")
    if ideal is not None:
        difference(panels[1], t, {"": (trace.opinion[0] - ideal.opinion[0], OPINION)}, "$\\Delta z$", "")
        off = trace.front_m[0, :, 0, 1] - ideal.front_m[0, :, 0, 1]
        difference(panels[3], t, {"": (off, COLOURS["ego"])}, "$\\Delta\\eta^\\top p$", "m")
    panels[-1].set_xlabel("time $t$ (s)")
    top.legend(loc="lower right", frameon=False)
    bottom.legend(loc="upper right", frameon=False)
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
    heights, height_in = ((3,), 3.6) if ideal is None else ((3, 1), 5.2)
    figure, panels = sheet(heights, height_in, axes=axes)
    top, t = panels[0], trace.time_s
    _shade_closing(top, trace, f"{_vehicle(trace.scenario.law.follower)} closes the gap")
    if ideal is not None:
        _draw_distances(top, ideal, 0, ", ideal", **PALE)
    _draw_distances(top, trace, 0, "" if ideal is None else f", {trace.plant}")
    for j, car in enumerate(trace.roster.neighbours):
        d = trace.distance_m[0, :, j]
        least = int(np.nanargmin(d))
        top.plot(t[least], d[least], "o", color=colour(car), markersize=4)
        top.annotate(
            f"{d[least]:.3f} m".replace("-", "\N{MINUS SIGN}"),
            (t[least], d[least]),
            xytext=(0, -13),
            textcoords="offset points",
            ha="center",
            color=colour(car),
        )
    touching = np.flatnonzero(trace.touching_ego[0].any(axis=1))
    if touching.size:
        top.axvline(t[touching[0]], color=LINE, linestyle="--", linewidth=1, label="bodies touch")
    top.margins(y=0.12)
    if ideal is not None:
        off = trace.distance_m[0] - ideal.distance_m[0]
        lines = {f"$d_{j + 1}$": (off[:, j], colour(car)) for j, car in enumerate(trace.roster.neighbours)}
        difference(panels[1], t, lines, "$\\Delta d_j$", "m")
    panels[-1].set_xlabel("time $t$ (s)")
    top.legend(loc="upper right", frameon=False, ncols=1 if ideal is None else 2)
    return figure


def comparison(a: Trace, b: Trace, labels: tuple[str, str], axes: Panels = None) -> Figure:
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
    lateral.set_ylabel("ego's $\\eta^\\top p$ (m)")
    distance.set_ylabel("distance $d_j$ (m)")
    distance.axhline(0, color=LINE, linewidth=1)
    both = min((a.roster, b.roster), key=lambda there: len(there.cars)).neighbours
    off = b.distance_m[0, in_b, : len(both)] - a.distance_m[0, in_a, : len(both)]
    lines = {f"$d_{j + 1}$": (off[:, j], colour(car)) for j, car in enumerate(both)}
    difference(apart, a.time_s[in_a], lines, "$\\Delta d_j$", "m")
    apart.set_xlabel("time $t$ (s)")
    ends(lateral, [End("ego", b.front_m[0, :, 0, 1], COLOURS["ego"])])
    each = enumerate(b.roster.neighbours)
    ends(distance, [End(f"$d_{{{j + 1}}}$", b.distance_m[0, :, j], colour(car)) for j, car in each])
    opinion.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, ncols=2, borderaxespad=0.2)
    if axes is None:
        each_line = []
        for letter, label, one in zip("AB", labels, (a, b), strict=True):
            said = (label.removeprefix(f"{letter}: "), *ran(one))
            each_line += wrap(f"{letter}: {'; '.join(said)}", LETTERS)
        figure.suptitle(words("\n".join(each_line)), x=0.01, ha="left", fontsize=9)
    return figure


def _draw_distances(axes: Axes, trace: Trace, run: int, of: str = "", **style: Any) -> None:
    """Every d_j of one run, and the margin."""
    for j, car in enumerate(trace.roster.neighbours):
        label = f"$d_{j + 1}$ to {_name(car)}{of}"
        axes.plot(trace.time_s, trace.distance_m[run, :, j], color=colour(car), label=label, **style)
    if trace.edge_distance_m is not None:
        label, dashed = f"body to the edge{of}", {"linestyle": "--", "color": "0.4"} | style
        axes.plot(trace.time_s, trace.edge_distance_m[run], label=label, **dashed)
    axes.axhline(0, color=LINE, linewidth=1)
    axes.set_ylabel("distance $d_j$ (m)")


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


def _shade_closing(axes: Axes, trace: Trace, label: str | None = None) -> None:
    """Marks when the follower does not yield: when it comes closer to the leader."""
    speed, law = trace.velocity_mps[0, :, 1:, 0], trace.scenario.law
    closing = speed[:, law.j_2] - speed[:, law.j_1] > 0.005
    edges = np.flatnonzero(np.diff(np.concatenate([[False], closing, [False]]).astype(int)))
    t = trace.time_s
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(t[start], t[end - 1], color=colour(law.follower), alpha=0.12, linewidth=0, label=label)
        label = None


def _name(car: str) -> str:
    return car.replace("_", " ")


def _vehicle(car: str) -> str:
    """As the paper calls it: Vehicle 2."""
    return _name(car).capitalize()


def _label(name: str, trace: Trace, ideal: Trace | None) -> str:
    return name if ideal is None else f"{name}, {trace.plant}"
