"""The space of a search: points of a unit cube, and the scenario that each of them stands for.

Every coordinate is a part of all draws, 0 to 1, of one key or of one change of a neighbour's mind. So the
same space serves a search, which looks at its corners too, and a probability, which weighs them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from math import sqrt
from typing import Any

import numpy as np

from mjmerge.config.document import Document, copied
from mjmerge.config.read import raise_problems, validated
from mjmerge.drivers.gap import Gap, Move
from mjmerge.drivers.speeds import Change, Speeds
from mjmerge.errors import MjmergeError, Problem, ScenarioError
from mjmerge.plant import check as check_plant
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.checks import check
from mjmerge.scenario.effect import given_in_vain
from mjmerge.scenario.levels import LEVELS, NAMES
from mjmerge.scenario.load import dump
from mjmerge.scenario.mismatch import Mismatch, is_number
from mjmerge.scenario.schema import Scenario
from mjmerge.scenario.space import Behaviour, Behaviours, Distribution, Level, Space
from mjmerge.state import Array
from mjmerge.sweep.plan import MISMATCH, size_of, written
from mjmerge.versions import versions

DEFAULT_LEVEL: Level = "realistic"
"""Of a space that nobody described."""
CHANGES = 3
"""Changes of mind of the follower there."""
BRAKES_MPS2 = 4.0
"""How hard it brakes and accelerates there: hard, and still what people do."""
LEAST_PART = 0.1
"""The mildest change of mind, over the hardest."""
SHORTEST_S = 0.1
"""A change of mind takes this long at least."""
TWO_SIDED = ("grade_rad", "bank_rad", "side_wind_n", "steer_offset_rad", "neighbour_position_bias_m")
"""Axes whose levels are as likely to the other side."""
_PEAK = 10 / sqrt(3)  # largest |s''| of the quintic step


@dataclass(frozen=True)
class Coordinate:
    """One coordinate of the space.

    Attributes:
        key: of the scenario; of a change of mind, such as ``drivers.vehicle_2.1.gap_m``.
        spread: how its values are distributed.
        also: other keys that go with any value but the scenario's own, and theirs.
    """

    key: str
    spread: Distribution
    also: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True)
class Ground:
    """A scenario and the space around it, on one plant.

    Attributes:
        scenario: where nothing is different yet.
        plant: what moves the cars.
        space: what may be different, as far as it acts on the plant.
        left_out: axes that were named and do not act there, and why.
        r_m: the margin r by which runs are judged, m; ``None`` for that of their law.
    """

    scenario: Scenario
    plant: str
    space: Space
    left_out: tuple[tuple[str, str], ...] = ()
    r_m: float | None = None

    @classmethod
    def around(cls, scenario: Scenario, plant: str) -> Ground:
        """Around a scenario: where its section ``search`` says, or a space that follows from its scale.

        An axis that cannot act on the plant is left out: friction, where there are no tyres.

        Raises:
            MjmergeError: there is no such plant, a key of the space is none, or nothing can be different.
        """
        check_plant(plant, scenario)
        changes, space = scenario.changes, scenario.search or default(scenario)
        scenario = scenario.settled().recalling(changes)
        problems: list[Problem] = []
        left_out: dict[str, str] = {}
        for key, spread in space.axes.items():
            vain: dict[str, str] = {}
            for part in (0.0, 1.0):
                try:
                    other = altered(scenario, {key: spread.at(part)})
                    vain |= given_in_vain(other, plant, [key])
                except ScenarioError as error:
                    problems += [replace(p, key=f"search.axes.{key}") for p in error.problems]
            if key in vain and not _acts_beside(scenario, plant, space, key):
                left_out[key] = vain.pop(key)
            problems += [Problem(why, f"search.axes.{name}") for name, why in vain.items() if name != key]
        if problems:
            raise ScenarioError(scenario.name, list(dict.fromkeys(problems)))
        rest = {key: spread for key, spread in space.axes.items() if key not in left_out}
        found = cls(scenario, plant, space.model_copy(update={"axes": rest}), tuple(sorted(left_out.items())))
        if not found.size:
            none = "; ".join(f"{key} {why}" for key, why in found.left_out) or "its search names nothing"
            raise MjmergeError(f"scenario {scenario.name!r}: nothing may be different on {plant}: {none}")
        return found

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Every coordinate, in the order of a point's numbers."""
        return (*self._axes(), *self._changes())

    def digest(self, *also: str) -> str:
        """Of all that a point's run follows from: the scenario, the plant, the space, the versions.

        Args:
            also: what else it follows from.
        """
        space = self.space.model_dump(mode="json")
        known = json.dumps([dump(self.scenario), self.plant, space, self.r_m, versions(), *also])
        return sha256(known.encode()).hexdigest()

    @property
    def size(self) -> int:
        """How many coordinates a point has, D."""
        return len(self.coordinates)

    def _axes(self) -> Iterator[Coordinate]:
        """Axes of the level that act on this plant, where nothing else is said, and those that are named."""
        space = self.space
        if space.level is not None:
            at = NAMES.index(space.level)
            for axis, steps in LEVELS[size_of(self.scenario)].items():
                key, step = MISMATCH + axis, steps[at]
                also = tuple((MISMATCH + name, value) for name, value in step.items() if name != axis)
                named = {key, *(other for other, _ in also)} & space.axes.keys()
                if named or axis in space.leave_out or key in space.leave_out or not self._acts(step):
                    continue
                start = getattr(self.scenario.mismatch, axis)
                if is_number(axis) and start is not None:
                    yield Coordinate(key, Distribution(uniform=_range(axis, start, step[axis])), also)
                else:
                    yield Coordinate(key, Distribution(choice=(start, step[axis])), also)
        for key, spread in space.axes.items():
            yield Coordinate(key, spread)

    def _acts(self, values: Mapping[str, Any]) -> bool:
        """Whether a mismatch has an effect on this plant."""
        there = Mismatch.model_validate(self.scenario.mismatch.model_dump() | dict(values))
        other = self.scenario.model_copy(update={"mismatch": there})
        return not given_in_vain(other, self.plant, [MISMATCH + name for name in values])

    def _changes(self) -> Iterator[Coordinate]:
        for car in self.scenario.roster.neighbours:
            may = self.space.neighbours.of(car)
            if may is None or not may.changes:
                continue
            key, low, high = _goal(may, car)
            room_s = (self.scenario.duration_s - may.from_s) / may.changes
            for k in range(may.changes):
                at = f"drivers.{car}.{k}"
                yield Coordinate(f"{at}.wait_s", Distribution(uniform=(0.0, room_s)))
                yield Coordinate(f"{at}.{key}", Distribution(uniform=(low, high)))
                hardest = may.acceleration_mps2
                yield Coordinate(f"{at}.peak_mps2", Distribution(uniform=(LEAST_PART * hardest, hardest)))

    def values(self, point: Array) -> dict[str, Any]:
        """What each coordinate comes to, by key."""
        parts = np.clip(point, 0.0, 1.0).tolist()
        return {c.key: c.spread.at(part) for c, part in zip(self.coordinates, parts, strict=True)}

    def axes(self, point: Array) -> dict[str, Any]:
        """What the coordinates come to that are keys of the scenario."""
        return {key: value for key, value in self.values(point).items() if not _is_change(key)}

    def ends(self, point: Array) -> dict[str, Any]:
        """How far each axis that is a number may go on the side on which a point has it."""
        found = {}
        spreads = {coordinate.key: coordinate.spread for coordinate in self.coordinates}
        for key, value in self.axes(point).items():
            low, high, own = spreads[key].at(0.0), spreads[key].at(1.0), _value(self.scenario, key)
            if spreads[key].choice is None and isinstance(own, int | float):
                found[key] = high if value > own else low
        return found

    def at(self, point: Array) -> Scenario:
        """The scenario that a point stands for.

        Args:
            point: its coordinates, (D,), each 0 to 1.

        Raises:
            ScenarioError: it is none, such as one whose cars overlap.
        """
        return self.of(self.values(point))

    def of(self, values: Mapping[str, Any]) -> Scenario:
        """The scenario in which some coordinates have these values, and the others are as in the scenario."""
        settings: dict[str, Any] = {}
        for coordinate in self.coordinates:
            key = coordinate.key
            if key in values and not _is_change(key):
                settings[key] = values[key]
                if values[key] != _value(self.scenario, key):
                    settings |= {name: value for name, value in coordinate.also if name not in values}
        found = altered(self.scenario, settings)
        drivers = {}
        for car in self.scenario.roster.neighbours:
            may = self.space.neighbours.of(car)
            if may is not None:
                drivers[car] = self._driver(car, may, values)
        return checked(found.model_copy(update={"drivers": found.drivers.model_copy(update=drivers)}))

    def _driver(self, car: str, may: Behaviour, values: Mapping[str, Any]) -> Gap | Speeds:
        """A neighbour that changes its mind as a point says."""
        key, _, _ = _goal(may, car)
        lead = may.gap_m is None
        time_s, now = may.from_s, begins(self.scenario, car, lead=lead)
        changes: list[Move | Change] = []
        for k in range(may.changes):
            at = f"drivers.{car}.{k}"
            if f"{at}.{key}" not in values:
                continue
            time_s += values[f"{at}.wait_s"]
            goal, peak = values[f"{at}.{key}"], values[f"{at}.peak_mps2"]
            if lead:
                changes.append(Change(start_s=time_s, rate_mps2=peak, speed_mps=goal))
                time_s += abs(goal - now) / peak
            else:
                lasts_s = max(SHORTEST_S, sqrt(_PEAK * abs(goal - now) / peak))
                changes.append(Move(start_s=time_s, duration_s=lasts_s, gap_m=goal))
                time_s += lasts_s
            now = goal
        return driver(self.scenario, car, tuple(changes), lead=lead)


