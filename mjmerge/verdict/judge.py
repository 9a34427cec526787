"""The verdict on a run: what it says about the guarantee.

The theorem says: from any safe state on, if its hypotheses hold, every d_j stays positive. So a run is

- ``held``: safe, and because of the barrier: without it the ideal plant comes to d_j <= 0, or within r and
  closer by more than a tenth of r (and a run that itself stays further than r away is not one that something
  else, such as the wind, kept away: with the barrier the ideal stays as far);
- ``vacuous``: safe, but nothing put the barrier to the test;
- ``incomplete``: the simulation ended early, or data are missing. Never a pass;
- ``unresolved``: in continuous time, some d_j fell below what the solver can tell from 0. Never a pass;
- ``assumption broken``: unsafe, and a hypothesis was broken in the approach;
- ``refuted``: unsafe with every hypothesis true in the approach: the theorem, or our code, is wrong.

Unsafe means d_j <= 0, bodies that touch the ego's, or, where the ego's lane ends, its body off the road
there. The approach is the stretch from the last time that the pair in question was comfortably apart
(d_j >= r/2; of the end d_end, or the distance from the edge where the law is not told of it) to the moment it
is unsafe: from that state the theorem starts anew, so what broke and was over before excuses nothing. Every
time that a run becomes unsafe counts.

The safety floor of the scenario is a separate, stricter question: it decides the exit code.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mjmerge.law import is_paper
from mjmerge.notebook.html import facts, page
from mjmerge.simulation.trace import Stop, Trace, check_trace
from mjmerge.state import Array, Mask, dot
from mjmerge.verdict.counterfactual import guarded, ideals_m, with_barrier_m
from mjmerge.verdict.hypotheses import OBEYS_WINDOW_S, SEEN, Hypothesis, asked
from mjmerge.verdict.metrics import Collision, Event, RanOff, collisions, ran_off

HELD, VACUOUS, INCOMPLETE, UNRESOLVED, BROKEN, REFUTED = (
    "held", "vacuous", "incomplete", "unresolved", "assumption broken", "refuted",
)  # fmt: skip
VERDICTS = (HELD, VACUOUS, INCOMPLETE, UNRESOLVED, BROKEN, REFUTED)
"""From the best to the worst."""

NEEDED = 0.1
"""The barrier was needed if without it the ideal comes within r, and closer by more than this part of r."""
COMFORTABLE = 0.5
"""A pair is comfortably apart from this part of r on: an approach begins after that."""


@dataclass(frozen=True)
class Breach:
    """A hypothesis that stopped being true.

    Attributes:
        hypothesis: its name.
        time_s: when it broke, s.
    """

    hypothesis: str
    time_s: float


@dataclass(frozen=True, repr=False)
class Verdict:
    """What one simulation says about the guarantee.

    Attributes:
        run: which simulation.
        verdict: one of ``VERDICTS``.
        reason: its grounds in words.
        unsafe_at_s: when d_j <= 0, bodies touched or the ego was off the end of its lane first, s; ``None``
            if never. Where several moments are unsafe, the one that the verdict is about.
        matters: the breach that the verdict names: of an unsafe run, the first that was still broken, or
            broke, in the approach; of a safe one, the first of all. ``None`` if there is none.
        breaches: hypotheses that broke, when each did first, in order of time.
        collisions: bodies that touched, whoever they are, in order of time.
        needed: whether the run is safe because of the barrier; ``None`` where it is not safe, or not over.
        without_barrier_m: least d_j, or distance from the edge, of the ideal without the barrier, m; ``None``
            where it was not asked for.
        floor_held: whether it also kept the scenario's safety floors, to the end.
        ran_off: where the ego ran off the end of its lane; ``None`` if it did not.
    """

    run: int
    verdict: str
    reason: str
    unsafe_at_s: float | None
    matters: Breach | None
    breaches: tuple[Breach, ...]
    collisions: tuple[Collision, ...]
    needed: bool | None
    without_barrier_m: float | None
    floor_held: bool
    ran_off: RanOff | None = None

    def __repr__(self) -> str:
        floor = "held" if self.floor_held else "BROKEN"
        return f"<Verdict on run {self.run}: {self.verdict}: {self.reason}; safety floor {floor}>"

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        ideal_m = self.without_barrier_m
        rows = {
            "reason": self.reason,
            "unsafe": "" if self.unsafe_at_s is None else f"from {self.unsafe_at_s:.2f} s on",
            "without the barrier": "" if ideal_m is None else f"the ideal comes to {ideal_m:.3f} m",
            "broken": ", ".join(f"'{b.hypothesis}' at {b.time_s:.2f} s" for b in self.breaches),
            "touched": ", ".join(f"{c.a} and {c.b} at {c.time_s:.2f} s" for c in self.collisions),
            "safety floor": "held" if self.floor_held else "BROKEN",
        }
        return page(f"Verdict on run {self.run}: {self.verdict}", facts(rows))

    def events(self) -> list[Event]:
        """The breaches as events of the run."""
        return [
            Event(b.time_s, "warning", "ego", f"hypothesis '{b.hypothesis}' no longer holds")
            for b in self.breaches
        ]


def judge(trace: Trace, without: Array | None = None) -> list[Verdict]:
    """The verdict on every simulation of a trace.

    Args:
        trace: what happened.
        without: what :attr:`Trace.least_m` is of each simulation on the ideal plant without the barrier, m,
            (N, C-1 or C). By default they are simulated, of those that are safe.

    Raises:
        MjmergeError: it is no trace.
    """
    check_trace(trace)
    evidence = _Evidence.of(trace)
    safe = [run for run in range(trace.runs) if evidence.is_safe(run)]
    least, ideal = np.full((2, *trace.least_m.shape), np.nan)
    far = [run for run in safe if evidence.kept_m(run) >= evidence.r_m]
    if without is not None:
        least[safe] = without[safe]
        far = [run for run in far if _needed(evidence, run, least[run])]
        ideal[far] = with_barrier_m(trace, far)
    elif safe and guarded(trace.scenario):
        least[safe], ideal[far] = ideals_m(trace, safe, far)
    expect, edge_m = trace.scenario.expect, trace.edge_distance_m
    floor = expect.min_distance_m.at_least
    above: Mask = np.all(trace.distance_m >= floor, axis=(1, 2))  # false for NaN: missing data is no pass
    if edge_m is not None:
        above = above & np.all(edge_m >= expect.min_edge_distance_m.at_least, axis=1)
    found = []
    for run in range(trace.runs):
        breaches = evidence.breaches(run)
        if run in safe:
            ruling = _ruling_of_safe(evidence, run, least[run], float(ideal[run].min()), breaches)
        else:
            ruling = _ruling_of_other(evidence, run)
        touched, off = tuple(collisions(trace, run)), ran_off(trace, run)
        failures: list[Collision | RanOff] = [*touched, *([off] if off else [])]
        found.append(
            Verdict(
                run=run,
                verdict=ruling.verdict,
                reason="; ".join([*(one.sentence for one in sorted(failures, key=_when)), ruling.reason]),
                unsafe_at_s=ruling.unsafe_at_s,
                matters=ruling.matters,
                breaches=breaches,
                collisions=touched,
                needed=ruling.needed,
                without_barrier_m=None if np.isnan(least[run]).any() else float(least[run].min()),
                floor_held=bool(above[run]) and ruling.unsafe_at_s is None and run not in evidence.stops,
                ran_off=off,
            )
        )
    return found


@dataclass(frozen=True)
class _Ruling:
    """A verdict and its grounds; the fields are those of :class:`Verdict`."""

    verdict: str
    reason: str
    unsafe_at_s: float | None = None
    matters: Breach | None = None
    needed: bool | None = None


@dataclass(frozen=True)
class _Evidence:
    """What the monitors say of a trace.

    Attributes:
        trace: the trace.
        hypotheses: those that are asked of it, by name.
        marks: the ticks at which each is broken, (N, T).
        apart_m: distance d_j of each neighbour, m, (N, T, C-1), and where the ego's lane ends one more: that
            of its body from the edge.
        unsafe: the ticks at which each of these is, likewise.
        stops: why simulations ended early, by simulation.
    """

    trace: Trace
    hypotheses: dict[str, Hypothesis]
    marks: dict[str, Mask]
    apart_m: Array
    unsafe: Mask
    stops: dict[int, Stop]

    @classmethod
    def of(cls, trace: Trace) -> _Evidence:
        hypotheses = asked(trace)
        marks = {name: one.marks(trace) for name, one in hypotheses.items()}
        apart_m, unsafe = trace.distance_m, (trace.distance_m <= 0) | trace.touching_ego
        if trace.edge_distance_m is not None:
            apart_m = np.concatenate([apart_m, trace.edge_distance_m[..., None]], axis=2)
            unsafe = np.concatenate([unsafe, trace.off_the_end[..., None]], axis=2)
        return cls(trace, hypotheses, marks, apart_m, unsafe, {stop.run: stop for stop in trace.stops})

    def is_safe(self, run: int) -> bool:
        """Whether it is so to the end, and known to be."""
        known = not np.isnan(self.apart_m[run]).any()
        return known and run not in self.stops and not self.unsafe[run].any()

    @property
    def r_m(self) -> float:
        """The margin r, m."""
        return self.trace.scenario.r_m

    def kept_m(self, run: int) -> float:
        """The least d_j, or distance from the edge, of a simulation, m."""
        return float(self.apart_m[run].min())

    def breaches(self, run: int) -> tuple[Breach, ...]:
        """What broke, when it did first, in order of time."""
        time_s = self.trace.time_s
        first = {name: int(np.argmax(m[run])) for name, m in self.marks.items() if m[run].any()}
        found = [Breach(name, float(time_s[tick])) for name, tick in first.items()]
        return tuple(sorted(found, key=lambda breach: breach.time_s))

    def broken_in(self, run: int, start: int, end: int) -> Breach | None:
        """Of what was still broken, or broke, between two ticks, both included: what broke first."""
        found = []
        for name, mask in self.marks.items():
            within = np.flatnonzero(mask[run, start : end + 1])
            if within.size:
                before = np.flatnonzero(~mask[run, : start + within[0]])  # since when it has been broken
                since = int(before[-1]) + 1 if before.size else 0
                found.append(Breach(name, float(self.trace.time_s[since])))
        return min(found, key=lambda breach: breach.time_s, default=None)

    def unknown_in(self, run: int, start: int, end: int) -> list[str]:
        """Hypotheses that cannot be evaluated between two ticks, both included: numbers are missing."""
        part = slice(start, end + 1)
        return [
            name
            for name, one in self.hypotheses.items()
            if any(np.isnan(self.trace.column(column)[run, part]).any() for column in one.reads)
        ]

    def approach(self, run: int, tick: int, pairs: Mask) -> int:
        """The tick from which pairs, (C-1 or C,), came to be unsafe at one: all were last comfortable."""
        guarded = self.trace.guarded_m
        by_m = guarded if guarded.shape == self.apart_m.shape else self.apart_m  # of the end d_end, if told
        near = by_m[run, :tick, pairs] < COMFORTABLE * self.trace.scenario.r_m
        apart = [np.flatnonzero(~row) for row in near]
        return min(int(ticks[-1]) if ticks.size else 0 for ticks in apart)


def _needed(e: _Evidence, run: int, without_m: Array) -> bool:
    """Whether the ideal without the barrier comes to d_j <= 0, or within r and closer than the run."""
    least = float(without_m.min())
    return least <= 0 or least < min(e.kept_m(run) - NEEDED * e.r_m, e.r_m)


def _ruling_of_safe(
    e: _Evidence, run: int, without_m: Array, ideal_m: float, breaches: tuple[Breach, ...]
) -> _Ruling:
    trace, first = e.trace, breaches[0] if breaches else None
    guard, off = trace.scenario.law.guard, guarded(trace.scenario) is False
    if off:
        return _Ruling(VACUOUS, f"safe, but {guard} is off", matters=first, needed=False)
    if np.isnan(without_m).any():
        why = f"safe, but how it would end without {guard} is not known"
        return _Ruling(VACUOUS, why, matters=first)
    j = int(np.argmin(without_m))
    alone = f"without {guard} the ideal {_comes_to(trace, j, without_m[j])}"
    if not _needed(e, run, without_m):
        why = f"safe, but not because of {guard}: {alone}"
        return _Ruling(VACUOUS, why, matters=first, needed=False)
    if ideal_m < e.kept_m(run) - NEEDED * e.r_m:
        why = f"safe, but something else kept it away: with {guard} the ideal comes to d = {ideal_m:.3f} m"
        return _Ruling(VACUOUS, why, matters=first, needed=False)
    if not _dissipates(trace, run):
        return _Ruling(VACUOUS, f"safe, but {guard} did not slow it down", matters=first, needed=False)
    wrong = _told_wrong(trace, run)
    if wrong is not None:
        j, off_m = wrong
        size = f"{abs(off_m):.3f} m too {'large' if off_m > 0 else 'small'}"
        why = f"safe, but another distance was guarded: the ego was told {size} a d_{j + 1} where it is least"
        return _Ruling(VACUOUS, why, matters=first, needed=True)
    if first is not None:
        why = f"safe beyond its hypotheses: '{first.hypothesis}' broke at {first.time_s:.2f} s; {alone}"
        return _Ruling(HELD, why, matters=first, needed=True)
    return _Ruling(HELD, f"safe, and {guard} was needed: {alone}", needed=True)


def _when(failure: Collision | RanOff) -> float:
    return failure.time_s


def _comes_to(trace: Trace, j: int, least_m: float) -> str:
    """How close a simulation comes, in words, by the place of what it comes close to."""
    if j < len(trace.roster.neighbours):
        return f"comes to d_{j + 1} = {least_m:.3f} m"
    return "runs off the end of its lane" if least_m <= 0 else f"comes to {least_m:.3f} m from the edge"


def _dissipates(trace: Trace, run: int) -> bool:
    """Whether the barrier acted, all in all, as one that takes energy out of the motion towards neighbours.

    That is along - sum_j g_j d_j'/d_j. Its work on one pair says nothing: away from one is towards another.
    """
    if not is_paper(trace.scenario.law):
        return True  # no other claims that
    g = trace.front_m[run, :, :1] - trace.guarded_points_m[run]
    g /= np.linalg.norm(g, axis=-1, keepdims=True)
    closing = -trace.guarded_rate_mps[run] / trace.guarded_m[run]
    against = np.sum(closing[..., None] * g, axis=1)
    return bool(np.nansum(dot(trace.u_c_mps2[run], against)) > 0)


def _told_wrong(trace: Trace, run: int) -> tuple[int, float] | None:
    """A neighbour whose distance is told wrong, to one side, all the while it is least; and by how much, m.

    Noise errs to both sides, and what is late is right where a distance no longer changes.
    """
    off = trace.sensed_distance_m[run] - trace.distance_m[run]
    half = max(1, round(OBEYS_WINDOW_S / trace.scenario.control_step_s))
    for j, tick in enumerate(np.argmin(trace.distance_m[run], axis=0).tolist()):
        there = off[max(tick - half, 0) : tick + half + 1, j]
        bound = SEEN * trace.scenario.r_m
        if np.all(there > bound) or np.all(there < -bound):
            return j, float(np.mean(there))
    return None


def _ruling_of_other(e: _Evidence, run: int) -> _Ruling:
    """Of a simulation that became unsafe, ended early, or has holes."""
    stop = e.stops.get(run)
    rulings = list(_rulings_of_moments(e, run))
    if stop is not None and stop.touched:
        rulings.append(_ruling_of_touch(e, run, stop))
    if rulings:
        return max(rulings, key=lambda ruling: VERDICTS.index(ruling.verdict))  # the first of the worst
    why = "the simulation ended early" if stop is not None else "distances are missing"
    return _Ruling(INCOMPLETE, why)


def _rulings_of_moments(e: _Evidence, run: int) -> Iterator[_Ruling]:
    """Of each moment at which the simulation becomes unsafe."""
    trace = e.trace
    any_pair = np.any(e.unsafe[run], axis=1)
    for tick in np.flatnonzero(np.diff(any_pair, prepend=False) & any_pair).tolist():
        at_s = float(trace.time_s[tick])
        start = e.approach(run, tick, e.unsafe[run, tick])
        where = f"unsafe at {at_s:.2f} s"
        breach = e.broken_in(run, start, tick)
        unknown = e.unknown_in(run, start, tick)
        if breach is not None:
            why = f"{where}, after '{breach.hypothesis}' broke at {breach.time_s:.2f} s"
            yield _Ruling(BROKEN, why, at_s, breach)
        elif unknown:
            yield _Ruling(INCOMPLETE, f"{where}; whether '{unknown[0]}' held is not known", at_s)
        else:
            yield _Ruling(REFUTED, f"{where} with every hypothesis true", at_s)


def _ruling_of_touch(e: _Evidence, run: int, stop: Stop) -> _Ruling:
    """Of a simulation in continuous time that ended where d_j was no more than the solver can tell from 0."""
    known = np.flatnonzero(~np.isnan(e.trace.distance_m[run]).any(axis=1))
    last = int(known[-1]) if known.size else 0
    d = e.trace.guarded_m[run, last]
    pairs = np.zeros(e.apart_m.shape[2], dtype=bool)
    pairs[: len(d)] = d == d.min()
    start = e.approach(run, last, pairs)
    breach = e.broken_in(run, start, last)
    if breach is not None:
        why = f"{stop.reason}, after '{breach.hypothesis}' broke at {breach.time_s:.2f} s"
        return _Ruling(BROKEN, why, stop.time_s, breach)
    if stop.crossing:
        return _Ruling(REFUTED, f"{stop.reason}, with every hypothesis true", stop.time_s)
    return _Ruling(UNRESOLVED, f"{stop.reason}: the theorem keeps it above 0, but by no number")
