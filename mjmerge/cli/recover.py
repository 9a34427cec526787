"""``mjmerge recover``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from mjmerge.cli.options import RunPath, unsaid


@dataclass(frozen=True)
class Recover:
    """Rewrite the recording of a run that was killed as a whole file; the old one stays."""

    run: RunPath
    """A run folder, or an unfinished .mcap or .rrd file (*.partial)."""
    out: Annotated[Path | None, unsaid("FILE")] = None
    """File to write; by default run.recovered.mcap or run.recovered.rrd beside the old one."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.record.read import recording
        from mjmerge.review.recover import recover, recovered_name

        path = recording(self.run)
        out = self.out or recovered_name(path)
        found = recover(path, out)
        print(f"{out}: {len(found.ticks)} ticks, up to {found.last_s:.2f} s")
        return 0
