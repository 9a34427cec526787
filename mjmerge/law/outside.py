"""Laws that somebody brings: ``kind: mine.py:Name`` in a scenario, see :mod:`mjmerge.config.doors`.

A law is a class derived from :class:`Law`, or a function of one file:

    def law(seen, memory, dt, *, gain=2.0):
        return u  # m/s^2, (N, 2); or u, {"ttc_s": ttc_s}, to have that recorded

``seen`` is a :class:`Seen`; ``memory`` is a dict of arrays (N, ...), empty at first, that is the law's own;
what follows the star becomes a key of the scenario. With :func:`each_run` above it, it is called for one
simulation at a time: all arrays are without the axis N, and ``memory`` may hold anything.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from pydantic import (
    ConfigDict,
    PrivateAttr,
    SerializationInfo,
    ValidatorFunctionWrapHandler,
    create_model,
)

from mjmerge.config.document import described
from mjmerge.config.doors import DoorError, from_outside, let_in_before, resolve, told
from mjmerge.law.base import VECTORS, Decision, Flow, Law, Memory, Signal
from mjmerge.law.sensed import Sensed, geometry
from mjmerge.roster import PER_NEIGHBOUR, XY, Axis
from mjmerge.state import Array

GROUP = "mjmerge.laws"
"""Entry points of packages that bring laws."""
DEFAULT = "opinion_dynamics"
"""The kind of a law that says none: the paper's."""
_CLASS = "__mjmerge_law__"
"""Attribute of a function: the class that it became."""
GUARDED = "guarded"
"""Key of a function that says whether it keeps clear: with false it leaves out what does."""
_RUNS = "runs"
"""Name of the memory of a law that is called for each simulation by itself: dicts, (N,)."""
MOST_SIGNALS = 64
"""Of one law."""
_ROWS = 3
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
        return found
    if inspect.isclass(found) or not callable(found):
        raise DoorError(
            f"{kind} is no law: a function law(seen, memory, dt), or a class derived from mjmerge.law.Law"
        )
    made: type[Law] | None = getattr(found, _CLASS, None)
    if made is None:
        made = create_model("Function", __base__=_Function, **_keys(kind, found))
        made._function = staticmethod(found)
        made.__doc__ = (inspect.getdoc(found) or "").partition("\n")[0]
        with suppress(AttributeError):  # of what is no function of Python's
            setattr(found, _CLASS, made)
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


class _Function(Law):
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

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> _Function:
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
            owns[run] = deepcopy(memory[_RUNS][run]) if memory else {}
            given.append(_answer(self._function(_row(there, run), owns[run], step_s, **keys)))
        names = given[0][1].keys() if given else ()
        if any(one.keys() != names for _, one in given):
            raise DoorError("it gives other signals in one simulation than in another")
        return Decision(
            np.array([u for u, _ in given]),
            {name: np.array([one[name] for _, one in given]) for name in names},
            after={_RUNS: owns},
        )


def _again(kind: str, keys: dict[str, Any], found: tuple[Signal, ...], remembers: bool) -> Law:
    """A law that is a function, in another process."""
    law = brought(kind).model_validate(keys)
    assert isinstance(law, _Function)
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


def decided(law: Law, seen: Sensed, memory: Memory, step_s: float) -> Decision:
    """What a law decides. One from outside that does not answer in some simulations fails in these alone.

    Args:
        law: which.
        seen: what the ego senses.
        memory: what the law remembers.
        step_s: the control step, s.
    """
    if not from_outside(law.kind):
        return law.decide(seen, memory, step_s)
    runs = len(seen.p)
    try:
        made = _asked(law, seen, memory, step_s)
    except DoorError as error:
        if runs == 1:
            u = np.full((1, 2), np.nan)
            none = {s.name: np.full((1, *_shape(s, seen)), np.nan) for s in law.signals}
            return Decision(u, none, after=memory, failed={0: str(error)})
        alone = slice_each(seen, memory)
        return _joined([decided(law, *one, step_s) for one in alone])
    odd = np.flatnonzero(~np.isfinite(made.u).all(axis=1)).tolist()
    why = f"{law.kind} gives a command that is not finite"
    return replace(made, failed={run: f"{why}: {made.u[run].tolist()}" for run in odd})


def remembered(law: Law, memory: Memory, decision: Decision, step_s: float) -> Memory:
    """The memory of a law one control step later."""
    return law.advance(memory, decision, step_s) if decision.after is None else decision.after


