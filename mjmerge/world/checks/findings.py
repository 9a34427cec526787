"""What is wrong with a car, and how it is told: everything at once, and the same thing once."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from mjmerge.roster import WHEELS

MOST_NAMED = 6
"""Parts that one line names; of more it says how many."""
_WHEEL = re.compile("|".join(WHEELS))


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with what has that kind and name.

    Attributes:
        kind: of the part: a tag of MJCF, ``actuator`` or ``sensor``.
        name: of the part; empty if it has none.
        message: what is wrong and what to do about it.
        place: ``file:line``; empty where only its kind and name are known.
    """

    kind: str
    name: str
    message: str
    place: str = ""


def told(findings: Iterable[Finding]) -> list[str]:
    """A line for each thing that is wrong; what is so of several parts alike is told of the first of them."""
    alike: dict[tuple[str, str], list[Finding]] = {}
    for finding in dict.fromkeys(findings):  # two cars may be of one file
        file, _, _ = finding.place.rpartition(":")
        about = _WHEEL.sub("*", finding.message.replace(finding.name or "*", "*", 1))
        alike.setdefault((file, about), []).append(finding)
    return [_line(some) for some in alike.values()]


def listed(names: Iterable[str]) -> str:
    """Names with commas, the first few of them."""
    some = list(names)
    more = f" and {len(some) - MOST_NAMED} more" if len(some) > MOST_NAMED else ""
    return ", ".join(some[:MOST_NAMED]) + more


def _line(alike: list[Finding]) -> str:
    first, *others = alike
    line = f"{first.place}: {first.message}"
    if others:
        names = [f.name for f in others if f.name and "unnamed" not in f.name]
        line += f" (so is {listed(names)})" if names else f" ({len(others)} more are like it)"
    return line
