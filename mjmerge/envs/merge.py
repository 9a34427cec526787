"""The merge: an agent drives the ego in the law's place, and sees what the law sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import pi
from typing import Literal

import numpy as np

from mjmerge.config.acts import WHEELS
from mjmerge.envs.parts import FAR_M, FAST_MPS, Part
from mjmerge.envs.stepper import Stepper
from mjmerge.envs.task import Score, State, Task
from mjmerge.errors import MjmergeError, UnknownNameError
from mjmerge.law import Decision, Law, Memory, Sensed
from mjmerge.scenario.cars import believed_sheets
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import Turn
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array, Cars, Mask, limit, norm
from mjmerge.vehicle.bicycle import front_acceleration
from mjmerge.verdict.metrics import MERGED_M

ACTIONS = ("acceleration", "steering")
"""What an agent gives: u of its front axle; or acceleration along the car and a steering angle."""
MOST_MPS2 = 10.0
"""Hardest acceleration that can be asked for, m/s^2: all that a dry road gives."""
FAILED = -10.0
"""Reward of a failure."""
LOST = 5.0
"""As many times its first distance from the gap is as far as it makes a difference."""


class Agent(Law):
    """What an agent's episode is judged as: a law that nobody knows; it has no hypotheses of its own."""

    kind: Literal["agent"] = "agent"

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """Nobody knows.

        Raises:
            MjmergeError: always.
        """
        del seen, memory, step_s
        raise MjmergeError("what an agent decides is not known: it drove, and is gone")


class Merge(Task):
    """Drives the ego into the gap between the law's leader and follower, and keeps clear of everybody.

    The reward of a tick is h [in the gap] + (progress), in a run that is over with :data:`FAILED` where it
    fails. In the gap is within :data:`~mjmerge.verdict.metrics.MERGED_M` of the leader across the road, and
    between leader and follower along it: so whoever is there for a second has 1 for it. Progress is the
    change of -|p - m|/L, m being the middle between the two and L the distance from it at the start, and
    stops to count at :data:`LOST` L. Going there pays 1 in all, once, and going round in circles nothing.
    """

    failed = FAILED

    def __init__(self, scenario: Scenario, plant: str, action: str = "acceleration") -> None:
        """Args: what to run; what moves the cars; one of ``ACTIONS``.

        Raises:
            MjmergeError: there is no such action, or the plant's cars have no wheels to steer.
        """
        super().__init__(scenario, plant)
        if action not in ACTIONS:
            raise UnknownNameError("action", action, ACTIONS)
        if action == "steering" and plant not in WHEELS:
            raise MjmergeError(f"{plant} has no wheels to steer: the action must be 'acceleration'")
        self.action, self._sheet = action, believed_sheets(scenario)[0]
        self.sees = tuple(_sees(scenario, steers=plant in WHEELS))
        self.acts = _acts(action, self._sheet.steer_limit_rad)

    def command(self, turn: Turn, given: Array) -> Array:
        """See :meth:`Task.command`; a steering angle is gone to as fast as the car's steering is."""
        if self.action == "acceleration":
            return given
        sheet, car, h = self._sheet, _ahead(turn), self.scenario.control_step_s
        turns = limit((given[:, 1] - car.steer_command_rad[:, 0]) / h, sheet.steer_rate_limit_radps)
        theta, v, delta = (a[:, 0] for a in (car.heading_rad, car.speed_mps, car.steer_rad))
        wheelbase_m, eps_v_mps = np.array(sheet.wheelbase_m), self.scenario.law.eps_v_mps
        return front_acceleration(given[:, 0], turns, theta, v, delta, wheelbase_m, eps_v_mps)

    def begin(self, state: State) -> Score:
        """See :meth:`Task.begin`."""
        return _Score(state.front_m, self.scenario)

    def as_judged(self, trace: Trace) -> Trace:
        """See :meth:`Task.as_judged`: the law that looked on has no part in it."""
        law = self.scenario.law
        common = ("leader", "follower", "choice", "r_m", "eps_v_mps")
        agent = Agent().model_copy(update={name: getattr(law, name) for name in common})
        return replace(trace, scenario=trace.scenario.model_copy(update={"law": agent}))


