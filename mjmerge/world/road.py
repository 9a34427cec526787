"""The road, as it is drawn."""

from __future__ import annotations

from math import ceil

from dm_control import mjcf

from mjmerge.config.bounds import MOST_DASHES
from mjmerge.scenario.schema import Scenario


def mark_lanes(root: mjcf.RootElement, scenario: Scenario) -> None:
    """The markings of the lanes that the cars start in, in the size of the lane."""
    lanes = [start.front_m[1] for start in scenario.starts]
    width = scenario.road.lane_width_m
    low, high = min(lanes) - width / 2, max(lanes) + width / 2
    speeds = [start.speed_mps for start in scenario.starts]
    starts = [start.front_m[0] for start in scenario.starts]
    begin = min(starts) - 4 * width
    end = max(starts) + 8 * width + 1.5 * max(max(speeds), 0.0) * scenario.duration_s

    def line(name: str, x: float, y: float, length: float) -> None:
        root.worldbody.add(
            "geom",
            name=name,
            type="box",
            size=(length / 2, width / 60, width / 2400),
            pos=(x, y, width / 2400),
            rgba=(0.93, 0.93, 0.9, 1),
            contype=0,
            conaffinity=0,
            group=2,
        )

    for name, y in (("edge_right", low), ("edge_left", high)):
        line(name, (begin + end) / 2, y, end - begin)
    if high - low > 1.5 * width:  # two lanes: dashes between them
        apart = max(width, (end - begin) / MOST_DASHES)
        for i in range(min(ceil((end - begin) / apart), MOST_DASHES)):
            line(f"dash_{i}", begin + (i + 0.5) * apart, (low + high) / 2, width / 3)
