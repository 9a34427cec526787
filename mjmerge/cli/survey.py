"""``mjmerge survey``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import tyro

from mjmerge.cli.options import Count, at_least
from mjmerge.cli.progress import progress_bar


@dataclass(frozen=True)
class Survey:
    """Count how often the decision goes wrong among random merges: the printed mu-law and the gated one."""

    runs: Count = 1000
    """Number of merges for each variant."""
    seed: Count = 0
    """Seed of the first."""
    variants: Annotated[tuple[str, ...], tyro.conf.arg(metavar="VARIANT")] = ("literal", "gated")
    """Variants of the law; see `mjmerge list laws`."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console

        from mjmerge.paper.survey import SurveyCounts as Found
        from mjmerge.paper.survey import survey
        from mjmerge.paper.tables import survey_table

        at_least(1, runs=self.runs)
        at_least(0, seed=self.seed)
        found: list[Found] = []
        with progress_bar(self.runs * len(self.variants), "surveying") as progress:
            for variant in self.variants:
                before = self.runs * len(found)
                found.append(survey(self.runs, self.seed, variant, partial(_further, progress, before)))
        Console(highlight=False).print(survey_table(found))
        return 0


def _further(progress: Callable[[float], None], before: int, done: int) -> None:
    progress(before + done)
