"""Figures of traces, as the paper draws them: functions from traces to matplotlib figures, and to files.

A figure of one run, or of a run beside the ideal one: then the ideal is a broad pale line below, and a panel
shows the difference. Lengths in m, time in s; nothing here opens a window.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.outputs import written
from mjmerge.paper.bifurcation import Branches
from mjmerge.scenario.schema import CARS
from mjmerge.simulation.trace import NEIGHBOURS, Trace
from mjmerge.state import Array
from mjmerge.verdict.metrics import INTENT, shared_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {"ego": "#2a9d55", "vehicle_1": "#2c61bf", "vehicle_2": "#d97321"}
OPINION = "#7b3fa0"
MU = "#999999"
LINE = "#c00000"
"""The lane of the vehicles, and the margin."""
_DPI = 110
_ARROW = 0.04  # least way of z that gets an arrowhead
_PALE: dict[str, Any] = {"linewidth": 5, "alpha": 0.3, "solid_capstyle": "butt"}


def words(text: str) -> str:
    """A name in a figure as it is: matplotlib would read formulas between dollar signs."""
    return text.replace("$", "\\$")


def sheet(heights: Sequence[float], height_in: float, columns: int = 1) -> tuple[Figure, Any]:
    """An empty figure and its axes: panels of these relative heights over one time axis, or columns."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    grid = {"height_ratios": heights}
    axes = figure.subplots(len(heights), columns, sharex=columns == 1, squeeze=False, gridspec_kw=grid)
    for panel in axes.flat:
        panel.grid(alpha=0.25)
        panel.margins(x=0)
    return figure, axes[0] if columns > 1 else axes[:, 0]


def save(figure: Figure, path: Path, ending: str = "") -> None:
    """As PNG or PDF, by the path's ending unless given; the same figure gives the same bytes, whenever."""
    nothing = {
        ".png": {"Software": None},
        ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    }
    ending = ending or path.suffix
    with written(path) as partial:
        figure.savefig(partial, dpi=_DPI, metadata=nothing[ending], format=ending[1:])


def save_columns(columns: Mapping[str, Array], path: Path) -> None:
    """As CSV, a header of names that end in their units, and every number in full.

    Args:
        columns: one-dimensional, all of one length.
        path: file to write.
    """
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    save_rows(chain([columns], rows), path)


