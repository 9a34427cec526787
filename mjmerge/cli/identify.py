"""``mjmerge identify``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjmerge.cli.options import Flag, unsaid
from mjmerge.cli.progress import progress_bar
from mjmerge.cli.style import bold, plain
from mjmerge.config import shipped


@dataclass(frozen=True)
class Identify:
    """Measure a car model by driving it, against its data sheet. Exit code 0: all holds; 1: not all."""

    model: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")]
    """Name of a shipped model (see `mjmerge list models`), or the path of its folder."""
    out: Annotated[Path | None, unsaid("DIR")] = None
    """Folder for table and plots; by default identified/<model>, where an earlier one makes way."""
    accept: Flag = False
    """Also store the table beside the model, where every run finds whether its cars were accepted."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console

        from mjmerge.cli.places import identified_folder
        from mjmerge.outputs import prepare
        from mjmerge.proving import report as identified
        from mjmerge.proving.identify import identify
        from mjmerge.vehicle.acceptance import store
        from mjmerge.versions import versions
        from mjmerge.world.compose import single

        place = shipped.model_folder(self.model)
        single(self.model)  # a bad car is refused before anything is written
        folder = self.out or identified_folder(place)
        replaced = prepare(folder, self.out is None, identified.FILES)
        with progress_bar(1.0, "driving") as progress:
            found = identify(self.model, progress)
        identified.write(folder, found)
        if self.accept:
            store(place, found.table, versions())
        if self.json:
            print(json.dumps(identified.as_json(found) | {"out": str(folder), "versions": versions()}))
            return 0 if found.passed else 1
        console = Console(highlight=False)
        console.print(identified.rich_table(found.table))
        if replaced:
            console.print(f"what was in {plain(folder)} was replaced")
        console.print(f"table and plots:  {bold(folder)}", soft_wrap=True)
        return 0 if found.passed else 1
