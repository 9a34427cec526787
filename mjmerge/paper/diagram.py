"""The bifurcation diagram, drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mjmerge.figures.overview import ran_both
from mjmerge.figures.runs import difference
from mjmerge.figures.style import MU, OPINION, PALE, head, sheet
from mjmerge.paper.bifurcation import Branches
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array
from mjmerge.verdict.metrics import INTENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_ARROW = 0.04  # least way of z that gets an arrowhead


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
    head(
        figure,
        "the opinion with μ held: circles are where it starts, dots where it comes to rest",
    )
    return figure


def bifurcation_run(found: Branches, trace: Trace, ideal: Trace) -> Figure:
    """The branches, and the way that mu and z took over them in a run, beside the ideal one; simulation 0."""
    figure, (plane, course) = sheet((1,), 4.2, columns=2)
    _draw_branches(plane, found)
    plane.plot(ideal.mu[0], ideal.opinion[0], color=OPINION, **PALE)
    plane.plot(trace.mu[0], trace.opinion[0], color=OPINION)
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
    difference(course, t, lines, f"{trace.plant} less ideal", "")
    course.set_xlabel("time $t$ (s)")
    head(figure, *ran_both(trace, ideal))
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


def _colours_of(mu: Array) -> list[str]:
    """From blue, mu < 0, to purple, mu > 0."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    below, above = colormaps["Blues_r"], colormaps["Purples"]
    half = max(float(np.abs(mu).max()), 1e-12)
    shades = [below(0.55 + 0.5 * m / half) if m < 0 else above(0.45 + 0.5 * m / half) for m in mu.tolist()]
    return [to_hex(shade) for shade in shades]
