"""A row of the gate, and what came of it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mjmerge.config import shipped
from mjmerge.gate.baseline import RowMargins
from mjmerge.scenario.schema import GateRow, Scenario
from mjmerge.verdict.judge import Verdict


@dataclass(frozen=True)
class RowResult:
    """One row of the gate.

    Attributes:
        file: the scenario's file.
        label: what the scenario is called among those that are checked: two files have two labels.
        check: what it says of this row.
        scenario: the scenario with the row's keys.
    """

    file: Path
    label: str
    check: GateRow
    scenario: Scenario

    @property
    def command(self) -> str:
        """The command that runs this row alone, and records it."""
        where = (
            self.file.stem
            if shipped.scenarios().get(self.file.stem) == self.file.resolve()
            else str(self.file)
        )
        keys = [word for text in self.check.set for word in ("--set", text)]
        seed = ["--seed", str(self.check.seed)] if self.check.seed else []
        return shlex.join(["mjmerge", "run", where, "--plant", self.check.plant, *seed, *keys])


@dataclass(frozen=True)
class Result:
    """A row, measured and judged.

    Attributes:
        row: the row.
        measured: what it came to.
        baseline: what it came to when the baseline was made; ``None`` if there is none.
        made_with: the versions that was with.
        verdict: the contract's.
        stopped: why the simulation ended early; empty if it did not.
        problems: why the row fails; none if it passes.
        metrics: what the scenario's own metrics came to, by name; NaN where they do not know.
        wall_s: how long it took, its part of the batch that it was in, s.
    """

    row: RowResult
    measured: RowMargins
    baseline: RowMargins | None
    made_with: Mapping[str, str]
    verdict: Verdict
    stopped: str
    problems: tuple[str, ...]
    wall_s: float = 0.0
    metrics: Mapping[str, float] = field(default_factory=dict)
