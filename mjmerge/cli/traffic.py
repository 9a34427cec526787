"""``mjmerge traffic``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mjmerge.errors import MjmergeError


@dataclass(frozen=True)
class Traffic:
    """Write a recording as a CommonRoad file (XML 2020a), for others' tools."""

    file: Annotated[Path, tyro.conf.Positional]
    """The file to write, .xml."""
    export: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None
    """The recording: a run folder, or a .mcap or .rrd file, finished or not."""
    step_s: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Time between two states, s, a whole multiple of the control step; by default that."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.record.read import read, recording
        from mjmerge.review.commonroad import write

        if self.export is None:
            raise MjmergeError("say what to write: --export RUN")
        if self.file.suffix != ".xml":
            raise MjmergeError(f"a CommonRoad file ends with .xml, got {self.file}")
        write(read(recording(self.export)), self.file, self.step_s)
        print(self.file)
        return 0