def save_rows(rows: Iterable[Iterable[object]], path: Path) -> None:
    """As CSV, every row on a line.

    Args:
        rows: the header, and what stands below it.
        path: file to write.
    """
    with written(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def overview(trace: Trace, run: int = 0) -> Figure:
    """Opinion, lateral positions and distances of one run."""
    figure, (opinion, lateral, distance) = sheet((1, 1, 1), 8.5)
    t = trace.time_s
    opinion.plot(t, trace.opinion[run], color=OPINION, label="$z$")
    opinion.plot(t, trace.mu[run], color=MU, linewidth=0.8, label="$\\mu$")
    opinion.set_ylabel("opinion")
    for c, car in enumerate(CARS):
        lateral.plot(t, trace.front_m[run, :, c, 1], color=COLOURS[car], label=_name(car))
    lateral.set_ylabel("lateral position $\\eta^\\top p$ (m)")
    _draw_distances(distance, trace, run)
    distance.set_xlabel("time (s)")
    for axes in (opinion, lateral, distance):
        axes.legend(loc="upper right", frameon=False)
    figure.suptitle(f"{words(trace.scenario.name)} on {trace.plant}, seed {trace.seeds[run]}")
    return figure


def opinion(trace: Trace, ideal: Trace | None = None) -> Figure:
    """Opinion and lateral position of the ego, with the lane of the vehicles in red; simulation 0."""
    figure, panels = sheet((3, 3) if ideal is None else (3, 1, 3, 1), 5.4 if ideal is None else 7.2)
    top, bottom = (panels[0], panels[1]) if ideal is None else (panels[0], panels[2])
    t = trace.time_s
    _shade_closing(top, trace, "Vehicle 2 closes the gap")
    _shade_closing(bottom, trace)
    top.axhline(trace.scenario.law.k_s / trace.scenario.law.k_mu, color=MU, linestyle=":", label="$1/k_\\mu$")
    bottom.axhline(trace.front_m[0, 0, 1, 1], color=LINE, label="lane of Vehicles 1 and 2")
    if ideal is not None:
        top.plot(t, ideal.opinion[0], color=OPINION, label="$z$, ideal", **_PALE)
        bottom.plot(t, ideal.front_m[0, :, 0, 1], color=COLOURS["ego"], label="ego, ideal", **_PALE)
    top.plot(t, trace.opinion[0], color=OPINION, label=_label("$z$", trace, ideal))
    bottom.plot(t, trace.front_m[0, :, 0, 1], color=COLOURS["ego"], label=_label("ego", trace, ideal))
    top.set_ylabel("opinion $z$")
    top.set_ylim(-0.01, 0.235)
    bottom.set_ylabel("lateral position $\\eta^\\top p$ (m)")
    if ideal is not None:
        _difference(panels[1], t, {"": (trace.opinion[0] - ideal.opinion[0], OPINION)}, "$\\Delta z$", 1, "")
        off = trace.front_m[0, :, 0, 1] - ideal.front_m[0, :, 0, 1]
        _difference(panels[3], t, {"": (off, COLOURS["ego"])}, "$\\Delta\\eta^\\top p$", 1e3, "mm")
    panels[-1].set_xlabel("time $t$ (s)")
    top.legend(loc="lower right", frameon=False)
    bottom.legend(loc="upper right", frameon=False)
    return figure


def distances(trace: Trace, ideal: Trace | None = None) -> Figure:
    """d_1 and d_2, with the margin in red; simulation 0."""
    figure, panels = sheet((3,) if ideal is None else (3, 1), 3.6 if ideal is None else 5.2)
    top, t = panels[0], trace.time_s
    _shade_closing(top, trace, "Vehicle 2 closes the gap")
    if ideal is not None:
        _draw_distances(top, ideal, 0, ", ideal", **_PALE)
    _draw_distances(top, trace, 0, "" if ideal is None else f", {trace.plant}")
    for j, car in enumerate(NEIGHBOURS):
        d = trace.distance_m[0, :, j]
        least = int(np.nanargmin(d))
        top.plot(t[least], d[least], "o", color=COLOURS[car], markersize=4)
        top.annotate(
            f"{d[least]:.3f} m".replace("-", "\N{MINUS SIGN}"),
            (t[least], d[least]),
            xytext=(0, -13),
            textcoords="offset points",
            ha="center",
            color=COLOURS[car],
        )
    touching = np.flatnonzero(trace.touching[0, :, :2].any(axis=1))
    if touching.size:
        top.axvline(t[touching[0]], color=LINE, linestyle="--", linewidth=1, label="bodies touch")
    top.margins(y=0.12)
    if ideal is not None:
        off = trace.distance_m[0] - ideal.distance_m[0]
        lines = {f"$d_{j + 1}$": (off[:, j], COLOURS[car]) for j, car in enumerate(NEIGHBOURS)}
        _difference(panels[1], t, lines, "$\\Delta d_j$", 1e3, "mm")
    panels[-1].set_xlabel("time $t$ (s)")
    top.legend(loc="upper right", frameon=False, ncols=1 if ideal is None else 2)
    return figure


def comparison(a: Trace, b: Trace, labels: tuple[str, str]) -> Figure:
    """Opinion, lateral position and distances of two runs, the first broad and pale, and how they differ."""
    figure, (opinion, lateral, distance, apart) = sheet((2, 2, 3, 1.5), 9.6)
    in_a, in_b = shared_ticks(a, b)
    style: tuple[dict[str, Any], ...] = (_PALE, {})
    for trace, label, how in zip((a, b), map(words, labels), style, strict=True):
        opinion.plot(trace.time_s, trace.opinion[0], color=OPINION, label=label, **how)
        lateral.plot(trace.time_s, trace.front_m[0, :, 0, 1], color=COLOURS["ego"], label=label, **how)
    for trace, how in zip((a, b), style, strict=True):
        for j, car in enumerate(NEIGHBOURS):
            name = f"$d_{j + 1}$ to {_name(car)}" if trace is b else None
            distance.plot(trace.time_s, trace.distance_m[0, :, j], color=COLOURS[car], label=name, **how)
    opinion.set_ylabel("opinion $z$")
    lateral.set_ylabel("ego's $\\eta^\\top p$ (m)")
    distance.set_ylabel("distance $d_j$ (m)")
    distance.axhline(0, color=LINE, linewidth=1)
    off = b.distance_m[0, in_b] - a.distance_m[0, in_a]
    lines = {f"$d_{j + 1}$": (off[:, j], COLOURS[car]) for j, car in enumerate(NEIGHBOURS)}
    _difference(apart, a.time_s[in_a], lines, "$\\Delta d_j$", 1e3, "mm")
    apart.set_xlabel("time $t$ (s)")
    for axes in (opinion, distance):
        axes.legend(loc="upper right", frameon=False)
    return figure


def bifurcation(found: Branches, mu: Array, time_s: Array, z: Array) -> Figure:
    """Stable and unstable branches, and trajectories with mu held that converge onto them.

    Args:
        found: the branches.
        mu: where it is held, (M,).
        time_s: of the trajectories, s, (T,).
        z: the trajectories, (T, M, K).
    """
    figure, (plane, course) = sheet((1,), 4.2, columns=2)
    _draw_branches(plane, found)
    for m, (held, colour) in enumerate(zip(mu.tolist(), _colours_of(mu), strict=True)):
        for start, end in zip(z[0, m].tolist(), z[-1, m].tolist(), strict=True):
            plane.plot((held, held), (start, end), color=colour, linewidth=1)
            if abs(end - start) > _ARROW:
                arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 0, "mutation_scale": 13}
                plane.annotate("", (held, 0.35 * end + 0.65 * start), (held, start), arrowprops=arrow)
        plane.plot(np.full(z.shape[2], held), z[0, m], "o", color=colour, fillstyle="none", markersize=5)
        plane.plot(np.full(z.shape[2], held), z[-1, m], "o", color=colour, markersize=5)
        course.plot(time_s, z[:, m], color=colour, linewidth=1)
        course.plot([], [], color=colour, label=f"$\\mu = {held:g}$")
    plane.set_ylim(1.15 * found.mu[0], 1.35 * found.mu[-1])
    plane.legend(loc="lower right", frameon=False)
    course.set_xlabel("time $t$ (s)")
    course.set_ylabel("opinion $z$, with $\\mu$ held")
    course.set_ylim(-0.004, 1.3 * z[0].max())
    course.legend(loc="upper right", frameon=False, ncols=2)
    return figure


