"""What a person gets from a search for breaking points: the intervals as a table, every point, a plot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmerge.figures.style import COLOURS, LINE, MU, OPINION, head, save, save_rows
from mjmerge.outputs import put
from mjmerge.search.breaking import Break, Range, Tried, Until, margin
from mjmerge.sweep.rows import BELOW, ENDED, MARGIN, OFF, TOUCHES, broke

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.table import Table

FILES = ("breaking.png", "breaking.csv", "breaking.md")
"""All that is written."""


def write(
    found: Sequence[Break],
    folder: Path,
    title: str,
    until: Until,
    across: Range | None = None,
    seeds: int = 1,
) -> None:
    """Plot, every point that was run, and text."""
    figure = frontier(found, title, across, until) if across is not None else along_axes(found, title, until)
    save(figure, folder / "breaking.png")
    head = ("min_distance_m", "min_clearance_m", "verdict", "first_broken", "broken_at_s")
    rows = [
        (line.range.key, t.value, line.fixed, t.failed, *(t.row[name] for name in head))
        for line in found
        for t in line.tried
    ]
    header = ("axis", "value", across.key if across else "other", "failed", *head)
    save_rows([header, *rows], folder / "breaking.csv")
    put(folder / "breaking.md", markdown(found, title, until, across, seeds))


def seed_notes(found: Sequence[Break], seeds: int) -> list[str]:
    """Where so many seeds were asked for and are all the same run, a line per axis."""
    axes = dict.fromkeys(one.range.key for one in found if one.seeds < seeds)
    return [f"nothing is random along {axis}: {seeds} seeds are one run, which was run once" for axis in axes]


def markdown(
    found: Sequence[Break], title: str, until: Until, across: Range | None = None, seeds: int = 1
) -> str:
    """The intervals as a table."""
    what = "d_j <= 0 or bodies that touch" if until == "unsafe" else "a broken safety floor"
    name, *given = title.splitlines()
    lines = [f"# Breaking points of {name}", "", *([f"**{'; '.join(given)}**", ""] if given else [])]
    lines += [f"The smallest mismatch with {what}.", ""]
    head = ["axis", *([across.key] if across else []), "breaks", "least d_j before (m)", "and after (m)"]
    head += ["what broke first", "beyond it"]
    lines += ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for one in found:
        cells = [one.range.key, *([f"{one.fixed:.4g}"] if across else []), one.text]
        cells += [_least(one.passes), _least(one.fails), _first(one), _beyond(one)]
        lines.append("| " + " | ".join(cells) + " |")
    lines += [line for note in seed_notes(found, seeds) for line in ("", note[0].upper() + note[1:] + ".")]
    return "\n".join([*lines, "", "![Breaking points](breaking.png)"]) + "\n"


def rich_table(found: Sequence[Break], across: Range | None = None) -> Table:
    """Breaking points as a table for the terminal."""
    from rich.table import Table

    other = [across.key] if across else []
    grid = Table("axis", *other, "breaks", "what broke first", "beyond it", box=None, pad_edge=False)
    for one in found:
        fixed = [f"{one.fixed:.4g}"] if across else []
        grid.add_row(one.range.key, *fixed, one.text, _first(one), _beyond(one))
    return grid


def as_json(found: Sequence[Break], across: Range | None = None) -> list[dict[str, Any]]:
    """What ``--json`` prints."""
    return [
        {
            "axis": one.range.key,
            "searched": [one.range.start, one.range.end],
            **({across.key: one.fixed} if across else {}),
            "passes_at": one.passes.value if one.passes else None,
            "fails_at": one.fails.value if one.fails else None,
            "min_distance_before_m": one.passes.row["min_distance_m"] if one.passes else None,
            "min_distance_after_m": one.fails.row["min_distance_m"] if one.fails else None,
            "first_broken": one.fails.row["first_broken"] if one.fails else None,
            "distinct_seeds": one.seeds,
            "passes_again_at": [t.value for t in one.again],
            "command": " ".join(("mjmerge", *one.fails.case.command)) if one.fails else None,
        }
        for one in found
    ]


def _least(tried: Tried | None) -> str:
    value = tried.row["min_distance_m"] if tried else None
    return "-" if value is None else f"{value:.4f}"


def _first(one: Break) -> str:
    return "-" if one.fails is None else one.fails.row["first_broken"] or "nothing"


def _beyond(one: Break) -> str:
    if one.fails is None:
        return "-"
    return (
        f"passes again at {', '.join(f'{t.value:.4g}' for t in one.again)}" if one.again else "stays broken"
    )


SAFE = "safe"
_MARKS = {
    SAFE: ("o", COLOURS["ego"]),
    TOUCHES: ("X", LINE),
    MARGIN: ("v", COLOURS["vehicle_2"]),
    OFF: ("s", OPINION),
    ENDED: ("D", "black"),
    BELOW: ("v", MU),
}
"""What can come of a point, and how it is drawn."""


def came(tried: Tried) -> str:
    """What came of a point, of its worst seed."""
    return broke(tried.row) if tried.failed else SAFE


def along_axes(found: Sequence[Break], title: str, until: Until) -> Figure:
    """Least d_j along every axis, what broke at each point, and the interval of the first break."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 1.1 + 2.5 * len(found)), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, one in zip(figure.subplots(len(found), 1, squeeze=False)[:, 0], found, strict=True):
        known = [t for t in one.tried if t.row["min_distance_m"] is not None]
        at = [(t.value, margin(t.row)) for t in known]
        axes.plot(*zip(*at, strict=True), color=MU, linewidth=0.8)
        _scatter(axes, known, at, 26)
        axes.axhline(0, color=LINE, linewidth=1)
        if one.fails and one.passes:
            axes.axvline(one.fails.value, color=LINE, linestyle="--", linewidth=0.8)
        axes.set_xlabel(one.range.key)
        axes.set_ylabel("least $d_j$ (m)")
        breaks = f"breaks {one.text}" if one.fails else f"does not break{one.text.removeprefix('never')}"
        axes.set_title(breaks, fontsize=9, loc="left")
        axes.grid(alpha=0.25)
    _legend(figure, until)
    head(figure, title)
    return figure


