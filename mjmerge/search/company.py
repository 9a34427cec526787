"""Keys of a scenario that act only in company, such as a patch of ice, where it begins and how long it is.

Which these are is not listed anywhere: a key goes with another if it is in vain once that one is taken back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mjmerge.errors import ScenarioError
from mjmerge.roster import PLANTS
from mjmerge.scenario.effect import without
from mjmerge.scenario.schema import Scenario
from mjmerge.search.space import altered
from mjmerge.sweep.plan import MISMATCH

_MOST = list(PLANTS)[-1]
"""The plant on which every key acts that acts on any."""


@dataclass(frozen=True)
class Company:
    """Keys that act only together.

    Attributes:
        keys: all of them, the first one is what the others go with.
        amounts: those without which others are in vain: how much there is of it. The rest says where or how.
    """

    keys: tuple[str, ...]
    amounts: frozenset[str]


def companies(base: Scenario, axes: Mapping[str, Any]) -> list[Company]:
    """The keys of a scenario that differ from another's, those that act only together as one.

    Args:
        base: that other scenario.
        axes: the keys and their values, in the order in which they are to come out.
    """
    needs: dict[str, set[str]] = {key: set() for key in axes}
    try:
        idle = _idle(base, axes)
        for key in axes:
            left = {other: value for other, value in axes.items() if other != key}
            for other in (_idle(base, left) - idle) & left.keys():
                needs[other].add(key)
    except ScenarioError:  # what is no scenario is left as it is: each for itself
        return [Company((key,), frozenset({key})) for key in axes]
    amounts = {one for of in needs.values() for one in of}
    found: list[set[str]] = []
    for key in axes:
        mine = {key, *needs[key]}
        found = [*(one for one in found if not one & mine), mine.union(*(one for one in found if one & mine))]
    order = list(axes)
    groups = []
    for group in found:
        much = group & amounts or group
        first = min(much, key=order.index)
        rest = sorted(group - {first}, key=order.index)
        groups.append(Company((first, *rest), frozenset(much)))
    return sorted(groups, key=lambda group: min(map(order.index, group.keys)))


def _idle(base: Scenario, axes: Mapping[str, Any]) -> set[str]:
    """Keys that are in vain with these in place."""
    other = {key: value for key, value in axes.items() if not key.startswith(MISMATCH)}
    mine = {key.removeprefix(MISMATCH): value for key, value in axes.items() if key not in other}
    scenario = altered(base, other)
    mismatch = scenario.mismatch.model_copy(update=mine)
    return {*without(scenario.model_copy(update={"mismatch": mismatch}), _MOST)}
