"""The axes of mismatch as they are shown: row by row, as JSON, and in ``docs/mismatch.md``."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import Any, NamedTuple

from mjmerge.config.frozen import Frozen
from mjmerge.config.units import written
from mjmerge.scenario.axis import LEVEL_NAMES, SIZES, Axis, axes, levels, ranges


class AxisRow(NamedTuple):
    """An axis in words; of ``sizes`` its levels for each of :data:`SIZES`, one after the other."""

    name: str
    unit: str
    range: str
    default: str
    sizes: tuple[str, ...]
    axis: Axis


def rows(model: type[Frozen]) -> list[AxisRow]:
    """Every axis of a mismatch in words, in the order in which they are declared."""
    bounds, steps = ranges(model), levels(model)
    return [
        AxisRow(
            name,
            "-" if "enum" in bounds[name] else written(name),
            _range(bounds[name]),
            _words(model.model_fields[name].default),
            tuple(", ".join(_words(level[name]) for level in steps[size].get(name, ())) for size in SIZES),
            axis,
        )
        for name, axis in axes(model).items()
    ]


def as_json(model: type[Frozen]) -> dict[str, dict[str, Any]]:
    """Every axis of a mismatch as plain values; ranges as in JSON Schema, levels with all their keys."""
    bounds, steps = ranges(model), levels(model)
    return {
        row.name: {
            "part": row.axis.part,
            "unit": row.unit,
            "range": bounds[row.name],
            "default": model.model_fields[row.name].default,
            "levels": {
                size: dict(zip(LEVEL_NAMES, map(dict, steps[size].get(row.name, ())), strict=False))
                for size in SIZES
            },
            "plants": list(row.axis.on),
            "only": row.axis.only,
            "changes": row.axis.changes,
            "source": row.axis.source,
        }
        for row in rows(model)
    }


def markdown(model: type[Frozen]) -> str:
    """The tables of what each axis is, a heading and a table for each part."""
    sizes = (f"{size}: {', '.join(LEVEL_NAMES)}" for size in SIZES.values())
    head = ("key", "unit", "range", "default", "what it changes", *sizes, "where the numbers come from")
    parts = []
    for part, there in groupby(rows(model), lambda row: row.axis.part):
        cells = (
            (f"`{r.name}`", r.unit, r.range, r.default, r.axis.changes, *r.sizes, r.axis.source)
            for r in there
        )
        parts.append(f"### {part[0].upper()}{part[1:]}\n\n" + "\n".join(_table(head, cells)) + "\n")
    return "\n".join(parts)


def where_markdown(model: type[Frozen]) -> str:
    """The table of where the axes act, those that act alike in a row."""
    alike: dict[str, list[str]] = {}
    for name, axis in axes(model).items():
        alike.setdefault(axis.where, []).append(f"`{name}`")
    found = ((", ".join(names), where) for where, names in alike.items())
    return "\n".join(_table(("keys", "act on"), found)) + "\n"


def _table(head: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> Iterator[str]:
    yield f"| {' | '.join(head)} |"
    yield "|---" * len(head) + "|"
    yield from (f"| {' | '.join(cells)} |" for cells in rows)


def _range(bounds: dict[str, Any]) -> str:
    """In words: from 0; above 0 to 2; slip, ideal."""
    if "enum" in bounds:
        return ", ".join(bounds["enum"])
    low, above = bounds.get("minimum"), bounds.get("exclusiveMinimum")
    high, below = bounds.get("maximum"), bounds.get("exclusiveMaximum")
    least = "" if low is None else f"{low:g}"
    if above is not None:
        least = f"above {above:g}"
    most = "" if high is None else f"{high:g}"
    if below is not None:
        most = f"below {below:g}"
    if not most:
        return f"from {least}" if low is not None else least or "any"
    return f"{least} to {most}" if least else f"up to {most}"


def _words(value: object) -> str:
    return "null" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
