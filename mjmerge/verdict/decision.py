"""How the ego decides: numbers about z and mu that the distances do not show.

The mu-law multiplies three conditions, so two false ones make a true one; z decays while the ego is refused
and needs as long to come back. These metrics say how often, and for how long, that mattered.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from mjmerge.law import is_paper
from mjmerge.simulation.trace import Trace
from mjmerge.state import Mask
from mjmerge.verdict.metrics import INTENT, lateral_error_m

CONDITIONS = ("beside the gap", "room for 2r", "gap stays open")
"""The three conditions of the mu-law, in its order."""


@dataclass(frozen=True)
class DecisionMetrics:
    """Decision metrics of one simulation; a time that never came is ``None``.

    Attributes:
        wrong_sign_s: time for which mu was driven up while a condition was false, s.
        refusal_memory_s: longest time from "all conditions true again" to w > 0.5, s.
        abort_s: longest time from "a condition turns false" to w < 0.5, where the ego had meant to merge, s.
        straddling_s: time spent between the lanes, from 20 % to 80 % of the way across, s.
        least_z: smallest opinion.
        underflow: whether z fell below the smallest normal float64: it may never come back.

    Under a law that has no opinion, all but the time between the lanes are ``None``.
    """

    wrong_sign_s: float | None
    refusal_memory_s: float | None
    abort_s: float | None
    straddling_s: float
    least_z: float | None
    underflow: bool | None

    def as_dict(self) -> dict[str, float | bool | None]:
        """For the summary."""
        return asdict(self)


def conditions(trace: Trace) -> Mask:
    """Which of ``CONDITIONS`` hold, (N, T, 3); false where there is no data."""
    x, law = trace.front_m[:, :, 0, 0], trace.scenario.law
    assert is_paper(law), "no other law has them"
    beside = (x - trace.leader_m[..., 0]) * (x - trace.follower_m[..., 0]) < 0
    room = trace.gap_m > 2 * law.r_m
    open_ = trace.gap_rate_mps > -law.eps_1 * trace.gap_m
    return np.stack([beside, room, open_], axis=-1)


def decision(trace: Trace) -> list[DecisionMetrics]:
    """Decision metrics of every simulation."""
    h, law = trace.scenario.control_step_s, trace.scenario.law
    off = np.abs(lateral_error_m(trace))
    lane = abs(law.r_eta_m) if is_paper(law) else off[:, :1]
    across = off / np.where(lane == 0, 1.0, lane)
    straddling = (across > 0.2) & (across < 0.8)
    if not is_paper(law):
        return [
            DecisionMetrics(None, None, None, float(straddling[run].sum() * h), None, None)
            for run in range(trace.runs)
        ]
    allowed: Mask = np.all(conditions(trace), axis=2)
    wants = trace.weight > INTENT
    wrong = (trace.mu_input_per_s > 0) & ~allowed
    least_z = np.where(np.isnan(trace.opinion), np.inf, trace.opinion).min(axis=1)
    return [
        DecisionMetrics(
            wrong_sign_s=float(wrong[run].sum() * h),
            refusal_memory_s=_longest_lag(allowed[run], wants[run], h),
            abort_s=_longest_lag(~allowed[run], ~wants[run], h),
            straddling_s=float(straddling[run].sum() * h),
            least_z=float(least_z[run]),
            underflow=bool(least_z[run] < np.finfo(float).tiny),
        )
        for run in range(trace.runs)
    ]


def _longest_lag(cause: Mask, effect: Mask, step_s: float) -> float | None:
    """Longest time from a tick where ``cause`` begins, with ``effect`` false, to where ``effect`` is true, s.

    A cause that ends before its effect came does not count.
    """
    lags: list[float] = []
    for start in np.flatnonzero(cause[1:] & ~cause[:-1]) + 1:
        if effect[start]:
            continue
        stops = np.flatnonzero(~cause[start:])
        end = start + stops[0] if stops.size else len(cause)
        came = np.flatnonzero(effect[start:end])
        if came.size:
            lags.append(float(came[0] * step_s))
    return max(lags) if lags else None
