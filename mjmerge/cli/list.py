"""``mjmerge list``."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mjmerge.cli.options import Flag
from mjmerge.cli.style import bold, plain
from mjmerge.config import shipped
from mjmerge.roster import PLANTS

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_WIDE = 1000
_DESCRIPTION = re.compile(r"^description:.*?(?=^[^\s#]|\Z)", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class List:
    """List what there is: scenarios, campaigns, models, laws, drivers, plants, metrics, axes of mismatch."""

    what: Annotated[
        Literal["all", "scenarios", "campaigns", "models", "laws", "drivers", "plants", "metrics", "axes"],
        tyro.conf.Positional,
    ] = "all"
    """Which kind to list; listed alone, axes and drivers have unit, default and meaning of each key."""
    json: Flag = False
    """Print one JSON object, by kind and name, and nothing else."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        what: dict[str, Callable[[], Mapping[str, Any]]] = {
            "scenarios": _scenarios,
            "campaigns": _campaigns,
            "models": _models,
            "laws": _laws,
            "drivers": lambda: _drivers(in_full=self.json or self.what == "drivers"),
            "plants": lambda: PLANTS,
            "metrics": _metrics,
            "axes": _mismatch,
        }
        listed = {kind: entries() for kind, entries in what.items() if self.what in ("all", kind)}
        if self.json:
            print(json.dumps(listed, indent=2))
        else:
            shown = {kind: entries for kind, entries in listed.items() if entries or self.what == kind}
            _show(shown, in_full=self.what == "drivers")
        return 0


def _scenarios() -> dict[str, str]:
    return {name: _described(path) for name, path in shipped.scenarios().items()}


def _campaigns() -> dict[str, str]:
    return {name: _described(path) for name, path in shipped.campaigns().items()}


def _described(path: Path) -> str:
    """A file's description, without the rest of what it says: a scenario takes its time to read."""
    from mjmerge.config.document import parse

    said = _DESCRIPTION.search(path.read_text(encoding="utf-8"))
    value = parse(said[0]).value if said else {}
    return str(value.get("description", "")) if isinstance(value, dict) else ""


def _models() -> dict[str, str]:
    from mjmerge.scenario.cars import data_sheet
    from mjmerge.vehicle.acceptance import acceptance

    def described(name: str, folder: Path) -> str:
        state = acceptance(folder).state
        return f"{data_sheet(name).description} (acceptance tests: {state})"

    return {name: described(name, folder) for name, folder in shipped.models().items()}


def _laws() -> dict[str, str]:
    from mjmerge.config.doors import installed
    from mjmerge.law import VARIANTS, kinds
    from mjmerge.law.outside import DEFAULT, GROUP

    return (
        {name: _first_line(cls.__doc__) for name, cls in kinds().items()}
        | {f"{DEFAULT}, variant {name}": line for name, line in VARIANTS.items()}
        | {name: f"from outside: {value}" for name, value in sorted(installed(GROUP).items())}
    )


def _drivers(in_full: bool) -> dict[str, dict[str, Any]]:
    """What each does, and in full the keys that it has."""
    from mjmerge.config.doors import installed
    from mjmerge.config.keys import keys
    from mjmerge.drivers import kinds
    from mjmerge.drivers.outside import GROUP

    def told(cls: Any) -> dict[str, Any]:
        said = f"{_first_line(cls.__doc__)} {'It can lead.' if cls.can_lead else 'It follows.'}"
        every = {name: key._asdict() for name, key in keys(cls).items()} if in_full else {}
        return {"what": said, "can_lead": cls.can_lead, "keys": every}

    return {name: told(cls) for name, cls in sorted(kinds().items())} | {
        name: {"what": f"from outside: {value}"} for name, value in sorted(installed(GROUP).items())
    }


def _metrics() -> dict[str, str]:
    from mjmerge.config.doors import installed
    from mjmerge.scenario.metrics import GROUP

    return installed(GROUP)


