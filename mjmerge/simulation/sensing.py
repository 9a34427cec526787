"""What the ego is told of the world: the truth, late, noisy, biased or missing.

Between the plant's truth and the law stands one :class:`Sensing` per batch. What it changes is in
:data:`mjmerge.scenario.mismatch.SENSING`; a simulation that none of it applies to is told the truth, bit for
bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mjmerge.config.acts import WHEELS
from mjmerge.scenario.cars import believed_sheets
from mjmerge.scenario.mismatch import SENSING, Mismatch, column
from mjmerge.scenario.schema import Scenario
from mjmerge.state import Array, Cars, Mask
from mjmerge.vehicle.delay import Age, Past
from mjmerge.vehicle.foresight import Foresight

_DRAWN_TICKS = 256  # random numbers are drawn for this many ticks at a time, so that batches cannot matter
_STREAM = 1_000  # of a simulation's seed; drivers have the streams from 0 on
_OWN, _OTHER = 7, 4  # numbers measured per tick: p, v, theta, v_r, delta of the ego; p_j, v_j of each other
_EXACT = Mismatch()


def exact(mismatch: Mismatch) -> bool:
    """Whether the ego is told the truth."""
    return all(getattr(mismatch, name) == getattr(_EXACT, name) for name in SENSING)


def foresight(scenario: Scenario, plant: str, *, continuous: bool) -> Foresight:
    """What a scenario's ego makes of what it is told, where it steers; elsewhere that is what it is told."""
    way, steers = scenario.actuation, plant in WHEELS and not continuous
    inverse = way.inverse if steers else "measured"
    wheelbase_m = believed_sheets(scenario)[0].wheelbase_m
    return Foresight(inverse, way.dead_time_s, scenario.control_step_s, wheelbase_m)


