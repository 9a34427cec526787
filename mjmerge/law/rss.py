"""The paper's tracking under Responsibility-Sensitive Safety (RSS).

S. Shalev-Shwartz, S. Shammah, A. Shashua, On a formal model of safe and scalable self-driving cars,
arXiv 1708.06374 (2017). Two cars are in danger while neither of their distances is safe:

- along the road, if for the response time rho the rear car, at v_r, accelerates by a_max and then brakes by
  b_min, while the front car, at v_f, brakes by b_max,

      d_min = [v_r rho + a_max rho^2/2 + (v_r + rho a_max)^2/(2 b_min) - v_f^2/(2 b_max)]_+

- across it, if both accelerate towards each other by a_lat for rho, and then brake by b_lat to no lateral
  speed; with each one's speed v_i towards the other, and v_i,rho = v_i + rho a_lat,

      d_min = mu + [sum_i (v_i + v_i,rho) rho/2 + v_i,rho |v_i,rho|/(2 b_lat)]_+

The proper response to a danger, whose threshold t_b is the last time without: until t_b + rho accelerate by
a_max and a_lat at most. From then on, if it was along the road that t_b was safe, the rear car brakes by
b_min at least, to a stand, and the front car by b_max at most; if it was across it, both brake by b_lat at
least across it, and then do not move towards each other. The law is the tracking within these limits.

Where our world forces a reading:

- Distances are those of squares of side r, |x - x_j| - r and |y - y_j| - r, of front axles. While one is not
  negative neither is d_j, by which every law is judged; at the squares' corners it need not go so far.
- Lateral speeds are as sensed: the paper's mu-lateral-velocity, which leaves out swerves within mu, needs the
  future. Of others a lateral motion counts as none if braking by b_lat ends it within mu/2.
- v_rho |v_rho| follows the paper's definition; its lemma prints the square, the same for cars that approach.
- Everybody drives forwards, with the ego's constants.
- A danger may begin between two ticks: t_b is the tick before, and a_max, a_lat and b_max bind at all times.
  A command is held: braking begins with the last tick before t_b + rho, and ends at a stand with a tick that
  may be softer, which costs b_min h^2/8 at most (0.05 mm). A danger at t = 0 counts as both.

It answers for what the ego causes. Who drives into it from behind has to brake; the ego does not make way.

The paper leaves the constants open. The defaults are those of its library (ad-rss-lib) in CARLA, rho = 1 s,
a_max = 3.5, b_min = 4, b_max = 8, a_lat = 0.2, b_lat = 0.8 m/s^2, and mu = 0.1 m of that library's tests, at
1/10 by similarity. With these it does not merge in ``paper``: at 2 m/s it wants 1.76 m beyond r before and
behind it, and the gap opens to 2.31 m = 2 r + 1.11 m. With rho = 0.05 s, 0.16 s at full size, it does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar, Literal, Self

import numpy as np

from mjmerge.config.frozen import NonNegative, Positive
from mjmerge.law.base import Decision, Memory, Signal
from mjmerge.law.nominal import Tracking
from mjmerge.law.sensed import Sensed
from mjmerge.roster import PER_NEIGHBOUR
from mjmerge.state import Array, Mask

_ROUNDING = 1e-6  # of a bound or a step: what differs by less is the same


class Rss(Tracking):
    """The paper's tracking, limited to the proper responses of Responsibility-Sensitive Safety."""

    guard: ClassVar[str] = "the proper response"
    gives: ClassVar[tuple[str, ...]] = ("target_m", "u_n_mps2", "u_c_mps2")

    kind: Literal["rss"] = "rss"
    response_time_s: Positive = 0.316
    """rho, everybody's response time, s; 1 s at full size."""
    max_acceleration_mps2: NonNegative = 3.5
    """a_max, hardest acceleration along the road, m/s^2."""
    min_braking_mps2: Positive = 4.0
    """b_min, braking that a rear car in danger owes at least, m/s^2."""
    max_braking_mps2: Positive = 8.0
    """b_max, hardest braking of a front car, m/s^2."""
    lateral_acceleration_mps2: Positive = 0.2
    """a_lat, hardest acceleration across the road, m/s^2."""
    lateral_braking_mps2: Positive = 0.8
    """b_lat, braking across the road that a car in danger owes at least, m/s^2."""
    lateral_margin_m: NonNegative = 0.01
    """mu, what must be left across the road, m; 0.1 m at full size."""
    guarded: bool = True
    """Whether it responds; with false it is the tracking alone."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """See :meth:`Law.problems`."""
        if self.max_braking_mps2 < self.min_braking_mps2:
            least = f"min_braking_mps2 ({self.min_braking_mps2} m/s^2)"
            yield "max_braking_mps2", f"({self.max_braking_mps2} m/s^2) must not be below {least}"

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Safe distances, dangers and responses, and what all of it counts on."""
        each = (PER_NEIGHBOUR,)
        return (
            Signal("safe_along_m", "least safe distance along the road, beyond r", "d_min along", each),
            Signal("safe_across_m", "least safe distance across the road, beyond r", "d_min across", each),
            Signal("danger", "0 none; 1 along, 2 across, 3 both: what was safe before it", "danger", each),
            Signal("begins_safe", "whether there is no danger at t = 0", asks="no danger at t = 0"),
            Signal("responds_in_time", "whether rho covers a tick", asks="rho is a control step or more"),
            Signal(
                "others_within_bounds",
                "whether it accelerates as it may, since t_b",
                axes=each,
                asks="others stay within a_max and b_max, and across the road within a_lat or b_lat",
            ),
            Signal(
                "others_respond",
                "whether it does what it owes, since t_b",
                axes=each,
                asks="others in danger respond properly after rho",
            ),
        )  # fmt: skip

    def start(self, runs: int, initial: Mapping[str, float]) -> Memory:
        """Of each neighbour, in a shape that fits any number of them.

        The time since t_b, s; which distances were safe then; whether it has since left its bounds, or not
        responded; and its velocity one control step ago, m/s.
        """
        del initial
        return {
            "since_s": np.zeros((runs, 1)),
            "along": np.ones((runs, 1)),
            "across": np.ones((runs, 1)),
            "wild": np.zeros((runs, 1)),
            "idle": np.zeros((runs, 1)),
            "v_j_mps": np.full((runs, 1, 2), np.nan),
        }

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """See :class:`Law`."""
        u_n, target = self.nominal(seen)
        far = np.abs(seen.p_j - seen.p[:, None]) - self.r_m
        d_along, d_across = self.safe_along_m(seen), self.safe_across_m(seen)
        safe_along, safe_across = far[..., 0] >= d_along, far[..., 1] >= d_across
        danger = ~(safe_along | safe_across)
        since = np.where(danger, memory["since_s"], 0.0)
        along = np.where(danger, memory["along"] > 0, safe_along)
        across = np.where(danger, memory["across"] > 0, safe_across)

        u_c = np.zeros_like(u_n)
        if self.guarded:
            due = danger & (since + step_s > self.response_time_s + _ROUNDING * step_s)
            u_c = self._bounded(u_n, seen, due & along, due & across, step_s) - u_n
        wild, idle = self._others(seen, memory, since, along, across, step_s)
        wild |= danger & (memory["wild"] > 0)
        idle = danger & (idle | (memory["idle"] > 0))
        first = np.isnan(memory["v_j_mps"]).all(axis=(1, 2))
        in_time = step_s <= self.response_time_s * (1 + _ROUNDING)
        return Decision(
            u_n + u_c,
            {
                "target_m": target,
                "u_n_mps2": u_n,
                "u_c_mps2": u_c,
                "safe_along_m": d_along,
                "safe_across_m": d_across,
                "danger": np.where(danger, along + 2.0 * across, 0.0),
                "begins_safe": np.where(first & danger.any(axis=1), 0.0, 1.0),
                "responds_in_time": np.full(len(u_n), float(in_time)),
                "others_within_bounds": np.where(wild, 0.0, 1.0),
                "others_respond": np.where(idle, 0.0, 1.0),
            },
            after={
                "since_s": since + step_s,
                "along": along.astype(float),
                "across": across.astype(float),
                "wild": np.where(danger & wild, 1.0, 0.0),
                "idle": idle.astype(float),
                "v_j_mps": seen.v_j,
            },
        )

    def unguarded(self) -> Self:
        """The tracking alone."""
        return self.model_copy(update={"guarded": False}) if self.guarded else self

    def safe_along_m(self, seen: Sensed) -> Array:
        """Least safe distance along the road to each neighbour, m, (N, C-1)."""
        v, v_j = np.maximum(seen.v[:, None, 0], 0.0), np.maximum(seen.v_j[..., 0], 0.0)
        leads = seen.p[:, None, 0] > seen.p_j[..., 0]
        rear, front = np.where(leads, v_j, v), np.where(leads, v, v_j)
        rho, a = self.response_time_s, self.max_acceleration_mps2
        goes = rear * rho + a * rho * rho / 2 + (rear + rho * a) ** 2 / (2 * self.min_braking_mps2)
        return np.maximum(goes - front * front / (2 * self.max_braking_mps2), 0.0)

    def safe_across_m(self, seen: Sensed) -> Array:
        """Least safe distance across the road to each neighbour, m, (N, C-1)."""
        side = self._side(seen)
        goes = self._swerve_m(side * seen.v[:, None, 1]) + self._swerve_m(-side * seen.v_j[..., 1])
        return self.lateral_margin_m + np.maximum(goes, 0.0)

    def _swerve_m(self, v: Array) -> Array:
        """How far a car goes that accelerates by a_lat for rho and then brakes by b_lat, m, by its speed."""
        rho, b_lat = self.response_time_s, self.lateral_braking_mps2
        v_rho = v + rho * self.lateral_acceleration_mps2
        return (v + v_rho) * rho / 2 + v_rho * np.abs(v_rho) / (2 * b_lat)

    def _side(self, seen: Sensed) -> Array:
        """1 for a neighbour on the left, or level, and -1 on the right, (N, C-1)."""
        return np.where(seen.p_j[..., 1] >= seen.p[:, None, 1], 1.0, -1.0)

    def _bounded(self, u_n: Array, seen: Sensed, along: Mask, across: Mask, step_s: float) -> Array:
        """The command within what the responses leave of it.

        Args:
            u_n: the tracking's, m/s^2, (N, 2).
            seen: what the ego senses.
            along: to whom a response along the road is due, (N, C-1).
            across: the same across it.
            step_s: the control step, s.
        """
        v, b_lat, a_lat = seen.v, self.lateral_braking_mps2, self.lateral_acceleration_mps2
        behind = along & (seen.p[:, None, 0] <= seen.p_j[..., 0])
        left = self._side(seen) > 0
        most_x = np.where(behind.any(axis=1), self._braked(v[:, 0], self.min_braking_mps2, step_s), np.inf)
        most_y = np.where((across & left).any(axis=1), self._braked(v[:, 1], b_lat, step_s), np.inf)
        least_y = np.where((across & ~left).any(axis=1), -self._braked(-v[:, 1], b_lat, step_s), -np.inf)
        most_x = np.minimum(most_x, self.max_acceleration_mps2)
        u_x = np.maximum(np.minimum(u_n[:, 0], most_x), -self.max_braking_mps2)
        u_y = np.minimum(np.maximum(u_n[:, 1], -a_lat), a_lat)
        return np.stack([u_x, np.maximum(np.minimum(u_y, most_y), least_y)], axis=-1)

    def _braked(self, v: Array, least: float, step_s: float) -> Array:
        """The most acceleration that brakes a speed by so much at least, to none and not beyond, m/s^2.

        Away from there it is what would bring the speed to none.
        """
        stops = -v / step_s if step_s > 0 else np.where(v > 0, -np.inf, np.where(v < 0, np.inf, 0.0))
        return np.maximum(stops, -least)

    def _others(
        self, seen: Sensed, memory: Memory, since: Array, along: Mask, across: Mask, step_s: float
    ) -> tuple[Mask, Mask]:
        """Whether each neighbour left its bounds, and did less than it owed, over a step."""
        if step_s <= 0:
            return np.zeros_like(along), np.zeros_like(along)
        was = memory["v_j_mps"]
        did = (seen.v_j - was) / step_s
        b_min, b_lat, near = self.min_braking_mps2, self.lateral_braking_mps2, 1 + _ROUNDING
        most, least = self.max_acceleration_mps2 * near, -self.max_braking_mps2 * near
        wild = (did[..., 0] > most) | (did[..., 0] < least)
        wild |= np.abs(did[..., 1]) > max(self.lateral_acceleration_mps2, b_lat) * near
        leads, towards = seen.p[:, None, 0] > seen.p_j[..., 0], -self._side(seen)
        goes_on = along & leads & (did[..., 0] > self._braked(was[..., 0], b_min, step_s) + _ROUNDING * b_min)
        v = towards * was[..., 1]
        swerves = np.maximum(v, 0.0) ** 2 / (2 * b_lat) > self.lateral_margin_m / 2
        turns = towards * did[..., 1] > self._braked(v, b_lat, step_s) + _ROUNDING * b_lat
        owed = since > self.response_time_s + step_s * (1 - _ROUNDING)
        return wild, owed & (goes_on | (across & swerves & turns))
