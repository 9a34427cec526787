"""Drivers that somebody brings: ``kind: mine.py:Name`` in a scenario, see :mod:`mjmerge.config.doors`."""

from __future__ import annotations

from inspect import isabstract
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import ConfigDict, ValidatorFunctionWrapHandler

from mjmerge.config.document import described
from mjmerge.config.doors import DoorError, admitted, from_outside, resolve, told
from mjmerge.drivers.base import Along, Driver
from mjmerge.state import Array

GROUP = "mjmerge.drivers"
"""Entry points of packages that bring drivers."""


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
        DoorError: a driver from outside raised something, or intends what is no acceleration per simulation.
    """
    method = getattr(driver, what)
    if not from_outside(driver.kind):
        return method(*arguments)
    place, _, _ = driver.kind.rpartition(":")
    with told(Path(place), f"{driver.kind} was asked for {what}: "):
        answer = method(*arguments)
    if what == "problems":
        with told(Path(place), f"{driver.kind} was asked for {what}: "):
            return list(answer)
    if what == "acceleration_mps2":
        own = arguments[1]
        given = np.asarray(answer)
        if given.shape not in ((), own.speed_mps.shape) or given.dtype.kind not in "fiu":
            raise DoorError(
                f"{driver.kind} intends {described(answer)}; it must be one acceleration for each of the "
                f"{len(own.speed_mps)} simulations, an array of that length"
            )
    return answer


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
