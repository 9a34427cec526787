"""A short animation of a run, from its trace: the road from above beside opinion and distances, as GIF."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.figures.overview import ran
from mjmerge.figures.style import COLOURS, LINE, OPINION, End, ends, words
from mjmerge.outputs import written
from mjmerge.roster import colour
from mjmerge.scenario.cars import car_sheets
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array
from mjmerge.vehicle.datasheet import DataSheet
from mjmerge.verdict.metrics import intends, merged_at_s

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from PIL.Image import Image

EVERY_S = 0.2
"""Simulated time between two frames, s."""
SHOWN_S = 0.1
"""Time that each is shown, s: twice as fast as it was."""
_SIZE_IN, _DPI = (8.0, 4.0), 96
_PANELS = ((0.07, 0.13, 0.56, 0.74), (0.72, 0.54, 0.24, 0.33), (0.72, 0.13, 0.24, 0.33))
_COLOURS = 64  # of the palette that all frames share
_BEHIND_M, _AHEAD_M, _ASIDE_M = 0.9, 0.75, 0.3  # road around the cars
_DASH_M, _EVERY_M = 0.6, 1.2  # lane markings as drawn


def frames(trace: Trace, at: Sequence[int]) -> Iterator[Image]:
    """Simulation 0 at some ticks."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    figure = Figure(figsize=_SIZE_IN, dpi=_DPI)
    canvas = FigureCanvasAgg(figure)
    figure.text(0.01, 0.985, words("; ".join(ran(trace))), va="top", fontsize=9)
    road, opinion, distance = (figure.add_axes(place) for place in _PANELS)
    moving, place = _road(road, trace)
    for axes, drawn in ((opinion, draw_opinion), (distance, draw_distance)):
        dots, move = drawn(axes, trace)
        moving, place = moving + dots, both(place, move)

    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    for tick in at:
        canvas.restore_region(still)
        place(tick)
        for artist in moving:
            artist.axes.draw_artist(artist)
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def ticks(trace: Trace) -> list[int]:
    """The ticks that are shown: one every ``EVERY_S``, and the last."""
    last = int(np.flatnonzero(~np.isnan(trace.front_m[0, :, 0, 0]))[-1])
    every = max(1, round(EVERY_S / trace.scenario.control_step_s))
    return [*range(0, last, every), last]


def animate(trace: Trace, path: Path, progress: Callable[[float], None] | None = None) -> None:
    """Writes the animation of simulation 0 as GIF; the same trace gives the same bytes.

    Args:
        trace: the run.
        path: file to write.
        progress: called with the part that is done, 0 to 1.
    """
    from PIL import Image

    shown = ticks(trace)
    # one palette for all, from a picture that has every colour: what does not move costs nothing
    palette = next(frames(trace, shown[-1:])).quantize(_COLOURS, Image.Quantize.FASTOCTREE)
    pictures: list[Image.Image] = []
    for picture in frames(trace, shown):
        pictures.append(picture.quantize(palette=palette, dither=Image.Dither.NONE))
        if progress is not None:
            progress(len(pictures) / len(shown))
    with written(path) as partial:
        pictures[0].save(
            partial,
            format="GIF",
            save_all=True,
            append_images=pictures[1:],
            duration=round(1e3 * SHOWN_S),
            loop=0,
            optimize=False,
        )


Move = Callable[[int], None]


def both(first: Move, second: Move) -> Move:
    """One after the other."""

    def move(tick: int) -> None:
        first(tick)
        second(tick)

    return move


