"""A record made a test: its follower nearer, towards the least gap that Assumption 1 allows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import sqrt

import numpy as np

from mjmerge.merges.event import STARTS_APART, Event

LEAST_GAP = 2.02
"""The gap that is tightened to, over r: Assumption 1 leaves the ego more than 2."""
FASTER = 0.25
"""How much faster than it was the follower may be driven."""


def tightened(event: Event, steps: int) -> Iterator[Event]:
    """The event with its follower moved nearer in so many steps, the last to the least gap.

    At first it starts nearer, as long as the law can still begin; what is missing then, it drives faster by a
    factor. A record that breaks Assumption 1 is eased in the same way: its follower starts further back.

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
    shift_m = float(gap_m.min() - least_m)
    if shift_m <= 0:
        return shift_m, 1.0
    ego, follower = event.front_m[0, 0], event.front_m[0, 2]
    apart_m = (1 + 2 * STARTS_APART) * event.r_m
    room_m = sqrt(max(apart_m**2 - ego[1] ** 2, 0.0))
    shift_m = min(shift_m, max(float(ego[0] - follower[0]) - room_m, 0.0))
    travelled = event.front_m[:, 2, 0] - follower[0]
    rolls = travelled > 1.0
    if not rolls.any():
        return shift_m, 1.0
    factor = float(((gap_m - shift_m - least_m)[rolls] / travelled[rolls]).min())
    return shift_m, 1 + min(max(factor, 0.0), FASTER)


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
