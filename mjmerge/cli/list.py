"""``mjmerge list``."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mjmerge.config import shipped

if TYPE_CHECKING:
    from rich.table import Table

_WIDE = 1000


@dataclass(frozen=True)
class List:
    """List what there is: scenarios, campaigns, models, laws, drivers, plants, metrics, axes of mismatch."""

    what: Annotated[
        Literal["all", "scenarios", "campaigns", "models", "laws", "drivers", "plants", "metrics", "axes"],
        tyro.conf.Positional,
    ] = "all"
    """Which kind to list: a line on each, and of axes their unit, range, default, levels and plants."""
    json: bool = False
    """Print one JSON object, by kind and name, and nothing else."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.config.doors import installed
        from mjmerge.drivers import kinds
        from mjmerge.drivers.outside import GROUP
        from mjmerge.law import VARIANTS
        from mjmerge.law import kinds as laws
        from mjmerge.law.outside import DEFAULT as PAPER
        from mjmerge.law.outside import GROUP as LAWS
        from mjmerge.plant import PLANTS
        from mjmerge.scenario.axis_tables import as_json
        from mjmerge.scenario.cars import data_sheet
        from mjmerge.scenario.load import load
        from mjmerge.scenario.metrics import GROUP as METRICS
        from mjmerge.scenario.mismatch import Mismatch
        from mjmerge.sweep.campaign import described as campaign_line
        from mjmerge.vehicle.acceptance import acceptance

        def first_line(text: str | None) -> str:
            return (text or "").strip().splitlines()[0]

        def described(name: str, folder: Path) -> str:
            state = acceptance(folder).state
            return f"{data_sheet(name).description} (acceptance tests: {state})"

        what: dict[str, Callable[[], Mapping[str, Any]]] = {
            "scenarios": lambda: {name: load(name).description for name in shipped.scenarios()},
            "campaigns": lambda: {name: campaign_line(path) for name, path in shipped.campaigns().items()},
            "models": lambda: {name: described(name, folder) for name, folder in shipped.models().items()},
            "laws": lambda: (
                {name: first_line(cls.__doc__) for name, cls in laws().items()}
                | {f"{PAPER}, variant {name}": line for name, line in VARIANTS.items()}
                | {name: f"from outside: {value}" for name, value in sorted(installed(LAWS).items())}
            ),
            "drivers": lambda: (
                {
                    name: f"{first_line(cls.__doc__)} {'It can lead.' if cls.can_lead else 'It follows.'}"
                    for name, cls in sorted(kinds().items())
                }
                | {name: f"from outside: {value}" for name, value in sorted(installed(GROUP).items())}
            ),
            "plants": lambda: PLANTS,
            "metrics": lambda: installed(METRICS),
            "axes": lambda: as_json(Mismatch),
        }
        listed = {kind: entries() for kind, entries in what.items() if self.what in ("all", kind)}
        if self.json:
            print(json.dumps(listed, indent=2))
        else:
            _show({kind: entries for kind, entries in listed.items() if entries or self.what == kind})
        return 0


def _show(listed: Mapping[str, Mapping[str, Any]]) -> None:
    """A table of each kind; where no window bounds its width, that of axes has a line for each."""
    from rich.console import Console

    console = Console(highlight=False)
    for kind, entries in listed.items():
        if kind != "axes":
            console.print(_lines(kind, entries))
            continue
        table, notes = _axes()
        if not console.is_terminal:
            unbounded = console.options.update(width=_WIDE)
            console.width = max(console.width, console.measure(table, options=unbounded).maximum)
        console.print(table)
        for note in notes:
            console.print(note, soft_wrap=True)


def _lines(kind: str, entries: Mapping[str, str]) -> Table:
    from rich.table import Table

    grid = Table(title=kind, title_justify="left", title_style="bold", show_header=False, box=None)
    grid.add_column(style="cyan", no_wrap=True)
    grid.add_column()
    for name, line in entries.items():
        grid.add_row(name, line)
    return grid


def _axes() -> tuple[Table, list[str]]:
    """The table of all axes, and what some of them need to mean anything."""
    from rich.table import Table

    from mjmerge.config.acts import listed
    from mjmerge.scenario.axis import LEVEL_NAMES, SIZES
    from mjmerge.scenario.axis_tables import rows
    from mjmerge.scenario.mismatch import Mismatch

    title = f"axes of mismatch, and their levels: {', '.join(LEVEL_NAMES)}"
    grid = Table(title=title, title_justify="left", title_style="bold", box=None)
    grid.add_column("axis", style="cyan", no_wrap=True)
    for head in ("unit", "range", "default", *SIZES.values(), "acts on"):
        grid.add_column(head, overflow="fold")
    needs: dict[str, list[str]] = {}
    for row in rows(Mismatch):
        grid.add_row(row.name, row.unit, row.range, row.default, *row.sizes, row.axis.plants)
        if row.axis.only:
            needs.setdefault(row.axis.only, []).append(row.name)
    return grid, [f" {listed(tuple(names))}: only {what}" for what, names in needs.items()]
