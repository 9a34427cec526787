"""A record made a test: its follower nearer, towards the least gap that Assumption 1 allows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from mjmerge.merges.event import GENTLE_MPS2, STARTS_APART, Event, barrier_mps2

LEAST_GAP = 2.02
"""The gap that is tightened to, over r: Assumption 1 leaves the ego more than 2."""
FASTER = 0.25
"""How much faster than it was the follower may be driven."""
_ROUNDS, _TRIED = 4, 2001


def tightened(event: Event, steps: int) -> Iterator[Event]:
    """The event with its follower moved nearer in so many steps, the last to the least gap.

    At first it starts nearer, as long as cars can do what the barrier then asks for; what is missing, it
    drives faster by a factor. A record that breaks Assumption 1 is eased: its follower starts further back.

    Args:
        event: as recorded.
        steps: how many.
    """
    shift_m, factor = towards(event)
    for k in range(1, steps + 1):
        part = k / steps
        yield moved(event, part * shift_m, 1 + part * (factor - 1), part)


def towards(event: Event) -> tuple[float, float]:
    """How far ahead the follower is to start, m, and how much faster it is to drive, a factor."""
    least_m, gap_m = LEAST_GAP * event.r_m, event.gap_m
    missing_m = float(gap_m.min() - least_m)
    if missing_m <= 0:
        return missing_m, 1.0
    travelled_m = event.front_m[:, 2, 0] - event.front_m[0, 2, 0]
    rolls = travelled_m > 1.0
    shift_m, factor = 0.0, 1.0
    for _ in range(_ROUNDS):  # a faster follower starts further back
        shift_m = min(missing_m, _furthest_m(event, factor))
        if rolls.any():
            more = float(((gap_m - shift_m - least_m)[rolls] / travelled_m[rolls]).min())
            factor = 1 + min(max(more, 0.0), FASTER)
    return shift_m, factor


def _furthest_m(event: Event, factor: float) -> float:
    """How far ahead the follower may start, so that the law can begin and cars can do what it asks for, m."""
    ways_m = np.linspace(0, max(float(event.front_m[0, 0, 0] - event.front_m[0, 2, 0]), 0.0), _TRIED)
    front_m = np.repeat(event.front_m[:1], len(ways_m), axis=0)
    front_m[:, 2, 0] += ways_m
    speed_mps = np.gradient(event.front_m[:3, :, 0], event.time_s[:3], axis=0)[:1] * (1.0, 1.0, factor)
    asked_mps2 = barrier_mps2(front_m, speed_mps, event.r_m)
    d_m = np.hypot(*(front_m[:, 0] - front_m[:, 2]).T) - event.r_m
    most_mps2 = max(GENTLE_MPS2, event.first_mps2)
    good = (d_m >= STARTS_APART * event.r_m) & (asked_mps2 <= most_mps2)
    first_bad = int(np.argmin(good)) if not good.all() else len(good)
    return float(ways_m[max(first_bad - 1, 0)])


def moved(event: Event, shift_m: float, factor: float, step: float) -> Event:
    """The event with another motion of its follower.

    Args:
        event: as recorded.
        shift_m: how far ahead it starts.
        factor: of its speeds.
        step: how far that is on the way to the least gap.
    """
    front_m = event.front_m.copy()
    start = front_m[0, 2, 0]
    front_m[:, 2, 0] = start + shift_m + factor * (front_m[:, 2, 0] - start)
    said = [f"starts {abs(shift_m):.2f} m further {'ahead' if shift_m > 0 else 'back'}"] * (
        abs(shift_m) > 5e-3
    )
    said += [f"drives {factor:.3f} times as fast"] * (factor - 1 > 5e-4)
    if not said:
        said = ["is where it was: nothing nearer is allowed"]
    least_m = float(np.min(front_m[:, 1, 0] - front_m[:, 2, 0]))
    words = f"follower {' and '.join(said)}: least gap {least_m:.2f} m, {least_m / event.r_m:.2f} r"
    name = f"{event.name}-tight-{round(100 * step):03d}"
    return replace(event, front_m=front_m, tightened=words, step=step, name=name)
