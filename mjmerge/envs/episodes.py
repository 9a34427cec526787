"""N episodes of a task as arrays: what every kind of environment is made of.

Episodes that begin together are one batch, a :class:`~mjmerge.envs.stepper.Stepper`, and stay one until all
of them are over. One that begins anew meanwhile is in another batch, with whichever others begin then.

A step records the state that it begins in. So an episode has as many steps as its trace has rows, and is over
with the step that began in an unsafe state, after which it could not go on, or that was the last of the
scenario's duration. What is seen after that last step is the truth, and not what would be sensed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmerge.envs.parts import asked
from mjmerge.envs.stepper import Stepper
from mjmerge.envs.task import Score, State, Task, only
from mjmerge.errors import MjmergeError
from mjmerge.law import Sensed
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.simulation.loop import Turn
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array, Mask
from mjmerge.verdict.hypotheses import asked as hypotheses
from mjmerge.verdict.judge import judge

Ids = NDArray[np.intp]
"""Which episodes, in increasing order, (M,)."""


_KEPT = ("observation", "terminated", "truncated")
"""What one that waits still shows: it is not handed out itself."""


@dataclass
class _Batch:
    """Episodes that began together.

    Attributes:
        members: which of all they are, (M,).
        stepper: runs them.
        turn: where they are.
        score: their rewards.
        live: which of them go on, and have not begun anew in another batch, (M,).
    """

    members: Ids
    stepper: Stepper
    turn: Turn
    score: Score
    live: Mask


@dataclass(frozen=True)
class Outcome:
    """What came of a step in N episodes.

    Attributes:
        observation: what each agent sees, (N, K).
        reward: of each, (N,); 0 of one that waits.
        terminated: whether it is over because it failed, or came to the end of its task, (N,).
        truncated: whether it is over because its time is up, (N,).
        info: what else there is to tell, each (N, ...).
        ends: what there is to tell of those that are over with this step, by which they are.
    """

    observation: Array
    reward: Array
    terminated: Mask
    truncated: Mask
    info: Mapping[str, Array | Mask]
    ends: Mapping[int, dict[str, Any]]


class Episodes:
    """N episodes of a task; one that is over waits until it begins anew."""

    def __init__(self, task: Task, runs: int, threads: int = 0) -> None:
        """Args: the task; how many episodes there are at a time, N; threads for the physics.

        Raises:
            MjmergeError: as of :class:`~mjmerge.envs.stepper.Stepper`.
        """
        self.task, self.runs, self._threads = task, runs, threads
        self._of: list[_Batch | None] = [None] * runs
        self._batches: list[_Batch] = []
        self._stepper()
        seen, waits = np.zeros((runs, len(task.most_seen))), np.ones(runs, dtype=bool)
        self._last = Outcome(seen, np.zeros(runs), ~waits, waits, {}, {})

    def _stepper(self) -> Stepper:
        task = self.task
        return Stepper(task.scenario, task.plant, drives=task.drives, threads=self._threads)

    def reset(
        self, which: Ids, seeds: Sequence[int], cases: Sequence[Mismatch]
    ) -> tuple[Array, dict[str, Array | Mask]]:
        """Begins some of them anew, as one batch.

        Args:
            which: these, M of them.
            seeds: of each.
            cases: mismatch of each.

        Returns:
            What every agent sees now, (N, K), and what there is to tell of these, each (M, ...).
        """
        stepper = self._stepper()
        turn = stepper.reset(seeds, cases)
        state = State.of(turn, stepper)
        score = self.task.begin(state)
        for batch in self._batches:
            batch.live &= ~np.isin(batch.members, which)
        new = _Batch(which, stepper, turn, score, np.ones(len(which), dtype=bool))
        self._batches = [*(batch for batch in self._batches if batch.live.any()), new]
        for i in which.tolist():
            self._of[i] = new
        last = self._last
        seen, terminated, truncated = (getattr(last, name).copy() for name in _KEPT)
        seen[which], terminated[which], truncated[which] = self.task.observe(turn), False, False
        self._last = replace(last, observation=seen, terminated=terminated, truncated=truncated)
        return seen.copy(), _info(state, score)

    @property
    def over(self) -> Mask:
        """Which of them wait to begin anew, (N,)."""
        over: Mask = self._last.terminated | self._last.truncated
        return over

    def trace(self, which: int) -> Trace:
        """What happened so far in one of them, N = 1; what is yet to come is NaN.

        Raises:
            MjmergeError: it has never begun.
        """
        batch = self._of[which]
        if batch is None:
            raise MjmergeError("no episode has begun: reset comes first")
        run = int(np.searchsorted(batch.members, which))
        return batch.stepper.trace.alone(run, batch.stepper.scenario)

    @np.errstate(over="ignore", invalid="ignore")  # what stopped may hold anything, unseen
    def step(self, actions: object) -> Outcome:
        """One control step of all that are not over.

        Args:
            actions: of each agent, (N, A); nothing is done with that of one that waits.

        Raises:
            MjmergeError: an action is none.
        """
        given, last = asked(self.task.acts, self.task.most_asked, actions, self.runs), self._last
        found: dict[str, Any] = {name: getattr(last, name).copy() for name in _KEPT}
        found["reward"] = np.zeros(self.runs)
        ends: dict[int, dict[str, Any]] = {}
        for batch in self._batches:
            made, mine = self._advance(batch, given[batch.members]), batch.members[batch.live]
            everyone = len(mine) == self.runs
            for name, values in made.items():
                if everyone:
                    found[name] = values
                    continue
                into = found.setdefault(name, np.zeros((self.runs, *values.shape[1:]), values.dtype))
                into[mine] = values[batch.live]
            over = batch.live & np.logical_or(made["terminated"], made["truncated"])
            if over.any():
                ends |= self._ends(batch, np.flatnonzero(over))
                batch.live &= ~over
        self._batches = [batch for batch in self._batches if batch.live.any()]
        own = {name: found.pop(name) for name in ("reward", *_KEPT)}
        self._last = Outcome(**own, info=found, ends=ends)
        return replace(self._last, **{n: getattr(self._last, n).copy() for n in _KEPT})

    def _advance(self, batch: _Batch, given: Array) -> dict[str, Array | Mask]:
        """One control step of a batch: what came of it, each (M, ...)."""
        task, turn, stepper = self.task, batch.turn, batch.stepper
        state, ran = State.of(turn, stepper), turn.running.copy()
        after = stepper.step(task.command(turn, given))
        reward = batch.score(state, stepper)
        stopped = ran & ~turn.running
        failed = stopped | state.unsafe
        if failed.any():
            reward = reward + task.failed * stopped
            turn.running[state.unsafe] = False
        if after is None:  # nothing is sensed any more
            after = _beyond(turn, stepper)
        batch.turn = after
        over = np.full(len(ran), stepper.over)
        return {
            "observation": task.observe(after),
            "reward": reward,
            "terminated": failed,
            "truncated": over & ~failed,
            **_info(state, batch.score),
        }

    def _ends(self, batch: _Batch, over: Ids) -> dict[int, dict[str, Any]]:
        """What there is to tell of episodes of a batch that are over, by which they are."""
        trace = self.task.as_judged(only(batch.stepper.trace, over))
        names, found = hypotheses(trace), {}
        verdicts = judge(trace, np.full(trace.least_m.shape, np.nan))  # which guard there was, nobody knows
        for run, verdict in zip(batch.members[over].tolist(), verdicts, strict=True):
            first = {breach.hypothesis: breach.time_s for breach in verdict.breaches}
            found[run] = {
                "verdict": verdict.verdict,
                "reason": verdict.reason,
                "broken_at_s": {name: first.get(name, inf) for name in names},
            }
        return found


def _info(state: State, score: Score) -> dict[str, Array | Mask]:
    """What there is to tell of every tick."""
    time_s = np.full(len(state.distance_m), state.time_s)
    return {"time_s": time_s, "distance_m": state.distance_m, **score.info()}


def alone(info: Mapping[str, Array | Mask], which: int) -> dict[str, Any]:
    """What there is to tell of one of them: numbers as such, and no views.

    Args:
        info: of all, each (N, ...).
        which: this one.
    """
    rows = {name: values[which] for name, values in info.items()}
    return {name: row.copy() if row.ndim else row.item() for name, row in rows.items()}


def _beyond(turn: Turn, stepper: Stepper) -> Turn:
    """The turn after the last one: where the cars are, as it truly is."""
    cars = turn.plant.observe()
    if turn.sensed is None:
        return turn._replace(cars=cars)
    end = None if stepper.ramp is None else stepper.ramp.obstacle
    return turn._replace(cars=cars, sensed=Sensed.of(cars, turn.sensed.u_1, end), ahead=cars)