class Sensing:
    """Holds what was measured before; one for all N simulations."""

    def __init__(
        self, mismatches: Sequence[Mismatch], seeds: Sequence[int], step_s: float, neighbours: int
    ) -> None:
        """Args: what is wrong in each simulation; their seeds; the control step, s; how many neighbours."""
        truth = np.array([exact(m) for m in mismatches], dtype=bool)
        self.exact = bool(truth.all())
        if self.exact:
            return
        self._told_truth, self._neighbours = truth, neighbours
        self._step_s = step_s
        delay_s, self._bias_m, self._behind_m, self._dropout, self._window_s, told_delay_s = (
            column(mismatches, name)
            for name in (
                "sensing_delay_s", "neighbour_position_bias_m", "neighbour_reference_m", "neighbour_dropout",
                "neighbour_velocity_window_s", "leader_acceleration_delay_s",
            )
        )  # fmt: skip
        self._longest_s = float(delay_s.max()), float(told_delay_s.max())
        self._ages = Age.of(delay_s, step_s), Age.of(told_delay_s, step_s)
        self._tracks = bool(self._dropout.any() or self._window_s.any())
        self._told = np.array([m.leader_acceleration == "known" for m in mismatches])
        noise = {
            name: column(mismatches, name)
            for name in (
                "position_noise_m", "velocity_noise_mps", "heading_noise_rad", "steer_noise_rad",
                "neighbour_position_noise_m", "neighbour_velocity_noise_mps",
            )
        }  # fmt: skip
        p, v, theta, delta, p_j, v_j = noise.values()
        self._deviation = np.stack([p, p, v, v, theta, v, delta, *[p_j, p_j, v_j, v_j] * neighbours], axis=-1)
        self._rngs = [np.random.default_rng([seed, _STREAM]) for seed in seeds]
        self._tick = 0
        self._truth: Past | None = None

    def __call__(self, cars: Cars, u_1: Array) -> tuple[Cars, Array]:
        """The cars as the ego sees them now, and what it is told of the leader's acceleration, m/s^2, (N, 2).

        Of the neighbours only position and velocity are the ego's view: their own actuation reads the rest.
        Call it once per control tick.
        """
        if self.exact:
            return cars, u_1
        noise, lost = self._draw()
        truth = self._flat(cars)
        if self._truth is None:
            self._truth, self._u_1 = (
                Past(now, s, self._step_s) for now, s in zip((truth, u_1), self._longest_s, strict=True)
            )
        else:
            self._truth.push(truth)
            self._u_1.push(u_1)
        seen = self._truth.ago(self._ages[0])
        seen = np.where(self._deviation == 0, seen, seen + noise)
        own, others = seen[:, :_OWN], seen[:, _OWN:].reshape(len(seen), self._neighbours, _OTHER)
        p_j, v_j = others[..., :2], others[..., 2:]
        if self._tracks:
            p_j, v_j = self._followed(p_j, v_j, lost)
        told = np.where(self._told[:, None], self._u_1.ago(self._ages[1]), 0.0)
        return self._but_for_truth(cars, self._cars(cars, own, p_j, v_j)), told

    def _flat(self, cars: Cars) -> Array:
        """What there is to measure, (N, K), with the neighbours' measured points in place."""
        n, point = len(cars.front_m), cars.front_m[:, 1:]
        if self._behind_m.any():
            behind, heading = self._behind_m[:, None, None], cars.heading_rad[:, 1:]
            ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            point = np.where(behind == 0, point, point - behind * ahead)
        if self._bias_m.any():
            bias = self._bias_m[:, None, None] * (1.0, 0.0)
            point = np.where(bias == 0, point, point + bias)
        own = [cars.front_m[:, 0], cars.velocity_mps[:, 0]]
        own += [a[:, :1] for a in (cars.heading_rad, cars.speed_mps, cars.steer_rad)]
        others = np.concatenate([point, cars.velocity_mps[:, 1:]], axis=-1).reshape(n, -1)
        return np.concatenate([*own, others], axis=1)

    def _draw(self) -> tuple[Array, Mask]:
        """This tick's noise, (N, K), and which neighbours are not seen, (N, C-1)."""
        k = self._tick % _DRAWN_TICKS
        if k == 0:
            numbers = _OWN + _OTHER * self._neighbours
            self._normal = np.stack([r.standard_normal((_DRAWN_TICKS, numbers)) for r in self._rngs])
            self._uniform = np.stack([r.random((_DRAWN_TICKS, self._neighbours)) for r in self._rngs])
        self._tick += 1
        return self._deviation * self._normal[:, k], self._uniform[:, k] < self._dropout[:, None]

    def _followed(self, p_j: Array, v_j: Array, lost: Mask) -> tuple[Array, Array]:
        """The neighbours as tracked: carried on while they are not seen, and differentiated if need be."""
        if self._tick == 1:
            self._last_p, self._last_v = p_j, v_j
            self._positions = Past(p_j, float(self._window_s.max()), self._step_s)
        else:
            gone = lost[..., None]
            carried = self._last_p + self._step_s * self._last_v
            p_j = np.where(gone, carried, p_j)
            self._positions.push(p_j)
            window = np.minimum(self._window_s, (self._tick - 1) * self._step_s)[:, None, None]
            moved = p_j - self._positions.ago(Age.of(window[:, 0, 0], self._step_s))
            differs = window > 0
            v_j = np.where(differs, moved / np.where(differs, window, 1.0), v_j)
            v_j = np.where(gone & ~differs, self._last_v, v_j)
            self._last_p, self._last_v = p_j, v_j
        return p_j, v_j

    def _but_for_truth(self, cars: Cars, seen: Cars) -> Cars:
        """The truth where nothing is wrong: even the sign of a zero would be lost in adding no noise."""
        if not self._told_truth.any():
            return seen

        def told(name: str) -> Array:
            truth = getattr(cars, name)
            at = self._told_truth.reshape(-1, *(1,) * (truth.ndim - 1))
            seen_or_true: Array = np.where(at, truth, getattr(seen, name))
            return seen_or_true

        names = ("front_m", "velocity_mps", "heading_rad", "speed_mps", "steer_rad")
        return replace(seen, **{name: told(name) for name in names})

    def _cars(self, cars: Cars, own: Array, p_j: Array, v_j: Array) -> Cars:
        def told(truth: Array, ego: Array) -> Array:
            seen = truth.copy()
            seen[:, 0] = ego
            return seen

        return replace(
            cars,
            front_m=np.concatenate([own[:, None, :2], p_j], axis=1),
            velocity_mps=np.concatenate([own[:, None, 2:4], v_j], axis=1),
            heading_rad=told(cars.heading_rad, own[:, 4]),
            speed_mps=told(cars.speed_mps, own[:, 5]),
            steer_rad=told(cars.steer_rad, own[:, 6]),
        )
