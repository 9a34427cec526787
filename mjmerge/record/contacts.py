"""How contacts are seen: discs that stay red for a while, and a mark at the place for the rest of the run.

A contact is over within some ticks. All of this follows from the columns and the cars' data sheets.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjmerge.roster import Roster
from mjmerge.simulation.log import TickBlock
from mjmerge.state import Array, nanoseconds
from mjmerge.vehicle.datasheet import DataSheet
from mjmerge.verdict.metrics import JOIN_S, Collision

SEEN_S = 2.0
"""Discs of cars that touched stay red for so long, s."""
NOTHING = "no contact"
STEPS = 8
"""Into so many parts the colours of a disc divide the distances 0 to r."""
_ANCHORS = np.array([[1.0, 0.16, 0.12, 0.5], [1.0, 0.78, 0.1, 0.4], [0.4, 0.9, 0.5, 0.16]])
"""Red at d_j = 0, amber at r/2, green at r."""
_RED = np.array([[1.0, 0.0, 0.05, 0.8]])
_BETWEEN = [np.interp(np.linspace(0, 1, STEPS + 1), [0, 0.5, 1], part) for part in _ANCHORS.T]
DISC_RGBA = np.concatenate([np.stack(_BETWEEN, axis=-1), _RED])
"""Colour of a disc by its shade: inside it (0), by d_j over r, clear of it, touched (the last)."""
CLEAR, TOUCHED = STEPS, STEPS + 1
PIN_RADIUS_R, HEAD, MARK_RGB = 0.02, 2.5, (1.0, 0.235, 0.235)
"""Of the pin where bodies touched: its radius over r, the radius of its head over that, its colour."""
_PIN, _LEANS_R = 1.6, 2.4
"""How high it is over the cars' labels, and how far it leans to the left, over r: it hides none of them."""
_NEVER = -(2**40)
"""A tick long before the first."""
_CORNER_R = 0.02
"""Corners that are as deep as the deepest, but for this part of a car's width, are where two bodies touch."""


@dataclass(frozen=True)
class Mark:
    """Where two bodies began to touch. Given anew once it is known how fast they moved against each other.

    Attributes:
        number: of the contact in the run, from 1.
        time_ns: when this is known, ns.
        place_m: where on the road, m, (2,).
        collision: who, when, and how fast.
    """

    number: int
    time_ns: int
    place_m: Array
    collision: Collision

    def pin_m(self, r_m: float, label_m: float) -> Array:
        """Foot and head of the pin, m, (2, 3), by the margin r and the height of the cars' labels, m."""
        x, y = self.place_m
        return np.array([[x, y, 0.0], [x, y + _LEANS_R * r_m, _PIN * label_m]])

    @property
    def state(self) -> str:
        """Who touches whom, without when."""
        return who(self.collision)


def who(collision: Collision) -> str:
    """Who touches whom, as the beginning of a sentence."""
    return collision.sentence.partition(" at ")[0]


def states(there: Roster) -> list[str]:
    """All that :attr:`Mark.state` can be, after ``NOTHING``."""
    cars = there.cars
    return [NOTHING, *(who(Collision(cars[a], cars[b], 0.0, None)) for a, b in there.pairs)]


