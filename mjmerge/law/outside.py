"""Laws that somebody brings: ``kind: mine.py:Name`` in a scenario, see :mod:`mjmerge.config.doors`.

A law is a class derived from :class:`Law`, or a function, see :mod:`mjmerge.law.function`.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from pydantic import ConfigDict, PrivateAttr, ValidatorFunctionWrapHandler

from mjmerge.config.document import described
from mjmerge.config.doors import DoorError, admitted, keeps, resolve
from mjmerge.law.base import Decision, Law, Memory, Signal
from mjmerge.law.function import law_of
from mjmerge.law.sensed import Sensed

GROUP = "mjmerge.laws"
"""Entry points of packages that bring laws."""
OWN = frozenset(
    {
        "remembers", "gives", "needs", "guard", "signals", "label", "problems", "start", "decide", "advance",
        "unguarded", "singular", "flow",
    }
)  # fmt: skip
"""What the class of a law is there to say."""
DEFAULT = "opinion_dynamics"
"""The kind of a law that says none: the paper's."""


def brought(kind: str) -> type[Law]:
    """The class of a law from outside.

    Args:
        kind: its located name.

    Raises:
        DoorError: it is not there, does not run, or is no law.
    """
    return _checked(kind, resolve(kind))


def _checked(kind: str, found: Any) -> type[Law]:
    """What was found, if it is a law's class, or the class that a function becomes.

    Raises:
        DoorError: it is neither.
    """
    if isinstance(found, type) and issubclass(found, Law):
        if found.decide is Law.decide:
            raise DoorError(f"{kind} is no law yet: it lacks decide")
        keeps(kind, found, Law, OWN)
        needs: Any = found.needs
        if not isinstance(needs, Mapping) or not all(
            isinstance(n, str) for pair in needs.items() for n in pair
        ):
            raise DoorError(f"{kind} needs {described(needs)}; it must be extras by the name of a module")
        return found
    if inspect.isclass(found) or not callable(found):
        raise DoorError(
            f"{kind} is no law: a function law(seen, memory, dt), or a class derived from mjmerge.law.Law"
        )
    return law_of(kind, found)


class AbsentLaw(Law):
    """A law from outside whose code is not let in, as where a recording is read: its keys alone."""

    model_config = ConfigDict(extra="allow")

    kind: str
    _signals: tuple[Signal, ...] = PrivateAttr(default=())

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Those that were recorded, as whoever reads a recording says."""
        return self._signals

    def with_signals(self, signals: tuple[Signal, ...]) -> AbsentLaw:
        """A copy that has these signals."""
        copy = self.model_copy()
        copy._signals = signals
        return copy

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """Nobody knows.

        Raises:
            DoorError: always.
        """
        del seen, memory, step_s
        raise DoorError(f"what {self.kind} decides is not known without its code")


def let_in(value: Any, shipped: ValidatorFunctionWrapHandler) -> Any:
    """Validates a law; see :func:`mjmerge.config.doors.admitted`."""
    if isinstance(value, Mapping) and "kind" not in value:
        value = {"kind": DEFAULT, **value}
    return admitted(value, shipped, Law, _checked)
