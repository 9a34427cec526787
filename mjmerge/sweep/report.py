"""What a person gets from a sweep: failure rates with intervals, margins, the worst runs, their commands."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.figures.style import save
from mjmerge.outputs import put
from mjmerge.scenario.distinct import distinct
from mjmerge.scenario.effect import told
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.sweep.campaign import GRID, RANDOM
from mjmerge.sweep.figures import figures
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.rows import EMPTY, FAILED, METRIC, METRICS_HELD, PASSED, Rows, groups
from mjmerge.sweep.statistics import CONFIDENCE, Rate, clopper_pearson
from mjmerge.verdict import own
from mjmerge.versions import versions

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.table import Table

REPORT = "report.md"
WORST = 10
"""Runs that the report shows the command of."""

_FEW = 12  # an axis of no more values is tabled value by value, another in quarters


def failure_rate(rows: Rows) -> Rate:
    """How many failed, of those that were not vacuous; of copies of a run, one counts."""
    counts = Counter(row["outcome"] for row in distinct(rows))
    return clopper_pearson(counts[FAILED], counts[FAILED] + counts[PASSED])


def summary(plan: Plan, table: pa.Table) -> dict[str, Any]:
    """What ``--json`` prints of a sweep."""
    rows: Rows = table.to_pylist()
    return {
        "campaign": plan.name,
        "runs": len(rows),
        "distinct": len(distinct(rows)),
        "left_out": {why: list(axes) for why, axes in plan.left_out.items()},
        "outcomes": {name: sum(row["outcome"] == name for row in rows) for name in (PASSED, EMPTY, FAILED)},
        "failure_rate": _as_json(failure_rate(rows)),
        "groups": [
            dict(zip(("scenario", "plant", "variant"), key, strict=True))
            | {
                "runs": len(group),
                "distinct": len(distinct(group)),
                "no_effect": list(_idle(plan, group)),
                "vacuous": _vacuous(group),
                "failure_rate": _as_json(failure_rate(group)),
                "min_distance_m": _least(group),
                **({"metrics": _metrics(plan, group)} if plan.metrics else {}),
            }
            for key, group in groups(rows).items()
        ],
        "stopped": sum(row["stopped"] is not None for row in rows),
        "touching_with_margin": len(_runs_with("touching_in_margin_s", distinct(rows))),
        "clear_without_margin": len(_runs_with("clear_without_margin_s", distinct(rows))),
        "worst": [
            {
                "run": row["run"],
                "min_distance_m": row["min_distance_m"],
                "verdict": row["verdict"],
                "command": command(plan, row),
            }
            for row in worst(rows)
        ],
        "versions": versions(),
    }


def write(plan: Plan, table: pa.Table, folder: Path) -> None:
    """``report.md`` and its figures."""
    rows: Rows = table.to_pylist()
    drawn = []
    for name, figure in figures(plan, rows):
        save(figure, folder / name)
        drawn.append(name)
    put(folder / REPORT, "\n".join(_lines(plan, rows, drawn, notes(plan, table))) + "\n")


def rich_table(table: pa.Table) -> Table:
    """Failure rates for the terminal."""
    from rich.markup import escape
    from rich.table import Table

    columns = ("scenario", "plant", "law", "runs", "distinct", "vacuous", "failed", "least d_j")
    grid = Table(*columns, box=None, pad_edge=False)
    for key, group in groups(table.to_pylist()).items():
        counts = map(str, (len(group), len(distinct(group)), _vacuous(group), failure_rate(group)))
        grid.add_row(*map(escape, key), *counts, _metres(_least(group)) + " m")
    return grid


def notes(plan: Plan, table: pa.Table) -> list[str]:
    """What a reader of the rates has to know, a line each: copies, axes left out, keys without effect."""
    rows: Rows = table.to_pylist()
    found = []
    copies = len(rows) - len(distinct(rows))
    if copies:
        found.append(
            f"{copies} of {len(rows)} runs are copies of others (the same scenario, plant and mismatch, with "
            "the same seed, or where nothing is random): each run counts once"
        )
    found += [f"left out of the levels: {', '.join(axes)} ({why})" for why, axes in plan.left_out.items()]
    for (scenario, _), group in groups(rows, ("scenario", "plant")).items():
        idle = _idle(plan, group)
        found += [f"the {key} of {scenario} is without effect: it {why}" for key, why in idle.items()]
    return found


def _idle(plan: Plan, rows: Rows) -> dict[str, str]:
    """What the scenario of some rows says itself and is without effect in all of them, and why."""
    cases = [plan.cases[row["run"]] for row in rows]
    seen: dict[tuple[int, Mismatch], dict[str, str]] = {}
    for case in cases:
        key = id(case.batch), case.mismatch
        if key not in seen:
            here = case.batch.scenario.model_copy(update={"mismatch": case.mismatch})
            seen[key] = told(here, case.batch.plant, continuous=case.batch.continuous)
    every = list(seen.values())
    return {key: why for key, why in every[0].items() if all(key in other for other in every)}


def _vacuous(rows: Rows) -> int:
    return sum(row["outcome"] == EMPTY for row in distinct(rows))


def worst(rows: Rows) -> Rows:
    """The runs that came closest, of copies one; one without data is worse than any other."""

    def margin(row: dict[str, Any]) -> float:
        return -np.inf if row["min_distance_m"] is None else float(row["min_distance_m"])

    return sorted(distinct(rows), key=margin)[:WORST]


def command(plan: Plan, row: Mapping[str, Any]) -> str:
    """The command that gives this run alone, bit for bit, and records it."""
    return shlex.join(("mjmerge", *plan.cases[row["run"]].command))


def _as_json(rate: Rate) -> dict[str, Any]:
    return {
        "failed": rate.count,
        "of": rate.of,
        "rate": rate.value,
        "low": rate.low,
        "high": rate.high,
        "confidence": CONFIDENCE,
    }


def _least(rows: Rows) -> float | None:
    known = [row["min_distance_m"] for row in rows if row["min_distance_m"] is not None]
    return min(known, default=None)


def _runs_with(column: str, rows: Rows) -> Rows:
    """Rows in which a duration is more than none."""
    return [row for row in rows if row[column]]


def _lines(plan: Plan, rows: Rows, drawn: Sequence[str], remarks: Sequence[str]) -> Iterator[str]:
    yield f"# Sweep {plan.name}"
    yield ""
    if plan.description:
        yield f"{plan.description}\n"
    made_with = ", ".join(f"{name} {version}" for name, version in versions().items())
    count = f"{len(rows)} runs, {len(distinct(rows))} distinct"
    yield f"{count}; all rows are in `table.parquet`. Made with {made_with}."
    yield ""
    for note in remarks:
        yield f"- {note}"
    yield from [""] if remarks else []
    yield "## Failures"
    yield ""
    out = ", or a metric of its own is out of its bounds" if plan.bounds else ""
    yield (
        "A run has failed if it did not keep its scenario's safety floor to the end: also if it ended early, "
        f"or has no data{out}. A vacuous run (safe, but nothing put the barrier to the test) counts neither "
        "way. "
        f"Rates are failed / (failed + passed) of distinct runs, with Clopper-Pearson intervals at "
        f"{CONFIDENCE:.0%}."
    )
    yield ""
    yield from _table(
        ("scenario", "plant", "law", "runs", "distinct", "vacuous", "failed", "least d_j (m)"),
        [
            (
                *key,
                len(group),
                len(distinct(group)),
                _vacuous(group),
                failure_rate(group),
                _metres(_least(group)),
            )
            for key, group in groups(rows).items()
        ],
    )
    named = [row for row in rows if row["mismatch"] not in (GRID, RANDOM)]
    if len({row["mismatch"] for row in named}) > 1:
        yield from _by_name(named)
    rest = [row for row in rows if row["mismatch"] in (GRID, RANDOM)]
    if rest:
        yield from _by_axis(plan, rest)
    yield from _symptoms(rows)
    yield from _collisions(rows)
    yield from _own(plan, rows)
    yield "## The worst runs"
    yield ""
    yield "Each command gives its run again, bit for bit, and records it; `mjmerge view` then opens it."
    yield ""
    for row in worst(rows):
        broken = row["first_broken"]
        first = f", '{broken}' broke first" if broken else ""
        least = row["min_distance_m"]
        margin = "no data" if least is None else f"{least:.4f} m"
        yield f"- run {row['run']}: {margin}, {row['verdict']}{first}"
        yield ""
        yield f"      {command(plan, row)}"
        yield ""
    if drawn:
        yield "## Figures"
        yield ""
        for name in drawn:
            yield f"![{name.removesuffix('.png')}]({name})"
            yield ""


def _by_name(rows: Rows) -> Iterator[str]:
    """Margins of named mismatches, a column per scenario, plant and variant."""
    yield "## Margins by mismatch"
    yield ""
    yield "Least d_j in m over the seeds; bold where a run failed, (v) where all runs were vacuous."
    yield ""
    columns = list(groups(rows))
    plants = {plant for _, plant, _ in columns}
    heads = [" ".join((s, v) if len(plants) == 1 else (s, p, v)) for s, p, v in columns]
    body = []
    for (name,), of in groups(rows, ("mismatch",)).items():
        by = groups(of)
        body.append((name, *(_cell(by[c]) if c in by else "" for c in columns)))
    yield from _table(("mismatch", *heads), body)


def _cell(rows: Rows) -> str:
    text, rows = _metres(_least(rows)), distinct(rows)
    failed = sum(row["outcome"] == FAILED for row in rows)
    if failed:
        return f"**{text}**" + (f" ({failed} of {len(rows)})" if len(rows) > 1 else "")
    return f"{text} (v)" if all(row["outcome"] == EMPTY for row in rows) else text


def _by_axis(plan: Plan, rows: Rows) -> Iterator[str]:
    """Failure rates along every axis of the grid or of the draws."""
    yield "## Failures along each axis"
    yield ""
    yield "All other axes vary at the same time; an axis of many values is cut into quarters."
    yield ""
    body = []
    for (scenario, plant, variant), group in groups(rows).items():
        for axis in plan.axes:
            for label, part in _slices(axis, group):
                rate = failure_rate(part)
                body.append((scenario, plant, variant, axis, label, rate, _metres(_least(part))))
    yield from _table(("scenario", "plant", "law", "axis", "value", "failed", "least d_j (m)"), body)


def _slices(axis: str, rows: Rows) -> Iterator[tuple[str, Rows]]:
    values = {row[axis] for row in rows if row[axis] is not None}
    if len(values) < 2:
        return
    if len(values) <= _FEW or not all(isinstance(value, float) for value in values):
        for value in sorted(values):
            yield _short(value), [row for row in rows if row[axis] == value]
        return
    edges = np.quantile(
        [row[axis] for row in rows if row[axis] is not None], (0, 0.25, 0.5, 0.75, 1)
    ).tolist()
    for k, (low, high) in enumerate(pairwise(edges)):
        part = [
            row
            for row in rows
            if row[axis] is not None
            and low <= row[axis]
            and (row[axis] < high or (k == 3 and row[axis] == high))
        ]
        yield f"{_short(low)} to {_short(high)}", part


def _symptoms(rows: Rows) -> Iterator[str]:
    failed = [row for row in distinct(rows) if row["outcome"] == FAILED]
    if not failed:
        return
    yield "## What broke first"
    yield ""
    yield (
        "Of the runs that failed, the hypothesis of the theorem that was broken first in the approach to the "
        "unsafe moment (in a run that only missed its floor: first of all). That is a symptom: the cause is "
        "what such a run needs to fail, and only another run without it can tell."
    )
    yield ""
    counts = Counter((row["verdict"], row["first_broken"] or "none") for row in failed)
    yield from _table(
        ("verdict", "first broken", "runs"),
        [(verdict, first, n) for (verdict, first), n in counts.most_common()],
    )


def _collisions(rows: Rows) -> Iterator[str]:
    bodies = [row for row in distinct(rows) if row["min_clearance_m"] is not None]
    if not bodies:
        return
    touched = [row for row in bodies if row["first_contact_s"] is not None]
    in_margin, clear = (
        len(_runs_with(name, bodies)) for name in ("touching_in_margin_s", "clear_without_margin_s")
    )
    yield "## Collisions"
    yield ""
    yield (
        f"Of {len(bodies)} runs with bodies, the ego touched another car in {len(touched)}; bodies touched "
        f"while d_j > 0 in {in_margin} runs, and stayed clear while d_j <= 0 in {clear}."
    )
    hardest = max(touched, key=lambda row: row["contact_impulse_n_s"] or 0.0, default=None)
    if hardest is not None and hardest["contact_impulse_n_s"]:
        yield (
            f"The hardest contact was {hardest['contact_impulse_n_s']:.3g} N s in all, at up to "
            f"{hardest['contact_speed_mps'] or 0:.3g} m/s, in run {hardest['run']}."
        )
    yield ""


def _metrics(plan: Plan, rows: Rows) -> dict[str, dict[str, float | int | None]]:
    """Range and middle of each own metric over distinct runs, and in how many it is not known; by name."""
    found: dict[str, dict[str, float | int | None]] = {}
    for name in plan.metrics:
        of = [row for row in distinct(rows) if name in own.names(plan.cases[row["run"]].batch.scenario)]
        known = [row[METRIC + name] for row in of if row[METRIC + name] is not None]
        if of:
            middle = float(np.median(known)) if known else None
            least, most = min(known, default=None), max(known, default=None)
            found[name] = {"least": least, "median": middle, "most": most, "unknown": len(of) - len(known)}
    return found


def _own(plan: Plan, rows: Rows) -> Iterator[str]:
    if not plan.metrics:
        return
    yield "## Metrics of the scenarios' own"
    yield ""
    yield "Over distinct runs; `metric.<name>` in the table."
    if plan.bounds:
        out = sum(row[METRICS_HELD] is False for row in distinct(rows))
        yield f"In {out} runs some metric is out of its bounds."
    yield ""
    body = [
        (*key, name, *(_short(v) if v is not None else "-" for v in numbers.values()))
        for key, group in groups(rows).items()
        for name, numbers in _metrics(plan, group).items()
    ]
    yield from _table(("scenario", "plant", "law", "metric", "least", "median", "most", "not known"), body)


def _table(head: Sequence[str], body: Sequence[Sequence[object]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in body:
        yield "| " + " | ".join(map(str, row)) + " |"
    yield ""


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
