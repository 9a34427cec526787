"""A recording as a CommonRoad file, XML of version 2020a, so that others' tools can judge it.

M. Althoff, M. Koschi, S. Manzinger, CommonRoad: Composable benchmarks for motion planning on roads, IEEE
Intelligent Vehicles Symposium (2017) 719; the format is that of the CommonRoad XML documentation, 2020a. A
state's position is the centre of the car's rectangle in the road frame; speed and acceleration are along the
car. The ego is an obstacle like the others, and what it was to do is the planning problem: who plans in its
place leaves that obstacle out. Nothing in the file depends on when or where it is written.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np

from mjmerge.errors import MjmergeError, UnreadableError
from mjmerge.outputs import whole
from mjmerge.record.read import Recorded
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array, norm
from mjmerge.vehicle.actuation import CRAWL_MPS
from mjmerge.vehicle.datasheet import DataSheet

VERSION = "2020a"
DATE = "1970-01-01"
"""The format wants one; a recording has none."""
FIRST_LANE, PROBLEM = 101, 201
"""Ids; those of obstacles are 1 for the ego, and 1 + N for vehicle_N."""
_TAGS = ("interstate", "lane_change", "multi_lane", "simulated")
_NOWHERE = "999"
_SAME_LANE = 0.5  # lanes that are nearer than this part of their width are one
_MOST_POINTS = 200


@dataclass(frozen=True)
class Lane:
    """A lane along the road.

    Attributes:
        id: of its lanelet.
        right_m: its right bound across the road, m.
        left_m: its left bound, m.
    """

    id: int
    right_m: float
    left_m: float


@dataclass(frozen=True)
class Motion:
    """How a car's rectangle moves, at each time step.

    Attributes:
        centre_m: of the rectangle, (T, 2).
        heading_rad: of the car, (T,).
        speed_mps: along the car, negative backwards, (T,).
        acceleration_mps2: its rate, (T,).
    """

    centre_m: Array
    heading_rad: Array
    speed_mps: Array
    acceleration_mps2: Array


def lanes(scenario: Scenario) -> list[Lane]:
    """The lanes that cars start in, from right to left; neighbouring ones have a bound in common."""
    width_m = scenario.road.lane_width_m
    middles: list[float] = []
    for y in sorted(start.front_m[1] for start in scenario.starts):
        if not middles or y - middles[-1] > _SAME_LANE * width_m:
            middles.append(y)
    bounds = [(y - width_m / 2, y + width_m / 2) for y in middles]
    for i, (a, b) in enumerate(pairwise(middles)):
        if b - a <= 1.5 * width_m:
            middle = (a + b) / 2
            bounds[i], bounds[i + 1] = (bounds[i][0], middle), (middle, bounds[i + 1][1])
    return [Lane(FIRST_LANE + i, *pair) for i, pair in enumerate(bounds)]


def motion(trace: Trace, car: int, sheet: DataSheet, every: int, ticks: int) -> Motion:
    """How a car of the only simulation moves.

    Args:
        trace: the run.
        car: which, by its place.
        sheet: its data sheet.
        every: ticks of a time step.
        ticks: how many ticks are known.
    """
    heading, velocity = trace.heading_rad[0, :ticks, car], trace.velocity_mps[0, :ticks, car]
    if (
        trace.plant == "double_integrator"
    ):  # a point's heading is where it goes; no car turns about at a stand
        heading = _as_of_a_car(heading, norm(velocity))
    forwards = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    ahead_m = sheet.front_overhang_m - sheet.length_m / 2
    speed = np.sum(velocity * forwards, axis=-1)
    rate = np.gradient(speed, trace.scenario.control_step_s)
    centre = trace.front_m[0, :ticks, car] + ahead_m * forwards
    return Motion(centre[::every], heading[::every], speed[::every], rate[::every])


def _as_of_a_car(heading_rad: Array, speed_mps: Array) -> Array:
    """Headings that stay as they were while a car stands, and do not turn about when it rolls back."""
    folded = (heading_rad + np.pi / 2) % np.pi - np.pi / 2
    moves = np.where(speed_mps > CRAWL_MPS, np.arange(len(folded)), -1)
    last = np.maximum.accumulate(moves)
    found: Array = np.where(last >= 0, folded[np.maximum(last, 0)], 0.0)
    return found


def commonroad(found: Recorded, step_s: float | None = None) -> str:
    """A recording as the text of a CommonRoad file.

    Args:
        found: the file as read.
        step_s: time between two states, s, a multiple of the control step; by default that.

    Raises:
        UnreadableError: it has not two ticks without a gap between them.
        MjmergeError: it is no multiple.
    """
    trace, scenario = found.run(), found.scenario()
    every = _every(scenario.control_step_s, step_s)
    ticks = _known(found, trace, every)
    moved = [motion(trace, c, sheet, every, ticks) for c, sheet in enumerate(found.sheets())]
    root = Xml.Element(
        "commonRoad",
        timeStepSize=_number(every * scenario.control_step_s),
        commonRoadVersion=VERSION,
        author="mjmerge",
        affiliation="",
        source=_source(found),
        benchmarkID=_benchmark(scenario.name),
        date=DATE,
    )
    place = Xml.SubElement(root, "location")
    for name, value in (("geoNameId", f"-{_NOWHERE}"), ("gpsLatitude", _NOWHERE), ("gpsLongitude", _NOWHERE)):
        Xml.SubElement(place, name).text = value
    tags = Xml.SubElement(root, "scenarioTags")
    for tag in _TAGS:
        Xml.SubElement(tags, tag)
    _lanelets(root, scenario, moved)
    for c, (one, sheet) in enumerate(zip(moved, found.sheets(), strict=True)):
        _obstacle(root, 1 + c, sheet, one)
    _problem(root, scenario, moved[0])
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode", xml_declaration=False)


def write(found: Recorded, path: Path, step_s: float | None = None) -> None:
    """Writes a recording as a CommonRoad file, whole or not at all.

    Raises:
        OutputError: the file is there already, or cannot be written.
        UnreadableError: see :func:`commonroad`, as of MjmergeError.
    """
    text = f'<?xml version="1.0" encoding="UTF-8"?>\n{commonroad(found, step_s)}\n'

    def save(partial: Path) -> None:
        partial.write_bytes(text.encode("utf-8"))

    whole(path, save)


def _every(control_step_s: float, step_s: float | None) -> int:
    """Ticks of a time step."""
    if step_s is None:
        return 1
    every = round(step_s / control_step_s) if 0 < step_s < np.inf else 0
    if every < 1 or abs(every * control_step_s - step_s) > 1e-9 * step_s:
        multiple = f"a whole multiple of the control step, {control_step_s:g} s"
        raise MjmergeError(f"the time step must be {multiple}, got {step_s:g} s")
    return every


def _known(found: Recorded, trace: Trace, every: int) -> int:
    """How many ticks there are until the simulation ended: all cars' motion, without a gap.

    Raises:
        UnreadableError: there is a gap, or there are fewer than two time steps.
    """
    numbers = (trace.front_m, trace.velocity_mps, trace.heading_rad)
    known = np.all([~np.isnan(of[0]).reshape(len(trace.time_s), -1).any(axis=1) for of in numbers], axis=0)
    ticks = int(np.argmin([*known, False]))
    if known[ticks:].any():
        raise UnreadableError(found.path, f"the tick at {trace.time_s[ticks]:g} s is missing")
    if ticks <= every:
        raise UnreadableError(found.path, f"it has {ticks} ticks: no two time steps")
    return ticks


def _source(found: Recorded) -> str:
    """Where it comes from: what ran, on what, by which version."""
    about = found.manifest
    ran = f"{about['scenario']} on {about['plant']}, seed {about['seed']}"
    text = f"mjmerge {about['versions']['mjmerge']}: {ran}"
    return "".join(c if c.isprintable() else "?" for c in text)


def _benchmark(name: str) -> str:
    """The id of the scenario: no country, its name in letters and digits, first configuration of a first."""
    words = re.findall("[A-Za-z0-9]+", name)
    return f"ZAM_{''.join(word[:1].upper() + word[1:] for word in words) or 'Merge'}-1_1_T-1"


def _lanelets(root: Xml.Element, scenario: Scenario, moved: Sequence[Motion]) -> None:
    there, width_m = lanes(scenario), scenario.road.lane_width_m
    x = np.concatenate([one.centre_m[:, 0] for one in moved])
    start, end = float(x.min()) - 4 * width_m, float(x.max()) + 4 * width_m
    points = min(2 + ceil((end - start) / (10 * width_m)), _MOST_POINTS)
    for i, lane in enumerate(there):
        element = Xml.SubElement(root, "lanelet", id=str(lane.id))
        for name, y in (("leftBound", lane.left_m), ("rightBound", lane.right_m)):
            bound = Xml.SubElement(element, name)
            for at in np.linspace(start, end, points).tolist():
                _point(bound, at, y)
        for name, k in (("adjacentLeft", i + 1), ("adjacentRight", i - 1)):
            beside = there[k] if 0 <= k < len(there) else None
            if beside is not None and {lane.left_m, lane.right_m} & {beside.left_m, beside.right_m}:
                Xml.SubElement(element, name, ref=str(beside.id), drivingDir="same")
        Xml.SubElement(element, "laneletType").text = "interstate"


def _obstacle(root: Xml.Element, id_: int, sheet: DataSheet, one: Motion) -> None:
    element = Xml.SubElement(root, "dynamicObstacle", id=str(id_))
    Xml.SubElement(element, "type").text = "car"
    rectangle = Xml.SubElement(Xml.SubElement(element, "shape"), "rectangle")
    for name, value in (("length", sheet.length_m), ("width", sheet.width_m)):
        Xml.SubElement(rectangle, name).text = _number(value)
    _state(element, "initialState", one, 0)
    path = Xml.SubElement(element, "trajectory")
    for k in range(1, len(one.centre_m)):
        _state(path, "state", one, k)


def _state(above: Xml.Element, name: str, one: Motion, k: int) -> None:
    state = Xml.SubElement(above, name)
    _point(Xml.SubElement(state, "position"), *one.centre_m[k].tolist())
    _exact(state, "orientation", float(one.heading_rad[k]))
    Xml.SubElement(Xml.SubElement(state, "time"), "exact").text = str(k)
    _exact(state, "velocity", float(one.speed_mps[k]))
    _exact(state, "acceleration", float(one.acceleration_mps2[k]))


def _problem(root: Xml.Element, scenario: Scenario, ego: Motion) -> None:
    """Where the ego starts, and that it is to be in the leader's lane by the end."""
    element = Xml.SubElement(root, "planningProblem", id=str(PROBLEM))
    start = Xml.SubElement(element, "initialState")
    _point(Xml.SubElement(start, "position"), *ego.centre_m[0].tolist())
    _exact(start, "velocity", float(ego.speed_mps[0]))
    _exact(start, "orientation", float(ego.heading_rad[0]))
    for name in ("yawRate", "slipAngle"):
        _exact(start, name, 0.0)
    Xml.SubElement(Xml.SubElement(start, "time"), "exact").text = "0"
    goal = Xml.SubElement(element, "goalState")
    y = getattr(scenario.initial, scenario.law.leader).front_m[1]
    target = min(lanes(scenario), key=lambda lane: abs((lane.left_m + lane.right_m) / 2 - y))
    Xml.SubElement(Xml.SubElement(goal, "position"), "lanelet", ref=str(target.id))
    time = Xml.SubElement(goal, "time")
    for name, k in (("intervalStart", 1), ("intervalEnd", len(ego.centre_m) - 1)):
        Xml.SubElement(time, name).text = str(k)


def _point(above: Xml.Element, x: float, y: float) -> None:
    point = Xml.SubElement(above, "point")
    for name, value in (("x", x), ("y", y)):
        Xml.SubElement(point, name).text = _number(value)


def _exact(above: Xml.Element, name: str, value: float) -> None:
    Xml.SubElement(Xml.SubElement(above, name), "exact").text = _number(value)


def _number(value: float) -> str:
    """A decimal, to a billionth: the format has no exponents."""
    return f"{value:.9f}".rstrip("0").rstrip(".")
