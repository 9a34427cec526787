"""What recording costs: ``python tests/benchmarks/recording.py [SECONDS]``. A table, no test.

The ``paper`` scenario on MuJoCo's cars, after a shorter run that warms up. Time is what the run spends inside
its recorders. Sizes are carried on to ten minutes with the slope between two lengths; ``recording.py 600``
measures them, and the memory.

- at most 15 % of the run's time, and 50 us per tick;
- a file for ten minutes: at most 50 MB;
- memory of the process, all of it: at most 500 MB.
"""

from __future__ import annotations

import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

import mjmerge
from mjmerge.record import FORMATS, Header, Outcome, Recording, versions
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.load import dump
from mjmerge.simulation.log import TickBlock
from mjmerge.verdict.judge import judge
from mjmerge.world.compose import build

REPEATS = 3
LONG_S = 600.0


@dataclass
class Clocks:
    """Time that a run spends on its recordings, s: by the wall clock, and of the processor (this thread)."""

    wall_s: float = 0.0
    own_s: float = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        wall, own = time.perf_counter(), time.thread_time()
        try:
            yield
        finally:
            self.wall_s += time.perf_counter() - wall
            self.own_s += time.thread_time() - own


@dataclass
class Timed:
    """A sink with clocks."""

    sink: Recording
    clocks: Clocks

    def write(self, block: TickBlock) -> None:
        with self.clocks.running():
            self.sink.write(block)


def once(scenario, world) -> tuple[float, Clocks, Clocks, dict[str, int]]:
    """Time of a run but for its recordings, s; that of writing, of opening and closing; and the sizes."""
    header = Header(
        scenario,
        dump(scenario),
        "mujoco",
        0,
        world.model,
        world.xml,
        versions(),
        0.01,
        tuple(car_sheets(scenario)),
    )
    writing, ends = Clocks(), Clocks()
    with tempfile.TemporaryDirectory() as name:
        recording = Recording(Path(name), header, FORMATS)
        with ends.running():
            recording.__enter__()
        began = time.perf_counter()
        trace = mjmerge.simulate(scenario, "mujoco", world=world, sink=Timed(recording, writing), threads=1)
        simulated = time.perf_counter() - began - writing.wall_s
        outcome = Outcome([], judge(trace)[0].verdict, {})
        with ends.running():
            recording.close(outcome)
        assert recording.failures == []
        return simulated, writing, ends, {f.name: f.stat().st_size for f in recording.files}


def main() -> None:
    """Prints the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 35.0
    scenario = mjmerge.load("paper", [f"duration_s={seconds}"])
    half = mjmerge.load("paper", [f"duration_s={seconds / 2}"])
    world = build(scenario)
    short = once(half, world)[3]
    runs = [once(scenario, world) for _ in range(REPEATS)]
    sizes = runs[-1][3]
    simulated = statistics.median(run[0] for run in runs)

    def median(clock: str, parts: tuple[int, ...]) -> float:
        return statistics.median(sum(getattr(run[part], clock) for part in parts) for run in runs)

    def ticks(seconds_: float) -> str:
        return f"{seconds_ / scenario.ticks * 1e6:.0f} us"

    table = Table("what", "measured", "target", title=f"{seconds:g} s at 100 Hz, medians of {REPEATS}")
    table.add_row("run without recording", f"{simulated:.2f} s", "")
    table.add_row("recording, share of that", f"{median('wall_s', (1, 2)) / simulated:.1%}", "<= 15 %")
    table.add_row("writing, per tick", ticks(median("wall_s", (1,))), "<= 50 us")
    table.add_row("  of the processor", ticks(median("own_s", (1,))), "")
    table.add_row("opening and closing", f"{median('wall_s', (2,)) * 1e3:.0f} ms", "")
    table.add_row("  of the processor", f"{median('own_s', (2,)) * 1e3:.0f} ms", "")
    for name, size in sizes.items():
        whole = size + (size - short[name]) / (seconds / 2) * (LONG_S - seconds)
        table.add_row(f"{name}, ten minutes", f"{whole / 1e6:.1f} MB", "<= 50 MB")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    table.add_row(f"memory of this process, {seconds:g} s", f"{peak:.0f} MB", "<= 500 MB, ten minutes")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
