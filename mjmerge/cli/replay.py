"""``mjmerge replay``."""

from __future__ import annotations

import json
from dataclasses import dataclass

from mjmerge.cli.options import Count, Flag, RunPath, at_least
from mjmerge.cli.progress import progress_bar
from mjmerge.cli.style import bold


@dataclass(frozen=True)
class Replay:
    """Run a recording's scenario again and compare bit for bit. Exit code 0: same; 1: not; 2: unreadable."""

    run: RunPath
    """A run folder, or a .mcap or .rrd file, finished or not."""
    any_code: Flag = False
    """Run laws, drivers and metrics from outside though their code here is not what the recording carries."""
    threads: Count = 0
    """Threads for the physics, 0 for all cores; does not change the result."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console

        from mjmerge.record.read import recording
        from mjmerge.review.replay import replay

        at_least(0, threads=self.threads)
        path = recording(self.run)
        with progress_bar(1.0, "replaying") as progress:
            done = replay(path, self.threads, progress, any_code=self.any_code)
        if self.json:
            print(json.dumps(done.as_dict()))
        else:
            console = Console(highlight=False, soft_wrap=True)
            console.print(bold(path))
            for line in done.lines():
                console.print(line, markup=False)
        return 0 if done.same else 1
