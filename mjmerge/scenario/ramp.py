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

    @property
    def corner_m(self) -> Array:
        """The corner of the obstacle, on the edge line, m, (N, 2)."""
        middle, across = np.abs(self.lane_m - self.inner_m), self.outer_m - self.inner_m
        off = np.minimum(self.r_m - self.sheet.width_m / 2, middle) * np.sign(across)
        return np.stack([self.ends_m - self.taper_m * off / across, self.inner_m + off], axis=-1)

    def nearest(self, p: Array, v: Array) -> tuple[Array, Array]:
        """The point of the obstacle that is nearest to the ego, m, and how it moves, m/s, each (N, 2).

        The obstacle stands; its nearest point goes along its side with the ego, and rests at its corner.

        Args:
            p: front axle of the ego, m, (N, 2).
            v: its velocity, m/s, (N, 2).
        """
        corner, across = self.corner_m, self.outer_m - self.inner_m
        long = np.hypot(self.taper_m, across)
        beside = np.stack([np.ones_like(across), np.zeros_like(across)], axis=-1)
        before = np.stack([-self.taper_m / long, across / long], axis=-1)
        inward = np.stack([np.abs(across) / long, np.sign(across) * self.taper_m / long], axis=-1)
        q = p - corner
        at, to = np.zeros_like(q), np.zeros_like(v)
        least = norm(q)
        for side in (beside, before):
            along = np.maximum(dot(q, side), 0.0)[..., None]
            apart = norm(q - along * side)
            closer = (apart < least)[..., None]
            at, to = np.where(closer, along * side, at), np.where(closer, dot(v, side)[..., None] * side, to)
            least = np.minimum(least, apart)
        within = ((np.sign(across) * q[..., 1] >= 0) & (dot(q, inward) >= 0))[..., None]
        return np.where(within, p, corner + at), np.where(within, v, to)

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
        unit = e / np.where(distance == 0, 1.0, distance)[..., None]
        return {
            END_DISTANCE: distance - self.r_m,
            END_RATE: dot(unit, velocity_mps - v_end),
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
        side = np.where(self.outer_m >= self.inner_m, 1.0, -1.0)
        wide_m = np.abs(self.outer_m - self.inner_m)
        nose_m, tail_m = self.sheet.front_overhang_m, self.sheet.length_m - self.sheet.front_overhang_m
        half_m = self.sheet.width_m / 2
        x, y = self.ends_m - front_m[..., 0], self.inner_m - front_m[..., 1]  # to the apex
        cos, sin = np.cos(heading), np.sin(heading)
        long = np.hypot(self.taper_m, wide_m)
        faces = []
        # faces of the wedge: how far the body reaches along their inward normals
        for n_x, n_y in ((np.zeros_like(side), side), (wide_m / long, side * self.taper_m / long)):
            along, across = n_x * cos + n_y * sin, n_y * cos - n_x * sin
            reach = np.maximum(along * nose_m, -along * tail_m) + np.abs(across) * half_m
            faces.append(n_x * x + n_y * y - reach)
        # faces of the body: the apex beyond one, and the wedge going away from it
        for f_x, f_y, reach_m in (
            (cos, sin, nose_m), (-cos, -sin, tail_m), (-sin, cos, half_m), (sin, -cos, half_m),
        ):  # fmt: skip
            leaves = (f_x >= 0) & (side * wide_m * f_y >= self.taper_m * f_x)
            faces.append(np.where(leaves, f_x * x + f_y * y - reach_m, -np.inf))
        found = faces[0]
        for gap in faces[1:]:
            found = np.maximum(found, gap)
        return np.where(np.isnan(x + y + heading), np.nan, found)
