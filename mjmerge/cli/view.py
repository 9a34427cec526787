"""``mjmerge view``."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjmerge.errors import UnknownNameError


@dataclass(frozen=True)
class View:
    """Open a recording in the Rerun viewer."""

    run: Annotated[Path, tyro.conf.Positional]
    """A run folder, or a recording in it."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
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
                from mjmerge.record.mcap_view import write_view

                shown = Path(folder) / "mcap.rrd"
                write_view(file, shown)
            viewer = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(shown)]
            code = subprocess.run(viewer, check=False).returncode
        if code:
            print(
                "mjmerge: the Rerun viewer needs a display; without one, open the recording on another "
                f"machine (`rerun {file.name}`, same Rerun version), or its run.mcap in Foxglove",
                file=sys.stderr,
            )
            return 3
        return 0