class Contacts:
    """Watches the consecutive blocks of one run."""

    def __init__(self, there: Roster, sheets: Sequence[DataSheet], step_s: float) -> None:
        """Args: who is in it; the data sheet of each car; simulated time between ticks, s."""
        self._there, self._sheets, self._step_s = there, sheets, step_s
        self._last = np.full(len(there.pairs), _NEVER)
        self._open: dict[int, Mark] = {}
        self._count = 0
        self._of = np.array([[j in pair for pair in there.pairs] for j in range(1, len(there.cars))])

    def add(self, block: TickBlock) -> tuple[list[Mark], Array]:
        """Looks at the next ticks.

        Returns:
            The marks of contacts that begin, or whose speed is known now; how long ago each neighbour's body
            last touched one, s, (B, C-1), infinite where it never did.
        """
        columns, ticks = block.columns, block.ticks
        touching = (columns["clearance_m"] <= 0) | (columns["contact_impulse_n_s"] > 0)
        if not touching.any() and (self._last == _NEVER).all():
            return [], np.full((len(ticks), len(self._of)), np.inf)
        last = np.where(touching, ticks[:, None], _NEVER)
        last = np.maximum.accumulate(np.concatenate([self._last[None], last]))
        marks = [
            mark
            for k, i in np.argwhere(touching).tolist()
            for mark in self._look(columns, int(ticks[k]), k, i, int(ticks[k] - last[k, i]))
        ]
        self._last = last[-1]
        ago = ticks[:, None] - np.stack([last[1:, of].max(axis=1) for of in self._of], axis=-1)
        return marks, np.where(ago > -_NEVER // 2, np.inf, ago * self._step_s)

    def _look(self, columns: Mapping[str, Array], tick: int, row: int, pair: int, ago: int) -> Iterator[Mark]:
        """The mark of a pair that touches at a tick, where there is something new about it."""
        joined, known = round(JOIN_S / self._step_s), self._open.get(pair)
        speed = float(columns["contact_speed_mps"][row, pair])
        fast = speed if speed > 0 else None
        time_s, (a, b) = tick * self._step_s, self._there.pairs[pair]
        if ago - 1 >= joined or known is None:
            both = [a, b]
            sheets = [self._sheets[c] for c in both]
            place_m = place(columns["front_m"][row, both], columns["heading_rad"][row, both], sheets)
            if not np.isfinite(place_m).all():
                return
            self._count += 1
            cars = self._there.cars
            met = Collision(cars[a], cars[b], time_s, fast)
            known = Mark(self._count, int(nanoseconds(time_s)), place_m, met)
        elif fast is None or known.collision.speed_mps is not None:
            return
        else:
            of = known.collision
            met = Collision(of.a, of.b, of.time_s, fast)
            known = Mark(known.number, int(nanoseconds(time_s)), known.place_m, met)
        self._open[pair] = known
        yield known


def place(front_m: Array, heading_rad: Array, sheets: Sequence[DataSheet]) -> Array:
    """Where two bodies are nearest, or deepest in each other, m, (2,), as the rectangles of their sheets.

    Args:
        front_m: their front axles, m, (2, 2).
        heading_rad: their headings, (2,).
        sheets: their data sheets.
    """
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    turn = np.stack([np.stack([cos, -sin], axis=-1), np.stack([sin, cos], axis=-1)], axis=1)
    half = np.array([[s.length_m / 2, s.width_m / 2] for s in sheets])
    ahead = np.array([[s.front_overhang_m - s.length_m / 2, 0.0] for s in sheets])
    center = front_m + np.einsum("cij,cj->ci", turn, ahead)
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    corners = center[:, None] + np.einsum("cij,ckj->cki", turn, signs * half[:, None])
    seen = np.einsum("cji,ckj->cki", turn, corners[::-1] - center[:, None])  # the other's corners
    beyond = np.abs(seen) - half[:, None]
    apart = np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(axis=-1), 0)
    deepest = apart <= apart.min() + _CORNER_R * half[:, 1].min()
    found: Array = corners[::-1][deepest].mean(axis=0)
    return found


def shade(distance_m: Array, r_m: float, ago_s: Array) -> NDArray[np.int64]:
    """Which of ``DISC_RGBA`` each disc has.

    Args:
        distance_m: d_j, m, (D, C-1).
        r_m: the margin r, m.
        ago_s: how long ago a neighbour's body last touched one, s, (D, C-1).
    """
    inside_m = np.clip(np.where(np.isnan(distance_m), r_m, distance_m), 0, r_m)
    part = np.minimum(np.ceil(inside_m / r_m * STEPS), STEPS)
    return np.where(ago_s <= SEEN_S, TOUCHED, part.astype(np.int64))