def _mismatch() -> dict[str, Any]:
    from mjmerge.scenario.axis_tables import as_json
    from mjmerge.scenario.mismatch import Mismatch

    return as_json(Mismatch)


def _first_line(text: str | None) -> str:
    return (text or "").strip().splitlines()[0]


def _show(listed: Mapping[str, Mapping[str, Any]], in_full: bool) -> None:
    """A table of each kind; where no window bounds its width, those of axes and keys have a line for each."""
    from rich.console import Console

    console = Console(highlight=False)
    for kind, entries in listed.items():
        if kind == "drivers" and in_full:
            for name, driver in entries.items():
                console.print(f"{bold(name)}  {plain(driver['what'])}", soft_wrap=True)
                _wide(console, _keys(driver.get("keys", {})))
        elif kind == "drivers":
            console.print(_lines(kind, {name: driver["what"] for name, driver in entries.items()}))
        elif kind == "axes":
            table, notes = _axes(changes=True)
            if console.is_terminal and _width(console, table) > console.width:
                table, notes = _axes(changes=False)
                notes.append(" what each changes: in a wider window, with --json, or in docs/mismatch.md")
            _wide(console, table)
            for note in notes:
                console.print(note, soft_wrap=True)
        else:
            console.print(_lines(kind, entries))


def _wide(console: Console, table: Table) -> None:
    """Prints a table, as wide as it is where no window bounds it."""
    if not console.is_terminal:
        console.width = max(console.width, _width(console, table))
    console.print(table)


def _width(console: Console, table: Table) -> int:
    """How wide a table is where nothing is folded."""
    return console.measure(table, options=console.options.update(width=_WIDE)).maximum


def _lines(kind: str, entries: Mapping[str, str]) -> Table:
    from rich.table import Table

    grid = Table(title=kind, title_justify="left", title_style="bold", show_header=False, box=None)
    grid.add_column(style="cyan", no_wrap=True)
    grid.add_column()
    for name, line in entries.items():
        grid.add_row(name, line)
    return grid


def _keys(of: Mapping[str, Mapping[str, Any]]) -> Table:
    """The keys of a driver: unit, default and meaning."""
    from rich.table import Table
    from rich.text import Text

    grid = Table(box=None, show_header=False)
    grid.add_column(style="cyan", no_wrap=True)
    for _ in ("unit", "default", "meaning"):
        grid.add_column(overflow="fold")
    for name, key in of.items():
        default = "required" if key["required"] else _words(key["default"])
        grid.add_row(Text(name), key["unit"], default, Text(key["meaning"]))
    return grid


def _words(default: Any) -> str:
    if default in ("", ()):
        return "none"
    return "null" if default is None else f"{default:g}" if isinstance(default, float) else str(default)


def _axes(changes: bool) -> tuple[Table, list[str]]:
    """The table of all axes, with what they change or without, and what some need to mean anything."""
    from rich.table import Table
    from rich.text import Text

    from mjmerge.config.acts import listed
    from mjmerge.scenario.axis import LEVEL_NAMES, SIZES
    from mjmerge.scenario.axis_tables import rows
    from mjmerge.scenario.mismatch import Mismatch

    title = f"axes of mismatch, and their levels: {', '.join(LEVEL_NAMES)}"
    grid = Table(title=title, title_justify="left", title_style="bold", box=None)
    grid.add_column("axis", style="cyan", no_wrap=True)
    what = ["what it changes"] if changes else []
    for head in ("unit", "range", "default", *SIZES.values(), "acts on", *what):
        grid.add_column(head, overflow="fold")
    needs: dict[str, list[str]] = {}
    for row in rows(Mismatch):
        said = [Text(row.axis.changes)] if changes else []
        grid.add_row(row.name, row.unit, row.range, row.default, *row.sizes, row.axis.plants, *said)
        if row.axis.only:
            needs.setdefault(row.axis.only, []).append(row.name)
    return grid, [f" {listed(tuple(names))}: only {what}" for what, names in needs.items()]