def driver(scenario: Scenario, car: str, changes: Sequence[Move | Change], *, lead: bool) -> Gap | Speeds:
    """Who makes these changes of mind, and is otherwise as the scenario's own driver, as far as it can be."""
    own, first = getattr(scenario.drivers, car), begins(scenario, car, lead=lead)
    if lead:
        gain: float = getattr(own, "gain_per_s", Speeds.model_fields["gain_per_s"].default)
        speeds = tuple(one for one in changes if isinstance(one, Change))
        if isinstance(own, Speeds):
            return own.model_copy(update={"changes": speeds})
        return Speeds(speed_mps=first, changes=speeds, gain_per_s=gain)
    eager: float = getattr(own, "bandwidth_radps", Gap.model_fields["bandwidth_radps"].default)
    moves = tuple(one for one in changes if isinstance(one, Move))
    if isinstance(own, Gap):
        return own.model_copy(update={"moves": moves})
    return Gap(gap_m=first, moves=moves, bandwidth_radps=eager)


def begins(scenario: Scenario, car: str, *, lead: bool) -> float:
    """The speed, m/s, or else the gap, m, that a neighbour has before it changes its mind."""
    own, starts = getattr(scenario.drivers, car), scenario.initial
    if lead:
        return float(getattr(own, "speed_mps", getattr(starts, car).speed_mps))
    if isinstance(own, Gap):
        return own.gap_m
    x = getattr(starts, car).front_m[0]
    others = [start.front_m[0] for start in scenario.starts[1:] if start.front_m[0] > x]
    if not others:
        raise MjmergeError(f"nobody drives ahead of {car}: it may change its speed, speed_mps, not its gap")
    return float(min(others) - x)


