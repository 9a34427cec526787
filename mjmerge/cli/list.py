"""``mjmerge list``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mjmerge.config import shipped


@dataclass(frozen=True)
class List:
    """List what there is: scenarios, campaigns, models, laws, drivers, plants, metrics, a line on each."""

    what: Annotated[
        Literal["all", "scenarios", "campaigns", "models", "laws", "drivers", "plants", "metrics"],
        tyro.conf.Positional,
    ] = "all"
    """Which kind to list."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from rich.console import Console
        from rich.table import Table

        from mjmerge.config.doors import installed
        from mjmerge.drivers import kinds
        from mjmerge.drivers.outside import GROUP
        from mjmerge.law import VARIANTS
        from mjmerge.plant import PLANTS
        from mjmerge.scenario.cars import data_sheet
        from mjmerge.scenario.load import load
        from mjmerge.scenario.metrics import GROUP as METRICS
        from mjmerge.sweep.campaign import described as campaign_line
        from mjmerge.vehicle.acceptance import acceptance

        def first_line(text: str | None) -> str:
            return (text or "").strip().splitlines()[0]

        def described(name: str, folder: Path) -> str:
            state = acceptance(folder).state
            return f"{data_sheet(name).description} (acceptance tests: {state})"

        what: dict[str, Callable[[], dict[str, str]]] = {
            "scenarios": lambda: {name: load(name).description for name in shipped.scenarios()},
            "campaigns": lambda: {name: campaign_line(path) for name, path in shipped.campaigns().items()},
            "models": lambda: {name: described(name, folder) for name, folder in shipped.models().items()},
            "laws": lambda: VARIANTS,
            "drivers": lambda: (
                {
                    name: f"{first_line(cls.__doc__)} {'It can lead.' if cls.can_lead else 'It follows.'}"
                    for name, cls in sorted(kinds().items())
                }
                | {name: f"from outside: {value}" for name, value in sorted(installed(GROUP).items())}
            ),
            "plants": lambda: PLANTS,
            "metrics": lambda: installed(METRICS),
        }
        console = Console(highlight=False)
        for kind, entries in what.items():
            if self.what == kind or (self.what == "all" and (kind != "metrics" or entries())):
                grid = Table(
                    title=kind, title_justify="left", title_style="bold", show_header=False, box=None
                )
                grid.add_column(style="cyan", no_wrap=True)
                grid.add_column()
                for name, line in entries().items():
                    grid.add_row(name, line)
                console.print(grid)
        return 0
