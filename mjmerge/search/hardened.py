"""What came of hardening a law, in words and numbers: the section to paste, what it is worth, its costs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mjmerge.scenario.load import dump
from mjmerge.search.candidate import Candidate
from mjmerge.search.falsify import Search
from mjmerge.search.harden import Fresh, Hardened, worst_m
from mjmerge.sweep.plan import written
from mjmerge.versions import versions


def section(found: Hardened) -> str:
    """The sections of the scenario's file that the last choice takes the place of, as YAML."""
    assert found.winner is not None, "there was something to choose"
    parts = dict.fromkeys(["law", *(key.partition(".")[0] for key in found.winner.settings)])
    return "".join(_section(dump(found.scenario), name) for name in parts)


def _section(text: str, name: str) -> str:
    """One section of a scenario's text."""
    lines = text.splitlines(keepends=True)
    first = lines.index(f"{name}:\n")
    below = lines[first + 1 :]
    many = next((k for k, line in enumerate(below) if not line.startswith(" ")), len(below))
    return "".join([lines[first], *below[:many]])


def options(law: Candidate) -> str:
    """A law as options of the command line."""
    return " ".join(f"--set {key}={written(value)}" for key, value in law.settings.items())


def sentences(found: Hardened) -> Iterator[str]:
    """What came of it, a line each."""
    runs, budget = found.runs, len(found.first.looks)
    if found.winner is None:
        yield (
            f"Nothing to harden against: no failure in {budget} runs, {found.first.valid} of them fair. "
            "That is no proof: another --seed, or a larger --budget, may find some."
        )
        return
    last = found.rounds[-1]
    if not found.winner.settings:
        if not any(one.solves for one in last.candidates):
            why = "none merges, keeps the floor without mismatch, and has most cases fair to it"
        else:
            why = "none has a better worst margin over what was found"
        yield f"No better law was found, of {_tried(found)} that were tried: {why}."
        yield f"{runs} runs in all."
        return
    before, after = worst_m(found.fresh), worst_m(found.hardened)
    rises = "is not known" if found.gained_m is None else "rises" if found.better else "does not rise"
    yield (
        f"The worst margin over {_searches(found)} {rises}: "
        f"{metres(before)} with the law as it is, {metres(after)} with the chosen one."
    )
    yield (
        f"Failures there: {_failures(found.fresh)} with the law as it is, {_failures(found.hardened)} with "
        "the chosen one."
    )
    yield (
        f"Without mismatch it merges at {_seconds(found.winner.merged_s)}, as it is at "
        f"{_seconds(last.before.merged_s)}; it asks for {found.winner.peak_mps2:.3g} m/s^2 at most, as it is "
        f"{last.before.peak_mps2:.3g}."
    )
    yield f"{runs} runs in all, {_tried(found)} laws tried."


def as_json(found: Hardened) -> dict[str, Any]:
    """What ``--json`` prints, but for the folder."""
    winner = found.winner
    last = found.rounds[-1] if found.rounds else None
    return {
        "scenario": found.ground.scenario.name,
        "plant": found.ground.plant,
        "runs": found.runs,
        "laws_tried": _tried(found),
        "failures_found": len(found.first.failures),
        "nothing_to_harden": winner is None,
        "better": found.better,
        "settings": None if winner is None else dict(winner.settings),
        "law": None if winner is None else found.scenario.law.model_dump(mode="json"),
        "worst_margin_m": {"before": worst_m(found.fresh), "after": worst_m(found.hardened)},
        "gained_m": found.gained_m,
        "fresh": {"before": [*map(_fresh, found.fresh)], "after": [*map(_fresh, found.hardened)]},
        "cost": None
        if winner is None or last is None
        else {"before": _law(last.before), "after": _law(winner)},
        "frontier": [_law(one) for one in found.frontier],
    }


def results(found: Hardened) -> dict[str, Any]:
    """All numbers."""
    rounds = [
        {
            "search": _search(one.search),
            "cases": one.cases,
            "as_it_is": _law(one.before),
            "laws": [_law(law) for law in one.candidates],
            "refused": one.refused,
            "chosen": _law(one.chosen),
        }
        for one in found.rounds
    ]
    keys = {key: spread.model_dump(mode="json", exclude_none=True) for key, spread in found.keys.items()}
    more = {"keys": keys, "first": _search(found.first), "rounds": rounds, "versions": versions()}
    return as_json(found) | more


def _law(one: Candidate) -> dict[str, Any]:
    return {
        "settings": dict(one.settings),
        "solves": one.solves,
        "worst_margin_m": or_none(one.worst_m),
        "cases": len(one.stood),
        "left_out": one.left_out,
        "enters": one.enters,
        "nominal_margin_m": or_none(one.nominal_m),
        "merged_at_s": one.merged_s,
        "peak_mps2": or_none(one.peak_mps2),
    }


def _search(one: Search) -> dict[str, Any]:
    return {
        "seed": one.seed,
        "method": one.method,
        "runs": len(one.looks),
        "valid": one.valid,
        "failures": len(one.failures),
        "first_failure_at_run": one.first_failure_at_run,
    }


def _fresh(one: Fresh) -> dict[str, Any]:
    return _search(one.search) | {"worst_margin_m": one.worst_m, "at_own_step_m": one.own_step_m}


def or_none(value: float) -> float | None:
    """A number, if it is one."""
    return value if np.isfinite(value) else None


def _tried(found: Hardened) -> int:
    return sum(len(one.candidates) + one.refused for one in found.rounds)


def _searches(found: Hardened) -> str:
    many, budget = len(found.fresh), len(found.first.looks)
    return f"{many} fresh search{'es' if many != 1 else ''} of {budget} runs"


def _failures(searches: Sequence[Fresh]) -> int:
    return sum(len(one.search.failures) for one in searches)


def metres(value: float | None) -> str:
    """A distance in m, in words."""
    return "unknown" if value is None else f"{value:.3f} m"


def _seconds(value: float | None) -> str:
    return "no time" if value is None else f"{value:.3g} s"
