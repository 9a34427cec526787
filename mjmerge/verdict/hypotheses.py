"""The theorem's hypotheses as monitors on a trace: at which ticks each is broken.

The theorem restarts from any safe state: what it asks at a time is asked of the state then, and what it asks
of the future is asked from then on. So every monitor marks ticks, and :mod:`mjmerge.verdict.judge` looks at
those that can have mattered.

A hypothesis is asked only where the plant has the thing: a double integrator has no wheels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np

from mjmerge.config.acts import BODIES, EVERY, LIMITS, WHEELS
from mjmerge.config.doors import from_outside
from mjmerge.law import Law, Signal
from mjmerge.law.cbf_qp import CbfQp
from mjmerge.law.function import GUARDED
from mjmerge.law.opinion_dynamics.barrier import effective_distance
from mjmerge.law.opinion_dynamics.parameters import Parameters
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.mismatch import column
from mjmerge.scenario.ramp import EDGE_DISTANCE, END_DISTANCE, END_RATE
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array, Mask, dot, norm
from mjmerge.verdict.loops import foreseen_window_s, longest_delay_s
from mjmerge.verdict.metrics import saturated

OBEYS_WINDOW_S, OBEYS_MPS = 0.1, 0.1
"""The ego moves as commanded if over this window its velocity changes as told to within this much."""
BOUNDED_MPS, BOUNDED_MPS2 = 100.0, 50.0
"""A neighbour that is faster, or accelerates by more, is no road car: its motion is not bounded."""
SEEN = 0.02
"""The ego knows a distance if it is told it to within this part of r (1.2 cm at the paper's scale)."""
FELT = 0.1
"""It knows its rate to within this part of k_o (0.1 m/s at the paper's scale): d falls by a factor
exp(-v/k_o) for a closing speed v, so an error of that size changes the distance that is kept by a tenth.
Under a law that has no k_o, it is that at the paper's scale."""


@dataclass(frozen=True)
class Hypothesis:
    """Something that the theorem asks, or that its world takes for granted.

    Attributes:
        name: what it is called.
        asks: what must be true, in a line.
        marks: the ticks of a trace at which it is broken, (N, T).
        reads: columns of the trace that this needs.
        plants: which plants have the thing.
        sampled: whether it is about a command that is held, or late: not asked in continuous time.
        laws: whose it is.
        ends: whether it is about the end of the ego's lane.
    """

    name: str
    asks: str
    marks: Callable[[Trace], Mask]
    reads: tuple[str, ...]
    plants: tuple[str, ...] = EVERY
    sampled: bool = False
    laws: tuple[type[Law], ...] = (Law,)
    ends: bool = False

    def asked(self, trace: Trace) -> bool:
        """Whether the trace's world has what this is about."""
        there = trace.plant in self.plants and not (self.sampled and trace.continuous)
        return there and self.of(trace.scenario.law, ends=trace.scenario.road.ends_m is not None)

    def of(self, law: Law, *, ends: bool = False) -> bool:
        """Whether it is one of this law's; of one from outside none is but those of every law.

        Args:
            law: which.
            ends: whether the ego's lane ends.
        """
        if self.ends and not ends:
            return False
        return self.laws == (Law,) or (isinstance(law, self.laws) and not from_outside(law.kind))


def asked(trace: Trace) -> dict[str, Hypothesis]:
    """The hypotheses that a trace is to be held against, by name."""
    return {name: one for name, one in HYPOTHESES.items() if one.asked(trace)} | own(trace.scenario.law)


def own(law: Law) -> dict[str, Hypothesis]:
    """The hypotheses that a law brings, by name: those of its signals that say whether one holds.

    None takes the place of one that is asked of it anyway.
    """
    brought = {called(signal.name): _own(signal) for signal in law.signals if signal.asks}
    return {
        name: one for name, one in brought.items() if name not in HYPOTHESES or not HYPOTHESES[name].of(law)
    }


def its_own(trace: Trace) -> dict[str, Hypothesis]:
    """Those that a trace is held against because of its law, by name: no other law is asked them."""
    of = {name: one for name, one in HYPOTHESES.items() if one.laws != (Law,) and one.asked(trace)}
    return of | own(trace.scenario.law)


def called(signal: str) -> str:
    """What a hypothesis is called that a signal of this name is about."""
    return signal.replace("_", " ")


def _own(signal: Signal) -> Hypothesis:
    def marks(trace: Trace) -> Mask:
        holds = trace.signals[signal.name]
        broken: Mask = np.any(holds.reshape(*holds.shape[:2], -1) < 0.5, axis=2)
        return broken

    return Hypothesis(called(signal.name), signal.asks, marks, (signal.name,))


def broken(trace: Trace) -> dict[str, Mask]:
    """The ticks at which each hypothesis that is asked is broken, by name, (N, T)."""
    return {name: one.marks(trace) for name, one in asked(trace).items()}


def _paper(trace: Trace) -> Parameters:
    """The paper's law, which alone is asked for what it needs."""
    law = trace.scenario.law
    assert isinstance(law, Parameters)
    return law


def _safe_start(trace: Trace) -> Mask:
    return _at_start(trace, np.any(trace.guarded_m[:, 0] <= 0, axis=1))


def _bounded_start(trace: Trace) -> Mask:
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = trace.guarded_rate_mps[:, 0] / trace.guarded_m[:, 0]
    return _at_start(trace, np.any(np.isinf(rate), axis=1))


def _at_start(trace: Trace, broken: Mask) -> Mask:
    """A mask (N,) as ticks, (N, T): what is broken at t = 0 is broken there only."""
    ticks = np.zeros(trace.distance_m.shape[:2], dtype=bool)
    ticks[:, 0] = broken
    return ticks


def _opinion_awake(trace: Trace) -> Mask:
    asleep: Mask = trace.opinion <= 0
    return asleep


def _barrier_on(trace: Trace) -> Mask:
    """Off everywhere with k_o = 0, or with a law that has none; and where a variant caps 1/d."""
    law, d = trace.scenario.law, trace.guarded_m
    if from_outside(law.kind):
        return np.full(d.shape[:2], getattr(law, GUARDED, None) is False)
    if not isinstance(law, Parameters):
        return np.full(d.shape[:2], law.unguarded() == law)
    capped: Mask = np.any((d > 0) & (effective_distance(law, d) > d), axis=2)
    return capped | (law.k_o <= 0)


def _neighbours_bounded(trace: Trace) -> Mask:
    """Until bodies touch, and about how neighbours move: not about what their drivers ask of their cars."""
    v, window = trace.velocity_mps[:, :, 1:], _window(trace, OBEYS_WINDOW_S)
    broken = norm(v) > BOUNDED_MPS
    broken[:, window:] |= norm(v[:, window:] - v[:, :-window]) > BOUNDED_MPS2 * OBEYS_WINDOW_S
    touched: Mask = np.logical_or.accumulate(np.any(trace.touching, axis=2), axis=1)
    before: Mask = np.any(broken, axis=2) & ~touched
    return before


def _neighbours_apart(trace: Trace) -> Mask:
    """By their bodies where there are any, else by the bodies they would have: rectangles along the road."""
    if trace.plant in BODIES:
        touching: Mask = np.any(trace.touching[:, :, trace.roster.others], axis=2)
        return touching
    sheets, p = car_sheets(trace.scenario), trace.front_m
    overlap = np.zeros(p.shape[:2], dtype=bool)
    for a, b in trace.roster.pairs[trace.roster.others]:
        one, other = sheets[a], sheets[b]
        noses = p[:, :, a, 0] + one.front_overhang_m, p[:, :, b, 0] + other.front_overhang_m
        along = np.minimum(*noses) - np.maximum(noses[0] - one.length_m, noses[1] - other.length_m)
        across = (one.width_m + other.width_m) / 2 - np.abs(p[:, :, a, 1] - p[:, :, b, 1])
        overlap |= (along >= 0) & (across > 0)
    return overlap


def _leave_2r(trace: Trace) -> Mask:
    """In continuous time margins meet, and the run ends, between two ticks: the gap at the next counts."""
    ego, one, two, r = trace.front_m[:, :, 0], trace.leader_m, trace.follower_m, trace.scenario.r_m
    ahead_s = trace.scenario.control_step_s if trace.continuous else 0.0
    gap = trace.gap_m + np.minimum(trace.gap_rate_mps * ahead_s, 0) if ahead_s else trace.gap_m
    between = (ego[..., 0] < one[..., 0]) & (ego[..., 0] > two[..., 0])
    in_lane = np.abs(ego[..., 1] - one[..., 1]) < r
    return between & in_lane & (gap + r <= 2 * r)


def _seen(trace: Trace) -> Mask:
    off = np.abs(trace.sensed_distance_m - trace.distance_m) > SEEN * trace.scenario.r_m
    unseen: Mask = np.any(off, axis=2)
    return unseen


def _felt(trace: Trace) -> Mask:
    with np.errstate(invalid="ignore"):
        off = np.abs(trace.sensed_distance_rate_mps - trace.distance_rate_mps)
    unfelt: Mask = np.any(off > FELT * getattr(trace.scenario.law, "k_o", 1.0), axis=2)
    return unfelt


def _margin_covers(trace: Trace) -> Mask:
    touching: Mask = np.any(trace.touching_ego & (trace.distance_m > 0), axis=2)
    return touching


def _end_told(trace: Trace) -> Mask:
    return np.full(trace.distance_m.shape[:2], trace.scenario.road.told == "nothing")


def _margin_covers_end(trace: Trace) -> Mask:
    return trace.off_the_end & (trace.signals[END_DISTANCE] > 0)


def _rolling(trace: Trace) -> Mask:
    return np.abs(trace.speed_mps[:, :, 0]) < trace.scenario.law.eps_v_mps


def _steers_within(trace: Trace) -> Mask:
    """A car's limit is in its data sheet; that of the bicycle equations is pi/2."""
    limit = trace.sheets[0].steer_limit_rad if trace.plant in LIMITS else pi / 2
    beyond: Mask = np.abs(trace.steer_rad[:, :, 0]) >= limit
    return beyond


def _unsaturated(trace: Trace) -> Mask:
    return saturated(trace)[:, :, 0]


def _obeys(trace: Trace) -> Mask:
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
    """Two things can be too fast for a hold of h: the loop, and the approach.

    The held loop is stable while its gain k_v + sum_j k_o/d_j is below 2/h (with one neighbour and without
    k_v: d > k_o h/2). And with a small k_o a single tick jumps over that bound, and over d = 0: it must not
    be able to, d_j + d_j' h > 0.

    Whatever crosses d = 0 passes a tick like that. So it counts only where the barrier does what it says: the
    fault is not the hold's where u_c is not what (barrier) gives for what the ego was told, at least by half.
    """
    law, h, d = _paper(trace), trace.scenario.control_step_s, trace.guarded_m
    near = d > 0  # inside the margin it is too late for an excuse
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = law.k_v + np.sum(np.where(near, law.k_o / effective_distance(law, d), 0.0), axis=2)
    jumps = np.any(near & (d + np.minimum(trace.guarded_rate_mps, 0) * h <= 0), axis=2)
    coarse: Mask = np.any(near, axis=2) & (jumps | (gain * h >= 2))
    return coarse & _barrier_acts(trace)


def _barrier_acts(trace: Trace) -> Mask:
    """Whether u_c has, along the barrier's command for what the ego was told, at least half its size."""
    law, (d, rate) = _paper(trace), _told(trace)
    e = trace.front_m[:, :, :1] - trace.guarded_points_m
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        closing = -np.minimum(rate, 0) / effective_distance(law, d)
        told = law.k_o * np.sum(np.where(d > 0, closing, 0.0)[..., None] * e / norm(e)[..., None], axis=2)
        acts: Mask = dot(trace.u_c_mps2, told) >= dot(told, told) / 2
    return acts


def _told(trace: Trace) -> tuple[Array, Array]:
    """d_j, m, and its rate, m/s, of all that the law keeps clear of, as it is told, (N, T, C-1 or C)."""
    d, rate, ramp = trace.sensed_distance_m, trace.sensed_distance_rate_mps, trace.ramp
    if ramp is None or not ramp.told:
        return d, rate
    end = ramp.columns(
        trace.sensed_front_m[:, :, 0], trace.sensed_velocity_mps[:, :, 0], trace.sensed_heading_rad
    )
    d, rate = (
        np.concatenate([of_cars, end[name][..., None]], axis=2)
        for of_cars, name in ((d, END_DISTANCE), (rate, END_RATE))
    )
    return d, rate


def _prompt(trace: Trace) -> Mask:
    """The true dead time of commands and measurements is less than the loop can stand at d_j."""
    late_s = column(trace.mismatch, "sensing_delay_s") + column(trace.mismatch, "command_delay_s")
    late: Mask = np.zeros(trace.distance_m.shape[:2], dtype=bool)
    law, wheelbase_m = _paper(trace), car_sheets(trace.scenario)[0].wheelbase_m
    way = trace.scenario.actuation
    turns = trace.plant in WHEELS and way.inverse == "measured"
    reckons_s = way.dead_time_s if way.inverse == "predicted" and trace.plant in WHEELS else 0.0
    for run in np.flatnonzero(late_s != reckons_s).tolist():
        d = trace.guarded_m[run]
        near = d > 0
        gain = law.k_v + law.k_o / np.where(near, effective_distance(law, d), np.inf)
        if reckons_s:
            least_s, most_s = foreseen_window_s(gain, law.k_p, reckons_s)
        else:
            turn = np.maximum(trace.speed_mps[run, :, :1], 0) / wheelbase_m if turns else None
            least_s, most_s = np.zeros(1), longest_delay_s(gain, law.k_p, turn)
        stands = (least_s <= late_s[run]) & (late_s[run] < most_s)
        late[run] = np.any(near & ~stands, axis=1)
    return late


def _starts_within(trace: Trace) -> Mask:
    law = trace.scenario.law
    assert isinstance(law, CbfQp)
    psi = trace.guarded_rate_mps[:, 0] + law.alpha_1 * trace.guarded_m[:, 0]
    return _at_start(trace, np.any(psi < 0, axis=1))


def _as_assumed(trace: Trace) -> Mask:
    """Those that nobody tells the ego of: all but the leader."""
    law = trace.scenario.law
    assert isinstance(law, CbfQp)
    e = trace.front_m[:, :, :1] - trace.front_m[:, :, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        towards = dot(e / norm(e)[..., None], trace.u_mps2[:, :, 1:])
    leads = np.broadcast_to(trace.two[0], towards.shape[:2])[..., None]
    others = np.arange(towards.shape[2]) != leads
    harder: Mask = np.any(others & (towards > law.a_j_mps2), axis=2)
    return harder


_DISTANCES = ("distance_m", "distance_rate_mps")
_PAPER: tuple[type[Law], ...] = (Parameters,)

HYPOTHESES: dict[str, Hypothesis] = {
    one.name: one
    for one in (
        Hypothesis("safe start", "d_j(0) > 0", _safe_start, ("distance_m",)),
        Hypothesis("bounded start", "d_j'(0)/d_j(0) is finite", _bounded_start, _DISTANCES),
        Hypothesis("opinion is positive", "z > 0", _opinion_awake, ("opinion",), laws=_PAPER),
        Hypothesis(
            "barrier is on",
            "k_o > 0, and nothing keeps k_o/d_j from growing",
            _barrier_on,
            ("distance_m",),
        ),
        Hypothesis(
            "neighbours bounded",
            "Assumption 1: v_j and its rate are bounded, and with them p_j in any finite time",
            _neighbours_bounded,
            ("velocity_mps",),
        ),
        Hypothesis(
            "neighbours keep apart",
            "Assumption 1: each neighbour keeps a safe distance from the others, at all times",
            _neighbours_apart,
            ("front_m",),
        ),
        Hypothesis(
            "neighbours leave 2r",
            "Assumption 1: once the ego is in their lane between them, leader and follower leave it 2r",
            _leave_2r,
            ("front_m", "gap_m", "gap_rate_mps"),
        ),
        Hypothesis(
            "distances known",
            "the ego is told d_j to within 2 % of r",
            _seen,
            ("sensed_distance_m", "distance_m"),
        ),
        Hypothesis(
            "closing speeds known",
            "the ego is told d_j' to within a tenth of k_o",
            _felt,
            ("sensed_distance_rate_mps", "distance_rate_mps"),
        ),
        Hypothesis(
            "ego rolls",
            "|v_r| >= eps_v, where the bicycle inverse is exact",
            _rolling,
            ("speed_mps",),
            WHEELS,
        ),
        Hypothesis(
            "steering within limit", "|delta| is less than its limit", _steers_within, ("steer_rad",), WHEELS
        ),
        Hypothesis(
            "command within limits",
            "the ego is never asked for more than it can do",
            _unsaturated,
            ("torque_clipped_n_m", "steer_clipped_rad"),
            LIMITS,
        ),
        Hypothesis(
            "ego moves as commanded",
            "the front axle's velocity changes as told: over 0.1 s to within 0.1 m/s",
            _obeys,
            ("velocity_mps", "u_mps2"),
            sampled=True,
        ),
        Hypothesis(
            "hold small against d",
            "the held loop is stable at d_j, and no tick can jump over what is left",
            _sampled_finely,
            _DISTANCES,
            sampled=True,
            laws=_PAPER,
        ),
        Hypothesis(
            "delay small against d",
            "the loop that is really there is stable at d_j under the true dead time",
            _prompt,
            ("distance_m",),
            sampled=True,
            laws=_PAPER,
        ),
        Hypothesis(
            "starts within the barriers",
            "d_j'(0) + alpha_1 d_j(0) >= 0",
            _starts_within,
            _DISTANCES,
            laws=(CbfQp,),
        ),
        Hypothesis(
            "neighbours accelerate as assumed",
            "no neighbour but the leader accelerates towards the ego by more than a_j",
            _as_assumed,
            ("front_m", "u_mps2"),
            laws=(CbfQp,),
        ),
        Hypothesis(
            "margin covers the bodies",
            "bodies do not touch while d_j > 0: the theorem is about front axles",
            _margin_covers,
            ("distance_m", "clearance_m", "contact_impulse_n_s"),
            BODIES,
        ),
        Hypothesis(
            "end is told", "the law is told where its lane ends", _end_told, (EDGE_DISTANCE,), ends=True
        ),
        Hypothesis(
            "margin covers the end",
            "the body is on the road while d_end > 0: the law keeps the front axle clear",
            _margin_covers_end,
            (EDGE_DISTANCE, END_DISTANCE),
            ends=True,
        ),
    )
}
"""Every hypothesis by name.

A missing number breaks nothing: a breach is an excuse, and there is none for what nobody saw. But nothing is
refuted either where one could not be evaluated.
"""
