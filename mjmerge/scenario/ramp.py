"""The end of the ego's lane: where it is, and how far the ego's body is from the edge of the road there.

The lane that the ego starts in reaches from the middle between it and the leader's to its outer side, half a
lane's width from where the ego starts. Beyond ``road.ends_m`` there is no road outside of that middle. Over
the taper before that, the edge line goes there straight from the outer side. So what is no road is a wedge,
with its apex where the edge line meets the middle; the outer side before the taper is nobody's edge.

The law may be told of it as of a standing obstacle: what is no road, moved outwards by r less half the ego's
width, but no further than the middle of the lane: at a distance r from that, the body is on the road. It is
told the nearest point: of a single point at the end a law knows nothing once it is past it, and goes back
into a lane that is gone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mjmerge.law.sensed import End
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.schema import Road, Scenario
from mjmerge.state import Array, dot, norm
from mjmerge.vehicle.datasheet import DataSheet

END_DISTANCE, END_RATE, EDGE_DISTANCE = "end_distance_m", "end_distance_rate_mps", "edge_distance_m"
"""Columns of a trace whose scenario has an end, see :mod:`mjmerge.simulation.trace`."""


@dataclass(frozen=True)
class Ramp:
    """The end of the ego's lane in N simulations.

    Attributes:
        ends_m: where it ends, along the road, m.
        taper_m: length over which it narrows before that, m.
        lane_m: where the ego starts, across the road, m, (N,).
        inner_m: the middle between there and the leader's lane, likewise.
        outer_m: the outer side of the lane, likewise.
        sheet: data sheet of the ego, at its size.
        r_m: the margin r, m.
        told: whether the law is told of it.
        turns: whether the ego has a heading; the body of a point lies along the road.
    """

    ends_m: float
    taper_m: float
    lane_m: Array
    inner_m: Array
    outer_m: Array
    sheet: DataSheet
    r_m: float
    told: bool
    turns: bool = True

    @classmethod
    def of(cls, scenarios: Sequence[Scenario], plant: str = "") -> Ramp | None:
        """That of scenarios which differ in where the cars start; ``None`` where the lane goes on.

        Args:
            scenarios: of each simulation, N of them.
            plant: what moves the cars.
        """
        first = scenarios[0]
        starts = np.array([[one.starts[c].front_m[1] for c in (0, 1 + one.law.j_1)] for one in scenarios])
        return cls.at(first.road, starts, car_sheets(first)[0], first.r_m, turns=plant != "double_integrator")

    @classmethod
    def at(
        cls, road: Road, lanes_m: Array, sheet: DataSheet, r_m: float, *, turns: bool = True
    ) -> Ramp | None:
        """From where the ego and its leader start across the road, m, (N, 2); the rest as in the class."""
        if road.ends_m is None:
            return None
        ego, leader = lanes_m[:, 0], lanes_m[:, 1]
        outer = ego + np.where(ego >= leader, 0.5, -0.5) * road.lane_width_m
        told = road.told == "obstacle"
        return cls(road.ends_m, road.taper_m, ego, (ego + leader) / 2, outer, sheet, r_m, told, turns)

    def alone(self, run: int) -> Ramp:
        """That of one simulation, N = 1."""
        row = slice(run, run + 1)
        lanes = {name: getattr(self, name)[row] for name in ("lane_m", "inner_m", "outer_m")}
        return replace(self, **lanes)

    @property
    def obstacle(self) -> End | None:
        """What the law is told of: :meth:`nearest`, or ``None`` where it is told nothing."""
        return self.nearest if self.told else None

    @cached_property
    def side(self) -> Array:
        """1 where the lane is left of its leader's, -1 where right, (N,)."""
        return np.where(self.outer_m >= self.inner_m, 1.0, -1.0)

    @cached_property
    def corner_m(self) -> Array:
        """The corner of the obstacle, on the edge line, m, (N, 2)."""
        middle, across = np.abs(self.lane_m - self.inner_m), self.outer_m - self.inner_m
        off = np.minimum(self.r_m - self.sheet.width_m / 2, middle) * self.side
        return np.stack([self.ends_m - self.taper_m * off / across, self.inner_m + off], axis=-1)

    @cached_property
    def edges(self) -> Array:
        """Unit vectors from the apex: along the lane that goes on, and back along the taper, (N, 2, 2)."""
        across = self.outer_m - self.inner_m
        long = np.hypot(self.taper_m, across)
        on = np.stack([np.ones_like(across), np.zeros_like(across)], axis=-1)
        return np.stack([on, np.stack([-self.taper_m / long, across / long], axis=-1)], axis=-2)

    def nearest(self, p: Array, v: Array) -> tuple[Array, Array]:
        """The point of the obstacle that is nearest to the ego, m, and how it moves, m/s, each (N, 2).

        The obstacle stands; its nearest point goes along its side with the ego, and rests at its corner.

        Args:
            p: front axle of the ego, m, (N, 2).
            v: its velocity, m/s, (N, 2).
        """
        q, edges = p - self.corner_m, self.edges
        along = np.maximum(dot(q[..., None, :], edges), 0.0)
        feet = along[..., None] * edges
        apart = norm(q[..., None, :] - feet)
        first = (apart[..., 0] <= apart[..., 1])[..., None]
        moves = np.where(along > 0, dot(v[..., None, :], edges), 0.0)[..., None] * edges
        back = edges[..., 1, :]
        inside = (self.side * q[..., 1] >= 0) & (
            self.side * (q[..., 0] * back[..., 1] - q[..., 1] * back[..., 0]) >= 0
        )
        within = inside[..., None]
        at = np.where(first, feet[..., 0, :], feet[..., 1, :])
        to = np.where(first, moves[..., 0, :], moves[..., 1, :])
        return np.where(within, p, self.corner_m + at), np.where(within, v, to)

    def columns(self, front_m: Array, velocity_mps: Array, heading_rad: Array) -> dict[str, Array]:
        """Its columns of the trace in one tick, each (N,).

        Args:
            front_m: front axle of the ego, m, (N, 2).
            velocity_mps: its velocity, m/s, (N, 2).
            heading_rad: theta, (N,).
        """
        p_end, v_end = self.nearest(front_m, velocity_mps)
        e = front_m - p_end
        distance = norm(e)
        closing = dot(e, velocity_mps - v_end)
        return {
            END_DISTANCE: distance - self.r_m,
            END_RATE: closing / np.where(distance == 0, 1.0, distance),
            EDGE_DISTANCE: self.edge_distance_m(front_m, heading_rad),
        }

    def edge_distance_m(self, front_m: Array, heading_rad: Array) -> Array:
        """How far the ego's body is from what is no road, m, (N,); less than 0 where it is off.

        By separating axes: exact beside a face of the body or of the edge, and never too large.

        Args:
            front_m: its front axle, m, (N, 2).
            heading_rad: theta, (N,).
        """
        heading = heading_rad if self.turns else np.zeros_like(heading_rad)
        nose_m, tail_m = self.sheet.front_overhang_m, self.sheet.length_m - self.sheet.front_overhang_m
        half_m = self.sheet.width_m / 2
        cos, sin = np.cos(heading), np.sin(heading)
        x, y = self.ends_m - front_m[..., 0], self.inner_m - front_m[..., 1]  # to the apex
        ahead, left = x * cos + y * sin, y * cos - x * sin
        back_x, back_y = self.edges[..., 1, 0], self.edges[..., 1, 1]
        back_ahead, back_left = back_x * cos + back_y * sin, back_y * cos - back_x * sin
        # faces of the body: the apex is beyond one, and both edges go away from it
        along = np.where((cos >= 0) & (back_ahead >= 0), ahead - nose_m, -np.inf)
        along = np.where((cos <= 0) & (back_ahead <= 0), np.maximum(along, -ahead - tail_m), along)
        across = np.where((sin <= 0) & (back_left >= 0), left - half_m, -np.inf)
        across = np.where((sin >= 0) & (back_left <= 0), np.maximum(across, -left - half_m), across)
        # edges: how far the body reaches beyond each
        beside = self.side * y - _reach(self.side * sin, cos, nose_m, tail_m, half_m)
        before = self.side * (back_left * ahead - back_ahead * left) - _reach(
            self.side * back_left, back_ahead, nose_m, tail_m, half_m
        )
        found: Array = np.maximum(np.maximum(along, across), np.maximum(beside, before))
        return np.where(np.isnan(x + y + heading), np.nan, found)


def _reach(along: Array, across: Array, nose_m: float, tail_m: float, half_m: float) -> Array:
    """How far a body reaches in a direction, m, by its components ahead and, in size, to the side."""
    return np.maximum(along * nose_m, -along * tail_m) + np.abs(across) * half_m
