"""Memory of a long sweep: ``python tests/benchmarks/memory.py [RUNS]``, no test.

10,000 short runs on MuJoCo, each with another mismatch, on 2 processes: from the 1,000th run on, what all
processes of the sweep hold together (each page once) is to stay within 10 %, by the median of each thousand.
A batch that has just begun holds more than one that has just ended; so the least and the most are told, too.
Pages of files, such as libraries, are left out: of those a process seems to hold more when others end that
have them, too.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from threading import Event, Thread

import quiet
from rich.console import Console
from rich.table import Table

from mjmerge.sweep.campaign import plan
from mjmerge.sweep.sweep import sweep

RUNS = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
PROCESSES, EVERY_S, DURATION_S = 2, 0.5, 0.5


def held_mib() -> float:
    """Memory of no file that this process and all that it started hold, MiB, shared pages once."""
    found = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            group = int(stat.read_text().rpartition(")")[2].split()[2])
            if group == os.getpgrp():
                rollup = (stat.parent / "smaps_rollup").read_text()
                found += int(rollup.partition("\nPss_Anon:")[2].split()[0])
        except (OSError, ValueError):  # it has ended meanwhile
            continue
    return found / 1024


def main() -> None:
    """Prints what is held from when on."""
    quiet.look()
    if os.getpgrp() != os.getpid():
        os.setpgrp()
    axes = {
        "mismatch.friction": {"uniform": [0.3, 1.0]},
        "mismatch.command_delay_s": {"uniform": [0.0, 0.1]},
    }
    block = {
        "scenarios": ["charge"],
        "set": {"duration_s": DURATION_S},
        "random": {"draws": RUNS, "axes": axes},
    }
    planned, done, over = plan({"blocks": [block]}), [0], Event()
    seen: list[tuple[int, float]] = []

    def watch() -> None:
        while not over.wait(EVERY_S):
            seen.append((done[0], held_mib()))

    watcher = Thread(target=watch)
    watcher.start()
    began = time.perf_counter()
    try:
        with tempfile.TemporaryDirectory() as folder:
            sweep(
                planned,
                Path(folder) / "out",
                processes=PROCESSES,
                progress=lambda runs, _: done.__setitem__(0, int(runs)),
            )
            size_kib = (Path(folder) / "out" / "table.parquet").stat().st_size / 1024
    finally:
        over.set()
        watcher.join()
    table = Table("from run", "to run", "median (MiB)", "least", "most")
    tenth, medians = RUNS // 10, []
    for first in range(0, RUNS, tenth):
        part = [mib for runs, mib in seen if first <= runs < min(first + tenth, RUNS)]
        if part:
            medians.append(statistics.median(part))
            row = (f"{mib:.0f}" for mib in (medians[-1], min(part), max(part)))
            table.add_row(str(first), str(first + tenth), *row)
    console = Console(width=100)
    console.print(table)
    later = medians[1:]
    if later:
        console.print(
            f"from run {tenth} on at most {max(later) / min(later):.3f} of the least; target <= 1.10"
        )
    console.print(f"{RUNS} runs in {time.perf_counter() - began:.0f} s, a table of {size_kib:.0f} KiB")


if __name__ == "__main__":
    main()
