"""Options that several commands share."""

from __future__ import annotations

from typing import Annotated

import tyro

from mjmerge.errors import MjmergeError

Overrides = Annotated[
    tuple[str, ...], tyro.conf.arg(name="set", metavar="KEY=VALUE"), tyro.conf.UseAppendAction
]
"""Scenario keys with other values, ``--set KEY=VALUE``, repeatable."""
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
"""Off unless it is given."""
Count = Annotated[int, tyro.conf.arg(metavar="N")]
"""A whole number."""


def at_least(least: int, **given: int) -> None:
    """Refuses options below a bound.

    Args:
        least: the bound.
        given: options by name.

    Raises:
        MjmergeError: with the first that is below it.
    """
    for name, value in given.items():
        if value < least:
            raise MjmergeError(f"--{name} is {value}; it must be at least {least}")
