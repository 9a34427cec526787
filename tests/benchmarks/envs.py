"""What an environment costs beside the loop: ``python tests/benchmarks/envs.py``. Ratios, no test.

Steps per second of 64 environments on one batch, over those of ``simulate`` with 64 runs, on each plant; at
least 0.9. Both in one process, one after the other, with the ego driven by the same commands. Steps alone are
timed, not what begins and ends an episode: that is in the second ratio, of whole episodes.
"""

from __future__ import annotations

import statistics
import time

import gymnasium
import numpy as np
import quiet
from rich.console import Console
from rich.table import Table

import mjmerge
import mjmerge.envs

ENVIRONMENTS = 64
REPEATS = 5
DURATIONS_S = {"double_integrator": 10, "bicycle": 10, "mujoco": 1}


def loop_s(scenario, plant: str, runs: int) -> tuple[float, np.ndarray]:
    """Time of a tick of the loop, s, and what the law asked for, (N, T, 2)."""
    began = time.perf_counter()
    trace = mjmerge.simulate(scenario, plant, runs=runs)
    return (time.perf_counter() - began) / scenario.ticks, trace.u_mps2[:, :, 0]


def steps_s(envs, u: np.ndarray) -> tuple[float, float]:
    """Time of a step of all environments, s: without what begins and ends an episode, and with it."""
    began = time.perf_counter()
    envs.reset(seed=0)
    ready = time.perf_counter()
    for k in range(u.shape[1] - 1):
        envs.step(u[:, k])
    stepped = time.perf_counter()
    _, _, _, truncated, _ = envs.step(u[:, -1])
    assert truncated.all()
    ended = time.perf_counter()
    return (stepped - ready) / (u.shape[1] - 1), (ended - began) / u.shape[1]


def main() -> None:
    """Prints the table."""
    quiet.look()
    table = Table("plant", "environments", "loop, us", "step, us", "loop / step", "whole episodes", "target")
    for plant, duration_s in DURATIONS_S.items():
        for runs in (1, ENVIRONMENTS):
            scenario = mjmerge.load("paper", [f"duration_s={duration_s}"])
            settings = [f"duration_s={duration_s}"]
            envs = gymnasium.make_vec("mjmerge/Merge-v0", num_envs=runs, plant=plant, settings=settings)
            _, u = loop_s(scenario, plant, runs)
            loops, steps, wholes = [], [], []
            for _ in range(REPEATS):
                loops.append(loop_s(scenario, plant, runs)[0])
                step, whole = steps_s(envs, u)
                steps.append(step)
                wholes.append(whole)
            ratios = [loop / step for loop, step in zip(loops, steps, strict=True)]
            whole = statistics.median(loop / one for loop, one in zip(loops, wholes, strict=True))
            table.add_row(
                plant,
                str(runs),
                f"{1e6 * min(loops):.0f}",
                f"{1e6 * min(steps):.0f}",
                f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})",
                f"{whole:.2f}",
                ">= 0.9" if runs == ENVIRONMENTS else "",
            )
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
