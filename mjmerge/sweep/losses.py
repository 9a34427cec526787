"""Runs that kill whoever works on them: they have no row, and the table says so."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mjmerge.sweep.plan import Plan

if TYPE_CHECKING:
    import pyarrow as pa

_TOLD = b"mjmerge"
LOST = "lost"


def lost_of(table: pa.Table) -> dict[int, str]:
    """Runs that a table, or a part of one, has no row of, and what was seen of each.

    Raises:
        ValueError: that cannot be read.
    """
    told = json.loads((table.schema.metadata or {}).get(_TOLD, b"{}"))
    lost = told.get(LOST, {}) if isinstance(told, dict) else None
    if not isinstance(lost, dict):
        raise ValueError("it does not say what it lacks")
    return {int(run): str(why) for run, why in lost.items()}


def as_json(plan: Plan, lost: Mapping[int, str]) -> list[dict[str, Any]]:
    """Each with what it is, and the command that gives it alone."""
    return [
        {
            "run": run,
            "scenario": plan.labels[case.batch.source],
            "plant": case.batch.plant,
            "variant": case.batch.scenario.law.label,
            "mismatch": case.point,
            "seed": case.seed,
            "why": why,
            "command": shlex.join(("mjmerge", *case.command)),
        }
        for run, why in sorted(lost.items())
        for case in (plan.cases[run],)
    ]


def lines(plan: Plan, lost: Mapping[int, str]) -> list[str]:
    """The same in words, a line each."""
    return [
        "no row of run {run} ({scenario} on {plant}, {variant}, mismatch {mismatch}, seed {seed}): "
        "its worker died {why}; alone it is `{command}`".format(**one)
        for one in as_json(plan, lost)
    ]
