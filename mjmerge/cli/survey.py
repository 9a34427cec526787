"""``mjmerge survey``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import tyro

from mjmerge.cli.progress import progress_bar
from mjmerge.errors import MjmergeError


@dataclass(frozen=True)
class Survey:
    """Count how often the decision goes wrong among random merges: the printed mu-law and the gated one."""

    runs: Annotated[int, tyro.conf.arg(metavar="N")] = 1000
    """Number of merges for each variant."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Seed of the first."""
    variants: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ("literal", "gated")
    """Variants of the law; see `mjmerge list laws`."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console

        from mjmerge.report import survey_table
        from mjmerge.survey import Survey as Found
        from mjmerge.survey import survey

        if self.runs < 1 or self.seed < 0:
            raise MjmergeError("--runs must be at least 1, --seed at least 0")
        found: list[Found] = []
        with progress_bar(self.runs * len(self.variants), "surveying") as progress:
            for variant in self.variants:
                before = self.runs * len(found)
                found.append(survey(self.runs, self.seed, variant, partial(_further, progress, before)))
        Console(highlight=False).print(survey_table(found))
        return 0


def _further(progress: Callable[[float], None], before: int, done: int) -> None:
    progress(before + done)
