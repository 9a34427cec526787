"""What ``verify`` finds: a thing that was looked at, and whether it is right."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjmerge.state import Array

_MOST_NAMED = 3


@dataclass(frozen=True)
class Check:
    """One thing looked at.

    Attributes:
        name: what.
        right: whether it is right; ``None`` for what is worth knowing and neither.
        says: what was found, in words.
    """

    name: str
    right: bool | None
    says: str


def checked(name: str, wrong: list[str], says: str) -> Check:
    """A check that is right where nothing is wrong."""
    return Check(name, not wrong, some(wrong) if wrong else says)


def some(items: list[str]) -> str:
    """The first few of a list."""
    more = f", and {len(items) - _MOST_NAMED} more" if len(items) > _MOST_NAMED else ""
    return "; ".join(items[:_MOST_NAMED]) + more


def compared(
    columns: Mapping[str, Array],
    expected: Mapping[str, Array],
    time_s: Array,
    relative: float,
    absolute: float | Mapping[str, Array],
) -> tuple[list[str], float]:
    """Recorded columns against what they should be.

    Args:
        columns: the recorded ones by name, (T, ...).
        expected: what they should be, by name, (T, ...); NaN where they should be.
        time_s: time of each row, s, (T,).
        relative: how far off a number may be, over its size.
        absolute: how far beside that, in the column's unit; one number, or by column, broadcast to it.

    Returns:
        Which are off most, by how much and when, in words; how far any is off that may be.
    """
    wrong: list[tuple[float, str]] = []
    most = 0.0
    for name, value in expected.items():
        there = columns[name]
        bound = absolute[name] if isinstance(absolute, Mapping) else absolute
        with np.errstate(all="ignore"):
            same = (there == value) | (np.isnan(there) & np.isnan(value))
            off = np.where(same, 0.0, np.abs(there - value))
            bad = ~(same | (off <= bound + relative * np.abs(value)))
        most = max(most, float(np.nanmax(np.where(bad, 0.0, off), initial=0.0)))
        if bad.any():
            rows = np.flatnonzero(bad.reshape(len(bad), -1).any(axis=1))
            worst = float(np.max(np.where(bad, np.nan_to_num(off, nan=np.inf), 0)))
            first_s = float(time_s[rows[0]])
            wrong.append(
                (
                    first_s,
                    f"{name} is off at {len(rows)} ticks, first at {first_s:.2f} s, by up to {worst:.3g}",
                )
            )
    return [text for _, text in sorted(wrong, key=lambda pair: pair[0])], most


def differing(
    key: str, claimed: Any, expected: Any, relative: float, who: str = "its numbers say"
) -> list[str]:
    """Where what a file claims differs from what follows from its numbers, key by key."""
    if isinstance(expected, Mapping) and isinstance(claimed, Mapping):
        return [
            text
            for part in sorted(expected.keys() | claimed.keys())
            for text in differing(f"{key}.{part}", claimed.get(part), expected.get(part), relative, who)
        ]
    if isinstance(expected, list | tuple) and isinstance(claimed, list) and len(claimed) == len(expected):
        pairs = zip(claimed, expected, strict=True)
        return [
            text for i, (c, e) in enumerate(pairs) for text in differing(f"{key}[{i}]", c, e, relative, who)
        ]
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (claimed, expected))
    if numbers:
        if claimed == expected or abs(claimed - expected) <= relative * max(1.0, abs(expected)):
            return []
        return [f"{key}: the file says {claimed:.6g}, {who} {expected:.6g}"]
    if type(claimed) is type(expected) and claimed == expected:
        return []
    return [f"{key}: the file says {_short(claimed)}, {who} {_short(expected)}"]


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 120 else text[:117] + "..."
