"""``mjmerge explain``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from mjmerge.cli.options import ANY_PLANT, Count, Flag, Overrides, at_least, processes, unsaid
from mjmerge.cli.style import bold

if TYPE_CHECKING:
    from rich.console import Console

    from mjmerge.search.explain import Explanation
    from mjmerge.search.meant import Meant

_RELATIVE = 1e-9


@dataclass(frozen=True)
class Explain:
    """Say why a run fails: which mismatch, move and rung of the ladder it needs, and what is enough.

    Each is taken back by itself, and the run made again: what makes it safe then is a cause. Exit code 0: it
    is safe; 1: it is not, and this is why; 2: bad input.
    """

    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO|RUN")]
    """Name of a shipped scenario, a YAML file, a recording, or the folder of a run or of a finding."""
    plant: Annotated[str | None, unsaid(ANY_PLANT)] = None
    """What moves the cars; by default that of the run, or mujoco."""
    seed: Annotated[int | None, unsaid("N")] = None
    """Of the run; by default that of the folder or recording, or 0."""
    continuous: Flag = False
    """In continuous time, as `mjmerge run --continuous`; a run that was, is again."""
    workers: Count = 0
    """Processes to spread over, 0 for one per core; does not change the result."""
    set_: Overrides = ()
    """Any scenario key; repeatable."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        at_least(0, workers=self.workers)
        if self.seed is not None:
            at_least(0, seed=self.seed)
        from rich.console import Console

        from mjmerge.scenario.ran import ran
        from mjmerge.search.explain import as_json, explain
        from mjmerge.search.meant import meant
        from mjmerge.sweep.workers import workers

        run = meant(self.what, self.set_)
        plant, seed = self.plant or run.plant, run.seed if self.seed is None else self.seed
        continuous = self.continuous or (run.continuous and self.plant in (None, run.plant))
        with workers(processes(self.workers)) as team:
            found = explain(run.scenario, plant, seed=seed, continuous=continuous, team=team)
        for line in _doubts(run, found):
            print(f"mjmerge: {line}", file=sys.stderr)
        if self.json:
            print(json.dumps(as_json(found)))
            return int(found.unsafe)
        console = Console(highlight=False)
        time_ = ", continuous time" if continuous else ""
        worst = f", the worst of {run.runs}" if run.runs > 1 and seed == run.seed else ""
        console.print(f"{bold(found.scenario.name)} on {plant}{time_}, seed {seed}{worst}", soft_wrap=True)
        for line in ran(found.scenario, plant)[1:]:
            if line.startswith("set: "):  # what its mismatch does is said below
                console.print(line, markup=False, soft_wrap=True)
        show(console, found)
        return int(found.unsafe)


def _doubts(run: Meant, found: Explanation) -> list[str]:
    """What speaks against the run again being the one that is meant."""
    there, here = run.min_distance_m, found.margin.min_distance_m
    same = (found.plant, found.seed, found.continuous) == (run.plant, run.seed, run.continuous)
    if there is None or not same or abs(there - here) <= _RELATIVE * max(1.0, abs(there)):
        return []
    return [
        f"this is another run: its least d_j is {here:.6g} m, and {there:.6g} m was recorded; "
        "`mjmerge replay` says what differs"
    ]


def show(console: Console, found: Explanation) -> None:
    """Prints an explanation."""
    from rich.table import Table
    from rich.text import Text

    from mjmerge.search.explain import sentences

    for line in sentences(found):
        console.print(line, markup=False, soft_wrap=True)
    if not found.table:
        return
    table = Table("taken back", "margin, m", "moves it by, m", "then", box=None, pad_edge=False)
    for one in found.table:
        moved = "-" if one.moves_m is None else f"{one.moves_m:+.3f}"
        margin = "-" if one.margin is None else f"{one.margin.least_m:.3f}"
        table.add_row(Text(one.what), margin, moved, one.then)
    console.print(table)
