"""CommonRoad scenarios, XML of version 2020a, read into tracks and lanes.

Source: the CommonRoad XML format, version 2020a. A lanelet is a lane; positions are rectangles' centres.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mjmerge.errors import Problem, ScenarioError, nearest
from mjmerge.state import Array
from mjmerge.traffic.lanes import located
from mjmerge.traffic.plausible import biased, doubts_of_units
from mjmerge.traffic.tracks import (
    Lane,
    Track,
    Tracks,
    Unused,
    read_bytes,
    refuse,
    track,
)

VERSION = "2020a"
LARGEST_BYTES = 32_000_000
MOST_STATES = 400_000
_ENCODINGS = ("utf-8", "us-ascii", "utf-16", "iso-8859-1", "iso-8859-15", "windows-1252")
_DECLARATION = re.compile(r"\s*<\?xml\b([^>]*)\?>")
_FURTHEST_M = 1e7
_JOINED_M = 3.0  # between the end of a lanelet and the start of the next
_MOVING, _STANDING = "dynamicObstacle", ("staticObstacle", "environmentObstacle", "phantomObstacle")
_NOT_CARS = ("unknown", "car")


def read_commonroad(path: Path) -> Tracks:
    """A CommonRoad file.

    Raises:
        ScenarioError: with everything that is wrong with it, with lines.
    """
    advice = "cut it down to the road users and times that matter"
    data = read_bytes(path, LARGEST_BYTES, "a CommonRoad file", advice)
    root = _root(path, data)
    reader = _Reader()
    step_s = reader.step_s(root)
    refuse(path, reader.problems)
    lanes = {lane.id: lane for lane in reader.lanelets(root)}
    found: dict[str, Track] = {}
    unused: list[Unused] = []
    for element in root:
        if element.tag in _STANDING:
            words = "stands for the whole record" if element.tag == _STANDING[0] else f"is a {element.tag}"
            unused.append(Unused(str(element.get("id", "?")), words, element.sourceline))
        elif element.tag == _MOVING:
            one = reader.obstacle(element)
            if isinstance(one, Track):
                one = track(one, step_s, f"{_MOVING} {one.id}", reader.notes, reader.problems)
            if isinstance(one, Unused):
                unused.append(one)
            elif one is not None:
                found[one.id] = one
    reader.problems += doubts_of_units(list(found.values()), step_s)
    if not found and not unused and not reader.problems:
        reader.problems.append(Problem("there is no road user in it: nothing to make scenarios of"))
    refuse(path, reader.problems)
    lanes = _joined(lanes, reader.notes)
    placed = {one.id: replace(one, lane=located(one.centre_m, lanes)) for one in found.values()}
    every = (*reader.notes, *biased(list(found.values()), step_s))
    return Tracks(path, f"CommonRoad {VERSION}", step_s, placed, lanes, tuple(unused), every)


def _root(path: Path, data: bytes) -> Any:
    """The root element. No document type is read, so that no entity is ever expanded or fetched."""
    from lxml import etree

    text = _text(path, data)
    doctype = re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE)
    if doctype is not None:
        line = text.count("\n", 0, doctype.start()) + 1
        refuse(path, [Problem("has a document type or entities; a CommonRoad file has none", "", line)])
    declaration = _DECLARATION.match(text)
    if declaration is not None:  # what it says of the encoding is true no more
        text = "\n" * declaration[0].count("\n") + text[declaration.end() :]
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, huge_tree=False, load_dtd=False, remove_comments=True,
        remove_pis=True,
    )  # fmt: skip
    try:
        root = etree.fromstring(text.lstrip("\ufeff \t\r").encode("utf-8"), parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        message = f"not a whole XML file: {getattr(error, 'msg', error)}"
        raise ScenarioError(path, [Problem(message, "", getattr(error, "lineno", None))]) from error
    if root.tag != "commonRoad":
        message = f"its root is <{str(root.tag)[:60]}>; that of a CommonRoad file is <commonRoad>"
        refuse(path, [Problem(message, "", root.sourceline)])
    version = root.get("commonRoadVersion")
    if version != VERSION:
        message = f"CommonRoad of version {version!r}; only {VERSION} is read: convert it first"
        refuse(path, [Problem(message, "commonRoadVersion", root.sourceline)])
    return root


def _text(path: Path, data: bytes) -> str:
    """What is in it, by the encoding that it declares; UTF-8 where it declares none."""
    named = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8"
    declared = re.match(rb"(?:\xef\xbb\xbf)?\s*<\?xml[^>]*encoding\s*=\s*[\"']([\w.-]{1,40})", data[:400])
    if declared is not None:
        named = declared[1].decode("ascii", "replace").lower()
        if named not in _ENCODINGS:
            message = f"encoding {named!r} is not read: {nearest(named, _ENCODINGS)}"
            refuse(path, [Problem(message, "", 1)])
    try:
        return data.decode("utf-8-sig" if named == "utf-8" else named)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ScenarioError(path, [Problem(f"not text in {named.upper()}", "", line)]) from error


class _Reader:
    """Reads elements, and collects what is wrong with them and what was put right."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self.notes: list[str] = []
        self._states = 0

    def step_s(self, root: Any) -> float:
        """Time between two time steps."""
        given = root.get("timeStepSize")
        value = _number(given)
        if value is None or not 1e-3 <= value <= 2:
            message = f"must be the seconds between two time steps, 0.001 to 2, got {given!r}"
            self.problems.append(Problem(message, "timeStepSize", root.sourceline))
            return 0.1
        return value

    def lanelets(self, root: Any) -> Iterator[Lane]:
        """The lanes, as far as they are right."""
        seen: dict[str, int] = {}
        before: dict[str, set[str]] = {}
        lanes = []
        for element in root.iterfind("lanelet"):
            id_, where = self._id(element, seen)
            bounds = [self._points(element, side, where) for side in ("leftBound", "rightBound")]
            if id_ is None or bounds[0] is None or bounds[1] is None:
                continue
            left, right = bounds[0], bounds[1]
            if len(left) != len(right):
                count = max(len(left), len(right))
                left, right = _resampled(left, count), _resampled(right, count)
            after = [str(of.get("ref")) for of in element.iterfind("successor")]
            for of in element.iterfind("predecessor"):
                before.setdefault(str(of.get("ref")), set()).add(id_)
            lanes.append(Lane(id_, left, right, tuple(after), element.sourceline))
        for lane in lanes:
            further = sorted(before.get(lane.id, set()) - {*lane.after})
            yield replace(lane, after=(*lane.after, *further))

    def obstacle(self, element: Any) -> Track | Unused | None:
        """A road user as it stands there; ``None`` where it is wrong."""
        id_, where = self._id(element)
        wrong = len(self.problems)
        kind = (element.findtext("type") or "unknown").strip()
        shape = self._shape(element, where)
        elements = [element.find("initialState"), *element.iterfind("trajectory/state")]
        if elements[0] is None:
            self._wrong(element, where, "has no initialState")
        if element.find("trajectory") is None and element.find("occupancySet") is None:
            self._wrong(element, where, "has no trajectory: one state at most; a track has at least two")
        if element.find("occupancySet") is not None:
            return Unused(
                id_ or "?", "is given by areas that it may be in, not by positions", element.sourceline
            )
        states = [one for one in elements if one is not None]
        self._states += len(states)
        if self._states > MOST_STATES:
            if self._states - len(states) <= MOST_STATES:
                self._wrong(element, where, f"the file has more than {MOST_STATES} states; cut it")
            return None
        areas = [
            one for one in states if one.find("position/point") is None and one.find("position") is not None
        ]
        if areas:
            return Unused(id_ or "?", "its position is an area, not a point", areas[0].sourceline)
        step = [self._time(one, where) for one in states]
        centre = [[self._exact(one, f"position/point/{c}", where) for c in "xy"] for one in states]
        speed = [self._optional(one, "velocity", where) for one in states]
        acceleration = [self._optional(one, "acceleration", where) for one in states]
        if len(self.problems) > wrong or id_ is None or shape is None:
            return None
        if isinstance(shape, str):
            return Unused(id_, shape, element.sourceline)
        return Track(
            id_, kind, *shape, np.array(step, dtype=np.int64), np.array(centre, dtype=float).reshape(-1, 2),
            np.array([], dtype=str), np.array(speed), np.array(acceleration), element.sourceline,
        )  # fmt: skip

    def _id(self, element: Any, seen: dict[str, int] | None = None) -> tuple[str | None, str]:
        id_ = element.get("id")
        where = f"{element.tag} {str(id_)[:40]}"
        if not id_:
            self._wrong(element, str(element.tag), "has no id")
            return None, where
        known = self.__dict__.setdefault("_known", {}) if seen is None else seen
        if id_ in known:
            self._wrong(element, where, f"is there twice, first on line {known[id_]}")
            return None, where
        known[id_] = element.sourceline
        return str(id_), where

    def _shape(self, element: Any, where: str) -> tuple[float, float] | str | None:
        """Length and width; why it is of no use; ``None`` where it is wrong."""
        shape = element.find("shape")
        if shape is None or not len(shape):
            self._wrong(element, where, "has no shape: how long and wide it is")
            return None
        if len(shape) > 1 or shape[0].tag not in ("rectangle", "circle"):
            return f"its shape is no rectangle ({', '.join(str(part.tag) for part in shape)})"
        part, sizes = shape[0], []
        for name in ("length", "width") if part.tag == "rectangle" else ("radius", "radius"):
            size = self._exact(shape, f"{part.tag}/{name}", where)
            if size is not None and not 0.1 <= size <= 100:
                self._wrong(part, where, f"its {name} is {size:g} m; 0.1 to 100 m are possible")
            sizes.append(size)
        off = [_number(of.text) for of in part.iterfind("center/*")]
        if any(off) or _number(part.findtext("orientation") or "0") != 0:
            return "its rectangle is not around its position"
        if sizes[0] is None or sizes[1] is None:
            return None
        twice = 1.0 if part.tag == "rectangle" else 2.0
        return twice * sizes[0], twice * sizes[1]

    def _points(self, element: Any, side: str, where: str) -> Array | None:
        bound = element.find(side)
        points = [] if bound is None else list(bound.iterfind("point"))
        if len(points) < 2:
            line = element if bound is None else bound
            self._wrong(line, where, f"its {side} has {len(points)} points; a line has at least two")
            return None
        values = [[self._exact(one, c, f"{where}, {side}") for c in "xy"] for one in points]
        if any(value is None for pair in values for value in pair):
            return None
        return np.array(values, dtype=float)

    def _time(self, state: Any, where: str) -> int:
        value = self._exact(state, "time/exact", where)
        if value is None:
            return 0
        if value != int(value) or value < 0:
            self._wrong(state, where, f"its time is {value:g}; time steps are whole numbers from 0 on")
            return 0
        return int(value)

    def _exact(self, element: Any, path: str, where: str) -> float | None:
        part = element.find(path)
        if part is None:
            self._wrong(element, where, f"<{path}> is missing in <{element.tag}>")
            return None
        value = _number(part.text)
        if value is None or abs(value) > _FURTHEST_M:
            text = (part.text or "").strip()[:40]
            self._wrong(part, where, f"<{part.tag}> must be a number, at most {_FURTHEST_M:g}, got {text!r}")
            return None
        return value

    def _optional(self, state: Any, name: str, where: str) -> float:
        """A number that may be missing, or an interval: NaN then."""
        if state.find(f"{name}/exact") is None:
            return np.nan
        value = self._exact(state, f"{name}/exact", where)
        return np.nan if value is None else value

    def _wrong(self, element: Any, where: str, message: str) -> None:
        self.problems.append(Problem(message, where, element.sourceline))


def _number(text: str | None) -> float | None:
    """A finite number; ``None`` for anything else."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _resampled(points_m: Array, count: int) -> Array:
    """So many points along the same line, (count, 2)."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points_m, axis=0).T)))
    at = np.linspace(0, along[-1], count)
    return np.stack([np.interp(at, along, points_m[:, i]) for i in (0, 1)], axis=1)


def _joined(lanes: dict[str, Lane], notes: list[str]) -> dict[str, Lane]:
    """The lanes with those links alone that lead from an end to a start."""
    found = {}
    for lane in lanes.values():
        end_m = lane.centre_m[-1]
        after = []
        for other in lane.after:
            apart = np.inf if other not in lanes else np.hypot(*(lanes[other].centre_m[0] - end_m))
            if other != lane.id and apart <= _JOINED_M:
                after.append(other)
            else:
                where = (
                    "which is not there" if other not in lanes else f"which starts {apart:.1f} m from its end"
                )
                notes.append(f"lanelet {lane.id} (line {lane.line}) goes on into {other}, {where}: left out")
        found[lane.id] = replace(lane, after=tuple(dict.fromkeys(after)))
    return found
