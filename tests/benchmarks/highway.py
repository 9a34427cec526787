"""Simulated time beside highway-env's: ``python tests/benchmarks/highway.py [SECONDS [REPEATS]]``, no test.

Needs ``pip install highway-env==1.12.1``, best in a virtual environment of its own. Its merge-v0 is rolled
out on two processes, without rendering: five cars, rectangles on a kinematic bicycle, at its own 15 Hz. With
a decision once a second, as it comes, the ego idles, or acts at random; with one at every step it idles.

Beside it stands the sweep of ``sweep.py`` (256 runs of three cars on MuJoCo, each with another mismatch, in
steps of 1 ms and a decision every 10 ms, with verdicts, rows and files), on two processes as well, with and
without larger steps first. With them it is to reach twice the simulated seconds per second.

Starting processes and importing counts for the sweep, and not for highway-env.
"""

from __future__ import annotations

import statistics
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context

import quiet
from rich.console import Console
from rich.table import Table
from sweep import DURATION_S, PROCESSES, REPEATS, RUNS, campaign, swept, timed

from mjmerge.sweep.plan import Plan

IDLE = 1
"""Its action that changes nothing."""
EGOS = {"idle": (True, 1), "at random": (False, 1), "idle, decisions at 15 Hz": (True, 15)}
"""Whether it idles, and its decisions per second."""
ROLLED_S = 300.0
"""Simulated time of each process, s."""


def rolled(idle: bool, decisions_hz: int, seed: int, least_s: float) -> tuple[float, float, float]:
    """Simulated, wall and processor time of one process, s."""
    import gymnasium
    import highway_env  # noqa: F401  # which makes its environments known

    gymnasium.logger.min_level = gymnasium.logger.ERROR  # that there is a merge-v1 is known
    env = gymnasium.make("merge-v0", disable_env_checker=True, config={"policy_frequency": decisions_hz})
    env.action_space.seed(seed)
    env.reset(seed=seed)
    simulated_s, wall_s, processor_s = 0.0, -time.perf_counter(), -time.process_time()
    while simulated_s < least_s:
        env.reset()
        over = False
        while not over:
            _, _, terminated, truncated, _ = env.step(IDLE if idle else env.action_space.sample())
            over = terminated or truncated
        simulated_s += env.unwrapped.time
    return simulated_s, wall_s + time.perf_counter(), processor_s + time.process_time()


def swept_rates(planned: Plan) -> tuple[float, float]:
    """Simulated time of a sweep over wall and over processor time."""
    wall_s, processor_s = timed(lambda: swept(planned))
    return RUNS * DURATION_S / wall_s, RUNS * DURATION_S / processor_s


def rolled_rates(
    pool: ProcessPoolExecutor, idle: bool, decisions_hz: int, least_s: float = ROLLED_S
) -> tuple[float, float]:
    """The same of merge-v0, on all processes at once."""
    each = [*pool.map(partial(rolled, idle, decisions_hz), range(PROCESSES), [least_s] * PROCESSES)]
    simulated_s, _, processor_s = (sum(column) for column in zip(*each, strict=True))
    return sum(simulated / wall for simulated, wall, _ in each), simulated_s / processor_s


def main() -> None:
    """Prints the table."""
    quiet.look()
    try:
        other = f"highway-env {version('highway-env')}"
    except PackageNotFoundError:
        raise SystemExit("highway-env is not installed: pip install highway-env==1.12.1") from None
    plain, larger = campaign(), campaign({"step_s": 0.002, "within_r": 0.01})
    found: dict[str, list[tuple[float, float]]] = {}
    with ProcessPoolExecutor(PROCESSES, get_context("spawn")) as pool:
        rolled_rates(pool, True, 1, 20.0)  # which imports
        for _ in range(REPEATS):
            found.setdefault("sweep", []).append(swept_rates(plain))
            found.setdefault("sweep, larger steps first", []).append(swept_rates(larger))
            for how, (idle, hz) in EGOS.items():
                found.setdefault(f"{other}, {how}", []).append(rolled_rates(pool, idle, hz))
    table = Table("on two processes", "simulated s per s", "min", "max", "per s of a processor")
    for name, rates in found.items():
        walls, processors = zip(*rates, strict=True)
        row = (f(walls) for f in (statistics.median, min, max))
        table.add_row(name, *(f"{rate:.1f}" for rate in (*row, statistics.median(processors))))
    console = Console(width=110)
    console.print(table)
    _, ours, *theirs = found
    for name in theirs:
        wall, processor = (
            [a[i] / b[i] for a, b in zip(found[ours], found[name], strict=True)] for i in (0, 1)
        )
        said = f"{statistics.median(wall):.2f} ({min(wall):.2f} to {max(wall):.2f})"
        by = f"{statistics.median(processor):.2f} by time of the processors"
        console.print(f"{ours} / {name}: {said}, {by}; target >= 2")


if __name__ == "__main__":
    main()
