"""Writes a recording again with something changed, as whoever wanted to deceive would: with our own code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjmerge.record import FORMATS, Outcome
from mjmerge.record.read import Recorded, read
from mjmerge.record.recording import PosedBlock
from mjmerge.record.scene import Scene
from mjmerge.review.derived import cars_of, commands, geometry
from mjmerge.review.poses import header, outcome, posed
from mjmerge.simulation.trace import the_truth
from mjmerge.state import Array

Change = Callable[[dict[str, Array]], None]


class Forger:
    """One recording, to be forged."""

    def __init__(self, path: Path) -> None:
        self.found = read(path)
        self.about = header(self.found)
        self.scene = Scene(self.about.model, self.about.scenario.law.r_m)
        self.block = posed(self.found, self.about, self.scene)
        self.true = outcome(self.found, self.found.trace())

    def columns(self, change: Change) -> dict[str, Array]:
        """Copies of the columns, changed; what the ego was told stays the truth if it was."""
        columns = {name: values.copy() for name, values in self.block.block.columns.items()}
        change(columns)
        return columns if self.about.told else columns | the_truth(columns, 0)

    def write(self, folder: Path, change: Change, **claims: Any) -> Path:
        """Changes columns and nothing that follows from them; ``claims`` replace fields of the outcome."""
        block = replace(self.block, block=replace(self.block.block, columns=self.columns(change)))
        return self.store(folder, block, replace(self.true, **claims))

    def consistent(self, folder: Path, change: Change, *, after: Change | None = None) -> Path:
        """Changes columns; all that our own code makes of them is made anew.

        Distances, commands, poses, events, summary, verdict and fingerprints; ``after`` changes what is left.
        """
        found = self._with(self.columns(change))
        c = dict(found.columns)
        law = self.about.scenario.law
        c |= geometry(c["front_m"], c["velocity_mps"], law.r_m, (law.j_1, law.j_2))
        found = replace(found, columns=c)
        c |= commands(found, found.trace(), cars_of(found, found.trace()))
        if not self.about.told:
            c |= the_truth(c, 0)
        if after is not None:
            after(c)
        found = replace(found, columns=c)
        moved = posed(found, self.about, self.scene)  # parts are carried along with their front axles
        end = outcome(found, found.trace())
        return self.store(folder, moved, end)

    def _with(self, columns: dict[str, Array]) -> Recorded:
        return replace(self.found, columns={"time_s": self.found.columns["time_s"], **columns})

    def store(self, folder: Path, block: PosedBlock, end: Outcome) -> Path:
        path = folder / f"forged.{self.found.kind}"
        path.unlink(missing_ok=True)
        recorder = FORMATS[f"run.{self.found.kind}"](path, self.about, self.scene)
        recorder.write(block)
        recorder.close(end)
        return path
