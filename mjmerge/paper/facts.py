"""What the paper publishes about its simulation, each fact as a question to the traces of two runs.

The paper prints no data: its facts are what its text says and what the axes of its figures show. A fact holds
or not, and says by which number; how a word such as "smooth" is measured stands with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mjmerge.law import of_paper
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array, Mask
from mjmerge.verdict.metrics import INTENT, MERGED_M, lateral_error_m, merged_at_s

_WAVERS_S, _MERGES_S = 10.0, 20.0  # "when t < 10", "after t = 20"
_FADED = 0.01  # of z(0): what "towards zero" means
_TURN_M = 0.005  # a lateral swing of less is not one
_SMOOTH_MPS2 = 3.0  # lateral acceleration above which the motion counts as jerky
_IDLE_MPS2 = 0.01  # Vehicle 2 neither accelerates nor brakes


@dataclass(frozen=True)
class Pair:
    """The published run, and the same with k_o = 0; simulation 0 of each counts."""

    barrier: Trace
    no_barrier: Trace


@dataclass(frozen=True)
class FactCheck:
    """What a pair of runs says about one fact.

    Attributes:
        holds: whether it was reproduced; ``None`` where it says nothing about the law.
        number: by what.
    """

    holds: bool | None
    number: str

    @property
    def word(self) -> str:
        """``yes``, ``no``, or ``axis only``."""
        return "axis only" if self.holds is None else "yes" if self.holds else "no"


@dataclass(frozen=True)
class Fact:
    """One published fact.

    Attributes:
        claim: what is published.
        source: where: the paper's label of the figure, or its section.
        read: the pair of runs -> whether it holds.
    """

    claim: str
    source: str
    read: Callable[[Pair], FactCheck]


def _opinion_range(pair: Pair) -> FactCheck:
    z = pair.barrier.opinion[0]
    return FactCheck(bool(z.min() >= 0 and z.max() <= 0.2), f"{z.min():.1e} to {z.max():.5f}")


def _opinion_fades(pair: Pair) -> FactCheck:
    """Below 1 % of z(0), and never faster than (zi-2) can: |z'| <= 2/(eps k_mu^2) for z, |mu| <= 1/k_mu."""
    trace, law = pair.barrier, of_paper(pair.barrier.scenario.law)
    z = trace.opinion[0, trace.time_s <= _WAVERS_S]
    fastest = 2 * (law.k_s / law.k_mu) ** 2 / law.eps
    leap = np.abs(np.diff(z)).max()
    fades = trace.time_s[-1] >= _WAVERS_S and 0 < z[0] <= 0.2 and 0 < z[-1] < _FADED * z[0] and z.min() > 0
    return FactCheck(
        bool(fades and leap <= fastest * trace.scenario.control_step_s),
        f"{z[0]:.3f} at 0 s, {z[-1]:.1e} at {min(_WAVERS_S, trace.time_s[-1]):.0f} s; "
        f"steps of at most {leap:.4f}",
    )


def _alternates(pair: Pair) -> FactCheck:
    """Vehicle 2's intended acceleration changes sign, both ways."""
    trace = pair.barrier
    asked = trace.u_mps2[0, :, 2, 0]
    busy = np.flatnonzero((np.abs(asked) > _IDLE_MPS2) & (trace.time_s < _WAVERS_S))
    if not busy.size:
        return FactCheck(False, "neither accelerates nor brakes")
    turns = busy[1:][np.diff(np.sign(asked[busy])) != 0]
    words = ["accelerates" if asked[k] > 0 else "brakes" for k in (busy[0], *turns)]
    times = ["", *(f" from {trace.time_s[k]:.1f} s" for k in turns)]
    return FactCheck(len(turns) >= 2, ", ".join(word + at for word, at in zip(words, times, strict=True)))


def _merges(pair: Pair) -> FactCheck:
    """For good within 0.1 m of the lane, between the two, and not before 20 s."""
    trace = pair.barrier
    merged = merged_at_s(trace)[0]
    along = trace.front_m[0, -1, :, 0]
    off = lateral_error_m(trace)[0, -1]
    between = along[2] < along[0] < along[1]
    if np.isnan(merged):
        return FactCheck(False, f"not merged; {off:.3f} m off at {trace.time_s[-1]:.0f} s")
    where = "between them" if between else "not between them"
    return FactCheck(
        bool(merged > _MERGES_S and between),
        f"within {MERGED_M} m from {merged:.1f} s on, {off:.4f} m at {trace.time_s[-1]:.0f} s, {where}",
    )


def turns(lateral_m: Array) -> int:
    """How often a lateral position (T,) turns back, swings of less than 5 mm aside."""
    count, heading, low, high = 0, 0, lateral_m[0], lateral_m[0]
    for y in lateral_m:
        low, high = min(low, y), max(high, y)
        way = -1 if y < high - _TURN_M and heading >= 0 else 1 if y > low + _TURN_M and heading <= 0 else 0
        if way:
            count += heading != 0
            heading, low, high = way, y, y
    return count


