"""How much of a sweep is the engine: ``python tests/benchmarks/sweep.py [SECONDS [REPEATS]]``, no test.

A sweep of 256 runs that differ in mismatch, with law, verdicts, rows and files, on 2 processes, beside bare
``mujoco.batch`` stepping of the same model on 2 threads and a Python loop over ``mj_step``; and with larger
steps where they are enough. What one process simulates at once is to be 0.96 inside the engine.
``highway.py`` has the same sweep beside another simulator.

On a machine that does other things as well, look at the ratio of processor times.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import quiet
from loop import engine_clock
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from mjmerge.roster import roster
from mjmerge.sweep.campaign import plan
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.shards import dealt, measure, shards
from mjmerge.sweep.sweep import sweep
from mjmerge.world.compose import build
from mjmerge.world.model import World

CARS = roster().cars

RUNS, PROCESSES = 256, 2
DURATION_S = float(sys.argv[1]) if len(sys.argv) > 1 else 12.0
REPEATS = int(sys.argv[2]) if len(sys.argv) > 2 else 3
FIDELITY = {"step_s": 0.002, "within_r": 0.01}


def campaign(fidelity: dict[str, float] | None = None) -> Plan:
    """256 runs of ``charge``, every one with another mismatch; maybe in larger steps first."""
    axes = {
        "mismatch.friction": {"uniform": [0.3, 1.0]},
        "mismatch.load_kg": {"uniform": [0.0, 1.5]},
        "mismatch.command_delay_s": {"uniform": [0.0, 0.1]},
        "mismatch.neighbour_position_noise_m": {"uniform": [0.0, 0.05]},
    }
    block = {
        "scenarios": ["charge"],
        "set": {"duration_s": DURATION_S},
        "random": {"draws": RUNS, "axes": axes},
    }
    return plan({"blocks": [block], **({"fidelity": fidelity} if fidelity else {})})


def rolling(world: World, planned: Plan, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """The cars as they start, (runs, nq) and (runs, nv)."""
    cars = [getattr(planned.cases[0].batch.scenario.initial, car) for car in CARS]
    still = np.zeros((1, len(cars)))
    qpos = world.qpos(np.array([[c.front_m for c in cars]]), still, np.stack([still, still], -1), still)
    qvel = world.qvel(np.array([[c.speed_mps for c in cars]]))
    return np.repeat(qpos, runs, axis=0), np.repeat(qvel, runs, axis=0)


def swept(planned: Plan) -> None:
    with tempfile.TemporaryDirectory() as folder:
        sweep(planned, Path(folder) / "out", processes=PROCESSES)


def bare(planned: Plan, world: World) -> None:
    """As many steps of as many worlds, and nothing else."""
    scenario = planned.cases[0].batch.scenario
    batch = Batch(world.model, nsim=RUNS, nthread=PROCESSES)
    batch.qpos, batch.qvel = rolling(world, planned, RUNS)
    for _ in range(scenario.ticks):
        batch.step(nstep=scenario.substeps)


def inside(planned: Plan) -> float:
    """Share of the engine in the time of what one of the processes simulates at once, up to its rows."""
    shard, *others = dealt(shards(planned), PROCESSES)[0]
    cases = [case for one in (shard, *others) for case in one.cases]
    with engine_clock() as spent:
        began = time.perf_counter()
        measure(cases, 1)
        total = time.perf_counter() - began
    return spent[0] / total


def plain(planned: Plan, world: World) -> None:
    """One world, a call of ``mj_step`` for each step."""
    data = mujoco.MjData(world.model)
    (data.qpos,), (data.qvel,) = rolling(world, planned, 1)
    for _ in range(planned.cases[0].batch.scenario.ticks * planned.cases[0].batch.scenario.substeps):
        mujoco.mj_step(world.model, data)


def timed(work: Callable[[], None]) -> tuple[float, float]:
    """Wall and processor time, children's included, s."""
    wall, before = time.perf_counter(), os.times()
    work()
    after = os.times()
    return time.perf_counter() - wall, sum(after[:4]) - sum(before[:4])


def told(values: list[float], form: str = ".3f") -> list[str]:
    """Median, least and most."""
    return [format(f(values), form) for f in (statistics.median, min, max)]


def main() -> None:
    """Prints the table."""
    quiet.look()
    planned, larger = campaign(), campaign(FIDELITY)
    scenario = planned.cases[0].batch.scenario
    world = build(scenario, [case.mismatch for case in planned.cases])
    measure(planned.cases[:1], 1)  # what is imported and composed once
    times = {"sweep": [], "larger": [], "bare": [], "plain": []}
    shares = []
    for _ in range(REPEATS):
        shares.append(inside(planned))
        times["sweep"].append(timed(lambda: swept(planned)))
        times["larger"].append(timed(lambda: swept(larger)))
        times["bare"].append(timed(lambda: bare(planned, world)))
        times["plain"].append(timed(lambda: plain(planned, world)))
    simulated = {**dict.fromkeys(("sweep", "larger", "bare"), RUNS * DURATION_S), "plain": DURATION_S}
    table = Table("what", "simulated s per s", "median", "min", "max", "target")
    names = {
        "sweep": f"sweep of {RUNS} runs, {PROCESSES} processes",
        "larger": "the same with fidelity",
        "bare": f"bare mujoco.batch, {PROCESSES} threads",
        "plain": "plain mj_step loop in Python, 1 run",
    }
    for key, name in names.items():
        table.add_row(name, f"{simulated[key] / statistics.median(w for w, _ in times[key]):.1f}")
    for i, name in enumerate(("wall time", "processor time")):
        for what, over, target in (("bare", "sweep", ""), ("sweep", "larger", ">= 1.8 of the former sweep")):
            ratios = [a[i] / b[i] for a, b in zip(times[what], times[over], strict=True)]
            table.add_row(
                f"{what} / {over}, {name}".replace("larger", "with fidelity"), "", *told(ratios), target
            )
    table.add_row("inside the engine", "", *told(shares), ">= 0.96")
    for key in ("sweep", "larger"):
        walls = [wall for wall, _ in times[key]]
        table.add_row(f"{names[key]}, s", "", *told(walls, ".1f"), "")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
