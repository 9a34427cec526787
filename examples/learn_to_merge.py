"""A linear policy learns to merge by CMA-ES, against chance: ``python examples/learn_to_merge.py``.

It takes 400 generations, some two minutes, or as many as are named. Each is one batch: as many episodes as
there are candidates, from start to end. Needs the extras envs and search.
"""

from __future__ import annotations

import sys

import cma
import gymnasium
import numpy as np

import mjmerge.envs  # noqa: F401  (makes them known to gymnasium)

CANDIDATES = 32
SETTINGS = ["duration_s=20", "control_step_s=0.05"]  # short and coarse: this is about learning


def scores(envs, act, seed):
    """What each of N candidates earns in an episode, (N,)."""
    seen, _ = envs.reset(seed=seed)
    earned, over = np.zeros(envs.num_envs), np.zeros(envs.num_envs, dtype=bool)
    while not over.all():
        seen, reward, failed, late, _ = envs.step(act(seen))
        earned, over = earned + reward, failed | late
    return earned


def linear(weights):
    """Policies from what each sees, (N, K), to what it does, (N, A); of weights (N, A (K + 1))."""
    weights = np.asarray(weights).reshape(CANDIDATES, 2, -1)
    return lambda seen: (weights[..., :-1] @ seen[..., None])[..., 0] + weights[..., -1]


def main() -> None:
    """Prints what chance and what the learned policy earn: a second in the gap is 1."""
    generations = int(sys.argv[1] if len(sys.argv) > 1 else 400)
    envs = gymnasium.make_vec(
        "mjmerge/Merge-v0", num_envs=CANDIDATES, plant="double_integrator", settings=SETTINGS,
        autoreset_mode="Disabled",  # who is done waits for the others
    )  # fmt: skip
    envs.action_space.seed(0)
    chance = scores(envs, lambda _: envs.action_space.sample(), seed=0)
    print(f"chance: {chance.mean():.2f}")
    numbers = envs.single_action_space.shape[0] * (envs.single_observation_space.shape[0] + 1)
    search = cma.CMAEvolutionStrategy(
        np.zeros(numbers), 0.3, {"popsize": CANDIDATES, "seed": 1, "verbose": -9}
    )
    while search.countiter < generations and not search.stop():
        candidates = search.ask()
        search.tell(candidates, -scores(envs, linear(candidates), seed=0))
    best = np.tile(search.result.xfavorite, (CANDIDATES, 1))
    print(f"learned: {scores(envs, linear(best), seed=0)[0]:.2f}, in {search.countiter} generations")


if __name__ == "__main__":
    main()
