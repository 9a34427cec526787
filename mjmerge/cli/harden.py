"""``mjmerge harden``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjmerge.cli.options import (
    Count,
    Flag,
    Machines,
    Overrides,
    PlantName,
    ScenarioName,
    at_least,
    team,
    unsaid,
)
from mjmerge.cli.progress import runs_bar
from mjmerge.cli.style import bold, plain
from mjmerge.config.bounds import MOST_RUNS, MOST_SEED, whole

MOST_ROUNDS = 12
"""Rounds, and fresh searches, at most."""


@dataclass(frozen=True)
class Harden:
    """Choose keys of the law that stand the failures a search finds, and say what that costs.

    In each round a search looks for failures of the law at hand, and the law is chosen that has the best
    worst margin over all that was found. At the end fresh searches, with seeds that no round used, judge the
    chosen law and the one as it was. Exit code 0: the worst margin rises, or there was nothing to harden
    against; 1: it does not; 2: bad input.
    """

    scenario: ScenarioName
    """Name of a shipped scenario or the path of a YAML file; its section `search` says where to look."""
    key: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="KEY=VALUES", help_behavior_hint=""),
        tyro.conf.UseAppendAction,
    ] = ()
    """A key that is chosen, law.k_o=LOW:HIGH or law.variant=ONE,OTHER; repeatable; by default the usual."""
    budget: Count = 256
    """Runs of each search."""
    tries: Count = 48
    """Laws that each round tries."""
    rounds: Count = 2
    """Rounds of a search and a choice."""
    fresh: Count = 2
    """Searches that judge the chosen law, and as many the law as it was."""
    seed: Count = 0
    """Of searches and choices; the same seed chooses the same."""
    plant: PlantName = "mujoco"
    """What moves the cars."""
    out: Annotated[Path | None, unsaid("DIR")] = None
    """Folder for everything; by default hardened/<scenario>-<plant> and what else was set; it makes way."""
    workers: Count = 0
    """Processes to spread over, 0 for one per core; does not change the result."""
    machines: Annotated[Machines, tyro.conf.arg(name="")] = Machines()  # noqa: RUF009
    """Who does the work."""
    set_: Overrides = ()
    """Any scenario key; repeatable."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        whole("--budget", self.budget, 1, MOST_RUNS)
        whole("--tries", self.tries, 1, MOST_RUNS)
        whole("--rounds", self.rounds, 1, MOST_ROUNDS)
        whole("--fresh", self.fresh, 1, MOST_ROUNDS)
        whole("--seed", self.seed, 0, MOST_SEED - 2 * MOST_ROUNDS)
        at_least(0, workers=self.workers)
        self.machines.check()
        from rich.console import Console

        from mjmerge.outputs import prepare
        from mjmerge.scenario.load import load
        from mjmerge.search.harden import harden, most_runs
        from mjmerge.search.harden_report import FILES, write
        from mjmerge.search.hardened import as_json, options, section, sentences
        from mjmerge.search.keys import keys_of
        from mjmerge.search.methods import METHODS
        from mjmerge.search.space import Ground

        ground = Ground.around(load(self.scenario, self.set_), self.plant)
        keys = keys_of(ground, self.key)
        METHODS["cma"](ground.size, self.seed)  # is refused where its library is not installed
        folder = self._folder(ground.scenario.name)
        if prepare(folder, self.out is None, FILES):
            _say(f"what was in {folder} was replaced")
        total = most_runs(self.budget, self.tries, self.rounds, self.fresh)
        with team(self.workers, self.machines) as who, runs_bar(total) as progress:
            found = harden(
                ground,
                keys,
                budget=self.budget,
                tries=self.tries,
                rounds=self.rounds,
                fresh=self.fresh,
                seed=self.seed,
                team=who,
                told=lambda done: progress(done, 0),
                said=_say,
            )
        write(found, folder)
        code = 0 if found.winner is None or found.better else 1
        if self.json:
            print(json.dumps(as_json(found) | {"out": str(folder)}))
            return code
        console = Console(highlight=False)
        console.print(f"{bold(ground.scenario.name)} on {plain(self.plant)}", soft_wrap=True)
        for line in sentences(found):
            console.print(line, markup=False, soft_wrap=True)
        if found.winner is not None and found.winner.settings:
            console.print(section(found).rstrip(), markup=False, soft_wrap=True)
            console.print(f"or:  {options(found.winner)}", markup=False, soft_wrap=True)
        console.print(f"report, frontier and law:  {bold(folder)}", soft_wrap=True)
        return code

    def _folder(self, scenario: str) -> Path:
        """Where everything goes."""
        if self.out is not None:
            return self.out
        from mjmerge.cli.places import hardened_folder

        given = {"seed": 0, "budget": 256, "tries": 48, "rounds": 2, "fresh": 2}
        other = [f"{name}_{getattr(self, name)}" for name, own in given.items() if getattr(self, name) != own]
        return hardened_folder(scenario, self.plant, (*self.key, *other, *self.set_))


def _say(text: str) -> None:
    print(f"mjmerge: {text}", file=sys.stderr)
