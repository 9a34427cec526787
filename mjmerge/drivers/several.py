"""The drivers of one neighbour in many simulations, asked together: what differs in them are numbers.

A driver whose class ``stacks`` is written so that each number among its fields may be an array (N,), one for
each simulation; so a thousand simulations whose drivers differ in their gaps and times are asked at once. All
others are asked once for those simulations in which they are the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from mjmerge.config.doors import from_outside
from mjmerge.drivers.base import Driver
from mjmerge.state import Array

Rows = slice | NDArray[np.intp]
"""Which simulations: all, or those of an index array."""
ALL = slice(None)


@dataclass(frozen=True)
class Together:
    """A driver, and the simulations in which it drives a neighbour.

    Attributes:
        driver: one, or several of a kind whose numbers are arrays (N,), one for each of these simulations.
        rows: which simulations.
        drawn: what its ``draw`` gave for them, with a row for each; ``None`` if it draws nothing.
    """

    driver: Driver
    rows: Rows
    drawn: Array | None = None

    def alone(self, run: int) -> Together:
        """The same in one of its simulations, which then is the only one; of a driver that is but one."""
        return replace(self, drawn=None if self.drawn is None else self.drawn[run : run + 1])


def together(drivers: Sequence[Driver]) -> list[Together]:
    """Who can be asked together.

    Args:
        drivers: one for each simulation, (N,).
    """
    first, runs = drivers[0], len(drivers)
    if all(driver is first or driver == first for driver in drivers):
        return [Together(first, ALL)]
    alike: list[tuple[object, list[int]]] = []
    for run, driver in enumerate(drivers):
        stacks = type(driver).stacks and not from_outside(driver.kind)
        key: object = _structure(driver) if stacks else driver
        for other, members in alike:
            if key is other or key == other:
                members.append(run)
                break
        else:
            alike.append((key, [run]))
    return [
        Together(
            _stacked([drivers[run] for run in members]), ALL if len(members) == runs else np.array(members)
        )
        for _, members in alike
    ]


def _structure(value: Any) -> object:
    """What must be the same in drivers that are asked together: all but their numbers."""
    if isinstance(value, BaseModel):
        return type(value), *(_structure(getattr(value, name)) for name in type(value).model_fields)
    if isinstance(value, tuple):
        return tuple(map(_structure, value))
    return float if isinstance(value, int | float) and not isinstance(value, bool) else value


def _stacked(values: Sequence[Any]) -> Any:
    """Values of one structure as one, with arrays in the place of numbers that differ."""
    first = values[0]
    if all(value is first or value == first for value in values):
        return first
    if isinstance(first, BaseModel):
        fields = type(first).model_fields
        return type(first).model_construct(**{n: _stacked([getattr(v, n) for v in values]) for n in fields})
    if isinstance(first, tuple):
        return tuple(_stacked(column) for column in zip(*values, strict=True))
    return np.array(values, dtype=np.float64)
