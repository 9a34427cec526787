"""``mjmerge traffic``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjmerge.cli.options import Count, Flag, PlantName, unsaid
from mjmerge.cli.progress import progress_bar
from mjmerge.cli.style import bold, plain
from mjmerge.config.bounds import whole
from mjmerge.errors import MjmergeError, UnknownNameError

IDEAL = "double_integrator"
MOST_STEPS = 20
"""In which a follower is tightened."""


@dataclass(frozen=True)
class Traffic:
    """Make scenarios of the lane changes in recorded traffic, and put the law beside the human.

    Each lane change in which leader and follower are seen becomes a scenario: the law is where the human
    was, the others drive as they were recorded. It is run once, and judged. Exit code 0: the file was read,
    whatever the verdicts; 2: bad input; 3: a simulation failed. With --export, write a recording as a
    CommonRoad file, for others' tools.
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """CommonRoad 2020a (.xml), or a table (.csv) with --map; with --export, the .xml file to write."""
    map: Annotated[str, unsaid("NAME|FILE")] = ""
    """Columns of a table: ngsim, highd, or a YAML file like theirs; by default what its header fits."""
    tighten: Annotated[Count, tyro.conf.arg(metavar="STEPS")] = 0
    """Also move each follower towards the least gap that Assumption 1 allows, in so many steps."""
    plant: PlantName = IDEAL
    """What moves the cars."""
    out: Annotated[Path | None, unsaid("DIR")] = None
    """Folder for everything; by default traffic/<file>, where an earlier one makes way."""
    export: Annotated[Path | None, unsaid("RUN")] = None
    """Write this recording, a run folder, or a .mcap or .rrd file, finished or not; read no traffic."""
    step: Annotated[float | None, unsaid("SECONDS")] = None
    """With --export: time between two states, a whole multiple of the control step; by default that."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        if self.export is not None:
            return self._export(self.export)
        if self.step is not None:
            raise MjmergeError("--step goes with --export")
        whole("--tighten", self.tighten, 0, MOST_STEPS)
        from rich.console import Console
        from rich.table import Table

        from mjmerge.cli.places import traffic_folder
        from mjmerge.merges.judged import as_json, merges
        from mjmerge.merges.report import FILES, sentence, write
        from mjmerge.outputs import prepare
        from mjmerge.roster import PLANTS
        from mjmerge.traffic.read import read

        if self.plant not in PLANTS:
            raise UnknownNameError("plant", self.plant, PLANTS)
        traffic = read(self.file, self.map)
        words = [self.plant] if self.plant != IDEAL else []
        words += [f"tighten_{self.tighten}"] if self.tighten else []
        folder = traffic_folder(self.file, words) if self.out is None else self.out
        if prepare(folder, self.out is None, FILES):
            print(f"mjmerge: what was in {folder} was replaced", file=sys.stderr)
        with progress_bar(1.0) as progress:
            found = merges(traffic, self.plant, self.tighten, lambda done, of: progress(done / of))
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

    def _export(self, run: Path) -> int:
        """Write a recording as a CommonRoad file."""
        from mjmerge.record.read import read, recording
        from mjmerge.review.commonroad import write

        other = {"map": "", "tighten": 0, "plant": IDEAL, "out": None}
        for name, default in other.items():
            if getattr(self, name) != default:
                raise MjmergeError(f"--{name} is of traffic that is read: it does not go with --export")
        if self.file.suffix != ".xml":
            raise MjmergeError(f"a CommonRoad file ends with .xml, got {self.file}")
        write(read(recording(run)), self.file, self.step)
        print(json.dumps({"file": str(self.file)}) if self.json else self.file)
        return 0
