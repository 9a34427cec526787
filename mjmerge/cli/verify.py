"""``mjmerge verify``."""

from __future__ import annotations

import json
from dataclasses import dataclass

from mjmerge.cli.options import Flag, RunPath
from mjmerge.cli.style import bold


@dataclass(frozen=True)
class Verify:
    """Check a recording with nothing but the file, or a run folder with all its files.

    Exit code 0: right; 1: something wrong; 2: unreadable.
    """

    run: RunPath
    """A run folder, or a .mcap or .rrd file, finished or not."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console

        from mjmerge.review.folder import verify_run
        from mjmerge.review.verify import table, verify

        found = verify(self.run) if self.run.is_file() else verify_run(self.run)
        if self.json:
            print(json.dumps(found.as_dict()))
        else:
            console = Console(highlight=False)
            console.print(bold(found.recorded.path), soft_wrap=True)
            console.print(table(found))
        return 0 if found.right else 1
