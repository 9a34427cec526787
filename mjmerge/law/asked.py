"""A law asked what it decides: one from outside that answers wrongly is told by its name and line.

Before t = 0 it is rehearsed. Later, what it does wrong in one simulation stops that one alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from mjmerge.config.document import described
from mjmerge.config.doors import DoorError, from_outside, told
from mjmerge.law.base import (
    GIVEN,
    OWN_DISTANCES,
    REMEMBERED,
    VECTORS,
    Decision,
    Flow,
    Law,
    Memory,
    Signal,
)
from mjmerge.law.function import RUNS, Function
from mjmerge.law.sensed import Sensed
from mjmerge.roster import PER_NEIGHBOUR, XY, Axis
from mjmerge.state import Array

MOST_SIGNALS = 64
"""Of one law."""
TAKEN = frozenset(
    {
        "time_s", "opinion", "mu", "mu_input_per_s", "weight", "distance_m", "distance_rate_mps",
        "sensed_distance_m", "sensed_distance_rate_mps", "sensed_front_m", "sensed_velocity_mps",
        "sensed_heading_rad", "sensed_speed_mps", "sensed_steer_rad", "sensed_leader_mps2", "gap_m",
        "gap_rate_mps", "clearance_m", "contact_impulse_n_s", "contact_speed_mps", "target_m",
        "u_n_mps2", "u_c_mps2", "u_mps2", "front_m", "velocity_mps", "heading_rad", "speed_mps",
        "steer_rad", "a_mps2", "omega_radps", "steer_command_rad", "torque_n_m",
        "torque_clipped_n_m", "steer_clipped_rad", "end_distance_m", "end_distance_rate_mps",
        "edge_distance_m",
    }
)  # fmt: skip
"""What no signal can be called: a column that is no law's (a test holds this against their declaration)."""
_ROWS = 3


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
    for what, given in (("signals", made.signals), ("memory", after)):
        if not isinstance(given, Mapping):
            raise DoorError(f"{law.kind} gives {described(given)} as its {what}; it must be arrays by name")
    runs = len(seen.p)
    signals = {name: _numbers(law, name, values) for name, values in made.signals.items()}
    declared = {s.name: (runs, *_shape(s, seen)) for s in law.signals} | _common(law, seen)
    if isinstance(law, Function) and not law.signals:
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
    lost = [name for name in law.remembers if name not in after]
    if lost:
        raise DoorError(f"{law.kind} says that it remembers {lost[0]}, and does not")
    _check_memory(law, after, runs)
    return Decision(u, signals, after)


def _check_memory(law: Law, memory: Memory, runs: int) -> None:
    """Refuses what is no memory of so many simulations.

    Raises:
        DoorError: it has something else than an array with a row for each.
    """
    for name, values in memory.items():
        if not isinstance(values, np.ndarray) or values.shape[:1] != (runs,):
            raise DoorError(
                f"{law.kind} remembers {name} as {described(values)}; it must be an array with a row for "
                f"each of the {runs} simulations"
            )


def _common(law: Law, seen: Sensed) -> dict[str, tuple[int, ...]]:
    """Shapes of the columns of every trace that a law fills."""
    runs = len(seen.p)
    shapes = dict.fromkeys(VECTORS, (runs, 2)) | dict.fromkeys(OWN_DISTANCES, (runs, seen.p_j.shape[1]))
    return {name: shapes.get(name, (runs,)) for name in law.gives}


def _numbers(law: Law, name: str, given: Any) -> Array:
    try:
        values = np.asarray(given)
    except ValueError:  # rows of different lengths
        values = np.empty(0, dtype=object)
    if values.dtype.kind not in "fiub":
        what = f"an array of {values.dtype}" if isinstance(given, np.ndarray) else described(given)
        raise DoorError(f"{law.kind} gives {name} as {what}; it must be numbers")
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
    _declares(law)
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
    if not isinstance(memory, Mapping):
        raise DoorError(
            f"{law.kind} starts with {described(memory)} as its memory; it must be arrays by name"
        )
    _check_memory(law, memory, _ROWS)
    if isinstance(law, Function):
        law._found = _learnt(law, _asked(law, several, memory, step_s), several)
    if len(law.signals) > MOST_SIGNALS:
        raise DoorError(f"{law.kind} has {len(law.signals)} signals; up to {MOST_SIGNALS} are recorded")
    names = [signal.name for signal in law.signals]
    for name in names:
        if not is_name(name):
            raise DoorError(
                f"{law.kind} has a signal called {str(name)[:40]!r}: expected lower-case letters, digits "
                "and _, with its unit at the end"
            )
        if name in TAKEN or names.count(name) > 1:
            other = "is a column of every run" if name in TAKEN else "is there twice"
            raise DoorError(f"{law.kind} has a signal called {name}, which {other}; call it otherwise")
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
    if isinstance(law, Function):
        law._remembers = any(memory[RUNS]) if RUNS in memory else bool(memory)


def _declares(law: Law) -> None:
    """Asks a law from outside for whatever it says of itself.

    Raises:
        DoorError: it raises something, or says what cannot be.
    """
    place, _, _ = law.kind.rpartition(":")
    with told(Path(place), f"the law {law.kind} fails: "):
        said = {name: getattr(law, name) for name in ("signals", "label", "guard", "singular")}
        said |= {"unguarded": law.unguarded(), "flow": law.flow()}
        columns = {name: tuple(getattr(law, name)) for name in ("gives", "remembers")}
        signals = isinstance(said["signals"], tuple) and all(map(_is_signal, said["signals"]))
    kinds: dict[str, tuple[tuple[type, ...], str]] = {
        "signals": (
            (tuple,),
            "a tuple of mjmerge.law.Signal, each with texts, and for its "
            "axes one of (), ('neighbours',) and (('x', 'y'),)",
        ),
        "label": ((str,), "text"),
        "guard": ((str,), "text"),
        "singular": ((bool,), "true or false"),
        "unguarded": ((Law, NoneType), "a law, or None"),
        "flow": ((Flow, NoneType), "a mjmerge.law.base.Flow, or None"),
    }
    for name, (types, must) in kinds.items():
        if not (signals if name == "signals" else isinstance(said[name], types)):
            raise DoorError(f"{law.kind} has {described(said[name])} for its {name}; it must be {must}")
    for name, of in (("gives", GIVEN), ("remembers", REMEMBERED)):
        for column in columns[name]:
            if column not in of:
                raise DoorError(f"{law.kind} {name} {str(column)[:40]!r}; it can be any of {', '.join(of)}")


def _is_signal(given: object) -> bool:
    """Whether it is a signal, through and through."""
    return (
        isinstance(given, Signal)
        and all(isinstance(text, str) for text in (given.name, given.doc, given.symbol, given.asks))
        and isinstance(given.axes, tuple)
        and all(isinstance(axis, str | tuple) for axis in given.axes)
        and given.axes in ((), (PER_NEIGHBOUR,), (XY,))
    )


def problems(law: Law) -> list[tuple[str, str]]:
    """What a law's keys get wrong together; see :meth:`Law.problems`.

    Raises:
        DoorError: a law from outside raises something when it is asked.
    """
    if not from_outside(law.kind):
        return list(law.problems())
    place, _, _ = law.kind.rpartition(":")
    with told(Path(place), f"the law {law.kind} fails: "):
        return [(str(key), str(message)) for key, message in law.problems()]


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
