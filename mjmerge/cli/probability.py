"""``mjmerge probability``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from mjmerge.cli.options import (
    ANY_PLANT,
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

BUDGET = 5000
"""Runs where nobody says."""


@dataclass(frozen=True)
class Probability:
    """Estimate how likely a margin below a bound is, under the distributions of a scenario's search space.

    Samples that fail are kept, for `mjmerge falsify` to shrink. Exit code 0: estimated, whatever it is; 2:
    bad input.
    """

    kept: ClassVar[str] = "what was run is kept; run it again to go on"

    scenario: ScenarioName
    """Name of a shipped scenario or the path of a YAML file; its section `search` has the distributions."""
    below: Annotated[float, tyro.conf.arg(metavar="M")] = 0.0
    """The bound on the least of every d_j and clearance, m."""
    budget: Count = BUDGET
    """Runs, about: what is likelier than 1e-4 takes fewer."""
    seed: Count = 0
    """Of the samples; the same seed gives the same estimate."""
    method: Literal["subset", "montecarlo"] = "subset"
    """Subset simulation, for what is rare, or independent samples."""
    plant: PlantName = "mujoco"
    """What moves the cars."""
    screen: Annotated[str | None, unsaid(ANY_PLANT)] = None
    """A cheap plant that looks first; the budget is then of runs that correct what it says."""
    out: Annotated[Path | None, unsaid("DIR")] = None
    """Folder for everything; by default probabilities/<scenario>-<plant> and what else was set."""
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
        at_least(1, budget=self.budget)
        at_least(0, seed=self.seed, workers=self.workers)
        self.machines.check()
        from rich.console import Console

        from mjmerge.cli.places import probability_folder
        from mjmerge.scenario.load import load
        from mjmerge.search.kept import Margins, settled
        from mjmerge.search.probability import Asked, as_json, probability
        from mjmerge.search.probability_report import correction, sentence, write
        from mjmerge.search.space import Ground
        from mjmerge.state import Array

        ground = Ground.around(load(self.scenario, self.set_), self.plant)
        asked = Asked(self.below, self.budget, self.method, self.seed, self.screen)
        asked.check(ground)
        for key, why in ground.left_out:
            print(f"mjmerge: left out: {key} {why}", file=sys.stderr)
        default = probability_folder(ground.scenario.name, self.plant, self._words)
        folder = self.out or settled(default, ground, asked)
        kept = Margins(folder, ground, asked)
        done = len(kept.known)
        with team(self.workers, self.machines) as who, runs_bar(asked.runs) as progress:

            def told(margins: Array) -> None:
                nonlocal done
                kept.add(margins)
                done += len(margins)
                progress(done, len(kept.known))

            found = probability(ground, asked, team=who, known=kept.known, told=told)
        write(found, folder)
        if self.json:
            print(json.dumps(as_json(found) | {"out": str(folder)}))
            return 0
        console = Console(highlight=False, soft_wrap=True)
        console.print(f"{bold(ground.scenario.name)} on {self.plant}: {plain(sentence(found))}")
        for k, level in enumerate(found.estimate.levels):
            took = f"{level.accepted:.0%} of the moves taken" if k else "independent samples"
            console.print(f"level {k}:  {level.part:.3g} below {level.bound:.4g} m; {took}")
        if found.screened is not None and self.screen is not None:
            for line in correction(found.screened, self.below, self.screen, self.plant):
                console.print(line, markup=False)
        console.print(f"{bold(folder)}:  {len(found.below)} samples that fail, for `mjmerge falsify --from`")
        return 0

    @property
    def _words(self) -> tuple[str, ...]:
        """What is set, for the name of the folder."""
        return (
            f"below_{self.below:g}" if self.below else "",
            f"budget_{self.budget}" if self.budget != BUDGET else "",
            self.method if self.method != "subset" else "",
            f"screen_{self.screen}" if self.screen else "",
            f"seed_{self.seed}" if self.seed else "",
            *self.set_,
        )
