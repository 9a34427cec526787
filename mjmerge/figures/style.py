"""What all figures have in common: colours, sheets, and how they are saved, as tables too."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.errors import MjmergeError
from mjmerge.outputs import written
from mjmerge.roster import PAINT, colour
from mjmerge.state import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = {car: colour(car) for car in PAINT}
"""Of the paper's cars."""


OPINION = "#7b3fa0"


MU = "#999999"


LINE = "#c00000"
"""The lane of the vehicles, and the margin."""


_DPI = 110
_SMALL_M = 0.1
"""A shorter length is said in millimetres."""
_LARGE_M = 1e6
"""One of this many metres or more has an exponent: no road is as long."""
_MARGIN = 0.05
"""Above and below what a panel shows, of its range."""
_LINE_PT = 11
"""Of a text at the end of a curve, from one line to the next, points."""


PALE: dict[str, Any] = {"linewidth": 5, "alpha": 0.3, "solid_capstyle": "butt"}


LETTERS = 100
"""In a line across the figure."""
_MINUS = re.compile(r"(?<![\w.)])-(?=\d)")
_UNIT = re.compile(r"(?<=\d) (?=(?:m|mm|s|ms|m/s|m/s²)\b)")


def words(text: str) -> str:
    """A text in a figure as it is, with the minus signs that the numbers of its axes have.

    Matplotlib would read formulas between dollar signs.
    """
    return _MINUS.sub("\N{MINUS SIGN}", text).replace("$", "\\$")


def fold(text: str) -> list[str]:
    """The lines of a text across the figure: a number and its unit stand on the same one."""
    kept = "\N{NO-BREAK SPACE}"
    return [line.replace(kept, " ") for line in wrap(_UNIT.sub(kept, text), LETTERS)]


def head(figure: Figure, *lines: str) -> None:
    """What a figure is of, above all its panels, each line folded where it is too long."""
    each = [part for line in lines for part in fold(line)]
    figure.suptitle(words("\n".join(each)), x=0.01, ha="left", fontsize=10)


Panels = Any
"""Axes of matplotlib, one for each panel; of a figure with one panel also that alone."""


def sheet(
    heights: Sequence[float], height_in: float, columns: int = 1, axes: Panels = None
) -> tuple[Figure, Any]:
    """An empty figure and its axes: panels of these relative heights over one time axis, or columns.

    Args:
        heights: of the panels, one after the other downwards.
        height_in: of the figure, inches.
        columns: panels beside each other.
        axes: what to draw into, in place of a figure of its own.

    Raises:
        MjmergeError: it is another number of axes.
    """
    if axes is not None:
        return _given(list(np.ravel(axes)), len(heights) * columns)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    grid = {"height_ratios": heights}
    made = figure.subplots(len(heights), columns, sharex=columns == 1, squeeze=False, gridspec_kw=grid)
    for panel in made.flat:
        _dress(panel)
    return figure, made[0] if columns > 1 else made[:, 0]


def _given(panels: list[Any], wanted: int) -> tuple[Figure, Any]:
    """Axes to draw into that somebody has made already, and the figure that they are in."""
    if len(panels) != wanted:
        raise MjmergeError(f"this figure has {wanted} panels: pass as many axes, got {len(panels)}")
    for panel in panels:
        _dress(panel)
    return panels[0].figure.figure, panels  # of a part of a figure, the whole


def _dress(panel: Axes) -> None:
    panel.grid(alpha=0.25)
    panel.margins(x=0)


@dataclass(frozen=True)
class End:
    """What is written at the right end of a curve.

    Attributes:
        label: the text.
        values: of the curve, one for each time; NaN where it has none.
        own: its colour.
    """

    label: str
    values: Array
    own: str


def ends(axes: Axes, each: Sequence[End]) -> None:
    """Names curves at their right ends, moved apart where they would cover each other."""
    shown = [(end, end.values[np.isfinite(end.values)]) for end in each]
    low, high = axes.get_ylim()
    height_pt = axes.get_window_extent().height * 72 / axes.figure.dpi
    gap = _LINE_PT / height_pt
    last = [(i, min(max((v[-1] - low) / (high - low), 0.0), 1.0)) for i, (_, v) in enumerate(shown) if v.size]
    for (i, _), y in zip(last, apart([y for _, y in last], gap), strict=True):
        text, own = shown[i][0].label, shown[i][0].own
        axes.text(1.01, y, text, transform=axes.transAxes, color=own, va="center", fontsize=9)


def apart(at: Sequence[float], gap: float) -> list[float]:
    """Places in their order, moved as little upwards as they must to be a gap from each other.

    Those that would then be above 1 are moved down, and whatever is below them with them.
    """
    order = np.argsort(at, kind="stable").tolist()
    found = [float(y) for y in at]
    for before, i in pairwise(order):
        found[i] = max(found[i], found[before] + gap)
    top = 1.0
    for i in reversed(order):
        found[i] = min(found[i], top)
        top = found[i] - gap
    return found


def limits(axes: Axes, values: Array) -> None:
    """Shows these values in full, and of the curves of a panel what is between them; nothing without any."""
    known = values[np.isfinite(values)]
    if known.size:
        low, high = float(known.min()), float(known.max())
        margin = _MARGIN * ((high - low) or 1.0)
        axes.set_ylim(low - margin, high + margin)


def length(value_m: float, digits: int = 3, sign: str = "-") -> str:
    """A length in the unit that a person would use: mm below a tenth of a metre, else m.

    Args:
        value_m: m.
        digits: significant ones.
        sign: as of format specifications: ``"+"`` to have it in any case.
    """
    if abs(value_m) >= _LARGE_M:
        return f"{value_m:{sign}.{digits}g} m"
    scaled, unit = (1e3 * value_m, "mm") if abs(value_m) < _SMALL_M else (value_m, "m")
    whole = len(f"{abs(scaled):.0f}") if abs(scaled) >= 1 else 0
    return f"{scaled:{sign}.{max(0, digits - whole)}f} {unit}"


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
