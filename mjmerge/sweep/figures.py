"""Figures of a sweep: the margins of named mismatches, and clouds of runs along each axis."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

from mjmerge.figures.style import COLOURS, LINE, MU, OPINION, head, sheet
from mjmerge.roster import paint
from mjmerge.sweep.campaign import GRID, RANDOM
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.rows import (
    BELOW,
    EMPTY,
    ENDED,
    FAILED,
    MARGIN,
    OFF,
    PASSED,
    TOUCHES,
    Rows,
    broke,
    groups,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_PANELS = 24
_MORE = ("vehicle_4", "vehicle_5", "vehicle_6", "vehicle_8")
"""Cars whose colours further laws have."""
_VARIANTS = (COLOURS["ego"], COLOURS["vehicle_1"], COLOURS["vehicle_2"], OPINION, MU, *map(paint, _MORE))
_MARKS = "os^vDPp*h"
"""Of laws."""
_CAME = {
    PASSED: COLOURS["ego"],
    EMPTY: MU,
    TOUCHES: LINE,
    MARGIN: COLOURS["vehicle_2"],
    OFF: OPINION,
    ENDED: "black",
    BELOW: COLOURS["vehicle_1"],
}
"""What can come of a run, and its colour; marks of those that failed are open."""


def figures(plan: Plan, rows: Rows) -> Iterator[tuple[str, Figure]]:
    """Every figure and its file."""
    names = _file_names([row["scenario"] for row in rows])
    for (scenario, plant), group in groups(rows, ("scenario", "plant")).items():
        title = f"{scenario} on {plant}{_set(plan, scenario, plant)}"
        named = [row for row in group if row["mismatch"] not in (GRID, RANDOM)]
        if len({row["mismatch"] for row in named}) > 1:
            yield f"margins_{names[scenario]}_{plant}.png", _margins(title, named)
        rest = [row for row in group if row["mismatch"] in (GRID, RANDOM)]
        axes = [axis for axis in plan.axes if _spread(axis, rest)]
        if axes:
            figure = _clouds(title, rest, axes[:_MOST_PANELS])
            yield f"axes_{names[scenario]}_{plant}.png", figure


def _set(plan: Plan, scenario: str, plant: str) -> str:
    """What all runs of a scenario on a plant are given beside its file, for a title."""
    of = [c for c in plan.cases if (plan.labels[c.batch.source], c.batch.plant) == (scenario, plant)]
    given = [text for text in of[0].overrides if all(text in case.overrides for case in of)]
    return f"; set: {', '.join(given)}" if given else ""


def _file_names(scenarios: Sequence[str]) -> dict[str, str]:
    """What of a file's name stands for each scenario: paths without their slashes, all different."""
    found: dict[str, str] = {}
    for scenario in dict.fromkeys(scenarios):
        name = scenario.strip("/").replace("/", "-")
        while name in found.values():
            name += "-"
        found[scenario] = name
    return found


def _spread(axis: str, rows: Rows) -> bool:
    values = {row[axis] for row in rows}
    return len(values) > 1 and all(isinstance(value, float) for value in values)


def _margins(title: str, rows: Rows) -> Figure:
    """Least d_j of every named mismatch, a mark per law variant; those of failures are open."""
    names = list(dict.fromkeys(row["mismatch"] for row in rows))
    laws = len(groups(rows, ("variant",)))
    figure, (axes,) = sheet((1,), 1.5 + max(0.22, 0.08 * laws) * len(names))
    beside = [0.8 * ((shown + 0.5) / laws - 0.5) for shown in range(laws)]
    for shown, ((variant,), of) in enumerate(groups(rows, ("variant",)).items()):
        colour, mark = _VARIANTS[shown % len(_VARIANTS)], _MARKS[shown % len(_MARKS)]
        axes.scatter([], [], s=26, color=colour, marker=mark, label=variant)
        for failed, face in ((False, colour), (True, "white")):
            part = [r for r in of if (r["outcome"] == FAILED) == failed and r["min_distance_m"] is not None]
            margins = [row["min_distance_m"] for row in part]
            heights = [names.index(row["mismatch"]) + beside[shown] for row in part]
            style = {"facecolor": face, "edgecolor": colour, "marker": mark, "s": 26, "zorder": 3}
            axes.scatter(margins, heights, **style)
    axes.scatter([], [], s=26, facecolor="white", edgecolor="black", label="failed")
    for row in range(1, len(names), 2):
        axes.axhspan(row - 0.5, row + 0.5, color="0.95", linewidth=0, zorder=0)
    axes.grid(visible=False, axis="y")
    _limits(axes, rows, axes.axvline)
    axes.set_yticks(range(len(names)), names, fontsize=9)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.margins(x=0.03)
    axes.set_xlabel("least $d_j$ (m)")
    head(figure, title)
    figure.legend(loc="outside lower center", ncols=6, frameon=False)
    return figure


def _clouds(title: str, rows: Rows, axes_: Sequence[str]) -> Figure:
    """Least d_j over the value of each axis, a mark per run: its law's, in the colour of what came of it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    known = [row for row in rows if row["min_distance_m"] is not None]
    marks = dict(zip(dict.fromkeys(row["variant"] for row in rows), cycle(_MARKS), strict=False))
    across = min(3, len(axes_))
    down = -(-len(axes_) // across)
    figure = Figure(figsize=(3.2 * across + 0.6, 2.6 * down + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(down, across, squeeze=False, sharey=True)
    for panel, axis in zip(panels.flat, axes_, strict=False):
        for (outcome, variant), of in groups(known, ("outcome", "variant")).items():
            for came in _CAME:
                part = [row for row in of if came == (broke(row) if outcome == FAILED else outcome)]
                panel.scatter(
                    [row[axis] for row in part],
                    [row["min_distance_m"] for row in part],
                    s=12 if len(marks) == 1 else 18,
                    marker=marks[variant],
                    **_style(came),
                )
        _limits(panel, rows, panel.axhline)
        panel.set_xlabel(axis, fontsize=9)
        panel.tick_params(labelsize=9)
        panel.locator_params(axis="x", nbins=5)
        panel.grid(alpha=0.25)
    for row in panels:
        row[0].set_ylabel("least $d_j$ (m)", fontsize=9)
    for panel in list(panels.flat)[len(axes_) :]:
        panel.set_visible(False)
    head(figure, title)
    blank, there = figure.axes[0], {broke(row) for row in known if row["outcome"] == FAILED}
    shown = [came for came in _CAME if came in there | {PASSED, EMPTY}]
    handles = [
        blank.scatter([], [], s=24, label=came.replace("d_j", "$d_j$"), **_style(came)) for came in shown
    ]
    if len(marks) > 1:
        handles += [
            blank.scatter([], [], s=24, marker=m, label=law, **_style("")) for law, m in marks.items()
        ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2 * across, frameon=False)
    return figure


def _style(came: str) -> dict[str, Any]:
    """How a mark is drawn: open where the run failed; black and open where it stands for a law."""
    own = _CAME.get(came, "black")
    return {"facecolor": own if came in (PASSED, EMPTY) else "none", "edgecolor": own, "linewidth": 0.8}


def _limits(axes: Axes, rows: Rows, line: Callable[..., Any]) -> None:
    """The margin, and the safety floor if there is one above it."""
    del axes
    line(0, color=LINE, linewidth=1)
    for floor in {row["floor_m"] for row in rows} - {0.0}:
        line(floor, color=LINE, linewidth=0.8, linestyle=":")
