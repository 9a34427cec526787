"""How much of the loop is the engine: ``python tests/benchmarks/loop.py``. Ratios in one process, no test.

- one run: share of the loop's time spent outside ``mujoco.batch``; at most 0.30.
- 256 runs on 2 threads: bare stepping of the same model from the same state, over the loop; at least 0.85.
"""

from __future__ import annotations

import statistics
import time
from contextlib import contextmanager

import numpy as np
import quiet
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

import mjmerge
from mjmerge.roster import roster
from mjmerge.world.compose import build

CARS = roster().cars

REPEATS = 5


@contextmanager
def engine_clock():
    """Adds up the time inside ``Batch.step``."""
    spent = [0.0]
    step = Batch.step

    def timed(self, *args, **kwargs):
        began = time.perf_counter()
        step(self, *args, **kwargs)
        spent[0] += time.perf_counter() - began

    Batch.step = timed
    try:
        yield spent
    finally:
        Batch.step = step


def outside_engine(scenario, world) -> float:
    """Share of one run's loop that is not the engine."""
    with engine_clock() as spent:
        began = time.perf_counter()
        mjmerge.simulate(scenario, "mujoco", world=world, threads=1)
        total = time.perf_counter() - began
    return 1 - spent[0] / total


def loop_s(scenario, world, runs: int, threads: int) -> float:
    """Time of the whole loop, s."""
    began = time.perf_counter()
    mjmerge.simulate(scenario, "mujoco", world=world, runs=runs, threads=threads)
    return time.perf_counter() - began


def bare_s(scenario, world, runs: int, threads: int) -> float:
    """Time of stepping as many cars as often, rolling at the same speed, s."""
    cars = [getattr(scenario.initial, car) for car in CARS]
    still = np.zeros((1, len(cars)))
    qpos = world.qpos(np.array([[c.front_m for c in cars]]), still, np.stack([still, still], -1), still)
    began = time.perf_counter()
    batch = Batch(world.model, nsim=runs, nthread=threads)
    batch.qpos, batch.qvel = qpos, world.qvel(np.array([[c.speed_mps for c in cars]]))
    for _ in range(scenario.ticks):
        batch.step(nstep=scenario.substeps)
    return time.perf_counter() - began


def main() -> None:
    """Prints the table."""
    quiet.look()
    one = mjmerge.load("paper", ["duration_s=10"])
    many = mjmerge.load("paper", ["duration_s=2"])
    world = build(one)
    shares, ratios = [], []
    for _ in range(REPEATS):
        shares.append(outside_engine(one, world))
        ratios.append(bare_s(many, world, 256, 2) / loop_s(many, world, 256, 2))
    table = Table("what", "median", "min", "max", "target")
    for what, values, target in (
        ("1 run: share outside the engine", shares, "<= 0.30"),
        ("256 runs, 2 threads: bare stepping / loop", ratios, ">= 0.85"),
    ):
        table.add_row(what, *(f"{f(values):.3f}" for f in (statistics.median, min, max)), target)
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
