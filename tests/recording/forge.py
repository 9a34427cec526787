"""Writes a recording again with something changed, as whoever wanted to deceive would: with our own code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjmerge.record import FORMATS, Outcome
from mjmerge.record.again import header, outcome, posed
from mjmerge.record.base import PosedBlock
from mjmerge.record.digest import digests
from mjmerge.record.read import read
from mjmerge.record.scene import Scene
from mjmerge.trace import Array, the_truth

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
        return columns if self.about.told else columns | the_truth(columns)

    def write(self, folder: Path, change: Change, **claims: Any) -> Path:
        """Changes columns and nothing that follows from them; ``claims`` replace fields of the outcome."""
        block = replace(self.block, block=replace(self.block.block, columns=self.columns(change)))
        return self.store(folder, block, replace(self.true, **claims))

    def consistent(self, folder: Path, change: Change, draw: bool = True, **claims: Any) -> Path:
        """Changes columns; poses, summary, verdict, events and fingerprints are made of them anew."""
        columns = self.columns(change)
        time_s = self.found.columns["time_s"]
        found = replace(self.found, columns={"time_s": time_s, **columns})
        end = outcome(found, found.trace())
        end = replace(end, digests=digests(found.columns, found.texts), **claims)
        block = replace(self.block, block=replace(self.block.block, columns=columns))
        if draw:  # the cars' parts are carried along with their front axles
            moved = posed(replace(found, path=self.found.path), self.about, self.scene)
            block = replace(block, pos_m=moved.pos_m, quat=moved.quat)
        return self.store(folder, block, end)

    def store(self, folder: Path, block: PosedBlock, end: Outcome) -> Path:
        path = folder / f"forged.{self.found.kind}"
        path.unlink(missing_ok=True)
        recorder = FORMATS[f"run.{self.found.kind}"](path, self.about, self.scene)
        recorder.write(block)
        recorder.close(end)
        return path
