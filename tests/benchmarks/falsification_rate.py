"""How often and how soon searches find failures: ``python tests/benchmarks/falsification_rate.py paper DIR``.

Several searches beside one of random points, whose batches run together: physics is most of a run then. Every
look is the one that ``mjmerge falsify SCENARIO --seed N --budget M --workers 1 --no-record`` has, and lies
where ``--out FOLDER/SCENARIO-cma-N`` finds it; what is there is not run again.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import quiet
from rich.console import Console
from rich.table import Table

import mjmerge
from mjmerge.outputs import put
from mjmerge.search.against import PROOF
from mjmerge.search.falsify import Look, Search, look_at
from mjmerge.search.findings import LOOKS, log, logged
from mjmerge.search.methods import METHODS, Asked, Method
from mjmerge.search.space import Ground
from mjmerge.sweep.workers import Workers, workers


@dataclass
class Run:
    """A search under way."""

    method: Method
    seed: int
    path: Path
    digest: str
    asked: Asked
    before: list[Look]
    looks: list[Look]
    points: np.ndarray

    def there(self) -> list[Look] | None:
        """What was seen before of the points that are asked for now."""
        found = self.before[len(self.looks) : len(self.looks) + len(self.points)]
        same = [look.point for look in found] == [tuple(point.tolist()) for point in self.points]
        return found if same else None

    def take(self, found: list[Look], ground: Ground, budget: int) -> None:
        """Tells the method, and keeps what was seen."""
        self.asked.tell([look.cost for look in found])
        self.looks += found[: budget - len(self.looks)]
        if len(self.looks) > len(self.before):
            search = Search(ground, self.method, self.seed, tuple(self.looks))
            put(self.path, log(search, self.digest))


def searches(ground: Ground, name: str, folder: Path, seeds: int) -> list[Run]:
    """One for each seed, and random points."""
    made = []
    of: list[tuple[Method, int]] = [("cma", seed) for seed in range(seeds)] + [("random", 0)]
    for method, seed in of:
        path = folder / f"{name}-{method}-{seed}" / LOOKS
        path.parent.mkdir(parents=True, exist_ok=True)
        digest = ground.digest(method, str(seed), repr(PROOF))
        before = logged(path, digest) if path.exists() else []
        asked = METHODS[method](ground.size, seed)
        made.append(Run(method, seed, path, digest, asked, before, [], np.zeros(0)))
    return made


def main() -> None:
    """Runs what is missing, and prints the table after each round."""
    quiet.look()
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("scenario")
    asked.add_argument("folder", type=Path)
    asked.add_argument("--budget", type=int, default=1000)
    asked.add_argument("--seeds", type=int, default=10)
    asked.add_argument(
        "--random", type=int, default=None, help="budget of the random points; default: the same"
    )
    asked.add_argument("--workers", type=int, default=1, help="processes")
    given = asked.parse_args()
    with workers(given.workers) as team:
        measure(given, team)


def measure(given: argparse.Namespace, team: Workers) -> None:
    """The rounds."""
    ground = Ground.around(mjmerge.load(given.scenario), "mujoco")
    runs = searches(ground, Path(given.scenario).stem, given.folder, given.seeds)
    budget = {"cma": given.budget, "random": given.budget if given.random is None else given.random}
    while left := [run for run in runs if len(run.looks) < budget[run.method]]:
        for run in left:
            run.points = run.asked.ask()
        new = []
        for run in left:
            found = run.there()
            if found is None:
                new.append(run)
            else:
                run.take(found, ground, budget[run.method])
        if new:
            points = np.concatenate([run.points for run in new])
            numbers = [len(run.looks) + i for run in new for i in range(len(run.points))]
            looks = iter(look_at(ground, points, 0, seeds=numbers, team=team))
            for run in new:
                mine = [next(looks) for _ in run.points]
                first = len(run.looks)
                mine = [renumbered(one, first + i) for i, one in enumerate(mine)]
                run.take(mine, ground, budget[run.method])
            show(runs)


def renumbered(look: Look, number: int) -> Look:
    """The same, by its number within its own search."""
    return Look(**vars(look) | {"number": number})


def show(runs: list[Run]) -> None:
    """Prints what there is so far."""
    table = Table("method", "seed", "runs", "fair", "failures", "first at run", "least margin (m)")
    for run in runs:
        found = Search(None, run.method, run.seed, tuple(run.looks))  # type: ignore[arg-type]
        best = found.best
        table.add_row(
            run.method,
            str(run.seed),
            str(len(run.looks)),
            str(found.valid),
            str(len(found.failures)),
            str(found.first_failure_at_run or "-"),
            "-" if best is None else f"{best.depth_m:.3f}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