class _Score(Score):
    """See :class:`Merge`."""

    def __init__(self, front_m: Array, scenario: Scenario) -> None:
        self._two, self._h = (1 + scenario.law.j_1, 1 + scenario.law.j_2), scenario.control_step_s
        self._first_m = np.maximum(self._off_m(front_m), 1e-9)
        self._near = np.full(len(front_m), -1.0)
        self._there: Mask = np.zeros(len(front_m), dtype=bool)

    def __call__(self, state: State, stepper: Stepper) -> Array:
        """See :meth:`Score.__call__`."""
        del stepper
        p, one, two = (state.front_m[:, car] for car in (0, *self._two))
        x, y = p[:, 0], p[:, 1]
        self._there = (np.abs(y - one[:, 1]) < MERGED_M) & (x < one[:, 0]) & (x > two[:, 0])
        near = -np.minimum(self._off_m(state.front_m) / self._first_m, LOST)
        progress, self._near = near - self._near, near
        reward: Array = progress + self._h * self._there + FAILED * state.unsafe
        return reward

    def info(self) -> dict[str, Array | Mask]:
        """See :meth:`Score.info`."""
        return {"in_gap": self._there}

    def _off_m(self, front_m: Array) -> Array:
        """How far the ego is from the middle of the gap, m, (N,)."""
        one, two = self._two
        return norm(front_m[:, 0] - (front_m[:, one] + front_m[:, two]) / 2)


def _acts(action: str, steer_limit_rad: float) -> tuple[Part, ...]:
    if action == "acceleration":
        doc = "acceleration u of the front axle, along the road and to its left"
        return (Part("u_mps2", "m/s^2", doc, (2,), MOST_MPS2),)
    return (
        Part("a_mps2", "m/s^2", "acceleration along the car", (1,), MOST_MPS2),
        Part("steer_rad", "rad", "steering angle, to the left", (1,), steer_limit_rad),
    )


def _sees(scenario: Scenario, *, steers: bool) -> list[Part]:
    """What the law sees, and of a car with wheels what the inverse sees."""
    end = scenario.road.ends_m is not None and scenario.road.told == "obstacle"
    others = len(scenario.roster.neighbours) + end
    last = "; last the nearest point of the lane's end" if end else ""
    sees = [
        Part(
            "neighbour_offset_m", "m", f"front axle of each neighbour, from the ego's{last}", (others, 2),
            FAR_M, _of(lambda law: law.p_j - law.p[:, None]),
        ),
        Part(
            "neighbour_velocity_mps", "m/s", "its velocity less the ego's", (others, 2), FAST_MPS,
            _of(lambda law: law.v_j - law.v[:, None]),
        ),
        Part("velocity_mps", "m/s", "of the ego's front axle", (2,), FAST_MPS, _of(lambda law: law.v)),
        Part(
            "leader_acceleration_mps2", "m/s^2", "what the leader says that it intends", (2,), FAST_MPS,
            _of(lambda law: law.u_1),
        ),
    ]  # fmt: skip
    if steers:
        sees += [
            Part("heading", "1", "cosine and sine of the ego's heading off the road", (2,), 1.0, _heading),
            Part("steer_rad", "rad", "its steering angle", (1,), pi / 2, lambda t: _ahead(t).steer_rad[:, 0]),
        ]
    return sees


def _of(read: Callable[[Sensed], Array]) -> Callable[[Turn], Array]:
    def found(turn: Turn) -> Array:
        assert turn.sensed is not None, "it is the ego's turn"
        return read(turn.sensed)

    return found


def _ahead(turn: Turn) -> Cars:
    assert turn.ahead is not None, "it is the ego's turn"
    return turn.ahead


def _heading(turn: Turn) -> Array:
    theta = _ahead(turn).heading_rad[:, 0]
    return np.stack([np.cos(theta), np.sin(theta)], axis=-1)
