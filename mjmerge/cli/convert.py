"""``mjmerge convert``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from mjmerge.cli.options import Flag, RunPath, unsaid
from mjmerge.errors import MjmergeError


@dataclass(frozen=True)
class Convert:
    """Write a recording as a table, a row per tick, units in the column names."""

    run: RunPath
    """A run folder, or a .mcap or .rrd file, finished or not."""
    csv: Flag = False
    """Write CSV."""
    parquet: Flag = False
    """Write Parquet."""
    out: Annotated[Path | None, unsaid("FILE")] = None
    """File to write; by default beside the recording, with the ending .csv or .parquet."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.record.read import read, recording
        from mjmerge.review.convert import to_csv, to_parquet

        if not self.csv and not self.parquet:
            raise MjmergeError("say what to write: --csv, --parquet or both")
        if self.csv and self.parquet and self.out is not None:
            raise MjmergeError("--out names one file: with it, choose either --csv or --parquet")
        path = recording(self.run)
        found = read(path)
        beside = path.with_suffix("") if path.suffix == ".partial" else path
        for wanted, ending, write in ((self.csv, ".csv", to_csv), (self.parquet, ".parquet", to_parquet)):
            if wanted:
                out = self.out or beside.with_suffix(ending)
                write(found, out)
                print(out)
        return 0
