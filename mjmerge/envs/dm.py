"""One environment of dm_env: ``mjmerge.envs.dm.merge(scenario="paper")``."""

from __future__ import annotations

from typing import Any

import dm_env
import numpy as np
from dm_env.auto_reset_environment import AutoResetEnvironment
from dm_env.specs import BoundedArray

from mjmerge.envs.episodes import Episodes, alone
from mjmerge.envs.make import Cases, cases_of, draw, merging, opposing
from mjmerge.envs.parts import Part
from mjmerge.envs.task import Task
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array


class Environment(AutoResetEnvironment):  # type: ignore[misc]  # it has no types
    """A task as an environment of dm_env; each part of what is seen has its name.

    The discount is 0 where an episode is over because it failed, and 1 where its time is up. Its first
    episode is the run with the seed that it is made with, of :func:`mjmerge.simulate`; the seeds of the next
    ones follow from that.

    Attributes:
        last: what there is to tell of the last step, by name; of the last of an episode its verdict.
    """

    last: dict[str, Any]

    def __init__(self, task: Task, seed: int = 0, cases: Cases = (), threads: int = 0) -> None:
        """Args: the task; the first seed; mismatches that episodes draw from; threads for the physics."""
        super().__init__()
        self.task, self.cases = task, cases_of(task, cases)
        self._seed: int | None = seed
        self._rng = np.random.default_rng(seed)
        self._episodes = Episodes(task, 1, threads)

    @property
    def trace(self) -> Trace:
        """What happened in this episode so far, N = 1."""
        return self._episodes.trace(0)

    def _reset(self) -> dm_env.TimeStep:
        (one, case), self._seed = draw(self._rng, self.cases, self._seed), None
        seen, info = self._episodes.reset(np.zeros(1, dtype=np.intp), [one], [case])
        self.last = alone(info, 0)
        return dm_env.restart(self._named(seen[0]))

    def _step(self, action: Array) -> dm_env.TimeStep:
        out = self._episodes.step(np.asarray(action)[None])
        self.last = alone(out.info, 0) | out.ends.get(0, {})
        seen, reward = self._named(out.observation[0]), float(out.reward[0])
        if out.terminated[0]:
            return dm_env.termination(reward, seen)
        if out.truncated[0]:
            return dm_env.truncation(reward, seen)
        return dm_env.transition(reward, seen)

    def _named(self, seen: Array) -> dict[str, Array]:
        return {part.name: seen[at].reshape(part.shape) for part, at in self.task.where_seen.items()}

    def observation_spec(self) -> dict[str, BoundedArray]:
        """See :meth:`dm_env.Environment.observation_spec`."""
        return {part.name: _spec(part) for part in self.task.sees}

    def action_spec(self) -> BoundedArray:
        """See :meth:`dm_env.Environment.action_spec`; the parts one after the other, as in ``task.acts``."""
        most, name = self.task.most_asked, ", ".join(part.name for part in self.task.acts)
        return BoundedArray(most.shape, np.float64, -most, most, name)


def _spec(part: Part) -> BoundedArray:
    return BoundedArray(part.shape, np.float64, -part.most, part.most, part.name)


def merge(*, seed: int = 0, cases: Cases = (), threads: int = 0, **how: Any) -> Environment:
    """The merge; the rest as of :func:`~mjmerge.envs.make.merging`."""
    return Environment(merging(**how), seed, cases, threads)


def adversary(*, seed: int = 0, cases: Cases = (), threads: int = 0, **how: Any) -> Environment:
    """The mirror image; the rest as of :func:`~mjmerge.envs.make.opposing`."""
    return Environment(opposing(**how), seed, cases, threads)
