"""Following by IDM, and the lane by MOBIL: how traffic simulators drive.

IDM, the Intelligent Driver Model (M. Treiber, A. Hennecke, D. Helbing, Phys. Rev. E 62 (2000) 1805), as in
the driver ``idm``: a car at speed v, with a free road s to one at v_l, accelerates by

    acc = a [1 - (v/v_0)^delta - (s*/s)^2],    s* = s_0 + max(0, v T + v (v - v_l) / (2 sqrt(a b)))

MOBIL (A. Kesting, M. Treiber, D. Helbing, General lane-changing model MOBIL for car-following models, Transp.
Res. Rec. 1999 (2007) 86): a car c changes lane where that is safe for its new follower n and worth it, with o
its old follower, and a tilde for accelerations after the change,

    a~_n >= -b_safe,    a~_c - a_c + p (a~_n - a_n + a~_o - a_o) > Delta a_th -+ Delta a_bias

The bias, there for the lane that is to be kept to, is here for the leader's while the leader is ahead; it is
large, because the change is mandatory. Both lanes are weighed at every tick, so a change can be taken back.

What the law sees forces, or the publications leave open:

- s is the distance of front axles along the road less the margin r, by which every law is judged.
- A neighbour is in a lane if it is within r of its centre. The centres are the leader's y as sensed, and the
  y at which the ego was first.
- Others are taken for drivers with the ego's own keys, v_0 included.
- While it changes, the ego brakes for the car ahead in its new lane and for the one ahead in its way, as in
  highway-env. Before that it brakes for the leader, too, by b at most: the synchronisation of W. Schakel,
  V. Knoop, B. van Arem, Transp. Res. Rec. 2316 (2012) 47. The models alone take it past the gap, on a free
  lane.
- It never brakes harder than a limit, nor than a gain times its speed, so that it comes to a stand.
- Across the road it is a critically damped oscillator about the centre of the lane that it chose.

Published are highway-env's numbers (T = 1.5 s, s_0 = 5 m, v_0 = 30 m/s, a = 3, b = 5, limit 6, b_safe = 2,
Delta a_th = 0.2 m/s^2, delta = 4, p = 0); the defaults are these at 1/10, by similarity. The bias is ours:
a + b_safe + Delta a_th, with which a free lane is left as soon as behind the leader the ego need brake by
b_safe at most, highway-env's condition for a planned change. So are the bandwidth and the gain.

With these numbers it does not merge in ``paper``: behind the leader it wants s_0 + v T = 1.45 m, its follower
must have 1.12 m, each beyond r = 0.6 m, and the gap opens to 2.31 m. With s_0 = 0.2 m and T = 0.17 s it does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from mjmerge.config.frozen import NonNegative, Positive
from mjmerge.law.base import Decision, Law, Memory, Signal
from mjmerge.law.sensed import Sensed
from mjmerge.roster import PER_NEIGHBOUR
from mjmerge.state import LEAST, Array, Mask, limit

_ROUNDING = 1e-6  # of a limit: what differs by less from an acceleration is the same


@dataclass(frozen=True)
class _Car:
    """Whoever is next, ahead or behind: at infinity, and at rest, where there is nobody.

    Attributes:
        s: free road to it, m, (N,).
        v: its speed along the road, m/s, (N,).
    """

    s: Array
    v: Array


class IdmMobil(Law):
    """Traffic simulators' driver: follows by IDM, and goes into the leader's lane when MOBIL says it may."""

    guard: ClassVar[str] = "its braking for others"
    gives: ClassVar[tuple[str, ...]] = ("target_m", "u_n_mps2", "u_c_mps2")

    kind: Literal["idm_mobil"] = "idm_mobil"
    desired_speed_mps: Positive = 9.49
    """v_0, speed on a free road, m/s; 30 m/s at full size."""
    time_gap_s: NonNegative = 0.474
    """T, safe time headway, s; 1.5 s at full size."""
    standstill_gap_m: Positive = 0.5
    """s_0, free road left to the car ahead at a stand, beyond r, m; 5 m at full size."""
    max_acceleration_mps2: Positive = 3.0
    """a, acceleration from a stand on a free road, m/s^2."""
    comfortable_deceleration_mps2: Positive = 5.0
    """b, comfortable braking, m/s^2."""
    exponent: Positive = 4.0
    """delta, how late it stops accelerating on the way to v_0, 1."""
    limit_mps2: Positive = 6.0
    """Hardest braking, and acceleration, along the road, m/s^2."""
    stop_gain_per_s: Positive = 10.0
    """How it comes to a stand: it never brakes harder than this times its speed, 1/s."""
    politeness: Annotated[float, Field(ge=0, le=1)] = 0.0
    """p, weight of the followers' accelerations beside the ego's own, 1."""
    safe_braking_mps2: Positive = 2.0
    """b_safe, braking that a change may impose on the new follower, m/s^2."""
    threshold_mps2: NonNegative = 0.2
    """Delta a_th, advantage below which no change is worth it, m/s^2."""
    bias_mps2: NonNegative = 5.2
    """Delta a_bias, what the leader's lane is worth by itself while the leader is ahead, m/s^2."""
    lateral_bandwidth_radps: Positive = 1.2
    """Bandwidth of the critically damped motion to the lane's centre, rad/s."""
    guarded: bool = True
    """Whether it keeps clear; with false, every road is free and every change safe."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """See :meth:`Law.problems`."""
        for name in ("comfortable_deceleration_mps2", "safe_braking_mps2"):
            least = getattr(self, name)
            if self.limit_mps2 < least:
                yield "limit_mps2", f"({self.limit_mps2} m/s^2) must not be below {name} ({least} m/s^2)"

    @property
    def signals(self) -> tuple[Signal, ...]:
        """What MOBIL weighs, and what it and IDM count on."""
        return (
            Signal("lane", "the lane it chose: 0 its own, 1 the leader's", "lane"),
            Signal("incentive_mps2", "MOBIL's advantage of the other lane, with its bias", "incentive"),
            Signal("new_follower_mps2", "what MOBIL expects of the follower in the other lane", "a~_n"),
            Signal(
                "within_limit",
                "whether IDM asks for no more than the limit",
                asks="the hardest braking is enough for IDM",
            ),
            Signal(
                "follower_yields",
                "whether it does as IDM would, where it is behind the ego and in its way",
                axes=(PER_NEIGHBOUR,),
                asks="whoever is behind the ego, and in its way, accelerates by no more than IDM does",
            ),
        )  # fmt: skip

    def start(self, runs: int, initial: Mapping[str, float]) -> Memory:
        """Its own lane, m, which is not known yet, and the one that it chose, each (N,); and of the others.

        That is their speed along the road, m/s, and what IDM asked of them, m/s^2, one control step ago, in a
        shape that fits any number of them.
        """
        del initial
        return {
            "own_lane_m": np.full(runs, np.nan),
            "lane": np.zeros(runs),
            "v_j_mps": np.full((runs, 1), np.nan),
            "asked_mps2": np.full((runs, 1), np.inf),
        }

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """See :class:`Law`."""
        v, y = seen.v[:, 0], seen.p[:, 1]
        own = np.where(np.isnan(memory["own_lane_m"]), y, memory["own_lane_m"])
        leaders = seen.p_j[:, self.j_1, 1]
        incentive, a_n, merges = self.mobil(seen, memory["lane"] > 0, own, leaders)
        lane = merges.astype(float)

        free = self.acceleration_mps2(v, _nobody(v))
        wanted = free
        for car in (self._ahead(seen, np.where(merges, leaders, own)), self._ahead(seen, y)):
            wanted = np.minimum(wanted, self.acceleration_mps2(v, car))
        leader = _Car(seen.p_j[:, self.j_1, 0] - seen.p[:, 0] - self.r_m, seen.v_j[:, self.j_1, 0])
        towards = np.maximum(self.acceleration_mps2(v, leader), -self.comfortable_deceleration_mps2)
        wanted = np.where(merges, wanted, np.minimum(wanted, towards))
        gain = min(self.stop_gain_per_s, 1 / step_s) if step_s > 0 else self.stop_gain_per_s
        wanted = np.maximum(wanted, -gain * v)
        braked = limit(wanted, self.limit_mps2)

        w, moves = self.lateral_bandwidth_radps, np.where(merges, seen.v_j[:, self.j_1, 1], 0.0)
        centre = np.where(merges, leaders, own)
        across = -w * w * (y - centre) - 2 * w * (seen.v[:, 1] - moves)
        u_n = np.stack([free, across], axis=-1)
        u_c = np.stack([braked - free, np.zeros_like(free)], axis=-1)
        desired = self.standstill_gap_m + np.maximum(leader.v, 0.0) * self.time_gap_s
        return Decision(
            u_n + u_c,
            {
                "target_m": np.stack([seen.p_j[:, self.j_1, 0] - self.r_m - desired, centre], axis=-1),
                "u_n_mps2": u_n,
                "u_c_mps2": u_c,
                "lane": lane,
                "incentive_mps2": incentive,
                "new_follower_mps2": a_n,
                "within_limit": (wanted >= -self.limit_mps2).astype(float),
                "follower_yields": self._yields(seen, memory, step_s),
            },
            after={
                "own_lane_m": own,
                "lane": lane,
                "v_j_mps": seen.v_j[..., 0],
                "asked_mps2": self._asked(seen),
            },
        )

    def unguarded(self) -> Self:
        """On a free road."""
        return self.model_copy(update={"guarded": False}) if self.guarded else self

    @np.errstate(over="ignore")  # of s* / s, where s is nothing
    def acceleration_mps2(self, v: Array, ahead: _Car) -> Array:
        """IDM's acceleration behind a car, unlimited, m/s^2.

        Args:
            v: speed along the road, m/s; backwards counts as a stand.
            ahead: the car.
        """
        a, b = self.max_acceleration_mps2, self.comfortable_deceleration_mps2
        v = np.maximum(v, 0.0)
        wanted: Array = a * (1 - (v / self.desired_speed_mps) ** self.exponent)
        if not self.guarded:
            return wanted
        s_star = self.standstill_gap_m + np.maximum(
            v * self.time_gap_s + v * (v - ahead.v) / (2 * sqrt(a * b)), 0.0
        )
        s = np.maximum(ahead.s, LEAST)
        return wanted - a * (s_star / s) ** 2

    def mobil(self, seen: Sensed, merges: Mask, own: Array, leaders: Array) -> tuple[Array, Array, Mask]:
        """The other lane's advantage, a~_n of its follower, m/s^2, and whether to be in the leader's, (N,).

        Args:
            seen: what the ego senses.
            merges: whether it has chosen the leader's lane so far, (N,).
            own: centre of its own lane, m, (N,).
            leaders: centre of the leader's, m, (N,).
        """
        now, then = np.where(merges, leaders, own), np.where(merges, own, leaders)
        v = seen.v[:, 0]
        ahead, new_ahead = self._ahead(seen, now), self._ahead(seen, then)
        behind, new_behind = self._behind(seen, now), self._behind(seen, then)
        a_n = self._limited(new_behind.v, _Car(new_behind.s, v))
        others = (a_n - self._limited(new_behind.v, self._beyond(new_behind, new_ahead))) + (
            self._limited(behind.v, self._beyond(behind, ahead)) - self._limited(behind.v, _Car(behind.s, v))
        )
        advantage = self._limited(v, new_ahead) - self._limited(v, ahead) + self.politeness * others
        bias = np.where(seen.p_j[:, self.j_1, 0] > seen.p[:, 0], self.bias_mps2, 0.0)
        advantage = advantage + np.where(merges, -bias, bias)
        safe = a_n >= -self.safe_braking_mps2 if self.guarded else np.ones_like(merges)
        changes = safe & (advantage > self.threshold_mps2)
        return advantage, a_n, merges ^ changes

    def _limited(self, v: Array, ahead: _Car) -> Array:
        """The same, but it brakes no harder than the limit: numbers that can be subtracted."""
        return np.maximum(self.acceleration_mps2(v, ahead), -self.limit_mps2)

    def _beyond(self, behind: _Car, ahead: _Car) -> _Car:
        """The car ahead as one behind the ego sees it when the ego is gone."""
        return _Car(behind.s + ahead.s + self.r_m, ahead.v)

    def _ahead(self, seen: Sensed, lane: Array) -> _Car:
        """Whoever is next ahead of the ego within r of a line along the road, at y in m, (N,)."""
        along = seen.p_j[..., 0] - seen.p[:, None, 0]
        return self._next(seen, np.where(self._within(seen, lane) & (along > 0), along, np.inf))

    def _behind(self, seen: Sensed, lane: Array) -> _Car:
        """Whoever is next behind it, or level with it."""
        along = seen.p[:, None, 0] - seen.p_j[..., 0]
        return self._next(seen, np.where(self._within(seen, lane) & (along >= 0), along, np.inf))

    def _within(self, seen: Sensed, lane: Array) -> Mask:
        return np.abs(seen.p_j[..., 1] - lane[:, None]) < self.r_m

    def _next(self, seen: Sensed, along: Array) -> _Car:
        """The nearest, from distances along the road, m, (N, C-1), infinite where they do not count."""
        rows, j = np.arange(len(along)), along.argmin(axis=1)
        s = along[rows, j] - self.r_m
        return _Car(s, np.where(np.isinf(s), 0.0, seen.v_j[rows, j, 0]))

    def _asked(self, seen: Sensed) -> Array:
        """What IDM asks of each neighbour that is behind in the ego's way, else inf, m/s^2, (N, C-1)."""
        along = seen.p[:, None, 0] - seen.p_j[..., 0]
        there = self._within(seen, seen.p[:, 1]) & (along >= 0)
        asked = self.acceleration_mps2(seen.v_j[..., 0], _Car(along - self.r_m, seen.v[:, None, 0]))
        return np.where(there, asked, np.inf)

    def _yields(self, seen: Sensed, memory: Memory, step_s: float) -> Array:
        """Whether each neighbour did no more than it was asked one step ago, (N, C-1)."""
        if step_s <= 0:
            return np.ones_like(seen.v_j[..., 0])
        was = memory["v_j_mps"]
        asked = np.maximum(memory["asked_mps2"], -was / step_s)  # it need not drive backwards
        broken = (seen.v_j[..., 0] - was) / step_s > asked + _ROUNDING * self.limit_mps2
        return np.where(broken, 0.0, 1.0)


def _nobody(like: Array) -> _Car:
    return _Car(np.full_like(like, np.inf), np.zeros_like(like))
