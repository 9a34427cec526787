"""Drivers that somebody brings: ``kind: mine.py:Name`` in a scenario, see :mod:`mjmerge.config.doors`."""

from __future__ import annotations

from collections.abc import Sequence
from inspect import isabstract
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import ConfigDict, ValidatorFunctionWrapHandler

from mjmerge.config.document import described
from mjmerge.config.doors import DoorError, admitted, from_outside, keeps, resolve, told
from mjmerge.drivers.base import Along, Driver
from mjmerge.state import Array

GROUP = "mjmerge.drivers"
"""Entry points of packages that bring drivers."""
OWN = frozenset({"can_lead", "problems", "draw", "random", "switches", "stands", "acceleration_mps2"})
"""What the class of a driver is there to say."""


def brought(kind: str) -> type[Driver]:
    """The class of a driver from outside.

    Args:
        kind: its located name.

    Raises:
        DoorError: it is not there, does not run, or is no driver.
    """
    return _checked(kind, resolve(kind))


def _checked(kind: str, found: Any) -> type[Driver]:
    """What was found, if it is a driver's class.

    Raises:
        DoorError: it is not.
    """
    if not (isinstance(found, type) and issubclass(found, Driver)):
        raise DoorError(f"{kind} is no driver: a class derived from mjmerge.drivers.Driver")
    if isabstract(found):
        missing = ", ".join(sorted(found.__abstractmethods__))
        raise DoorError(f"{kind} is no driver yet: it lacks {missing}")
    if not isinstance(found.can_lead, bool):
        raise DoorError(f"{kind} can lead with {described(found.can_lead)}; it must be true or false")
    keeps(kind, found, Driver, OWN)
    return found


def let_in(value: Any, shipped: ValidatorFunctionWrapHandler) -> Any:
    """Validates a driver; see :func:`mjmerge.config.doors.admitted`."""
    return admitted(value, shipped, Driver, _checked)


def ask(driver: Driver, what: str, *arguments: Any) -> Any:
    """Calls a method of a driver; one from outside that does not answer as it must is told by name.

    Args:
        driver: whom.
        what: name of the method.
        arguments: of it.

    Raises:
        DoorError: a driver from outside raised something, or answered what can be no answer.
    """
    if not from_outside(driver.kind):
        return getattr(driver, what)(*arguments)
    place, _, _ = driver.kind.rpartition(":")
    with told(Path(place), f"{driver.kind} was asked for {what}: "):
        answer = getattr(driver, what)(*arguments)
        if what == "problems":
            return [(str(key), str(message)) for key, message in answer]
        given = np.asarray(answer)
    verb, looked_at = _EXPECTED[what]
    right, must = looked_at(given, arguments)
    if not right:
        raise DoorError(f"{driver.kind} {verb} {described(answer)}; it must be {must}")
    return answer


def _acceleration(given: np.ndarray, arguments: Sequence[Any]) -> tuple[bool, str]:
    runs = len(arguments[1].speed_mps)
    right = given.shape in ((), (runs,)) and given.dtype.kind in "fiu"
    return right, f"one acceleration for each of the {runs} simulations, an array of that length"


def _stands(given: np.ndarray, arguments: Sequence[Any]) -> tuple[bool, str]:
    runs = len(arguments[1].speed_mps)
    right = given.shape in ((), (runs,)) and given.dtype.kind == "b"
    return right, f"true or false for each of the {runs} simulations, an array of that length"


def _switches(given: np.ndarray, arguments: Sequence[Any]) -> tuple[bool, str]:
    del arguments
    right = given.ndim == 1 and (not given.size or given.dtype.kind in "fiu")
    return right and bool(np.isfinite(given.astype(float)).all()), "an array of times, s"


def _draw(given: np.ndarray, arguments: Sequence[Any]) -> tuple[bool, str]:
    runs = len(arguments[0])
    right = given.shape[:1] == (runs,) and given.dtype.kind in "fiub"
    nothing = given.shape == () and given[()] is None
    return right or nothing, f"an array of numbers with a row for each of the {runs} simulations, or None"


def _random(given: np.ndarray, arguments: Sequence[Any]) -> tuple[bool, str]:
    del arguments
    return given.shape == () and given.dtype.kind == "b", "true or false"


_EXPECTED = {
    "acceleration_mps2": ("intends", _acceleration),
    "stands": ("means to stand with", _stands),
    "switches": ("switches at", _switches),
    "draw": ("draws", _draw),
    "random": ("is random with", _random),
}
"""Of each answer its verb, and, from it as an array and what was asked: is it one, and what must it be."""


class Absent(Driver):
    """A driver from outside whose code is not let in, as where a recording is read: its keys alone."""

    can_lead: ClassVar[bool] = True  # it did

    model_config = ConfigDict(extra="allow")

    kind: str

    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """Nobody knows.

        Raises:
            DoorError: always.
        """
        del time_s, own, leader, drawn, hold_s
        raise DoorError(f"what {self.kind} does is not known without its code")
