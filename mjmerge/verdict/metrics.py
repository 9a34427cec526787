"""Numbers read off a trace: when the ego merged, and what happened when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mjmerge.config.bounds import whole
from mjmerge.roster import EGO
from mjmerge.scenario.ramp import EDGE_DISTANCE
from mjmerge.simulation.trace import Trace, check_trace
from mjmerge.state import Array, Mask, nanoseconds

MERGED_M = 0.1
"""Lateral error below which, and for good, the merge counts as done, m."""
MERGED_RAD, MERGED_RADPS = 0.05, 0.1
"""The same of the heading off the road, rad (3 degrees), and of how fast it changes, rad/s."""
TURNED_RAD = 0.5
"""A car whose heading is further off the road than this, rad, drives across it: 29 degrees."""
INTENT = 0.5
"""Weight w above which the ego intends to merge (z itself never exceeds 1/k_mu)."""

_YAW_S = 0.1  # a yaw rate is the mean over this
JOIN_S = 0.3
"""A stretch of contact or saturation with shorter breaks is one event."""


@dataclass(frozen=True)
class Event:
    """Something that happened in one simulation.

    Attributes:
        time_s: when, s.
        level: how bad.
        car: which car, as in the roster.
        text: what, in words and numbers.
    """

    time_s: float
    level: Literal["info", "warning", "error"]
    car: str
    text: str


@dataclass(frozen=True)
class Collision:
    """Two bodies that touched, for the first time.

    Attributes:
        a: one car, as in the roster.
        b: the other.
        time_s: when, s.
        speed_mps: how fast they moved against each other, m/s; ``None`` where that is not known.
    """

    a: str
    b: str
    time_s: float
    speed_mps: float | None

    @property
    def sentence(self) -> str:
        """As the beginning of a reason."""
        fast = "" if self.speed_mps is None else f" at {self.speed_mps:.2f} m/s"
        who = f"the ego hits {self.b}" if self.a == EGO else f"{self.a} and {self.b} collide"
        return f"{who} at {self.time_s:.2f} s{fast}"


@dataclass(frozen=True)
class RanOff:
    """The ego's body over the edge of the road where its lane ends, for the first time.

    Attributes:
        time_s: when, s.
        speed_mps: how fast its front axle was, m/s.
    """

    time_s: float
    speed_mps: float

    @property
    def sentence(self) -> str:
        """As the beginning of a reason."""
        return f"the ego runs off the end of its lane at {self.time_s:.2f} s at {self.speed_mps:.2f} m/s"


def ran_off(trace: Trace, run: int = 0) -> RanOff | None:
    """When the ego ran off the end of its lane in one simulation; ``None`` if it did not, or has no end."""
    ticks = np.flatnonzero(trace.off_the_end[run])
    if not ticks.size:
        return None
    speed = float(np.hypot(*trace.velocity_mps[run, ticks[0], 0]))
    return RanOff(float(trace.time_s[ticks[0]]), speed)


def collisions(trace: Trace, run: int = 0) -> list[Collision]:
    """Which bodies touched in one simulation, whoever they are: the first time of each pair, in order."""
    found, cars, touching_at = [], trace.roster.cars, trace.touching_in(run)
    for i, (a, b) in enumerate(trace.roster.pairs):
        touching = np.flatnonzero(touching_at[:, i])
        if touching.size:
            first = touching[touching < touching[0] + max(1, round(JOIN_S / trace.scenario.control_step_s))]
            speeds = trace.contact_speed_mps[run, first, i]
            known = speeds[speeds > 0]
            speed = float(known[0]) if known.size else None
            found.append(Collision(cars[a], cars[b], float(trace.time_s[touching[0]]), speed))
    return sorted(found, key=lambda collision: collision.time_s)


def lateral_error_m(trace: Trace) -> Array:
    """How far the ego is across the road from the leader, signed, m, (N, T)."""
    return trace.front_m[:, :, 0, 1] - trace.leader_m[..., 1]


def intends(trace: Trace) -> Mask:
    """Whether the ego means to merge, (N, T): w > 1/2; under a law that has no w, whether it is on its way.

    That is, a fifth of the way across that it began with, or further.
    """
    across = np.abs(lateral_error_m(trace))
    weighed = ~np.isnan(trace.weight).all(axis=1, keepdims=True)
    means: Mask = np.where(weighed, trace.weight > INTENT, across < 0.8 * across[:, :1])
    return means


def turned_words(turned: float, words: str) -> str:
    """How far a car has turned off the road, rad, in words with a place for it; of more than a turn, none."""
    return (
        words.format(f"{np.degrees(turned):.0f} degrees") if abs(turned) <= 2 * np.pi else "round and round"
    )


def turned_rad(trace: Trace) -> Array:
    """The ego's heading where it is furthest off the road, signed, rad, (N,).

    NaN on a plant of points, which have no heading, and where nothing is known.
    """
    if trace.plant == "double_integrator":
        return np.full(trace.runs, np.nan)
    heading = np.nan_to_num(trace.heading_rad[:, :, 0])
    furthest = np.argmax(np.abs(heading), axis=1)
    turned: Array = trace.heading_rad[np.arange(trace.runs), furthest, 0]
    return turned


def merged(trace: Trace) -> Mask:
    """Whether the ego is in the leader's lane, along the road, and turns no more, (N, T); false for NaN.

    A point has no heading: on ``double_integrator`` the lane alone counts.
    """
    there = np.abs(lateral_error_m(trace)) < MERGED_M
    if trace.plant == "double_integrator":
        return there
    heading, window = trace.heading_rad[:, :, 0], max(1, round(_YAW_S / trace.scenario.control_step_s))
    straight: Mask = there & (np.abs(heading) < MERGED_RAD)
    turned = np.abs(heading[:, window:] - heading[:, :-window])
    straight[:, window:] &= turned < MERGED_RADPS * window * trace.scenario.control_step_s
    return straight


def merged_at_s(trace: Trace) -> Array:
    """Time from which the ego is :func:`merged` for good, s, (N,); NaN if never."""
    out = ~merged(trace)  # true for NaN: a run that stopped has not merged
    last_out = np.where(out.any(1), out.shape[1] - 1 - np.argmax(out[:, ::-1], axis=1), -1)
    ends_so = last_out < out.shape[1] - 1
    return np.where(ends_so, trace.time_s[np.minimum(last_out + 1, out.shape[1] - 1)], np.nan)


def shared_ticks(a: Trace, b: Trace) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Ticks of one trace and of the other that are at the same times, each (T,)."""
    ns_a, ns_b = (nanoseconds(trace.time_s) for trace in (a, b))
    in_a = np.flatnonzero(np.isin(ns_a, ns_b))
    return in_a, np.searchsorted(ns_b, ns_a[in_a])


