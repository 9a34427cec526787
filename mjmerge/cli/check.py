"""``mjmerge check``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjmerge.cli.options import Count, Flag, at_least, unsaid
from mjmerge.cli.progress import progress_bar
from mjmerge.config import shipped
from mjmerge.errors import MjmergeError
from mjmerge.outputs import put


@dataclass(frozen=True)
class Check:
    """Run the regression gate. Exit code 0: floors and baselines hold; 1: not all; 3: a run stopped."""

    scenarios: Annotated[tuple[Path, ...], tyro.conf.Positional, unsaid("SCENARIO|DIR")] = ()
    """Scenarios with a gate, by name or file, or folders of them; by default the shipped ones."""
    baselines: Annotated[Path | None, unsaid("DIR")] = None
    """Folder of the baselines; by default baselines/ beside each scenario."""
    only: Annotated[str, unsaid("TEXT")] = ""
    """Only rows with this in `scenario, row`."""
    update: Flag = False
    """Rewrite the baselines with what is measured now, and print what changed. Floors stay as they are."""
    threads: Count = 0
    """Threads for the physics, 0 for all cores; does not change the result."""
    junit: Annotated[Path | None, unsaid("FILE")] = None
    """Also write JUnit XML."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console

        from mjmerge.gate import gate
        from mjmerge.gate.report import gate_failure, gate_json, gate_junit, gate_table

        at_least(0, threads=self.threads)
        places = self.scenarios or (shipped.folder("scenarios"),)
        rows = [r for r in gate.rows(places) if self.only in f"{r.label}, {r.check.name}"]
        if not rows:
            raise MjmergeError(f"no row of the gate has {self.only!r} in its name")
        with progress_bar(len(rows), "checking") as progress:
            results = list(gate.run(rows, self.baselines, threads=self.threads, progress=progress))
        stale = gate.stale(rows, self.baselines)
        said = gate.update(results, self.baselines) if self.update else []
        if self.junit is not None:
            put(self.junit, gate_junit(results))
        failed = [result for result in results if result.problems]
        if self.json:
            print(json.dumps(gate_json(results, [] if self.update else stale)))
        else:
            console = Console(highlight=False)
            if not self.update:
                console.print(gate_table(results))
            for line in said or [*(gate_failure(result) for result in failed), *stale]:
                console.print(line, markup=False, soft_wrap=True)
        if any(result.stopped for result in results):
            return 3
        return 1 if failed and not self.update else 0
