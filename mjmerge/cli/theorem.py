"""``mjmerge theorem``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from mjmerge.cli.options import Count, at_least
from mjmerge.cli.progress import progress_bar
from mjmerge.config.bounds import LONGEST_S
from mjmerge.errors import MjmergeError


@dataclass(frozen=True)
class Theorem:
    """Look for a counterexample to the theorem in random worlds. Exit code 0: there is none; 1: there is."""

    runs: Count = 1000
    """Number of worlds."""
    seed: Count = 0
    """Seed of the first 50 worlds; the next 50 have the next one."""
    duration: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 12.0
    """Simulated time of each."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console

        from mjmerge.paper.tables import theorem_table
        from mjmerge.paper.theorem import tally

        at_least(1, runs=self.runs)
        at_least(0, seed=self.seed)
        if not 0 < self.duration <= LONGEST_S:
            raise MjmergeError(
                f"--duration is {self.duration}; it must be above 0 and at most {LONGEST_S:g} s"
            )
        with progress_bar(self.runs, "looking for a counterexample") as progress:
            done = tally(self.runs, self.seed, self.duration, progress)
        Console(highlight=False).print(theorem_table(done))
        for seed, i, world, duration_s in done.counterexamples:
            print(f"counterexample (seed {seed}, world {i}), after {duration_s} s: {world}")
        if done.violated:
            return 1
        return 3 if done.stuck else 0