def saturated(trace: Trace) -> Mask:
    """Whether a car was asked for more than it could do, (N, T, C); false where the plant has no limits."""
    return (np.abs(trace.torque_clipped_n_m) > 1e-9) | (np.abs(trace.steer_clipped_rad) > 1e-9)


def peak_u_mps2(trace: Trace) -> Array:
    """Most that the law asks of the ego, m/s^2, (N,); NaN where nothing is known."""
    u = np.hypot(*np.moveaxis(trace.u_mps2[:, :, 0], -1, 0))
    most = np.where(np.isnan(u), -np.inf, u).max(axis=1)
    return np.where(np.isinf(most), np.nan, most)


def rms_jerk_mps3(trace: Trace) -> Array:
    """Root mean square of the rate of what the law asks of the ego, over whole ticks, m/s^3, (N,)."""
    change = np.diff(trace.u_mps2[:, :, 0], axis=1) / trace.scenario.control_step_s
    squared = np.sum(change * change, axis=-1)
    known = ~np.isnan(squared)
    mean = np.where(known, squared, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.where(known.any(axis=1), np.sqrt(mean), np.nan)


def touching_ticks_in_margin(trace: Trace) -> NDArray[np.int64]:
    """Ticks in which the ego touches a neighbour although d_j > 0, (N, C-1): too small a margin."""
    found: NDArray[np.int64] = np.sum(trace.touching_ego & (trace.distance_m > 0), axis=1)
    return found


def clear_ticks_without_margin(trace: Trace) -> NDArray[np.int64]:
    """Ticks in which the ego is clear of a neighbour although d_j <= 0, (N, C-1): more margin than need."""
    touching = trace.touching_ego
    clear = ~touching & ~np.isnan(trace.clearance_m[..., : touching.shape[-1]])
    found: NDArray[np.int64] = np.sum(clear & (trace.distance_m <= 0), axis=1)
    return found


def chosen_anew(trace: Trace, run: int) -> list[int]:
    """Ticks at which one simulation's ego chooses a gap: the first, and others than before from then on."""
    if trace.scenario.law.choice == "named":
        return []
    known = ~np.isnan(trace.distance_m[run]).any(axis=1)
    pairs = np.stack([np.asarray(j)[run] for j in trace.two], axis=1)[known]
    return [k for k in range(len(pairs)) if k == 0 or (pairs[k] != pairs[k - 1]).any()]


def _opinion(trace: Trace, run: int, tick: int) -> str:
    """The opinion at a tick, where the law has one."""
    z = trace.opinion[run, tick]
    return "" if np.isnan(z) else f" (z = {z:.3f})"


def events(trace: Trace, run: int = 0) -> list[Event]:
    """What happened in one simulation, in order of time.

    Raises:
        MjmergeError: it is no trace, or there is no such simulation in it.
    """
    check_trace(trace)
    whole("run", run, 0, trace.runs - 1)
    found: list[Event] = []
    time_s, cars = trace.time_s, trace.roster.cars

    joined = round(JOIN_S / trace.scenario.control_step_s)

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

    for start, end in spans(intends(trace)[run]):
        add(start, "info", "ego", f"intends to merge{_opinion(trace, run, start)}")
        if end < len(time_s) and not np.isnan([trace.front_m[run, end, 0, 0], trace.weight[run, end]]).all():
            add(end, "info", "ego", f"gives up the merge{_opinion(trace, run, end)}")
    merged_s = merged_at_s(trace)[run]
    if not np.isnan(merged_s):
        found.append(
            Event(float(merged_s), "info", "ego", f"merged (lateral error < {MERGED_M} m from here on)")
        )
    if trace.plant != "double_integrator":
        heading = trace.heading_rad[run, :, 0]
        for start, end in spans(np.abs(heading) > TURNED_RAD):
            furthest = float(heading[start + int(np.argmax(np.abs(heading[start:end])))])
            text = f"drives across the road, {turned_words(furthest, 'up to {} off it')}{within(start, end)}"
            add(start, "warning", "ego", text)
    for j, name in enumerate(cars[1:]):
        d = trace.distance_m[run, :, j]
        for start, end in spans(d <= 0):
            least = np.nanmin(d[start:end])
            add(
                start,
                "error",
                "ego",
                f"d_{j + 1} <= 0: inside the margin of {name}, down to {least:.3f} m{within(start, end)}",
            )
    for start, end in spans(trace.off_the_end[run]):
        least = np.nanmin(trace.signals[EDGE_DISTANCE][run, start:end])
        speed = np.hypot(*trace.velocity_mps[run, start, 0])
        text = f"runs off the end of its lane at {speed:.2f} m/s, by {-least:.3f} m{within(start, end)}"
        add(start, "error", "ego", text)
    for i, (a, b) in enumerate(trace.roster.pairs):
        for start, end in spans(trace.touching_in(run)[:, i]):
            impulse = np.nansum(trace.contact_impulse_n_s[run, start:end, i])
            speeds = trace.contact_speed_mps[run, start:end, i]
            first = speeds[np.argmax(speeds > 0)]
            hit = f" at {first:.2f} m/s, {impulse:.3g} N s" if impulse > 0 else ""
            add(start, "error", cars[a], f"touches {cars[b]}{hit}{within(start, end)}")
    for k in chosen_anew(trace, run):
        one, two = (cars[1 + int(np.asarray(j)[run, k])] for j in trace.two)
        add(k, "info", "ego", f"chooses the gap between {one} and {two}")
    for c, name in enumerate(cars):
        for start, end in spans(saturated(trace)[run, :, c]):
            add(start, "warning", name, f"is asked for more than it can do{within(start, end)}")
    found += [Event(s.time_s, "error", s.car, f"stopped: {s.reason}") for s in trace.stops if s.run == run]
    return sorted(found, key=lambda e: e.time_s)