def _goal(may: Behaviour, car: str) -> tuple[str, float, float]:
    """What a change of mind is about, and between what: the gap or the speed."""
    if (may.gap_m is None) == (may.speed_mps is None):
        raise MjmergeError(f"search.neighbours.{car}: must have gap_m or speed_mps, one of the two")
    if may.gap_m is not None:
        return "gap_m", *may.gap_m
    assert may.speed_mps is not None
    return "speed_mps", *may.speed_mps


def _range(axis: str, start: float, level: Any) -> tuple[float, float]:
    """From no mismatch to a level of it; to both sides where an axis has two."""
    two = axis in TWO_SIDED and start == 0
    return (-abs(level), abs(level)) if two else (float(start), float(level))


def _acts_beside(scenario: Scenario, plant: str, space: Space, key: str) -> bool:
    """Whether a key that is in vain by itself acts where the other axes are at one of their ends."""
    for at in (0.0, 1.0):
        others = {name: spread.at(at) for name, spread in space.axes.items() if name != key}
        for part in (0.0, 1.0):
            with suppress(ScenarioError):
                other = altered(scenario, others | {key: space.axes[key].at(part)})
                differs = _value(other, key) != _value(altered(scenario, others), key)
                if differs and key not in given_in_vain(other, plant, [key]):
                    return True
    return False