def frontier(found: Sequence[Break], title: str, across: Range, until: Until) -> Figure:
    """Where one axis breaks, over the value of the other; every point that was run behind it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axis = found[0].range
    for line in found:
        _scatter(axes, line.tried, [(line.fixed or 0.0, t.value) for t in line.tried], 16)
    edge = [axis.end if line.fails is None else line.fails.value for line in found]
    beside = [line.fixed or 0.0 for line in found]
    axes.plot(beside, edge, color="black", linewidth=1.2, label="first break, or end of the search")
    axes.set_xlabel(across.key)
    axes.set_ylabel(axis.key)
    axes.grid(alpha=0.25)
    _legend(figure, until)
    head(figure, title)
    return figure


def _scatter(axes: Axes, tried: Sequence[Tried], at: Sequence[tuple[float, float]], size: float) -> None:
    """A mark for every point: what came of it."""
    for what, (marker, colour) in _MARKS.items():
        part = [where for t, where in zip(tried, at, strict=True) if came(t) == what]
        if part:
            x, y = zip(*part, strict=True)
            axes.scatter(
                x, y, s=size, marker=marker, color=colour, zorder=3, label=what.replace("d_j", "$d_j$")
            )


def _legend(figure: Figure, until: Until) -> None:
    """What the marks of all panels are, below them."""
    handles = {}
    for axes in figure.axes:
        for handle, what in zip(*axes.get_legend_handles_labels(), strict=True):
            handles["above the floor" if until == "floor" and what == SAFE else what] = handle
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, frameon=False)
