"""Figures of a search for failures: how the margin fell, run by run, and where in the space they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.figures.style import COLOURS, LINE, head, sheet
from mjmerge.scenario.ran import ran
from mjmerge.search.falsify import Search
from mjmerge.search.space import Coordinate
from mjmerge.sweep.plan import MISMATCH

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHADES = ((COLOURS["vehicle_1"], "o", "dots"), (COLOURS["vehicle_2"], "^", "triangles"))
"""Of a search, and of the one beside it."""
_NAMES = {"cma": "CMA-ES", "random": "uniform random", "samples": "samples"}


def progress(searches: Sequence[Search]) -> Figure:
    """The margin of every fair run, the least so far, and how many failures there are by then.

    Args:
        searches: one, or two by different methods.
    """
    figure, (margins, counts) = sheet((3, 2), 6.0)
    for found, (shade, mark, _) in zip(searches, _SHADES, strict=False):
        fair = [look for look in found.looks if look.margin_m is not None]
        at = np.array([look.number + 1 for look in fair])
        m = np.array([look.margin_m for look in fair], dtype=float)
        fails = np.array([look.fails for look in fair], dtype=bool)
        margins.scatter(at[~fails], m[~fails], s=9, color=shade, marker=mark, alpha=0.35, linewidth=0)
        margins.scatter(at[fails], m[fails], s=24, color=shade, marker="x", linewidth=1, zorder=3)
        runs = len(found.looks)
        if fair:
            least = np.minimum.accumulate(m)
            margins.step([*at, runs], [*least, least[-1]], where="post", color=shade, linewidth=1.2)
        number = np.array([look.number + 1 for look in found.failures])
        counts.step([0, *number, runs], [*range(len(number) + 1), len(number)], where="post", color=shade)
        counts.annotate(
            f"{_NAMES[found.method]}: {len(number)}",
            (runs, len(number)),
            (-4, 4),
            textcoords="offset points",
            ha="right",
            color=shade,
        )
    margins.axhline(0, color=LINE, linewidth=1)
    margins.set_ylabel("least $d_j$ or clearance (m)")
    margins.margins(y=0.08)
    counts.set_ylabel("failures so far")
    counts.set_xlabel("run")
    counts.margins(y=0.15)
    marks = [f"{form} ({_NAMES[found.method]})" for found, (*_, form) in zip(searches, _SHADES, strict=False)]
    ground = searches[0].ground
    head(
        figure,
        *ran(ground.scenario, ground.plant),
        f"{' and '.join(marks)} are fair runs, crosses fail, lines are the least so far",
    )
    return figure


def where(found: Search) -> Figure:
    """What each coordinate was in every fair run, and in those that failed."""
    coordinates = found.ground.coordinates
    figure, (axes,) = sheet((1,), 1.2 + 0.28 * len(coordinates))
    rng = np.random.default_rng(0)  # so that dots do not hide each other
    for fails, shade, mark, size, alpha in ((False, "#777777", "o", 7, 0.25), (True, LINE, "x", 16, 0.9)):
        points = [look.point for look in found.looks if look.fair and look.fails == fails]
        if not points:
            continue
        x = np.array(points)
        rows = np.broadcast_to(np.arange(len(coordinates)), x.shape)
        y = rows + 0.5 * (rng.random(x.shape) - 0.5)
        width = 1 if fails else 0
        axes.scatter(x.ravel(), y.ravel(), s=size, color=shade, marker=mark, alpha=alpha, linewidth=width)
    axes.set_yticks(range(len(coordinates)), [name(one) for one in coordinates], fontsize=9)
    axes.set_ylim(len(coordinates) - 0.5, -0.5)
    for k, one in enumerate(coordinates):
        low, high = (_text(one.spread.at(part)) for part in (0.0, 1.0))
        axes.text(1.02, k, f"{low} to {high}", va="center", fontsize=9, transform=axes.get_yaxis_transform())
    axes.set_xlim(-0.02, 1.02)
    axes.set_xticks([0, 0.5, 1], ["least", "", "most"])
    ground = found.ground
    head(
        figure,
        *ran(ground.scenario, ground.plant),
        f"dots are fair runs, red crosses the {len(found.failures)} that fail, beside them the range of each",
    )
    return figure


def name(one: Coordinate) -> str:
    """A coordinate in words."""
    parts = one.key.split(".")
    if len(parts) == 4 and parts[0] == "drivers":
        what = {"wait_s": "waits (s)", "gap_m": "gap (m)", "speed_mps": "speed (m/s)"}
        car = parts[1].replace("_", " ").capitalize()
        return f"{car}, change {int(parts[2]) + 1}: {what.get(parts[3], 'at most (m/s²)')}"
    return one.key.removeprefix(MISMATCH)


def _text(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