def _is_change(key: str) -> bool:
    """Whether a coordinate is about a change of mind."""
    parts = key.split(".")
    return len(parts) == 4 and parts[0] == "drivers" and parts[2].isdigit()


def _value(scenario: Scenario, key: str) -> Any:
    value: Any = scenario
    for part in key.split("."):
        value = getattr(value, part, None)
    return value


def altered(scenario: Scenario, settings: Mapping[str, Any]) -> Scenario:
    """A scenario with other values at some of its keys; all else, its name too, as it was.

    Raises:
        ScenarioError: there is no such key, or the value is none for it.
    """
    if not settings:
        return scenario
    alone = all(key.startswith(MISMATCH) for key in settings)  # the most common, and a tenth of the time
    sections = {"mismatch"} if alone else None
    document = copied(scenario.model_dump(include=sections, warnings=False))
    for key, value in settings.items():
        document.override(f"{key}={written(value)}")
    if alone:
        part = Document(document.value["mismatch"], problems=document.problems)
        mismatch = validated(Mismatch, part)
        raise_problems(f"scenario {scenario.name!r}, altered", part)
        return scenario.model_copy(update={"mismatch": mismatch})
    made = validated(Scenario, document)
    raise_problems(f"scenario {scenario.name!r}, altered", document)
    changed = {key.partition(".")[0] for key in settings}
    return scenario.model_copy(update={name: getattr(made, name) for name in changed})


def checked(scenario: Scenario) -> Scenario:
    """The scenario, if it is one that a file could say.

    Raises:
        ScenarioError: with what is wrong with it.
    """
    sections: dict[str, Any] = {name: getattr(scenario, name) for name in Scenario.model_fields}
    sections["sheets"] = dict(zip(scenario.roster.cars, car_sheets(scenario), strict=True))
    problems = list(check(sections))
    if problems:
        raise ScenarioError(f"scenario {scenario.name!r}, altered", problems)
    return scenario


def default(scenario: Scenario) -> Space:
    """The space of a scenario that says none: realistic mismatch, and a follower that changes its mind."""
    follower = scenario.law.follower
    start, ahead = getattr(scenario.initial, follower), getattr(scenario.initial, scenario.law.leader)
    gap_m = ahead.front_m[0] - start.front_m[0]
    may = Behaviour(
        changes=CHANGES,
        acceleration_mps2=BRAKES_MPS2,
        gap_m=(2.2 * scenario.r_m, max(gap_m, 4 * scenario.r_m)),
    )
    return Space(level=DEFAULT_LEVEL, neighbours=Behaviours.model_validate({follower: may}))
