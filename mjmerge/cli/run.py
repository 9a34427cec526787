"""``mjmerge run``."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mjmerge.cli.options import Count, Flag, Overrides, PlantName, ScenarioName, at_least, unsaid
from mjmerge.cli.progress import progress_bar
from mjmerge.cli.style import bold, plain

if TYPE_CHECKING:
    from mjmerge.record import Header
    from mjmerge.record.rerun.live import Live
    from mjmerge.search.explain import Explanation


@dataclass(frozen=True)
class Run:
    """Run a scenario, judge it, and record it. Exit code 0: safety floor and bounds held; 1: they did not."""

    scenario: ScenarioName
    """Name of a shipped scenario (see `mjmerge list`), or the path of a YAML file."""
    plant: PlantName = "mujoco"
    """What moves the cars."""
    seed: Count = 0
    """Seed of the first run; run i has seed + i."""
    runs: Count = 1
    """Number of simulations, each with its own seed; those worth a look are recorded."""
    duration: Annotated[float | None, unsaid("SECONDS")] = None
    """Simulated time, in place of the scenario's."""
    set_: Overrides = ()
    """Any scenario key, as in `--set law.k_o=0`; repeatable."""
    out: Annotated[Path | None, unsaid("DIR")] = None
    """Run folder; by default runs/<scenario>-<plant>-<seed> and what was set; the same run makes way."""
    threads: Count = 0
    """Threads for the physics, 0 for all cores; does not change the result."""
    continuous: Flag = False
    """Law and plant as one differential equation, solved to 1e-10; for the plants other than mujoco."""
    explain: Flag = False
    """Say why an unsafe run fails (of several the worst), in its report, too; takes tens of further runs."""
    live: Flag = False
    """Show the run in a Rerun viewer while it goes on, in real time."""
    live_at: Annotated[str | None, unsaid("127.0.0.1:PORT")] = None
    """Like --live, in a viewer that is open already."""
    live_fast: Flag = False
    """Like --live, as fast as possible."""
    record: bool = True
    """Write run.rrd, run.mcap and the rest of the run folder."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.scenario.load import load

        at_least(1, runs=self.runs)
        at_least(0, seed=self.seed, threads=self.threads)
        overrides = list(self.set_)
        if self.duration is not None:
            overrides.append(f"duration_s={self.duration!r}")
        scenario = load(self.scenario, overrides)

        from rich.console import Console  # what is wrong with a scenario is said before

        from mjmerge.cli.explain import show
        from mjmerge.cli.places import run_folder
        from mjmerge.run import run
        from mjmerge.verdict.table import table

        folder = self.out
        if folder is None and self.record:
            folder = run_folder(
                scenario,
                self.plant,
                self.seed,
                self.runs,
                continuous=self.continuous,
                overrides=self.set_,
            )

        with progress_bar(scenario.duration_s) as progress:
            done = run(
                scenario,
                self.plant,
                runs=self.runs,
                seed=self.seed,
                threads=self.threads,
                continuous=self.continuous,
                folder=folder,
                replace=self.out is None,
                record=self.record,
                explain=self.explain,
                live=self._live(),
                progress=progress,
            )
        if done.unseen_s:
            print(f"mjmerge: the live view did not show {done.unseen_s:.1f} s of the run", file=sys.stderr)
        for failure in done.failures:
            print(f"mjmerge: recorder failed: {failure}", file=sys.stderr)
        if self.json:
            if done.replaced:
                print(f"mjmerge: the earlier run in {folder} was replaced", file=sys.stderr)
            print(json.dumps(done.summary | self._explained(done.explanation)))
            return done.exit_code
        console = Console(highlight=False)
        many = f", {self.runs} runs" if self.runs > 1 else ""
        time_ = ", continuous time" if self.continuous else ""
        console.print(f"{bold(scenario.name)} on {self.plant}{time_}, seed {self.seed}{many}")
        for override in overrides:
            console.print(f"  {override}", markup=False)
        console.print(table(done.summary))
        if done.explanation is not None:
            which = f" with seed {done.explanation.seed}, the worst," if self.runs > 1 else ""
            console.print(f"why the run{which} fails:")
            show(console, done.explanation)
        elif self.explain:
            which = "the worst run" if self.runs > 1 else "the run"
            console.print(f"{which} is safe: there is nothing to explain")
        if done.replaced:
            console.print(f"the earlier run in {plain(folder)} was replaced")
        if folder is not None and self.record and not done.failures:
            command = shlex.join(["mjmerge", "view", str(folder)])
            console.print(f"look at it:  {bold(command)}", soft_wrap=True)
        return done.exit_code

    def _explained(self, found: Explanation | None) -> dict[str, Any]:
        """What ``--json`` has beside the summary."""
        from mjmerge.search.explain import as_json

        return {"explanation": None if found is None else as_json(found)} if self.explain else {}

    @property
    def kept(self) -> str:
        """What an interrupted run leaves behind."""
        return "what was recorded is kept as *.partial" if self.record else ""

    def _live(self) -> Callable[[Header], Live] | None:
        """What shows the run, if it is to be shown."""
        if not (self.live or self.live_fast or self.live_at is not None):
            return None
        from mjmerge.record.rerun.live import Live, port_of

        port = None if self.live_at is None else port_of(self.live_at)
        return partial(Live, port=port, real_time=not self.live_fast)
