"""The road, as it is drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import atan2, ceil, hypot
from typing import TYPE_CHECKING, NamedTuple

from mjmerge.config.bounds import MOST_DASHES
from mjmerge.scenario.ramp import Ramp
from mjmerge.scenario.schema import Scenario

if TYPE_CHECKING:  # compose.py imports it, without what it warns of where there is no window
    from dm_control import mjcf

WHITE, VERGE = (0.93, 0.93, 0.9, 1), (0.27, 0.33, 0.22, 1)


class Line(NamedTuple):
    """A marking, or a strip of ground.

    Attributes:
        name: its name.
        x_m: where its middle is, along the road, m.
        y_m: the same across it.
        length_m: its length, m.
        lane_m: width of the lane that it marks, m.
        yaw_rad: how it is turned, to the left, rad.
        width_m: of a strip of ground beside the road, m; 0 for a marking.
    """

    name: str
    x_m: float
    y_m: float
    length_m: float
    lane_m: float
    yaw_rad: float = 0.0
    width_m: float = 0.0


def markings(scenario: Scenario) -> Iterator[Line]:
    """Those of the lanes that the cars start in, in the size of the lane."""
    lanes = [start.front_m[1] for start in scenario.starts]
    width = scenario.road.lane_width_m
    low, high = min(lanes) - width / 2, max(lanes) + width / 2
    speeds = [start.speed_mps for start in scenario.starts]
    starts = [start.front_m[0] for start in scenario.starts]
    begin = min(starts) - 4 * width
    end = max(starts) + 8 * width + 1.5 * max(max(speeds), 0.0) * scenario.duration_s

    ramp = Ramp.of([scenario])
    outer = None
    if ramp is not None:
        end = max(end, ramp.ends_m + 4 * width)
        outer = "edge_left" if ramp.outer_m[0] > ramp.inner_m[0] else "edge_right"
        yield from _end(ramp, outer, begin, end, width)
    for name, y in (("edge_right", low), ("edge_left", high)):
        if name != outer:
            yield Line(name, (begin + end) / 2, y, end - begin, width)
    if ramp is not None:
        end = max(min(end, ramp.ends_m), begin + width)  # where dashes end
    if high - low > 1.5 * width:  # two lanes: dashes between them
        apart = max(width, (end - begin) / MOST_DASHES)
        for i in range(min(ceil((end - begin) / apart), MOST_DASHES)):
            yield Line(f"dash_{i}", begin + (i + 0.5) * apart, (low + high) / 2, width / 3, width)


def _end(ramp: Ramp, name: str, begin: float, end: float, width: float) -> Iterator[Line]:
    """The edge of a lane that ends: along its outer side, over the taper, beside the lane that goes on."""
    inner, outer = float(ramp.inner_m[0]), float(ramp.outer_m[0])
    taper = ramp.ends_m - ramp.taper_m
    begin = min(begin, taper - width)
    yield Line(name, (begin + taper) / 2, outer, taper - begin, width)
    across, middle = inner - outer, (inner + outer) / 2
    slope = (hypot(ramp.taper_m, across), atan2(across, ramp.taper_m))
    yield Line(f"{name}_taper", ramp.ends_m - ramp.taper_m / 2, middle, slope[0], width, slope[1])
    rest = end - ramp.ends_m
    yield Line(f"{name}_beyond", ramp.ends_m + rest / 2, inner, rest, width)
    yield Line("verge", ramp.ends_m + rest / 2, middle, rest, width, width_m=abs(across))


def mark(root: mjcf.RootElement, lines: Sequence[Line]) -> None:
    """Paints markings onto the road, and the ground beside it."""
    for line in lines:
        turned = {"euler": (0, 0, line.yaw_rad)} if line.yaw_rad else {}
        high_m = line.lane_m / (4800 if line.width_m else 2400)
        root.worldbody.add(
            "geom",
            name=line.name,
            type="box",
            size=(line.length_m / 2, line.width_m / 2 or line.lane_m / 60, high_m),
            pos=(line.x_m, line.y_m, high_m),
            **turned,
            rgba=VERGE if line.width_m else WHITE,
            contype=0,
            conaffinity=0,
            group=2,
        )
