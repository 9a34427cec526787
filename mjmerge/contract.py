"""The paper's hypotheses as monitors on a trace, and the verdict that follows.

The theorem says: if its hypotheses hold, d_1 and d_2 stay positive. So a run is

- ``held``: safe, and the barrier was really asked;
- ``vacuous``: safe, but nothing challenged it;
- ``assumption broken``: unsafe, after a hypothesis had broken;
- ``refuted``: unsafe with every hypothesis true: the theorem, or our code, is wrong;
- ``incomplete``: the simulation ended early without having become unsafe. Never a pass.

Unsafe means d_j <= 0 or bodies that touch the ego's; in continuous time also a run that had to end as d_j
reached 0. The safety floor of the scenario is a separate, stricter
question: it decides the exit code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np

from mjmerge.actuation import believed_sheets
from mjmerge.metrics import Event, saturated
from mjmerge.mismatch import column
from mjmerge.state import Array, Mask, norm
from mjmerge.trace import Trace

HELD, VACUOUS, BROKEN, REFUTED, INCOMPLETE = "held", "vacuous", "assumption broken", "refuted", "incomplete"
VERDICTS = (HELD, VACUOUS, INCOMPLETE, BROKEN, REFUTED)
"""From the best to the worst."""

OBEYS_WINDOW_S, OBEYS_MPS = 0.1, 0.1
"""The ego moves as commanded if over this window its velocity changes as told to within this much."""
BOUNDED_MPS, BOUNDED_MPS2 = 100.0, 50.0
"""A neighbour that is faster, or accelerates by more, is no road car: its motion is not bounded."""
SEEN = 0.02
"""The ego knows a distance if it is told it to within this part of r (1.2 cm at the paper's scale)."""


@dataclass(frozen=True)
class Breach:
    """A hypothesis that stopped being true.

    Attributes:
        hypothesis: its name.
        time_s: when it first broke, s.
    """

    hypothesis: str
    time_s: float


@dataclass(frozen=True)
class Verdict:
    """What one simulation says about the guarantee.

    Attributes:
        run: which simulation.
        verdict: one of ``VERDICTS``.
        unsafe_at_s: when d_j <= 0 or bodies touched first, s; ``None`` if never.
        breaches: hypotheses that broke, in order of time.
        floor_held: whether it also kept the scenario's safety floor, to the end.
    """

    run: int
    verdict: str
    unsafe_at_s: float | None
    breaches: tuple[Breach, ...]
    floor_held: bool

    def events(self) -> list[Event]:
        """The breaches as events of the run."""
        return [
            Event(b.time_s, "warning", "ego", f"hypothesis '{b.hypothesis}' no longer holds")
            for b in self.breaches
        ]

    @property
    def reason(self) -> str:
        """The verdict's grounds in words."""
        if self.verdict == BROKEN:
            first = self.breaches[0]
            broke = f"'{first.hypothesis}' broke at {first.time_s:.2f} s"
            return f"unsafe at {self.unsafe_at_s:.2f} s, after {broke}"
        return {
            HELD: "safe, and the barrier was asked",
            VACUOUS: "safe, but nothing challenged the barrier",
            REFUTED: f"unsafe at {self.unsafe_at_s or 0:.2f} s with every hypothesis true",
            INCOMPLETE: "the simulation ended early",
        }[self.verdict]


def _safe_start(trace: Trace) -> Mask:
    """d_j(0) > 0."""
    return _at_start(trace, np.any(trace.distance_m[:, 0] <= 0, axis=1))


def _bounded_start(trace: Trace) -> Mask:
    """d_j'(0)/d_j(0) is finite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = trace.distance_rate_mps[:, 0] / trace.distance_m[:, 0]
    return _at_start(trace, np.any(np.isinf(rate), axis=1))


def _opinion_awake(trace: Trace) -> Mask:
    """z(0) > 0."""
    return _at_start(trace, trace.opinion[:, 0] <= 0)


def _at_start(trace: Trace, broken: Mask) -> Mask:
    """A mask (N,) as ticks, (N, T): what is broken at t = 0 is broken there only."""
    ticks = np.zeros(trace.distance_m.shape[:2], dtype=bool)
    ticks[:, 0] = broken
    return ticks


def _barrier_on(trace: Trace) -> Mask:
    """k_o > 0."""
    return np.full(trace.distance_m.shape[:2], trace.scenario.law.k_o <= 0)


def _neighbours_bounded(trace: Trace) -> Mask:
    """Assumption 1: v_j and its rate are bounded (and with them p_j, in any finite time), until bodies touch.

    That is about how the neighbours move, not about what their drivers ask of cars that cannot give it.
    """
    v, window = trace.velocity_mps[:, :, 1:], _window(trace, OBEYS_WINDOW_S)
    broken = norm(v) > BOUNDED_MPS
    broken[:, window:] |= norm(v[:, window:] - v[:, :-window]) > BOUNDED_MPS2 * OBEYS_WINDOW_S
    touched: Mask = np.logical_or.accumulate(np.any(trace.touching, axis=2), axis=1)
    before: Mask = np.any(broken, axis=2) & ~touched
    return before


def _neighbours_apart(trace: Trace) -> Mask:
    """Assumption 1: once the ego is in their lane between them, the neighbours leave it 2r.

    In continuous time the margins meet, and the run ends, between two ticks: the gap counts as it will be at
    the next one.
    """
    p, r = trace.front_m, trace.scenario.law.r_m
    ahead_s = trace.scenario.control_step_s if trace.continuous else 0.0
    gap = trace.gap_m + np.minimum(trace.gap_rate_mps * ahead_s, 0) if ahead_s else trace.gap_m
    between = (p[:, :, 0, 0] < p[:, :, 1, 0]) & (p[:, :, 0, 0] > p[:, :, 2, 0])
    in_lane = np.abs(p[:, :, 0, 1] - p[:, :, 1, 1]) < r
    return between & in_lane & (gap + r <= 2 * r)


def _seen(trace: Trace) -> Mask:
    """The ego knows the distances, to within ``SEEN`` of r."""
    off = np.abs(trace.sensed_distance_m - trace.distance_m) > SEEN * trace.scenario.law.r_m
    unseen: Mask = np.any(off, axis=2)
    return unseen


def _margin_covers(trace: Trace) -> Mask:
    """The margin r keeps bodies apart: they do not touch while d_j > 0. The theorem is about front axles."""
    touching: Mask = np.any(trace.touching[:, :, :2] & (trace.distance_m > 0), axis=2)
    return touching


def _rolling(trace: Trace) -> Mask:
    """|v_r| >= eps_v: where the bicycle inverse is exact."""
    return np.abs(trace.speed_mps[:, :, 0]) < trace.scenario.law.eps_v_mps


def _steers_within(trace: Trace) -> Mask:
    """|delta| < its limit; that of the bicycle equations is pi/2, a double integrator does not steer."""
    limit = (
        believed_sheets(trace.scenario)[0].steer_limit_rad
        if trace.plant in ("bicycle_limited", "mujoco")
        else pi / 2
    )
    beyond: Mask = np.abs(trace.steer_rad[:, :, 0]) >= limit
    return beyond


def _unsaturated(trace: Trace) -> Mask:
    """The ego is never asked for more than it can do."""
    return saturated(trace)[:, :, 0]


def _obeys(trace: Trace) -> Mask:
    """The front axle is a double integrator: its velocity changes as commanded.

    In continuous time it is, by the equations; the bicycle is one while it rolls, which has its own monitor.
    """
    if trace.continuous:
        return np.zeros(trace.distance_m.shape[:2], dtype=bool)
    h = trace.scenario.control_step_s
    window = _window(trace, OBEYS_WINDOW_S)
    v, u = trace.velocity_mps[:, :, 0], trace.u_mps2[:, :, 0]
    told = np.cumsum(u * h, axis=1) - u * h  # integral of u up to each tick
    defect = norm((v[:, window:] - v[:, :-window]) - (told[:, window:] - told[:, :-window]))
    broken = np.zeros(v.shape[:2], dtype=bool)
    broken[:, window:] = defect > OBEYS_MPS
    return broken


def _window(trace: Trace, seconds: float) -> int:
    """Ticks in a stretch of time, at least one."""
    return max(1, round(seconds / trace.scenario.control_step_s))


def _sampled_finely(trace: Trace) -> Mask:
    """d_j > k_o h/2: the barrier's gain k_o/d_j is stable under a hold of h."""
    bound = trace.scenario.law.k_o * trace.scenario.control_step_s / 2
    return _within(trace, 0.0 if trace.continuous else bound)


def _prompt(trace: Trace) -> Mask:
    """d_j > 2 k_o tau/pi: that gain is stable under the true delay tau of commands and measurements."""
    if trace.continuous:
        return _within(trace, 0.0)
    late_s = column(trace.mismatch, "sensing_delay_s") + column(trace.mismatch, "command_delay_s")
    return _within(trace, 2 * trace.scenario.law.k_o * late_s[:, None, None] / pi)


def _within(trace: Trace, bound_m: Array | float) -> Mask:
    """0 < d_j < bound: inside the margin it is too late for an excuse."""
    d = trace.distance_m
    near: Mask = np.any((d > 0) & (d < bound_m), axis=2)
    return near


HYPOTHESES: dict[str, Callable[[Trace], Mask]] = {
    "safe start": _safe_start,
    "bounded start": _bounded_start,
    "opinion starts positive": _opinion_awake,
    "barrier is on": _barrier_on,
    "neighbours bounded": _neighbours_bounded,
    "neighbours leave 2r": _neighbours_apart,
    "distances known": _seen,
    "ego rolls": _rolling,
    "steering within limit": _steers_within,
    "command within limits": _unsaturated,
    "ego moves as commanded": _obeys,
    "hold small against d": _sampled_finely,
    "delay small against d": _prompt,
    "margin covers the bodies": _margin_covers,
}
"""Name of each hypothesis and the monitor that marks the ticks where it is broken, (N, T).

Missing data breaks nothing: a breach is an excuse, and there is none for what nobody saw.
"""


def challenged(trace: Trace) -> Mask:
    """Whether the barrier was really asked, (N,).

    It was if some neighbour came within r of touching the margin (d_j < r) and took d_j to less than half
    of what it had been before: the barrier then took k_o ln 2 or more out of the closing speed.
    """
    d = np.where(np.isnan(trace.distance_m), np.inf, trace.distance_m)
    before = np.maximum.accumulate(np.where(np.isinf(d), -np.inf, d), axis=1)
    asked: Mask = np.any((d < trace.scenario.law.r_m) & (d < before / 2), axis=(1, 2))
    return asked


def judge(trace: Trace) -> list[Verdict]:
    """The verdict on every simulation of a trace."""
    unsafe: Mask = np.any(trace.distance_m <= 0, axis=2) | np.any(trace.touching[:, :, :2], axis=2)
    broken = {name: monitor(trace) for name, monitor in HYPOTHESES.items()}
    asked = challenged(trace)
    floor = trace.scenario.expect.min_distance_m.at_least
    above: Mask = np.all(trace.distance_m >= floor, axis=(1, 2))  # false for NaN: missing data is no pass
    stopped = {s.run: s for s in trace.stops}
    missing: Mask = np.any(np.isnan(trace.distance_m), axis=(1, 2))

    verdicts = []
    for run in range(trace.runs):
        unsafe_at = _first(unsafe[run], trace.time_s)
        if unsafe_at is None and run in stopped and stopped[run].touched:
            unsafe_at = stopped[run].time_s
        breaches = [
            Breach(name, at) for name, m in broken.items() if (at := _first(m[run], trace.time_s)) is not None
        ]
        breaches.sort(key=lambda b: b.time_s)
        if unsafe_at is not None:
            verdict = BROKEN if breaches and breaches[0].time_s <= unsafe_at else REFUTED
        elif run in stopped or missing[run]:
            verdict = INCOMPLETE
        else:
            verdict = HELD if asked[run] else VACUOUS
        floor_held = bool(above[run]) and unsafe_at is None and run not in stopped
        verdicts.append(Verdict(run, verdict, unsafe_at, tuple(breaches), floor_held))
    return verdicts


def _first(mask: Mask, time_s: Array) -> float | None:
    """Time of the first tick where the mask holds, s."""
    return float(time_s[int(np.argmax(mask))]) if mask.any() else None
