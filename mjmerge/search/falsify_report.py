"""What a person gets from a search for failures: each as a folder that runs, a report, and figures."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjmerge.figures.style import save
from mjmerge.outputs import put
from mjmerge.scenario.load import dump
from mjmerge.scenario.ran import beneath
from mjmerge.scenario.schema import Scenario
from mjmerge.search.against import PROOF, Against
from mjmerge.search.falsify import Search
from mjmerge.search.falsify_figures import name, progress, where
from mjmerge.search.findings import Finding
from mjmerge.search.margin import KINDS, known
from mjmerge.sweep.statistics import clopper_pearson

SCENARIO, SENTENCE, FIGURE = "scenario.yaml", "finding.md", "figure.png"
"""Of a finding."""
BESIDE, REPORT, RESULTS = "beside.jsonl", "report.md", "results.json"
"""Of a search."""


def place(folder: Path, k: int) -> Path:
    """Where the k-th finding goes, counted from 1."""
    return folder / f"finding-{k}"


def write(
    found: Search,
    findings: Sequence[Finding],
    folder: Path,
    *,
    against: Against = PROOF,
    beside: Search | None = None,
) -> None:
    """A folder for each finding, with its scenario, and a report with figures.

    Args:
        found: what was looked at.
        findings: the different failures of it.
        folder: where everything goes.
        against: where the same behaviour is safe.
        beside: another search of the same space, by another method.

    Raises:
        OutputError: a file cannot be written.
    """
    for k, one in enumerate(findings, 1):
        at = place(folder, k)
        at.mkdir(parents=True, exist_ok=True)
        put(at / SCENARIO, dump(named(found, one, k)))
        put(at / SENTENCE, one.sentence + "\n")
    save(progress([found, *([beside] if beside else [])]), folder / "margins.png")
    save(where(found), folder / "space.png")
    put(folder / REPORT, "\n".join(_lines(found, findings, folder, against, beside)) + "\n")
    put(folder / RESULTS, json.dumps(as_json(found, findings, folder, beside), indent=2) + "\n")


def named(found: Search, one: Finding, k: int) -> Scenario:
    """The scenario of the k-th finding, counted from 1."""
    return one.scenario(f"{found.ground.scenario.name}_finding_{k}")


def as_json(
    found: Search, findings: Sequence[Finding], folder: Path, beside: Search | None = None
) -> dict[str, Any]:
    """What ``mjmerge falsify --json`` prints."""
    others = {} if beside is None else {"beside": _of_search(beside)}
    return {
        "scenario": found.ground.scenario.name,
        "plant": found.ground.plant,
        **_of_search(found),
        **others,
        "findings": [_of_finding(one, place(folder, k)) for k, one in enumerate(findings, 1)],
        "out": str(folder),
    }


def _of_search(found: Search) -> dict[str, Any]:
    best = found.best
    return {
        "method": found.method,
        "seed": found.seed,
        "runs": len(found.looks),
        "valid": found.valid,
        "failures": len(found.failures),
        "first_failure_at_run": found.first_failure_at_run,
        "best_margin_m": None if best is None else best.margin_m,
    }


def _of_finding(one: Finding, at: Path) -> dict[str, Any]:
    small = one.shrunk
    return {
        "scenario": str(at / SCENARIO),
        "seed": small.pair.seed,
        "min_distance_m": one.real.min_distance_m,
        "min_clearance_m": known(one.real.min_clearance_m),
        "margin_m": known(one.real.least_m),
        "ideal_min_distance_m": small.pair.ideal.min_distance_m,
        "ideal_verdict": small.pair.ideal.verdict,
        "verdict": one.real.verdict,
        "kind": one.kind,
        "axes": dict(small.parts.axes),
        "moves": {car: [move.model_dump() for move in of] for car, of in small.parts.moves.items() if of},
        "spare": small.spare,
        "at_half_step": small.half,
        "shrink_runs": small.runs,
        "sentence": one.sentence,
    }


def counted(found: Search) -> str:
    """How many failures there are, in words; of none, how rare they are at most."""
    runs, valid, count = len(found.looks), found.valid, len(found.failures)
    first = found.first_failure_at_run
    if count:
        return f"{count} of {valid} fair runs fail, {runs} were looked at; the first is run {first}"
    none = f"none of {valid} fair runs fails, {runs} were looked at"
    if not valid:
        return none
    if found.method == "random":
        most = clopper_pearson(0, valid).high
        return f"{none}: with 95 % confidence less than {most:.2g} of fair runs do"
    return f"{none}; that bounds nothing, as they were not drawn at random"


def command(one: Finding, at: Path) -> str:
    """What runs a finding again."""
    seed = ["--seed", str(one.shrunk.pair.seed)] if one.shrunk.pair.seed else []
    return shlex.join(["mjmerge", "run", str(at / SCENARIO), "--plant", one.plant, *seed])


def _lines(
    found: Search,
    findings: Sequence[Finding],
    folder: Path,
    against: Against,
    beside: Search | None,
) -> Iterator[str]:
    ground = found.ground
    yield from (f"# What breaks {ground.scenario.name} on {ground.plant}", "")
    yield from beneath(ground.scenario, ground.plant)
    yield from (f"A run counts if the same behaviour is safe {against.words}.", "")
    head = ("method", "seed", "runs", "fair", "failures", "first at run", "least margin (m)")
    yield from ("| " + " | ".join(head) + " |", "|" + "---|" * len(head))
    for search in (found, *([beside] if beside else [])):
        best = search.best
        least = "-" if best is None or best.margin_m is None else f"{best.margin_m:.4f}"
        first = search.first_failure_at_run or "-"
        cells = (
            search.method,
            search.seed,
            len(search.looks),
            search.valid,
            len(search.failures),
            first,
            least,
        )
        yield "| " + " | ".join(map(str, cells)) + " |"
    yield from ("", f"{counted(found)}.", "", "![Margin, run by run](margins.png)", "")
    yield from ("## The different ones, each as small as it gets", "")
    if not findings:
        yield "There is none."
    for k, one in enumerate(findings, 1):
        at = Path(f"finding-{k}")
        yield from (f"### {k}. {KINDS[one.kind]}", "", one.sentence, "")
        small = one.shrunk
        yield f"Found at run {one.look.number + 1}, shrunk in {small.runs} runs; verdict: {one.real.verdict}."
        yield from ("", f"    {command(one, at)}", "")
        if (folder / at / FIGURE).exists():
            yield from (f"![The run over its ideal]({at}/{FIGURE})", "")
    yield from ("## Where they are", "", "![Failures in the space](space.png)", "")
    yield from ("| what | from | to |", "|---|---|---|")
    for coordinate in ground.coordinates:
        low, high = (coordinate.spread.at(part) for part in (0.0, 1.0))
        yield f"| {name(coordinate)} | {_short(low)} | {_short(high)} |"


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if np.isfinite(value) else str(value)
    return str(value)
