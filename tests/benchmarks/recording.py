"""What recording costs: ``python tests/benchmarks/recording.py [SECONDS]``. A table, no test.

One run of the ``paper`` scenario on MuJoCo's cars with and without both recordings, after one that warms up;
sizes are scaled to ten minutes from two lengths, so that what every file has once does not count.

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
from pathlib import Path

from rich.console import Console
from rich.table import Table

import mjmerge
from mjmerge.contract import judge
from mjmerge.loader import dump
from mjmerge.record import FORMATS, Header, Outcome, Recording, versions
from mjmerge.world import build

REPEATS = 5
LONG_S = 600.0


def once(scenario, world, formats) -> tuple[float, float, float, dict[str, int]]:
    """Wall time and processor time of this thread, s, that of opening and closing alone, and the sizes."""
    header = Header(scenario, dump(scenario), "mujoco", 0, world.model, world.xml, versions(), 0.01)
    with tempfile.TemporaryDirectory() as name:
        wall, own = time.perf_counter(), time.thread_time()
        with Recording(Path(name), header, formats) as recording:
            opened = time.perf_counter() - wall
            trace = mjmerge.simulate(scenario, "mujoco", world=world, sink=recording, threads=1)
            closing = time.perf_counter()
            recording.close(Outcome([], judge(trace)[0].verdict, {}))
        ends = opened + time.perf_counter() - closing
        wall, own = time.perf_counter() - wall, time.thread_time() - own
        return wall, own, ends, {f.name: f.stat().st_size for f in recording.files}


def main() -> None:
    """Prints the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 35.0
    scenario = mjmerge.load("paper", [f"duration_s={seconds}"])
    half = mjmerge.load("paper", [f"duration_s={seconds / 2}"])
    world = build(scenario)
    once(half, world, FORMATS)
    bare = [once(scenario, world, {}) for _ in range(REPEATS)]
    full = [once(scenario, world, FORMATS) for _ in range(REPEATS)]
    sizes, short = full[-1][3], once(half, world, FORMATS)[3]
    per_s = {n: (sizes[n] - short[n]) / (seconds / 2) for n in sizes}

    def median(rows, column: int) -> float:
        return statistics.median(row[column] for row in rows)

    wall_s = median(full, 0) - median(bare, 0)
    own_s = median(full, 1) - median(bare, 1)
    table = Table("what", "measured", "target", title=f"{seconds:g} s at 100 Hz, medians of {REPEATS}")
    table.add_row("run without recording", f"{median(bare, 0):.2f} s", "")
    table.add_row("recording, share of that", f"{wall_s / median(bare, 0):.1%}", "<= 15 %")
    table.add_row("recording, per tick", f"{wall_s / scenario.ticks * 1e6:.0f} us", "<= 50 us")
    table.add_row("  processor time of the run's thread", f"{own_s / scenario.ticks * 1e6:.0f} us", "")
    table.add_row("  opening and closing, of all that", f"{median(full, 2) * 1e3:.0f} ms", "")
    for name, size in per_s.items():
        whole = sizes[name] + size * (LONG_S - seconds)
        table.add_row(f"{name}, ten minutes", f"{whole / 1e6:.1f} MB", "<= 50 MB")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    table.add_row("memory of this process, at most", f"{peak:.0f} MB", "<= 500 MB")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
