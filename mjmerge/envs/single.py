"""One environment of gymnasium: ``mjmerge/Merge-v0`` and ``mjmerge/Adversary-v0``."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjmerge.envs.episodes import Episodes, alone
from mjmerge.envs.make import Cases, cases_of, draw, merging, opposing
from mjmerge.envs.spaces import box
from mjmerge.envs.task import Task
from mjmerge.errors import MjmergeError
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array

# isort: split
import gymnasium  # after the room that says how it comes


class Single(gymnasium.Env[Array, Array]):  # type: ignore[misc]  # its types are optional here
    """A task as an environment of gymnasium; what is seen and given is told in ``task.sees``, ``task.acts``.

    Its first episode after ``reset(seed=s)`` is the run with the seed s of :func:`mjmerge.simulate`; the next
    ones have seeds of their own that follow from s.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  (gymnasium's)

    def __init__(self, task: Task, cases: Cases = (), threads: int = 0) -> None:
        """Args: the task; mismatches that episodes draw from; threads for the physics."""
        self.task, self.cases = task, cases_of(task, cases)
        self._episodes = Episodes(task, 1, threads)
        self.observation_space, self.action_space = box(task.sees), box(task.acts)

    @property
    def trace(self) -> Trace:
        """What happened in this episode so far, N = 1."""
        return self._episodes.trace(0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """See :meth:`gymnasium.Env.reset`; there are no options.

        Raises:
            MjmergeError: the seed is none of a simulation.
        """
        super().reset(seed=seed)
        if options:
            raise MjmergeError(f"reset takes no options, got {', '.join(map(str, options))}")
        one, case = draw(self.np_random, self.cases, seed)
        seen, info = self._episodes.reset(np.zeros(1, dtype=np.intp), [one], [case])
        return seen[0], alone(info, 0)

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """See :meth:`gymnasium.Env.step`.

        Raises:
            MjmergeError: the action is none, or the episode is over.
        """
        if self._episodes.over[0]:
            raise MjmergeError("no episode goes on: reset comes first")
        out = self._episodes.step(np.asarray(action)[None])
        info = alone(out.info, 0) | out.ends.get(0, {})
        ended = bool(out.terminated[0]), bool(out.truncated[0])
        return out.observation[0], float(out.reward[0]), *ended, info


def merge(cases: Cases = (), threads: int = 0, **how: Any) -> Single:
    """``mjmerge/Merge-v0``; the rest as of :func:`~mjmerge.envs.make.merging`."""
    return Single(merging(**how), cases, threads)


def adversary(cases: Cases = (), threads: int = 0, **how: Any) -> Single:
    """``mjmerge/Adversary-v0``; the rest as of :func:`~mjmerge.envs.make.opposing`."""
    return Single(opposing(**how), cases, threads)
