"""``mjmerge reproduce``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from mjmerge.cli.options import unsaid
from mjmerge.cli.progress import progress_bar
from mjmerge.cli.style import bold, plain


@dataclass(frozen=True)
class Reproduce:
    """Redraw the paper's figures and check its published facts. Exit code 0: all reproduced; 1: not all."""

    out: Annotated[Path | None, unsaid("DIR")] = None
    """Folder for figures, tables and animation; by default reproduced, where an earlier one makes way."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console

        from mjmerge.paper.reproduce import reproduce
        from mjmerge.paper.tables import facts_table

        folder = self.out or Path("reproduced")
        with progress_bar(1.0, "reproducing") as progress:
            done = reproduce(folder, replace=self.out is None, progress=progress)
        console = Console(highlight=False)
        console.print(facts_table(done.findings))
        if done.replaced:
            console.print(f"what was in {plain(folder)} was replaced")
        console.print(f"figures, tables and animation:  {bold(folder)}", soft_wrap=True)
        return 0 if done.complete else 1
