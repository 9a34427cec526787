"""What is said in a video: a title above it, and time, opinion and distances beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mjmerge.figures.animation import both, draw_distance, draw_opinion
from mjmerge.figures.style import LINE, words
from mjmerge.record.contacts import Mark
from mjmerge.simulation.trace import Trace
from mjmerge.verdict.metrics import intends, merged_at_s

Picture = NDArray[np.uint8]

_DPI = 100
_LINE_PX, _AROUND_PX, _LINES, _LETTERS = 20, 6, 5, 165
"""Of the title: height of a line, room above and below them, most lines, most letters in one."""


def title(ran: Sequence[str], verdict: str | None, summary: Mapping[str, Any], width: int) -> Picture:
    """What ran, and what came of it, as a strip, (height, width, 3).

    Args:
        ran: what ran, a line each.
        verdict: the recording's; ``None`` where the run has not finished.
        summary: likewise.
        width: pixels.
    """
    said = f"{verdict}: {summary['reason']}" if "reason" in summary else verdict or "the run has not finished"
    held = verdict is None or summary.get("floor_held", True)
    each = [*((line, "black") for line in ran), (said, "black" if held else LINE)]
    lines = [(part, color) for text, color in each for part in wrap(text, _LETTERS)]
    if len(lines) > _LINES:  # the verdict is last, and stays
        lines = [*lines[: _LINES - 2], ("...", "black"), lines[-1]]
    height = _LINE_PX * len(lines) + 2 * _AROUND_PX
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    canvas = FigureCanvasAgg(figure)
    for k, (text, color) in enumerate(lines):
        y = 1 - (_AROUND_PX + _LINE_PX * (k + 0.5)) / height
        weight = "normal" if k else "bold"
        figure.text(0.01, y, words(text), fontsize=10.5, color=color, va="center", weight=weight)
    canvas.draw()
    picture: Picture = np.asarray(canvas.buffer_rgba())[..., :3].copy()
    return picture


class Panel:
    """Time, opinion and distances, drawn by matplotlib; only what moves is drawn anew."""

    def __init__(self, trace: Trace, marks: Sequence[Mark], size: tuple[int, int]) -> None:
        """Args: the run; where bodies touch; width and height, pixels."""
        self._means, self._merged = intends(trace)[0], merged_at_s(trace)[0]
        self._trace, self._marks = trace, marks
        figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI)
        self._canvas, self._box = FigureCanvasAgg(figure), figure.bbox
        opinion, distance = (figure.add_axes((0.17, bottom, 0.78, 0.35)) for bottom in (0.5, 0.08))
        dots, move = draw_opinion(opinion, trace)
        more, other = draw_distance(distance, trace)
        distance.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False, ncols=4, borderpad=0.1)
        for mark in marks:
            distance.axvline(mark.collision.time_s, color=LINE, linewidth=2, alpha=0.5)
        self._clock = figure.text(0.05, 0.945, "", fontsize=14, animated=True)
        self._caption = figure.text(0.05, 0.9, "", fontsize=9.5, color=LINE, weight="bold", animated=True)
        self._moving, self._move = [*dots, *more], both(move, other)
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self._box)

    def draw(self, tick: int) -> Picture:
        """One picture, (height, width, 3)."""
        self._canvas.restore_region(self._still)
        self._move(tick)
        t = self._trace.time_s[tick]
        what = "has merged" if t >= self._merged else "means to merge" if self._means[tick] else "waits"
        self._clock.set_text(f"{t:.2f} s   the ego {what}")
        happened = [mark.collision.sentence for mark in self._marks if mark.collision.time_s <= t]
        self._caption.set_text(words("".join(happened[-1:])))
        for artist in self._moving:
            artist.axes.draw_artist(artist)
        for text in (self._clock, self._caption):
            text.draw(self._canvas.get_renderer())
        picture: Picture = np.asarray(self._canvas.buffer_rgba())[..., :3]
        return picture