def slice_each(seen: Sensed, memory: Memory) -> Iterator[tuple[Sensed, Memory]]:
    """Each simulation of what is seen and remembered, by itself."""
    for run in range(len(seen.p)):
        row = slice(run, run + 1)
        one = Sensed(**{name: values[row] for name, values in vars(seen).items()})
        yield one, {name: values[row] for name, values in memory.items()}


def _joined(parts: Sequence[Decision]) -> Decision:
    """Decisions of one simulation each, as one."""

    def together(rows: Sequence[Mapping[str, Any]]) -> dict[str, Array]:
        names = dict.fromkeys(name for row in rows for name in row)
        like = {name: next(row[name] for row in rows if name in row) for name in names}
        return {
            name: np.concatenate([row.get(name, np.full_like(like[name], np.nan)) for row in rows])
            for name in names
        }

    return Decision(
        np.concatenate([part.u for part in parts]),
        together([part.signals for part in parts]),
        after=together([part.after or {} for part in parts]),
        failed={run: part.failed[0] for run, part in enumerate(parts) if part.failed},
    )


def _asked(law: Law, seen: Sensed, memory: Memory, step_s: float) -> Decision:
    """What a law from outside decides and remembers, if it is what it must be.

    Raises:
        DoorError: it is not, or the law raised something; with the line of its file.
    """
    place, _, _ = law.kind.rpartition(":")
    with told(Path(place), f"the law {law.kind} fails: "), np.errstate(all="ignore"):
        made = law.decide(_frozen(seen), memory, step_s)
        if isinstance(made, Decision):
            after = law.advance(memory, made, step_s) if made.after is None else made.after
    if not isinstance(made, Decision):
        raise DoorError(f"{law.kind} decides {described(made)}; decide must return a Decision")
    runs = len(seen.p)
    signals = {name: _numbers(law, name, values) for name, values in made.signals.items()}
    declared = {s.name: (runs, *_shape(s, seen)) for s in law.signals} | _common(law, seen)
    if isinstance(law, _Function) and not law.signals:
        declared = {name: values.shape for name, values in signals.items()}  # as rehearsed, or never given
    for name in (*declared, *(n for n in signals if n not in declared)):
        if name not in signals or name not in declared:
            word = "does not give" if name in declared else "gives, and does not declare,"
            raise DoorError(f"{law.kind} {word} the signal {name}")
        if signals[name].shape != declared[name]:
            raise DoorError(
                f"{law.kind} gives {name} as an array of shape {signals[name].shape}, not {declared[name]}"
            )
    u = _numbers(law, "u", made.u)
    if u.shape != (runs, 2):
        raise DoorError(
            f"{law.kind} gives a command of shape {u.shape}; it must be u in m/s^2, x and y for each of the "
            f"{runs} simulations: ({runs}, 2)"
        )
    for name, values in after.items():
        if not isinstance(values, np.ndarray) or values.shape[:1] != (runs,):
            raise DoorError(
                f"{law.kind} remembers {name} as {described(values)}; it must be an array with a row for "
                f"each of the {runs} simulations"
            )
    return Decision(u, signals, after)


def _common(law: Law, seen: Sensed) -> dict[str, tuple[int, ...]]:
    """Shapes of the columns of every trace that a law fills."""
    return {name: (len(seen.p), 2) if name in VECTORS else (len(seen.p),) for name in law.gives}


def _numbers(law: Law, name: str, given: Any) -> Array:
    try:
        values = np.asarray(given)
    except ValueError:  # rows of different lengths
        values = np.empty(0, dtype=object)
    if values.dtype.kind not in "fiub":
        raise DoorError(f"{law.kind} gives {name} as {described(given)}; it must be numbers")
    return values.astype(np.float64)


def _shape(signal: Signal, seen: Sensed) -> tuple[int, ...]:
    """Shape of a signal, after the axis N."""
    return tuple(seen.p_j.shape[1] if axis == PER_NEIGHBOUR else len(axis) for axis in signal.axes)


def _frozen(seen: Sensed) -> Sensed:
    """What is sensed, in arrays that cannot be written to."""
    views = {name: values.view() for name, values in vars(seen).items()}
    for view in views.values():
        view.flags.writeable = False
    return Sensed(**views)


