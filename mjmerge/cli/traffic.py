"""``mjmerge traffic``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjmerge.cli.options import Count, Flag
from mjmerge.cli.progress import runs_bar
from mjmerge.cli.style import bold, plain
from mjmerge.config.bounds import whole

MOST_STEPS = 20
"""In which a follower is tightened."""


@dataclass(frozen=True)
class Traffic:
    """Make scenarios of the lane changes in recorded traffic, and put the law beside the human.

    Each lane change in which leader and follower are seen becomes a scenario: the law is where the human
    was, the others drive as they were recorded. It is run once, and judged. Exit code 0: the file was read,
    whatever the verdicts; 2: bad input; 3: a simulation failed.
    """

    file: Annotated[Path, tyro.conf.Positional]
    """CommonRoad 2020a (.xml), or a table (.csv) with --map."""
    map: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = ""
    """Columns of a table: ngsim, highd, or a YAML file like theirs; by default what its header fits."""
    tighten: Annotated[Count, tyro.conf.arg(metavar="STEPS")] = 0
    """Also move each follower towards the least gap that Assumption 1 allows, in so many steps."""
    plant: str = "double_integrator"
    """What moves the cars."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for everything; by default traffic/<file>, where an earlier one makes way."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        whole("--tighten", self.tighten, 0, MOST_STEPS)
        from rich.console import Console
        from rich.table import Table

        from mjmerge.cli.places import traffic_folder
        from mjmerge.errors import UnknownNameError
        from mjmerge.merges.judged import as_json, merges
        from mjmerge.merges.report import FILES, sentence, write
        from mjmerge.outputs import prepare
        from mjmerge.roster import PLANTS
        from mjmerge.traffic.read import read

        if self.plant not in PLANTS:
            raise UnknownNameError("plant", self.plant, PLANTS)
        traffic = read(self.file, self.map)
        words = [*([self.plant] if self.plant != "double_integrator" else [])]
        words += [f"tighten_{self.tighten}"] if self.tighten else []
        folder = traffic_folder(self.file, words) if self.out is None else self.out
        if prepare(folder, self.out is None, FILES):
            print(f"mjmerge: what was in {folder} was replaced", file=sys.stderr)
        with runs_bar(1) as progress:
            found = merges(traffic, self.plant, self.tighten, lambda done, of: progress(done / of, 0))
        write(found, folder)
        failed = any(not stop.touched for one in found.merges for stop in one.trace.stops)
        if self.json:
            print(json.dumps(as_json(found, str(folder))))
            return 3 if failed else 0
        console = Console(highlight=False)
        console.print(
            f"{bold(self.file.name)} on {plain(self.plant)}: {plain(sentence(found))}", soft_wrap=True
        )
        grid = Table("scenario", "verdict", "human d_1, d_2", "law d_1, d_2", box=None, pad_edge=False)
        for one in found.merges:
            least = [
                f"{m.leader.distance_m:.2f}, {m.follower.distance_m:.2f} m" for m in (one.human, one.law)
            ]
            verdict = f"{one.verdict.verdict}{'; breaks Assumption 1' if one.event.breaks else ''}"
            grid.add_row(plain(one.event.name), verdict, *least)
        if found.merges:
            console.print(grid)
        for skipped in found.skipped:
            console.print(f"no scenario of {plain(skipped.id)}: {plain(skipped.why)}", soft_wrap=True)
        console.print(f"scenarios, report and figures:  {bold(str(folder))}", soft_wrap=True)
        return 3 if failed else 0