def bifurcation_run(found: Branches, trace: Trace, ideal: Trace) -> Figure:
    """The branches, and the way that mu and z took over them in a run, beside the ideal one; simulation 0."""
    figure, (plane, course) = sheet((1,), 4.2, columns=2)
    _draw_branches(plane, found)
    plane.plot(ideal.mu[0], ideal.opinion[0], color=OPINION, label="the run, ideal", **_PALE)
    plane.plot(trace.mu[0], trace.opinion[0], color=OPINION, label=f"the run, {trace.plant}")
    t = trace.time_s
    wants = trace.weight[0] > INTENT
    for tick in (0, *(int(k) + 1 for k in np.flatnonzero(np.diff(wants)))):
        what = "start" if tick == 0 else "wants to merge" if wants[tick] else "gives up"
        at = (trace.mu[0, tick], trace.opinion[0, tick])
        side, gap = ("left", (7, 6)) if tick == 0 else ("right" if at[0] > 0 else "center", (0, -18))
        plane.plot(*at, "o", color=OPINION, markersize=4)
        plane.annotate(
            f"{what}, {t[tick]:.1f} s", at, xytext=gap, textcoords="offset points", ha=side, fontsize=9
        )
    plane.set_ylim(1.15 * found.mu[0], 1.35 * found.mu[-1])
    plane.legend(loc="lower right", frameon=False, fontsize=9)
    lines = {
        "$\\mu$": (trace.mu[0] - ideal.mu[0], MU),
        "$z$": (trace.opinion[0] - ideal.opinion[0], OPINION),
    }
    _difference(course, t, lines, f"{trace.plant} less ideal", 1, "")
    course.set_xlabel("time $t$ (s)")
    return figure


