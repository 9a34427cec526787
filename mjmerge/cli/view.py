"""``mjmerge view``."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from mjmerge.cli.options import Flag, RunPath
from mjmerge.errors import UnknownNameError


@dataclass(frozen=True)
class View:
    """Open a recording in the Rerun viewer, which talks to nobody."""

    run: RunPath
    """A run folder, or a .mcap or .rrd file."""
    check: Flag = False
    """Open no window: only make what the viewer would be shown, and say whether that can be."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.record.read import read
        from mjmerge.record.rerun.viewer import command, environment

        places = (self.run, Path("runs") / self.run)
        files = [p / "run.rrd" if p.is_dir() else p for p in places]
        file = next((f for f in files if f.is_file() and f.suffix in (".rrd", ".mcap")), None)
        if file is None:
            raise UnknownNameError(
                "recording", str(self.run), [str(p.parent) for p in Path("runs").glob("*/run.rrd")]
            )
        with tempfile.TemporaryDirectory() as folder:
            shown = file
            if file.suffix == ".mcap":
                from mjmerge.review.view import write_view

                shown = Path(folder) / "mcap.rrd"
                write_view(file, shown)
            elif self.check:
                read(file)
            if self.check:
                print(f"{file} can be shown")
                return 0
            code = subprocess.run(command(str(shown)), env=environment(), check=False).returncode
        if code:
            print(
                "mjmerge: the Rerun viewer needs a display; without one, open the recording on another "
                f"machine (`rerun {file.name}`, same Rerun version), or its run.mcap in Foxglove",
                file=sys.stderr,
            )
            return 3
        return 0
