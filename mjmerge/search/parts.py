"""A failure taken apart: what of it differs from the scenario that it came from, piece by piece.

An axis is a key with a value of its own, or several that act only together; a move is one change of one
neighbour's mind, at a time of its own; what else a neighbour does is a part, too. Any of them can be taken
back alone, and what is left is a scenario again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import copysign, floor, log10
from typing import Any

from mjmerge.drivers.gap import Gap, Move
from mjmerge.drivers.speeds import Change, Speeds
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.search import calm
from mjmerge.search.company import Company, companies
from mjmerge.search.space import altered, begins, checked, driver
from mjmerge.sweep.plan import MISMATCH

Name = tuple[str, ...]
"""Of a part: ``("axis", key)``, the first key of those that act only together; ``("move", car, number)``; or
``("does", car, key)``."""


@dataclass(frozen=True)
class Parts:
    """What differs from a scenario.

    Attributes:
        base: the scenario.
        axes: keys with values of their own.
        moves: by neighbour, its changes of mind in order of time; of those that the search drives.
        driven: by neighbour, who drives it there.
        does: by neighbour and key of its driver, what else it does; see :mod:`mjmerge.search.calm`.
    """

    base: Scenario
    axes: Mapping[str, Any]
    moves: Mapping[str, tuple[Move | Change, ...]] = field(default_factory=dict)
    driven: Mapping[str, Gap | Speeds] = field(default_factory=dict)
    does: Mapping[tuple[str, str], Any] = field(default_factory=dict)

    @classmethod
    def of(cls, base: Scenario, scenario: Scenario, also: Mapping[str, Any]) -> Parts:
        """What of a scenario differs from the one that it came from.

        Args:
            base: that one.
            scenario: the scenario.
            also: keys beside the mismatch that the search has set, and their values.
        """
        mine, theirs = scenario.mismatch, base.mismatch
        axes = {
            MISMATCH + name: getattr(mine, name)
            for name in Mismatch.model_fields
            if getattr(mine, name) != getattr(theirs, name)
        }
        axes |= {key: value for key, value in also.items() if not key.startswith(MISMATCH)}
        driven: dict[str, Gap | Speeds] = {}
        for car in scenario.roster.neighbours:
            one = getattr(scenario.drivers, car)
            if one != getattr(base.drivers, car) and isinstance(one, Gap | Speeds):
                driven[car] = one
        moves = {car: one.moves if isinstance(one, Gap) else one.changes for car, one in driven.items()}
        return cls(base, axes, moves, driven)

    @cached_property
    def companies(self) -> Mapping[str, Company]:
        """The axes, those that act only together as one, by the first key of each."""
        return {one.keys[0]: one for one in companies(self.base, self.axes)}

    @property
    def names(self) -> list[Name]:
        """Of every part, the axes first."""
        moves = [("move", car, str(k)) for car, of in self.moves.items() for k in range(len(of))]
        does = [("does", *what) for what in self.does]
        return [*(("axis", key) for key in self.companies), *moves, *does]

    def without(self, names: set[Name]) -> Parts:
        """All but some parts: an axis has the scenario's own value again, a move is not made."""
        gone = {key for first, of in self.companies.items() if ("axis", first) in names for key in of.keys}
        return replace(
            self,
            axes={key: value for key, value in self.axes.items() if key not in gone},
            moves={
                car: tuple(one for k, one in enumerate(of) if ("move", car, str(k)) not in names)
                for car, of in self.moves.items()
            },
            does={what: value for what, value in self.does.items() if ("does", *what) not in names},
        )

    @property
    def _amounts(self) -> set[str]:
        """The axes that say how much there is of something, and not where."""
        return {key for one in self.companies.values() for key in one.amounts}

    def nearer(self, part: float) -> Parts:
        """With only a part of it: 0 is the scenario's own, 1 is all of it.

        That is of every axis that is a number; without any, of how far the moves go. What an axis goes with
        and only says where it is, such as where a patch begins, stays as it is.
        """
        much = self._amounts
        axes = {
            key: self._nearer(key, value, part) if key in much else value for key, value in self.axes.items()
        }
        if axes != dict(self.axes) or part == 1:
            return replace(self, axes=axes)
        moves = {car: tuple(self._shorter(car, one, part) for one in of) for car, of in self.moves.items()}
        return replace(self, moves=moves)

    def _nearer(self, key: str, value: Any, part: float) -> Any:
        own = self.own(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not isinstance(own, int | float):
            return value
        return own + part * (value - own)

    def _shorter(self, car: str, one: Move | Change, part: float) -> Move | Change:
        first = begins(self.base, car, lead=isinstance(one, Change))
        name = "speed_mps" if isinstance(one, Change) else "gap_m"
        return one.model_copy(update={name: first + part * (getattr(one, name) - first)})

    def further(self, ends: Mapping[str, Any]) -> Parts:
        """With as much of each axis as there may be."""
        much = self._amounts
        axes = {key: ends.get(key, value) if key in much else value for key, value in self.axes.items()}
        return replace(self, axes=axes)

    def own(self, key: str) -> Any:
        """What the scenario has at a key."""
        value: Any = self.base
        for name in key.split("."):
            value = getattr(value, name, None)
        return value

    def rounded(self, digits: int) -> Parts:
        """With so many significant digits in every number; an axis is rounded away from the scenario's."""
        much = self._amounts
        axes = {
            key: _rounded(value, digits, self.own(key) if key in much else None)
            for key, value in self.axes.items()
        }
        moves = {
            car: tuple(
                one.model_copy(update={name: _rounded(v, digits) for name, v in one if isinstance(v, float)})
                for one in of
            )
            for car, of in self.moves.items()
        }
        return replace(self, axes=axes, moves=moves)

    def scenario(self) -> Scenario:
        """The scenario that they make.

        Raises:
            ScenarioError: they make none, such as moves that overlap.
        """
        found = altered(self.base, self.axes)
        drivers: dict[str, Any] = {}
        for car, of in self.moves.items():
            lead = isinstance(self.driven.get(car), Speeds)
            drivers[car] = driver(self.base, car, of, lead=lead)
        for (car, key), value in self.does.items():
            before = drivers.get(car, getattr(self.base.drivers, car))
            drivers[car] = value if key == calm.WHOLE else before.model_copy(update={key: value})
        return checked(found.model_copy(update={"drivers": found.drivers.model_copy(update=drivers)}))

    def sentence(self) -> Iterator[str]:
        """Each part in words."""
        for name in self.names:
            yield said(self, name)


def said(parts: Parts, name: Name) -> str:
    """A part in words."""
    if name[0] == "axis":
        return ", ".join(_valued(key, parts.axes[key]) for key in parts.companies[name[1]].keys)
    who = name[1].replace("_", " ").capitalize()
    if name[0] == "does":
        return calm.said(who, name[2], parts.does[name[1], name[2]])
    one = parts.moves[name[1]][int(name[2])]
    if isinstance(one, Move):
        return f"{who} goes to a gap of {one.gap_m:g} m at {one.start_s:g} s, in {one.duration_s:g} s"
    return f"{who} goes to {one.speed_mps:g} m/s at {one.start_s:g} s, at {one.rate_mps2:g} m/s^2"


def _valued(key: str, value: Any) -> str:
    """A key and its value."""
    return f"{key.removeprefix(MISMATCH)} {f'{value:g}' if isinstance(value, float) else value}"


def _rounded(value: Any, digits: int, own: Any = None) -> Any:
    """A number to so many significant digits; away from another one, if there is one."""
    if isinstance(value, bool) or not isinstance(value, float) or value == 0:
        return value
    places = digits - 1 - floor(log10(abs(value)))
    near = round(value, places)
    if isinstance(own, int | float) and abs(near - own) < abs(value - own):
        near = round(near + copysign(10.0**-places, value - own), places)
    return near
