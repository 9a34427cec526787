"""Laws that are functions, in a file of somebody's own.

    def law(seen, memory, dt, *, gain=2.0):
        return u  # m/s^2, (N, 2); or u, {"ttc_s": ttc_s}, to have that recorded

``seen`` is a :class:`Seen`; ``memory`` is a dict of arrays (N, ...), empty at first, that is the law's own;
what follows the star becomes a key of the scenario. With :func:`each_run` above it, it is called for one
simulation at a time: all arrays are without the axis N, and ``memory`` may hold anything.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from pydantic import PrivateAttr, create_model

from mjmerge.config.document import described
from mjmerge.config.doors import DoorError, resolve
from mjmerge.law.base import Decision, Flow, Law, Memory, Signal
from mjmerge.law.sensed import Sensed, geometry
from mjmerge.state import Array

GUARDED = "guarded"
"""Key of a function that says whether it keeps clear: with false it leaves out what does."""
RUNS = "runs"
"""Name of the memory of a law that is called for each simulation by itself: dicts, (N,)."""
_CLASS = "__mjmerge_law__"
"""Attribute of a function: the class that it became."""
_Any = TypeVar("_Any", bound=Callable[..., Any])


@dataclass(frozen=True)
class Seen(Sensed):
    """What a law that is a function is shown: all that is sensed, and what follows from it.

    Attributes:
        g: unit vectors from the neighbours to the ego, (N, C-1, 2).
        d: distances d_j = |p - p_j| - r, m, (N, C-1).
        d_dot: their rates, m/s, (N, C-1).
        dbar: gap between the leader and the follower less r, m, (N,).
        dbar_dot: its rate, m/s, (N,).
        r_m: the margin r, m.
        leader: where the leader is along the axis of neighbours.
        follower: where the follower is.
    """

    g: Array
    d: Array
    d_dot: Array
    dbar: Array
    dbar_dot: Array
    r_m: float
    leader: int
    follower: int


def each_run(function: _Any) -> _Any:
    """Marks a law that is a function of one simulation: it is called for each by itself."""
    function.__dict__["each_run"] = True
    return function


def law_of(kind: str, function: Callable[..., Any]) -> type[Law]:
    """The class that a function becomes.

    Args:
        kind: its located name.
        function: what stands there.

    Raises:
        DoorError: it cannot be called as a law is.
    """
    made: type[Law] | None = getattr(function, _CLASS, None)
    if made is None:
        made = create_model("Function", __base__=Function, **_keys(kind, function))
        made._function = staticmethod(function)
        made.__doc__ = (inspect.getdoc(function) or "").partition("\n")[0]
        with suppress(AttributeError):  # of what is no function of Python's
            setattr(function, _CLASS, made)
    return made


def _keys(kind: str, function: Callable[..., Any]) -> dict[str, Any]:
    """The keys that a function has after its star, and their defaults.

    Raises:
        DoorError: it cannot be called as a law is.
    """
    place, _, name = kind.rpartition(":")
    try:
        signature = inspect.signature(function)
        optional = {p.name for p in signature.parameters.values() if p.kind is p.KEYWORD_ONLY}
        signature.bind(None, None, None, **dict.fromkeys(optional))
    except (TypeError, ValueError) as error:
        line = getattr(getattr(function, "__code__", None), "co_firstlineno", 0)
        where = f"{place}, line {line}" if line else kind
        must = f"{name} must take three arguments, as in `def {name}(seen, memory, dt):`"
        raise DoorError(f"{where}: {must}: {error}") from error
    keys: dict[str, Any] = {}
    for parameter in signature.parameters.values():
        if parameter.kind is not parameter.KEYWORD_ONLY:
            continue
        default = parameter.default
        if parameter.name in Law.model_fields or parameter.name.startswith("_"):
            raise DoorError(f"{kind}: {parameter.name} is a key of every law; call it otherwise")
        if default is parameter.empty:
            keys[parameter.name] = (float, ...)
        elif isinstance(default, bool | str):
            keys[parameter.name] = (type(default), default)
        elif isinstance(default, int | float):
            keys[parameter.name] = (float, float(default))
        else:
            raise DoorError(
                f"{kind}: {parameter.name} is {described(default)} by default; a key is a number, text, or "
                "true or false"
            )
    return keys


class Function(Law):
    """A law that is a function."""

    _function: ClassVar[Callable[..., Any]]
    _found: tuple[Signal, ...] = PrivateAttr(default=())
    _remembers: bool = PrivateAttr(default=True)

    kind: str

    @property
    def signals(self) -> tuple[Signal, ...]:
        """What the function gave beside u when it was rehearsed."""
        return self._found

    def flow(self) -> Flow | None:
        """None, unless it kept nothing when it was rehearsed."""
        return None if self._remembers else Flow()

    def unguarded(self) -> Self | None:
        """With ``guarded`` false, if it has such a key."""
        if not isinstance(getattr(self, GUARDED, None), bool):
            return None
        return self.model_copy(update={GUARDED: False}) if getattr(self, GUARDED) else self

    def __reduce__(self) -> Any:
        return _again, (self.kind, self.model_dump(), self._found, self._remembers)

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Function:
        return self

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """Calls the function, for all simulations or for each."""
        near = geometry(self, seen)
        there = Seen(**vars(seen), **vars(near), r_m=self.r_m, leader=self.j_1, follower=self.j_2)
        keys = {n: getattr(self, n) for n in type(self).model_fields if n not in Law.model_fields}
        if not getattr(self._function, "each_run", False):
            own = {name: values.copy() for name, values in memory.items()}
            u, signals = _answer(self._function(there, own, step_s, **keys))
            return Decision(u, signals, after=own)
        runs = len(seen.p)
        owns = np.empty(runs, dtype=object)
        given = []
        for run in range(runs):
            owns[run] = deepcopy(memory[RUNS][run]) if memory else {}
            given.append(_answer(self._function(_row(there, run), owns[run], step_s, **keys)))
        names = given[0][1].keys() if given else ()
        if any(one.keys() != names for _, one in given):
            raise DoorError("it gives other signals in one simulation than in another")
        return Decision(
            np.array([u for u, _ in given]),
            {name: np.array([one[name] for _, one in given]) for name in names},
            after={RUNS: owns},
        )


def _again(kind: str, keys: dict[str, Any], found: tuple[Signal, ...], remembers: bool) -> Law:
    """A law that is a function, in another process."""
    law = law_of(kind, resolve(kind)).model_validate(keys)
    assert isinstance(law, Function)
    law._found, law._remembers = found, remembers
    return law


def _answer(given: Any) -> tuple[Any, dict[str, Any]]:
    """U and signals of what a function returned."""
    if isinstance(given, tuple) and len(given) == 2 and isinstance(given[1], Mapping):
        return given[0], dict(given[1])
    return given, {}


def _row(seen: Seen, run: int) -> Seen:
    """One simulation of what is seen, without the axis N."""
    return replace(
        seen, **{f.name: v[run] for f in fields(seen) if isinstance(v := getattr(seen, f.name), np.ndarray)}
    )
