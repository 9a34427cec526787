"""How large a campaign is, counted before anything is listed."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod
from typing import TYPE_CHECKING

from mjmerge.config.bounds import MOST_RUNS, MOST_SEED
from mjmerge.scenario.levels import LEVELS
from mjmerge.sweep.plan import is_mismatch

if TYPE_CHECKING:
    from mjmerge.sweep.campaign import Block, Campaign

MOST_SCENARIOS = 5_000
"""Different scenarios that a campaign may be made of: each is loaded and checked, its mismatch aside."""


def too_much(campaign: Campaign) -> Iterator[tuple[str, str]]:
    """What of a campaign is too much: message and key."""
    runs = scenarios = 0
    for i, block in enumerate(campaign.blocks):
        at = f"blocks.{i}"
        points, distinct = _points(block)
        each = len(block.scenarios) * len(block.plants) * max(1, len(block.variants) + len(block.laws))
        runs += each * points * block.seeds
        scenarios += each * distinct
        if runs > MOST_RUNS:
            yield f"that makes {runs} runs or more; a campaign has at most {MOST_RUNS}", _largest(block, at)
            return
        if scenarios > MOST_SCENARIOS:
            yield (
                f"that makes {scenarios} scenarios or more that differ in more than their mismatch; "
                f"a campaign has at most {MOST_SCENARIOS}",
                _largest(block, at),
            )
            return
        draws = block.random.draws if block.random else 1
        last = block.first_seed + draws * block.seeds - 1
        if last > MOST_SEED:
            yield (
                f"the last run would have the seed {last}; a seed is at most {MOST_SEED}",
                f"{at}.first_seed",
            )
        if block.random is not None and block.random.seed > MOST_SEED:
            yield f"must be at most {MOST_SEED}", f"{at}.random.seed"


def _points(block: Block) -> tuple[int, int]:
    """Points of a block, at least, and how many of them differ in more than their mismatch, at most."""
    sizes = {key: len(values) for key, values in block.grid.items()}
    named = list(block.mismatches.values())
    points = len(named) + (prod(sizes.values()) if sizes else 0)
    distinct = sum(not all(map(is_mismatch, keys)) for keys in named)
    if any(not is_mismatch(key) for key in sizes):
        distinct += prod(size for key, size in sizes.items() if not is_mismatch(key))
    if block.levels:
        points += len(block.levels) * min(len(axes) for axes in LEVELS.values())
    if block.random is not None:
        points += block.random.draws
        distinct += 0 if all(map(is_mismatch, block.random.axes)) else block.random.draws
    return max(points, 1), max(distinct, 1)


def _largest(block: Block, at: str) -> str:
    """The key that makes the most of a block."""
    sizes = {
        "grid": prod(len(values) for values in block.grid.values()),
        "random.draws": block.random.draws if block.random else 0,
        "seeds": block.seeds,
        "mismatches": len(block.mismatches),
        "scenarios": len(block.scenarios),
    }
    return f"{at}.{max(sizes, key=lambda key: sizes[key])}"