def _smooth(pair: Pair) -> FactCheck:
    """No more turns than changes of mind, no overshoot of the lane, no jump in velocity."""
    trace = pair.barrier
    y = lateral_error_m(trace)[0]
    swings = turns(y)
    minds = int(np.abs(np.diff(trace.weight[0] > INTENT)).sum())
    peak = np.abs(np.diff(trace.velocity_mps[0, :, 0, 1])).max() / trace.scenario.control_step_s
    over = max(float((-y * np.sign(y[0])).max()), 0.0)
    return FactCheck(
        bool(swings <= minds and peak <= _SMOOTH_MPS2 and over < MERGED_M and not np.isnan(y).any()),
        f"turns {swings} times for {minds} changes of mind, at most {peak:.2f} m/s^2, "
        f"overshoot {over * 1e3:.1f} mm",
    )


def _positive(j: int) -> Callable[[Pair], FactCheck]:
    def read(pair: Pair) -> FactCheck:
        d = pair.barrier.distance_m[0, :, j]
        return FactCheck(bool(d.min() > 0), f"at least {d.min():.3f} m at {_when(pair.barrier, d):.1f} s")

    return read


def _far(pair: Pair) -> FactCheck:
    """The largest d_1 is 1.5 to the nearest 0.1."""
    d = pair.barrier.distance_m[0, :, 0]
    return FactCheck(bool(abs(d.max() - 1.5) < 0.05), f"{d.max():.3f} m at {_when(pair.barrier, -d):.1f} s")


def _near(pair: Pair) -> FactCheck:
    d = pair.barrier.distance_m[0, :, 1]
    return FactCheck(bool(d.min() >= 0 and d.max() <= 1), f"{d.min():.3f} m to {d.max():.3f} m")


def _violated(pair: Pair) -> FactCheck:
    trace = pair.no_barrier
    out: Mask = trace.distance_m[0, :, 1] < 0
    within = out & (trace.time_s > 5) & (trace.time_s < 10)
    if not out.any():
        return FactCheck(False, f"never; at least {trace.distance_m[0, :, 1].min():.3f} m")
    spell = trace.time_s[out]
    text = f"from {spell[0]:.2f} s to {spell[-1]:.2f} s"
    touching = trace.clearance_m[0, :, 1] <= 0
    if touching.any():
        text += f"; bodies touch at {trace.time_s[touching][0]:.2f} s"
    return FactCheck(bool(within.any()), text)


def _depth(pair: Pair) -> FactCheck:
    d = pair.no_barrier.distance_m[0, :, 1]
    return FactCheck(
        bool(-0.5 < d.min() < 0), f"down to {d.min():.3f} m at {_when(pair.no_barrier, d):.1f} s"
    )


def _lateral_axis(pair: Pair) -> FactCheck:
    y = pair.barrier.front_m[0, :, 0, 1]
    return FactCheck(None, f"{y.min():.3f} m to {y.max():.3f} m, the lane at 0")


def _when(trace: Trace, values: Array) -> float:
    return float(trace.time_s[int(np.argmin(values))])


FACTS: tuple[Fact, ...] = (
    Fact("z stays in 0 to 0.2", "fig:z", _opinion_range),
    Fact("t < 10 s: z goes continuously from small positive towards zero", "fig:z, text", _opinion_fades),
    Fact("t < 10 s: Vehicle 2 alternates between braking and accelerating", "text", _alternates),
    Fact("after t = 20 s the ego merges between Vehicles 1 and 2", "fig:z, text", _merges),
    Fact("the lateral position is smooth, without oscillation", "fig:z, text", _smooth),
    Fact("d_1 stays positive", "fig:d", _positive(0)),
    Fact("d_2 stays positive", "fig:d", _positive(1)),
    Fact("d_1 goes up to 1.5", "fig:d", _far),
    Fact("d_2 stays in 0 to 1", "fig:d", _near),
    Fact("k_o = 0: d_2 is negative at some time in 5 < t < 10 s", "fig:d-collide", _violated),
    Fact("k_o = 0: the lowest d_2 lies between -0.5 and 0", "fig:d-collide", _depth),
    Fact("the lateral axis shows 0.5 to 1.5 (its origin is not published)", "fig:z", _lateral_axis),
)
"""Every published fact of the paper's Section 4, in its order."""


def read(pair: Pair) -> list[FactCheck]:
    """What a pair of runs says about each of ``FACTS``; a run that ended early reproduces nothing."""
    for trace in (pair.barrier, pair.no_barrier):
        for stop in trace.stops:
            if stop.run == 0:
                end = f"the simulation ended at {stop.time_s:.2f} s: {stop.reason}"
                return [FactCheck(False, end) for _ in FACTS]
    return [fact.read(pair) for fact in FACTS]
