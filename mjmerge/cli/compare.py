"""``mjmerge compare``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from mjmerge.cli.options import Flag, RunPath, unsaid
from mjmerge.cli.style import bold, plain


@dataclass(frozen=True)
class Compare:
    """Show two recordings side by side: a table, figure.png, and compare.rrd with both in one scene."""

    a: RunPath
    """A run folder, or a .mcap or .rrd file, finished or not."""
    b: RunPath
    """Another."""
    out: Annotated[Path | None, unsaid("DIR")] = None
    """Folder for figure and recording; by default compared, where an earlier one makes way."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console

        from mjmerge.outputs import prepare
        from mjmerge.record.read import read, recording
        from mjmerge.review.compare import Side, as_dict, figure, identical, recording_of_both, table

        a, b = (Side.of(read(recording(path))) for path in (self.a, self.b))
        folder = self.out or Path("compared")
        if prepare(folder, self.out is None, ("figure.png", "compare.rrd")):
            print(f"mjmerge: what was in {folder} was replaced", file=sys.stderr)
        figure(a, b, folder / "figure.png")
        recording_of_both(a, b, folder / "compare.rrd")
        if self.json:
            print(json.dumps(as_dict(a, b)))
            return 0
        console = Console(highlight=False)
        for side, name in ((a, "A"), (b, "B")):
            console.print(f"{bold(name)}  {plain(side.recorded.path)}", soft_wrap=True)
        console.print(table(a, b))
        if identical(a.recorded, b.recorded):
            console.print("every column is the same, bit for bit")
        console.print(f"figure and both cars in one scene:  {bold(folder)}", soft_wrap=True)
        return 0
