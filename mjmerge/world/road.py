"""The road, as it is drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil
from typing import NamedTuple

from dm_control import mjcf

from mjmerge.config.bounds import MOST_DASHES
from mjmerge.scenario.schema import Scenario


class Line(NamedTuple):
    """A marking: its name, where its middle is, its length and the width of its lane, m."""

    name: str
    x_m: float
    y_m: float
    length_m: float
    lane_m: float


def markings(scenario: Scenario) -> Iterator[Line]:
    """Those of the lanes that the cars start in, in the size of the lane."""
    lanes = [start.front_m[1] for start in scenario.starts]
    width = scenario.road.lane_width_m
    low, high = min(lanes) - width / 2, max(lanes) + width / 2
    speeds = [start.speed_mps for start in scenario.starts]
    starts = [start.front_m[0] for start in scenario.starts]
    begin = min(starts) - 4 * width
    end = max(starts) + 8 * width + 1.5 * max(max(speeds), 0.0) * scenario.duration_s

    for name, y in (("edge_right", low), ("edge_left", high)):
        yield Line(name, (begin + end) / 2, y, end - begin, width)
    if high - low > 1.5 * width:  # two lanes: dashes between them
        apart = max(width, (end - begin) / MOST_DASHES)
        for i in range(min(ceil((end - begin) / apart), MOST_DASHES)):
            yield Line(f"dash_{i}", begin + (i + 0.5) * apart, (low + high) / 2, width / 3, width)


def mark(root: mjcf.RootElement, lines: Sequence[Line]) -> None:
    """Paints markings onto the road."""
    for line in lines:
        root.worldbody.add(
            "geom",
            name=line.name,
            type="box",
            size=(line.length_m / 2, line.lane_m / 60, line.lane_m / 2400),
            pos=(line.x_m, line.y_m, line.lane_m / 2400),
            rgba=(0.93, 0.93, 0.9, 1),
            contype=0,
            conaffinity=0,
            group=2,
        )