def _draw_branches(axes: Axes, found: Branches) -> None:
    """Solid where stable, dotted where not."""
    for stable, style, name in ((True, "-", "stable equilibria"), (False, ":", "unstable equilibria")):
        for branch in range(2):
            z = np.where(found.stable[:, branch] == stable, found.z[:, branch], np.nan)
            label = name if branch == 0 else None
            axes.plot(found.mu, z, color="black", linestyle=style, linewidth=1.8, label=label)
    axes.set_xlabel("bifurcation parameter $\\mu$")
    axes.set_ylabel("opinion $z$")


def _draw_distances(axes: Axes, trace: Trace, run: int, of: str = "", **style: Any) -> None:
    """d_1 and d_2 of one run, and the margin."""
    for j, car in enumerate(NEIGHBOURS):
        label = f"$d_{j + 1}$ to {_name(car)}{of}"
        axes.plot(trace.time_s, trace.distance_m[run, :, j], color=COLOURS[car], label=label, **style)
    axes.axhline(0, color=LINE, linewidth=1)
    axes.set_ylabel("distance $d_j$ (m)")


def _difference(
    axes: Axes, t: Array, lines: Mapping[str, tuple[Array, str]], of: str, scale: float, unit: str
) -> None:
    """A panel of differences, and the largest in words."""
    for name, (values, colour) in lines.items():
        axes.plot(t, scale * values, color=colour, linewidth=1, label=name or None)
    largest = max(np.nanmax(np.abs(values)) for values, _ in lines.values()) * scale
    axes.set_ylabel(f"{of} ({unit})" if unit else of)
    axes.text(
        0.99, 0.93, f"at most {largest:.3g} {unit}".strip(), transform=axes.transAxes, ha="right", va="top"
    )
    if len(lines) > 1:
        axes.legend(loc="lower right", frameon=False, ncols=2, fontsize=9)


def _shade_closing(axes: Axes, trace: Trace, label: str | None = None) -> None:
    """Marks when Vehicle 2 does not yield: when it comes closer to Vehicle 1."""
    speed = trace.velocity_mps[0, :, :, 0]
    closing = speed[:, 2] - speed[:, 1] > 0.005
    edges = np.flatnonzero(np.diff(np.concatenate([[False], closing, [False]]).astype(int)))
    t = trace.time_s
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(t[start], t[end - 1], color=COLOURS["vehicle_2"], alpha=0.12, linewidth=0, label=label)
        label = None


def _colours_of(mu: Array) -> list[str]:
    """From blue, mu < 0, to purple, mu > 0."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    below, above = colormaps["Blues_r"], colormaps["Purples"]
    half = max(float(np.abs(mu).max()), 1e-12)
    shades = [below(0.55 + 0.5 * m / half) if m < 0 else above(0.45 + 0.5 * m / half) for m in mu.tolist()]
    return [to_hex(shade) for shade in shades]


def _name(car: str) -> str:
    return car.replace("_", " ")


def _label(name: str, trace: Trace, ideal: Trace | None) -> str:
    return name if ideal is None else f"{name}, {trace.plant}"