def rehearse(law: Law, seen: Sensed, initial: Mapping[str, float], step_s: float) -> None:
    """Asks a law from outside before anything runs, and learns which signals a function gives.

    Args:
        law: which.
        seen: the scenario's beginning, of one simulation.
        initial: as of :meth:`Law.start`.
        step_s: the control step, s.

    Raises:
        DoorError: it raises something, gives what is no command, gives another when asked again, or lets one
            simulation depend on others.
    """
    rng = np.random.default_rng(0)
    rows = {
        name: values
        + np.concatenate([values * 0, 0.05 * rng.standard_normal((_ROWS - 1, *values.shape[1:]))])
        if name != "u_1"
        else np.repeat(values, _ROWS, axis=0)
        for name, values in vars(seen).items()
    }
    several = Sensed(**rows)
    place, _, _ = law.kind.rpartition(":")
    with told(Path(place), f"the law {law.kind} fails: "):
        memory = law.start(_ROWS, initial)
    if isinstance(law, _Function):
        law._found = _learnt(law, _asked(law, several, memory, step_s), several)
    if len(law.signals) > MOST_SIGNALS:
        raise DoorError(f"{law.kind} has {len(law.signals)} signals; up to {MOST_SIGNALS} are recorded")
    for _ in range(2):  # the second time with a memory
        first, again = (_asked(law, several, memory, step_s) for _ in range(2))
        if not _same(first, again):
            raise DoorError(
                f"{law.kind} gives another command when it is asked the same again: what it keeps belongs "
                "into its memory, and nothing may be drawn"
            )
        if not np.isfinite(first.u).all():
            raise DoorError(f"{law.kind} gives a command that is not finite: {first.u[0].tolist()}")
        for run, (one, own) in enumerate(slice_each(several, memory)):
            alone = _asked(law, one, own, step_s)
            if alone.u.tobytes() != first.u[run : run + 1].tobytes():
                raise DoorError(
                    f"{law.kind} gives another command for a simulation alone than among {_ROWS}: each row "
                    "must follow from its own, to the last bit (or mark it with mjmerge.law.each_run)"
                )
        memory = first.after or {}
    if isinstance(law, _Function):
        law._remembers = any(memory[_RUNS]) if _RUNS in memory else bool(memory)


def _same(a: Decision, b: Decision) -> bool:
    """Whether two decisions are the same, bit for bit."""
    return a.u.tobytes() == b.u.tobytes() and all(
        a.signals[name].tobytes() == b.signals[name].tobytes() for name in a.signals
    )


def _learnt(law: Law, made: Decision, seen: Sensed) -> tuple[Signal, ...]:
    """The signals that a function gave.

    Raises:
        DoorError: one cannot be recorded.
    """
    found = []
    axes: dict[tuple[int, ...], tuple[Axis, ...]] = {
        (): (),
        (seen.p_j.shape[1],): (PER_NEIGHBOUR,),
    }
    for name, values in made.signals.items():
        if not is_name(name):
            raise DoorError(
                f"{law.kind} has a signal called {str(name)[:40]!r}: expected lower-case letters, digits "
                "and _, with its unit at the end"
            )
        of = axes.get(values.shape[1:], (XY,) if values.shape[1:] == (2,) else None)
        if of is None:
            raise DoorError(
                f"{law.kind} gives {name} as an array of shape {values.shape}; a signal is a number for each "
                "simulation, or one for each neighbour"
            )
        found.append(Signal(name, "a signal of the law's own", axes=of))
    return tuple(found)


def is_name(name: object) -> bool:
    """Whether a signal may be called so."""
    return (
        isinstance(name, str)
        and 0 < len(name) <= 64
        and name.isascii()
        and name.isidentifier()
        and name == name.lower()
        and not name.startswith("_")
    )


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
    """Validates a law: one from outside by its own class, all others by that of their kind.

    Nothing is run here: what has not been let in by whoever loads a scenario stays outside.
    """
    if isinstance(value, Law):
        return value
    if isinstance(value, Mapping) and "kind" not in value:
        value = {"kind": DEFAULT, **value}
    kind = value.get("kind") if isinstance(value, Mapping) else None
    if not from_outside(kind):
        return shipped(value)
    try:
        return _checked(str(kind), let_in_before(str(kind))).model_validate(value)
    except DoorError as error:
        raise ValueError(str(error)) from error


def as_mapping(law: Any, info: SerializationInfo) -> Any:
    """A law's keys, whatever its class; what is none stays as it is, to be told."""
    return law.model_dump(mode=info.mode, warnings=False) if isinstance(law, Law) else law