def _road(axes: Axes, trace: Trace) -> tuple[list[Any], Move]:
    """The road from above, moving along with the leader."""
    from matplotlib.patches import Circle, Polygon

    scenario, there, one = trace.scenario, trace.roster, 1 + trace.scenario.law.j_1
    seen = trace.front_m[0] - trace.front_m[0, :, one : one + 1] * (1.0, 0.0)  # (T, C, 2)
    width = scenario.road.lane_width_m
    lanes = sorted(set(trace.front_m[0, 0, :, 1].tolist()))
    low, high = lanes[0] - width / 2, lanes[-1] + width / 2
    left, right = np.nanmin(seen[..., 0]) - _BEHIND_M, np.nanmax(seen[..., 0]) + _AHEAD_M
    axes.set_xlim(left, right)
    axes.set_ylim(min(low, np.nanmin(seen[..., 1])) - _ASIDE_M, max(high, np.nanmax(seen[..., 1])) + _ASIDE_M)
    axes.set_aspect("equal")
    axes.set_xlabel("$\\rho^{\\!\\top}(p - p_1)$ (m)")
    axes.set_ylabel("$\\eta^{\\!\\top}\\!p$ (m)")
    axes.axhspan(low, high, color="#e6e7ea", zorder=0)
    for edge in (low, high):
        axes.axhline(edge, color="#888888", linewidth=1.5)

    (dashes,) = axes.plot([], [], color="white", linewidth=2.5)
    (way,) = axes.plot([], [], color=COLOURS["ego"], linewidth=1, linestyle=":")
    (axles,) = axes.plot([], [], "k.", markersize=5, zorder=5)
    title = axes.text(0, 1.02, "", transform=axes.transAxes, va="bottom")
    r = scenario.r_m
    discs = [Circle((0, 0), r, color=colour(car), alpha=0.22, linewidth=0) for car in there.neighbours]
    bodies = [Polygon(np.zeros((4, 2)), color=colour(car), zorder=4) for car in there.cars]
    for patch in (*discs, *bodies):
        axes.add_patch(patch)
    names = [
        axes.text(0, 0, name, ha="center", va="center", fontsize=8, color="white", zorder=6)
        for name in ("ego", *(str(j) for j in range(1, len(there.cars))))
    ]
    outlines = [_outline(sheet) for sheet in car_sheets(scenario)]
    merged, means = merged_at_s(trace)[0], intends(trace)[0]

    def place(tick: int) -> None:
        x_1 = trace.front_m[0, tick, one, 0]
        first = -((x_1 + left) % _EVERY_M)
        starts = left + first + _EVERY_M * np.arange(ceil((right - left) / _EVERY_M) + 1)
        x = np.stack([starts, starts + _DASH_M, np.full_like(starts, np.nan)], axis=1).ravel()
        dashes.set_data(x, np.full_like(x, (low + high) / 2 if len(lanes) > 1 else np.nan))
        way.set_data(*seen[: tick + 1, 0].T)
        axles.set_data(*seen[tick].T)
        for disc, at in zip(discs, seen[tick, 1:], strict=True):
            disc.set_center(tuple(at))
        for c, (body, name) in enumerate(zip(bodies, names, strict=True)):
            corners = seen[tick, c] + outlines[c] @ _turn(trace.heading_rad[0, tick, c])
            body.set_xy(corners)
            name.set_position(corners.T @ (0.18, 0.18, 0.32, 0.32))
        t = trace.time_s[tick]
        what = "means to merge" if means[tick] else "waits"
        title.set_text(f"{t:4.1f} s   the ego {'has merged' if t >= merged else what}")

    return [dashes, way, *discs, *bodies, axles, *names, title], place


def draw_opinion(axes: Axes, trace: Trace) -> tuple[list[Any], Move]:
    """Opinion over time, pale; what moves over it, and what moves that to a tick.

    Of a law that has none, its command along the road.
    """
    with_z = not np.isnan(trace.opinion[0]).all()
    shown = trace.opinion[0] if with_z else trace.u_mps2[0, :, 0, 0]
    axes.plot(trace.time_s, shown, color=OPINION, alpha=0.3)
    axes.set_ylabel("opinion $z$" if with_z else "$u$ along (m/s²)")
    axes.tick_params(labelbottom=False)
    return _dots(axes, trace.time_s, shown[:, None], [OPINION])


def draw_distance(axes: Axes, trace: Trace) -> tuple[list[Any], Move]:
    """Every distance over time, likewise."""
    colours = [colour(car) for car in trace.roster.neighbours]
    for j, own in enumerate(colours):
        axes.plot(trace.time_s, trace.distance_m[0, :, j], color=own, alpha=0.3)
    axes.axhline(0, color=LINE, linewidth=1)
    axes.set_ylabel("distance $d_j$ (m)")
    axes.set_xlabel("time $t$ (s)")
    ends(axes, [End(f"$d_{{{j + 1}}}$", trace.distance_m[0, :, j], own) for j, own in enumerate(colours)])
    return _dots(axes, trace.time_s, trace.distance_m[0], colours)


def _dots(axes: Axes, time_s: Array, values: Array, colours: list[str]) -> tuple[list[Any], Move]:
    """What has been so far, and a dot at its end, for each column of (T, K)."""
    axes.grid(alpha=0.25)
    axes.margins(x=0)
    lines = [axes.plot([], [], color=colour)[0] for colour in colours]
    dots = [axes.plot([], [], "o", color=colour, markersize=5, clip_on=False)[0] for colour in colours]

    def move(tick: int) -> None:
        for k, (line, dot) in enumerate(zip(lines, dots, strict=True)):
            line.set_data(time_s[: tick + 1], values[: tick + 1, k])
            dot.set_data(time_s[tick : tick + 1], values[tick : tick + 1, k])

    return [*lines, *dots], move


def _outline(car: DataSheet) -> Array:
    """Corners of the body as seen from the front axle, m, (4, 2)."""
    nose, side = car.front_overhang_m, car.width_m / 2
    tail = nose - car.length_m
    return np.array([[nose, side], [nose, -side], [tail, -side], [tail, side]])


def _turn(heading_rad: float) -> Array:
    """Turns row vectors by a heading, (2, 2)."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    return np.array([[c, s], [-s, c]])
