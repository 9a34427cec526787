"""Numbers read off a trace: when the ego merged, and what happened when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mjmerge.scenario import CARS
from mjmerge.state import PAIRS, Array, Mask
from mjmerge.trace import Trace

MERGED_M = 0.1
"""Lateral error below which, and for good, the merge counts as done, m."""
INTENT = 0.5
"""Weight w above which the ego intends to merge (z itself never exceeds 1/k_mu)."""

_JOIN_S = 0.3  # a stretch of contact or saturation with shorter breaks is one event


@dataclass(frozen=True)
class Event:
    """Something that happened in one simulation.

    Attributes:
        time_s: when, s.
        level: how bad.
        car: which car, as in ``CARS``.
        text: what, in words and numbers.
    """

    time_s: float
    level: Literal["info", "warning", "error"]
    car: str
    text: str


def lateral_error_m(trace: Trace) -> Array:
    """How far the ego is across the road from Vehicle 1, signed, m, (N, T)."""
    return trace.front_m[:, :, 0, 1] - trace.front_m[:, :, 1, 1]


def merged_at_s(trace: Trace) -> Array:
    """Time from which the ego stays within ``MERGED_M`` of Vehicle 1 in lane, s, (N,); NaN if never."""
    out = ~(np.abs(lateral_error_m(trace)) < MERGED_M)  # true for NaN: a run that stopped has not merged
    last_out = np.where(out.any(1), out.shape[1] - 1 - np.argmax(out[:, ::-1], axis=1), -1)
    merged = last_out < out.shape[1] - 1
    return np.where(merged, trace.time_s[np.minimum(last_out + 1, out.shape[1] - 1)], np.nan)


def shared_ticks(a: Trace, b: Trace) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Ticks of one trace and of the other that are at the same times, each (T,)."""
    ns_a, ns_b = (np.rint(trace.time_s * 1e9).astype(np.int64) for trace in (a, b))
    in_a = np.flatnonzero(np.isin(ns_a, ns_b))
    return in_a, np.searchsorted(ns_b, ns_a[in_a])


def saturated(trace: Trace) -> Mask:
    """Whether a car was asked for more than it could do, (N, T, C); false where the plant has no limits."""
    return (np.abs(trace.torque_clipped_n_m) > 1e-9) | (np.abs(trace.steer_clipped_rad) > 1e-9)


def touching_ticks_in_margin(trace: Trace) -> NDArray[np.int64]:
    """Ticks in which the ego touches a neighbour although d_j > 0, (N, 2): too small a margin."""
    found: NDArray[np.int64] = np.sum(trace.touching[..., :2] & (trace.distance_m > 0), axis=1)
    return found


def clear_ticks_without_margin(trace: Trace) -> NDArray[np.int64]:
    """Ticks in which the ego is clear of a neighbour although d_j <= 0, (N, 2): more margin than need be."""
    clear = ~trace.touching[..., :2] & ~np.isnan(trace.clearance_m[..., :2])
    found: NDArray[np.int64] = np.sum(clear & (trace.distance_m <= 0), axis=1)
    return found


def events(trace: Trace, run: int = 0) -> list[Event]:
    """What happened in one simulation, in order of time."""
    found: list[Event] = []
    time_s = trace.time_s

    joined = round(_JOIN_S / trace.scenario.control_step_s)

    def spans(mask: Mask) -> list[tuple[int, int]]:
        """First tick of each stretch where the mask holds, and the first tick after it; short breaks join."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))).tolist()
        found: list[tuple[int, int]] = []
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            if found and start - found[-1][1] < joined:
                found[-1] = (found[-1][0], end)
            else:
                found.append((start, end))
        return found

    def add(tick: int, level: Literal["info", "warning", "error"], car: str, text: str) -> None:
        found.append(Event(float(time_s[tick]), level, car, text))

    def within(start: int, end: int) -> str:
        return f", within {(end - start) * trace.scenario.control_step_s:.2f} s"

    for start, end in spans(trace.weight[run] > INTENT):
        add(start, "info", "ego", f"intends to merge (z = {trace.opinion[run, start]:.3f})")
        if end < len(time_s) and not np.isnan(trace.weight[run, end]):
            add(end, "info", "ego", f"gives up the merge (z = {trace.opinion[run, end]:.3f})")
    merged = merged_at_s(trace)[run]
    if not np.isnan(merged):
        found.append(
            Event(float(merged), "info", "ego", f"merged (lateral error < {MERGED_M} m from here on)")
        )
    for j, name in enumerate(CARS[1:]):
        d = trace.distance_m[run, :, j]
        for start, end in spans(d <= 0):
            least = np.nanmin(d[start:end])
            add(
                start,
                "error",
                "ego",
                f"d_{j + 1} <= 0: inside the margin of {name}, down to {least:.3f} m{within(start, end)}",
            )
    for i, (a, b) in enumerate(PAIRS):
        for start, end in spans(trace.touching[run, :, i]):
            impulse = np.nansum(trace.contact_impulse_n_s[run, start:end, i])
            speeds = trace.contact_speed_mps[run, start:end, i]
            first = speeds[np.argmax(speeds > 0)]
            hit = f" at {first:.2f} m/s, {impulse:.3g} N s" if impulse > 0 else ""
            add(start, "error", CARS[a], f"touches {CARS[b]}{hit}{within(start, end)}")
    for c, name in enumerate(CARS):
        for start, end in spans(saturated(trace)[run, :, c]):
            add(start, "warning", name, f"is asked for more than it can do{within(start, end)}")
    found += [Event(s.time_s, "error", s.car, f"stopped: {s.reason}") for s in trace.stops if s.run == run]
    return sorted(found, key=lambda e: e.time_s)
