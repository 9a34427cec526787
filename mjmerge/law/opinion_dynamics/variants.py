"""Other readings of the paper's equations, as named parts that combine: ``law.variant: gated+one_sided``.

A part steps in at one of the places that :class:`Part` names. Adding one is adding an entry to ``PARTS``;
parts that step in at the same place do so in the order they stand there, however the variant is spelt.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from mjmerge.errors import MjmergeError, nearest
from mjmerge.law.opinion_dynamics.parameters import Parameters
from mjmerge.state import Array

LITERAL = "literal"

Consent = Callable[[Array, Array, Array, Array], Array]
Approach = Callable[[Parameters, Array, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Part:
    """One deviation from the equations as printed.

    Attributes:
        why: why it exists, in a line.
        consent: (x, beside, room, open) -> argument x of the tanh in (mu), each (N,).
        approach: (law, d, d') -> what the barrier divides by, and what it divides, each (N, C-1).
        least_z: law -> the smallest opinion, 1.
        leader: u_1 -> what the tracking takes for it, m/s^2, (N, 2).
    """

    why: str
    consent: Consent | None = None
    approach: Approach | None = None
    least_z: Callable[[Parameters], float] | None = None
    leader: Callable[[Array], Array] | None = None


def _gated(x: Array, beside: Array, room: Array, open_: Array) -> Array:
    """Magnitude as printed, sign from the AND; where a condition changes, x is 0, so it is continuous."""
    size: Array = np.abs(x)
    return np.where((beside < 0) & (room > 0) & (open_ > 0), size, -size)


def _one_sided(law: Parameters, d: Array, d_dot: Array) -> tuple[Array, Array]:
    """Only closing counts."""
    del law
    return d, np.minimum(d_dot, 0.0)


def _guarded(law: Parameters, d: Array, d_dot: Array) -> tuple[Array, Array]:
    """Inside the margin, closing is damped as at d_cap and leaving is free: never a pull inward."""
    outside = d > 0
    return np.where(outside, d, law.d_cap_m), np.where(outside, d_dot, np.minimum(d_dot, 0.0))


def _capped(law: Parameters, d: Array, d_dot: Array) -> tuple[Array, Array]:
    """1/d is at most 1/d_cap, inside the margin too; two-sided there as everywhere."""
    return np.maximum(d, law.d_cap_m), d_dot


PARTS: dict[str, Part] = {
    "gated": Part(
        "mu rises only if all three merge conditions hold: in the product, two false ones make a true one",
        consent=_gated,
    ),
    "one_sided": Part(
        "barrier only while closing in: the printed one also drags the ego after a car that leaves",
        approach=_one_sided,
    ),
    "guarded": Part(
        "for d < 0, damps closing as at d_cap_m and leaving not at all: the printed one pulls inward there",
        approach=_guarded,
    ),
    "capped": Part(
        "1/d in the barrier is at most 1/d_cap_m: the printed gain k_o/d outgrows any sampling or delay",
        approach=_capped,
    ),
    "z_floor": Part(
        "z never falls below z_floor: the printed opinion takes as long to come back as it was refused",
        least_z=lambda law: law.z_floor,
    ),
    "no_u1": Part(
        "u_1 = 0 in the tracking: the printed law knows the leader's acceleration, which nobody tells it",
        leader=np.zeros_like,
    ),
}
"""Every part by name."""

VARIANTS: dict[str, str] = {
    LITERAL: "the equations as printed, two-sided barrier, product of the three merge conditions",
    **{name: part.why for name, part in PARTS.items()},
}
"""Readings of the law by name, with why each exists; all but the first combine with ``+``."""


@dataclass(frozen=True)
class Reading:
    """The parts of one variant by the place where they step in, as in :class:`Part`; ``literal`` has none."""

    consent: tuple[Consent, ...]
    approach: tuple[Approach, ...]
    least_z: tuple[Callable[[Parameters], float], ...]
    leader: tuple[Callable[[Array], Array], ...]


def complaints(variant: str) -> Iterator[str]:
    """What is wrong with the name of a variant."""
    names = variant.split("+")
    for name in dict.fromkeys(names):
        if name not in VARIANTS:
            yield f"no law variant called {name!r}: {nearest(name, VARIANTS)}"
        elif names.count(name) > 1:
            yield f"{name!r} stands in {variant!r} more than once"
    if LITERAL in names and len(set(names)) > 1:
        yield f"{LITERAL!r} is the law without any other part; drop it from {variant!r}"


@cache
def reading(variant: str) -> Reading:
    """The parts that a variant names, chosen once.

    Raises:
        MjmergeError: it names none, or one twice.
    """
    for complaint in complaints(variant):
        raise MjmergeError(complaint)
    parts = [part for name, part in PARTS.items() if name in variant.split("+")]
    return Reading(
        consent=tuple(part.consent for part in parts if part.consent),
        approach=tuple(part.approach for part in parts if part.approach),
        least_z=tuple(part.least_z for part in parts if part.least_z),
        leader=tuple(part.leader for part in parts if part.leader),
    )
