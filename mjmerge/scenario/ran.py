"""What ran, in words: in the title of every figure, report, recording and video."""

from __future__ import annotations

from mjmerge.config.doors import from_outside
from mjmerge.law import is_paper
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario

_ELSEWHERE = ("mismatch", "search", "gate")
"""Sections that are told in a line of their own, or are no part of a run."""


def ran(
    scenario: Scenario,
    plant: str,
    seed: int | None = None,
    *,
    continuous: bool = False,
    mismatch: Mismatch | None = None,
) -> list[str]:
    """What ran, every mismatch, and whatever else was given beside the file, a line each.

    Args:
        scenario: the run's.
        plant: what moved the cars.
        seed: of the run; ``None`` where there is not one.
        continuous: whether law and plant were one differential equation.
        mismatch: of the run; by default the scenario's.
    """
    kind = scenario.law.kind
    law = kind if from_outside(kind) else "" if is_paper(scenario.law) else scenario.law.label
    how = ", continuous time" if continuous else ""
    of = "" if seed is None else f", seed {seed}"
    lines = [f"{scenario.name} on {plant}{how}{of}{law and f', {law}'}"]
    off = _off(mismatch or scenario.mismatch)
    if off:
        lines.append(f"mismatch: {', '.join(f'{key} {value}' for key, value in off.items())}")
    others = _others(scenario)
    if others:
        lines.append(f"set: {', '.join(others)}")
    return lines


def given(scenario: Scenario, mismatch: Mismatch | None = None) -> list[str]:
    """Every mismatch, and whatever else was given beside the file, as ``--set`` takes it, to four digits.

    Args:
        scenario: the run's.
        mismatch: of the run; by default the scenario's.
    """
    off = _off(mismatch or scenario.mismatch)
    return [*(f"mismatch.{key}={value}" for key, value in off.items()), *_others(scenario)]


def beneath(scenario: Scenario, plant: str, mismatch: Mismatch | None = None) -> list[str]:
    """Mismatch and settings as Markdown, to stand below a title; nothing where there are none."""
    said = "; ".join(ran(scenario, plant, mismatch=mismatch)[1:])
    return [f"**{said}**", ""] if said else []


def _off(mismatch: Mismatch) -> dict[str, str]:
    known = Mismatch()
    return {key: _short(value) for key, value in mismatch if value != getattr(known, key)}


def _others(scenario: Scenario) -> list[str]:
    return [said for said in scenario.changes if said.partition("=")[0].split(".")[0] not in _ELSEWHERE]


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
