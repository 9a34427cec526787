"""Many environments of gymnasium on one batch: ``gymnasium.make_vec("mjmerge/Merge-v0", num_envs=64)``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mjmerge.config.bounds import MOST_RUNS, whole
from mjmerge.envs.episodes import Episodes, Ids, alone
from mjmerge.envs.make import Cases, cases_of, draw, merging, opposing
from mjmerge.envs.spaces import box
from mjmerge.envs.task import Task
from mjmerge.errors import MjmergeError, UnknownNameError
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array, Mask

# isort: split
from gymnasium.vector import AutoresetMode, VectorEnv  # after the room that says how it comes

_OWN = ("cases", "threads", "autoreset_mode")


class Vector(VectorEnv[Array, Array, Any]):  # type: ignore[misc]  # types are optional here
    """N episodes of a task at a time; number i is the environment alone with the seed ``seed + i``.

    Where one is over, it begins anew as the mode says: with the next step, which then does nothing else; in
    the same step, with what it ended with in ``final_obs`` and ``final_info``; or, disabled, when it is asked
    to by ``reset(options={"reset_mask": mask})``, and waits until then.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int = 1,
        cases: Cases = (),
        threads: int = 0,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Args: the task; how many; mismatches that episodes draw from; threads; when they begin anew."""
        modes = {mode.value: mode for mode in AutoresetMode}
        named = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        if named not in modes:
            raise UnknownNameError("autoreset mode", str(named), modes)
        self.mode = modes[named]
        self.metadata = {"render_modes": [], "autoreset_mode": self.mode}
        self.task, self.cases = task, cases_of(task, cases)
        self.num_envs = whole("num_envs", num_envs, 1, MOST_RUNS)
        self.single_observation_space, self.single_action_space = box(task.sees), box(task.acts)
        self.observation_space, self.action_space = box(task.sees, num_envs), box(task.acts, num_envs)
        self._episodes = Episodes(task, num_envs, threads)
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]

    def trace(self, which: int) -> Trace:
        """What happened so far in the episode of one of them, N = 1."""
        return self._episodes.trace(which)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """See :meth:`gymnasium.vector.VectorEnv.reset`.

        Args:
            seed: environment i has the seed ``seed + i``; or one for each, (N,).
            options: ``reset_mask``, (N,) of bool: only these begin anew.

        Raises:
            MjmergeError: the options are none, or a seed is none.
        """
        which = np.flatnonzero(self._mask(options or {}))
        if seed is None:
            seeds: list[int | None] = [None] * self.num_envs
        elif isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
            seeds = [int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise MjmergeError(f"there are {self.num_envs} environments, and {len(seeds)} seeds")
        for i in which.tolist():
            if seeds[i] is not None:
                self._rngs[i] = np.random.default_rng(seeds[i])
        seen, told = self._begin(which, [seeds[i] for i in which.tolist()])
        info: dict[str, Any] = {}
        self._tell(info, told, which)
        return seen, info

    def _mask(self, options: dict[str, Any]) -> Mask:
        unknown = [name for name in options if name != "reset_mask"]
        if unknown:
            raise MjmergeError(f"reset takes the option reset_mask, got {', '.join(map(str, unknown))}")
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, dtype=bool)))
        if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
            raise MjmergeError(f"reset_mask must be {self.num_envs} times true or false, and once true")
        return mask

    def _begin(self, which: Ids, seeds: Sequence[int | None]) -> tuple[Array, dict[str, Array | Mask]]:
        """Some of them anew: what all see, and what there is to tell of these."""
        rngs = [self._rngs[i] for i in which.tolist()]
        drawn = [draw(rng, self.cases, seed) for rng, seed in zip(rngs, seeds, strict=True)]
        return self._episodes.reset(which, [one for one, _ in drawn], [case for _, case in drawn])

    def _tell(self, info: dict[str, Any], told: Mapping[str, Array | Mask], which: Ids) -> None:
        """Puts what there is to tell of some of them, (M, ...) each, where all have a row, (N, ...)."""
        if len(which) == self.num_envs:
            masks = {f"_{name}": np.ones(self.num_envs, dtype=bool) for name in told}
            info.update(told, **masks)
            return
        for name, values in told.items():
            whole = info.setdefault(name, np.zeros((self.num_envs, *values.shape[1:]), values.dtype))
            whole[which] = values
            info.setdefault(f"_{name}", np.zeros(self.num_envs, dtype=bool))[which] = True

    def step(self, actions: Array) -> tuple[Array, Array, Mask, Mask, dict[str, Any]]:
        """See :meth:`gymnasium.vector.VectorEnv.step`.

        Raises:
            MjmergeError: an action is none.
        """
        before = self._episodes.over
        out = self._episodes.step(actions)
        seen, terminated, truncated = out.observation, out.terminated, out.truncated
        info: dict[str, Any] = {}
        went = np.flatnonzero(~before)
        rows = slice(None) if len(went) == self.num_envs else went
        self._tell(info, {name: values[rows] for name, values in out.info.items()}, went)
        new = np.flatnonzero(before) if self.mode is AutoresetMode.NEXT_STEP else np.array([], dtype=np.intp)
        for i, end in out.ends.items():
            if self.mode is AutoresetMode.SAME_STEP:
                last = alone(out.info, i) | end
                info = self._add_info(info, {"final_obs": seen[i], "final_info": last}, i)
            else:
                info = self._add_info(info, end, i)
        if self.mode is AutoresetMode.SAME_STEP:
            new = np.array(sorted(out.ends), dtype=np.intp)
        elif new.size:
            terminated[new] = truncated[new] = False
        if new.size:
            seen, told = self._begin(new, [None] * len(new))
            self._tell(info, told, new)
        return seen, out.reward, terminated, truncated, info


def merge(num_envs: int = 1, **how: Any) -> Vector:
    """``mjmerge/Merge-v0``; ``how`` as of :class:`Vector` and :func:`~mjmerge.envs.make.merging`."""
    own = {name: how.pop(name) for name in _OWN if name in how}
    return Vector(merging(**how), num_envs, **own)


def adversary(num_envs: int = 1, **how: Any) -> Vector:
    """``mjmerge/Adversary-v0``; ``how`` as of :class:`Vector` and :func:`~mjmerge.envs.make.opposing`."""
    own = {name: how.pop(name) for name in _OWN if name in how}
    return Vector(opposing(**how), num_envs, **own)
