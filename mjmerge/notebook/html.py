"""Tables and lines over time as HTML, small enough to be stored; what is shown says what stands in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from itertools import pairwise

import numpy as np

from mjmerge.state import Array

_WIDTH, _HEIGHT, _LEFT, _BELOW, _ABOVE = 640, 200, 48, 34, 22
_MOST_POINTS = 240
"""Of a line: more are not told apart on a screen."""
_TICKS = 6


def page(title: str, *parts: str) -> str:
    """A title, and below it what there is.

    Args:
        title: plain text.
        parts: HTML; empty ones are left out.
    """
    return f"<div><p><b>{escape(title)}</b></p>{''.join(parts)}</div>"


def facts(rows: Mapping[str, str]) -> str:
    """A table of two columns, names and what they are; empty ones are left out."""
    return table((), [(name, what) for name, what in rows.items() if what])


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of plain texts, aligned left."""
    left = ' style="text-align:left"'
    top = "".join(f"<th{left}>{escape(name)}</th>" for name in head)
    body = "".join(
        f"<tr>{''.join(f'<td{left}>{escape(cell)}</td>' for cell in cells)}</tr>" for cells in rows
    )
    return f"<table>{f'<thead><tr>{top}</tr></thead>' if head else ''}<tbody>{body}</tbody></table>"


def lines(x: Array, of: Mapping[str, tuple[Array, str]], label: str, below: str) -> str:
    """A drawing (SVG) of lines over one axis, with 0 marked; nothing where no number is finite.

    Args:
        x: where along the axis, (T,).
        of: name of each line, its values, (T,), and its colour.
        label: what the values are, with their unit.
        below: what the axis is, likewise.
    """
    thinned = {name: (_thinned(x, y), colour) for name, (y, colour) in of.items()}
    every = [xy for xy, _ in thinned.values() if xy.size]
    if not every:
        return ""
    x_ticks = _ticks(*_ends([xy[:, 0] for xy in every]))
    y_ticks = _ticks(*_ends([np.zeros(1), *(xy[:, 1] for xy in every)]))
    right, bottom = _WIDTH - 8, _HEIGHT - _BELOW
    to_x = _scale(x_ticks, _LEFT, right)
    to_y = _scale(y_ticks, bottom, _ABOVE)
    grid = [
        f'<path d="M{_LEFT} {to_y(y):.1f}H{right}" stroke="{"#c00000" if y == 0 else "#ddd"}"/>'
        f'<text x="{_LEFT - 5}" y="{to_y(y) + 4:.1f}" text-anchor="end">{y:g}</text>'
        for y in y_ticks
    ]
    grid += [f'<text x="{to_x(t):.1f}" y="{bottom + 14}" text-anchor="middle">{t:g}</text>' for t in x_ticks]
    drawn = [_line([(to_x(t), to_y(y)) for t, y in xy], colour) for xy, colour in thinned.values()]
    names = "".join(
        f'<tspan dx="14" fill="{colour}">{escape(name)}</tspan>' for name, (_, colour) in thinned.items()
    )
    said = (
        f'<text x="{_LEFT}" y="14">{escape(label)}{names}</text>'
        f'<text x="{(_LEFT + right) / 2:.0f}" y="{_HEIGHT - 4}" text-anchor="middle">{escape(below)}</text>'
    )
    size = f'width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}"'
    style = 'fill="currentColor" font-family="sans-serif" font-size="11"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} {style}>{"".join(grid + drawn)}{said}</svg>'


def _line(points: Sequence[tuple[float, float]], colour: str) -> str:
    corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{corners}" fill="none" stroke="{colour}" stroke-width="1.5"/>'


def _thinned(x: Array, y: Array) -> Array:
    """The finite points of a line, (K, 2); of too many, the least and the largest of each stretch."""
    there = np.flatnonzero(np.isfinite(y))
    if len(there) > _MOST_POINTS:
        edges = np.linspace(0, len(there), _MOST_POINTS // 2 + 1).astype(int)
        parts = [there[a:b] for a, b in pairwise(edges)]
        there = np.unique([part[pick(y[part])] for part in parts for pick in (np.argmin, np.argmax)])
    return np.stack([x[there], y[there]], axis=1)


def _ends(values: Sequence[Array]) -> tuple[float, float]:
    return min(float(v.min()) for v in values), max(float(v.max()) for v in values)


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers that enclose a range."""
    width = (high - low or abs(high) or 1.0) / _TICKS
    power = 10.0 ** np.floor(np.log10(width))
    step = power * next(m for m in (1, 2, 5, 10) if m * power >= width * (1 - 1e-9))
    first, last = np.floor(low / step + 1e-9), np.ceil(high / step - 1e-9)
    return [float(f"{k * step:.12g}") for k in np.arange(first, max(last, first + 1) + 1)]


def _scale(ticks: Sequence[float], start: float, end: float) -> Callable[[float], float]:
    """From a number within ticks to where it is drawn."""
    low, high = ticks[0], ticks[-1]
    return lambda value: start + (value - low) / (high - low) * (end - start)
