"""``mjmerge sweep``."""

from __future__ import annotations

import json
import sys
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from mjmerge.cli.options import Count, Flag, Machines, Overrides, PlantName, at_least, team, unsaid
from mjmerge.cli.progress import runs_bar
from mjmerge.cli.style import bold
from mjmerge.errors import MjmergeError


@dataclass(frozen=True)
class Sweep:
    """Run a campaign, a ladder or a search for breaking points.

    A campaign is many runs: a table, a report, and failure rates with intervals. Interrupted, it goes on
    where it was when it is run again. Exit code 0: all runs ended, whatever came of them (`mjmerge check` is
    the gate); 2: bad input; 3: some simulation ended early, or kills whatever process it is run in.
    """

    kept: ClassVar[str] = "what is finished is kept; run it again to go on"

    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CAMPAIGN|SCENARIO")]
    """Name of a shipped campaign, or the path of a YAML file; with --ladder and --break, of a scenario."""
    out: Annotated[Path | None, unsaid("DIR")] = None
    """Folder for everything; by default one in sweeps/, ladders/ or breaking/, named after what was asked."""
    workers: Count = 0
    """Processes to spread over, 0 for one per core; does not change the result."""
    machines: Annotated[Machines, tyro.conf.arg(name="")] = Machines()  # noqa: RUF009
    """Who does the work."""
    part: Annotated[str | None, unsaid("K/N")] = None
    """Run every N-th shard of a campaign, from the K-th on, in a folder that all parts share: job arrays."""
    merge: Annotated[tuple[Path, ...] | None, unsaid("DIR [DIR ...]")] = None
    """Run nothing, but make one table of parts that were run with an --out of their own."""
    ladder: Flag = False
    """Run the scenario from the paper's own world to physical cars, rung by rung: what each costs."""
    break_: Annotated[
        tuple[str, ...],
        tyro.conf.arg(name="break", metavar="AXIS", help_behavior_hint=""),
        tyro.conf.UseAppendAction,
    ] = ()
    """Find the smallest mismatch that breaks it: AXIS or AXIS=START:END, repeatable; frontier: AXIS,OTHER."""
    until: Literal["unsafe", "floor"] = "unsafe"
    """With --break, what counts as broken: d_j <= 0 or touching bodies, or the scenario's safety floor."""
    plant: PlantName = "mujoco"
    """With --break, what moves the cars."""
    seed: Count = 0
    """With --ladder and --break, seed of the runs (a campaign has its own)."""
    seeds: Count = 1
    """With --break, run each point with so many seeds: it breaks if one does."""
    set_: Overrides = ()
    """With --ladder and --break, any scenario key; repeatable."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        at_least(0, workers=self.workers, seed=self.seed)
        at_least(1, seeds=self.seeds)
        self.machines.check()
        if self.ladder and self.break_:
            raise MjmergeError("--ladder and --break are two things: choose one")
        if not (self.ladder or self.break_):
            if self.set_ or self.seed or self.seeds != 1:
                raise MjmergeError(
                    "a campaign has its own keys and seeds: --set, --seed and --seeds are for --break"
                )
            return self._campaign()
        if self.part is not None or self.merge is not None:
            raise MjmergeError("--part and --merge are for campaigns")
        return self._ladder() if self.ladder else self._break()

    def _prepare(self, folder: Path, files: Collection[str]) -> None:
        """Makes the folder; says what made way."""
        from mjmerge.outputs import prepare

        if prepare(folder, self.out is None, files):
            print(f"mjmerge: what was in {folder} was replaced", file=sys.stderr)

    def _campaign(self) -> int:
        from mjmerge.sweep.campaign import plan
        from mjmerge.sweep.parts import WHOLE, Part

        if self.merge is not None and self.part is not None:
            raise MjmergeError("--part and --merge are two things: choose one")
        part = WHOLE if self.part is None else Part.parse(self.part)
        planned = plan(self.what)

        from mjmerge.cli import campaign  # what is wrong with a campaign is said before

        folder = self.out or Path("sweeps") / planned.name
        if self.merge is not None:
            if not self.merge:
                raise MjmergeError("--merge takes the folders of the parts: --merge DIR DIR")
            return campaign.merge(planned, folder, self.merge, as_json=self.json)
        return campaign.run(planned, folder, part, team(self.workers, self.machines), as_json=self.json)

    def _ladder(self) -> int:
        from rich.console import Console

        from mjmerge.cli.places import ladder_folder
        from mjmerge.search import ladder
        from mjmerge.sweep.plan import given

        with team(self.workers, self.machines) as who, runs_bar(len(ladder.RUNGS)) as progress:
            found = ladder.climb(
                self.what, given(self.set_), who, seed=self.seed, progress=lambda done: progress(done, 0)
            )
        folder = self.out or ladder_folder(found.scenario.name, self.seed, self.set_)
        self._prepare(folder, ladder.FILES)
        ladder.write(found, folder)
        if self.json:
            print(json.dumps(ladder.as_json(found) | {"out": str(folder)}))
        else:
            console = Console(highlight=False)
            console.print(f"{bold(found.scenario.name)}, rung by rung")
            console.print(ladder.rich_table(found))
            for line in (ladder.delay_line(found), *ladder.idle_lines(found)):
                console.print(line, markup=False, soft_wrap=True)
            console.print(f"plot and table:  {bold(folder)}", soft_wrap=True)
        return 3 if any(rung.row["stopped"] for rung in found.rungs) else 0

    def _break(self) -> int:
        from rich.console import Console

        from mjmerge.cli.places import breaking_folder
        from mjmerge.scenario.load import load
        from mjmerge.scenario.ran import ran
        from mjmerge.search import breaking
        from mjmerge.search import report as breaking_report
        from mjmerge.sweep.plan import given

        settings = given(self.set_)
        pairs = [text.split(",") for text in self.break_]
        if any(len(pair) > 2 for pair in pairs) or (len(pairs) > 1 and any(len(pair) == 2 for pair in pairs)):
            raise MjmergeError("--break takes axes one by one, or once two of them: --break AXIS,OTHER")
        axes = [breaking.ranged(pair[0], self.what, settings, self.plant) for pair in pairs]
        across = breaking.ranged(pairs[0][1], self.what, settings, self.plant) if len(pairs[0]) == 2 else None
        breaking.check(self.what, self.plant, axes, settings, across=across, until=self.until)
        scenario = load(self.what, self.set_)
        name = scenario.name
        seeds = range(self.seed, self.seed + self.seeds)
        folder = self.out or breaking_folder(name, self.plant, self.break_, self.until, seeds, self.set_)
        self._prepare(folder, breaking_report.FILES)
        with team(self.workers, self.machines) as who:
            found = breaking.search(
                self.what,
                self.plant,
                axes,
                settings,
                who,
                across=across,
                until=self.until,
                seeds=seeds,
                progress=lambda text: print(text, file=sys.stderr),
            )
        title = "\n".join(ran(scenario, self.plant))
        breaking_report.write(found, folder, title, self.until, across, self.seeds)
        if self.json:
            print(
                json.dumps(
                    {"scenario": name, "plant": self.plant, "until": self.until, "out": str(folder)}
                    | {"axes": breaking_report.as_json(found, across)}
                )
            )
        else:
            console = Console(highlight=False)
            console.print(f"{bold(title.replace(chr(10), '; '))}: the smallest mismatch that breaks it")
            console.print(breaking_report.rich_table(found, across))
            for note in breaking_report.seed_notes(found, self.seeds):
                console.print(note, markup=False, soft_wrap=True)
            console.print(f"plot and every point:  {bold(folder)}", soft_wrap=True)
        return 0
