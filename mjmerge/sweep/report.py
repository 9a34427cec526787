"""What a person gets from a sweep: a table for the terminal, and ``report.md`` with its figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.figures.style import save
from mjmerge.outputs import put
from mjmerge.scenario.distinct import distinct
from mjmerge.sweep import laws
from mjmerge.sweep.campaign import GRID, RANDOM
from mjmerge.sweep.figures import figures
from mjmerge.sweep.plan import Plan
from mjmerge.sweep.rows import EMPTY, FAILED, METRICS_HELD, Rows, groups
from mjmerge.sweep.statistics import CONFIDENCE
from mjmerge.sweep.tally import (
    command,
    failure_rate,
    least_m,
    notes,
    own_metrics,
    runs_with,
    vacuous_runs,
    worst,
)
from mjmerge.versions import versions

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.table import Table

REPORT = "report.md"

_FEW = 12  # an axis of no more values is tabled value by value, another in quarters


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
        counts = map(str, (len(group), len(distinct(group)), vacuous_runs(group), failure_rate(group)))
        grid.add_row(*map(escape, key), *counts, _metres(least_m(group)) + " m")
    return grid


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
    yield from markdown_table(
        ("scenario", "plant", "law", "runs", "distinct", "vacuous", "failed", "least d_j (m)"),
        [
            (
                *key,
                len(group),
                len(distinct(group)),
                vacuous_runs(group),
                failure_rate(group),
                _metres(least_m(group)),
            )
            for key, group in groups(rows).items()
        ],
    )
    yield from laws.section(rows, markdown_table)
    named = [row for row in rows if row["mismatch"] not in (GRID, RANDOM)]
    if len({row["mismatch"] for row in named}) > 1:
        yield from _by_name(named)
    rest = [row for row in rows if row["mismatch"] in (GRID, RANDOM)]
    if rest:
        yield from _by_axis(plan, rest)
    yield from _symptoms(rows)
    yield from _collisions(rows)
    yield from _ends(plan, rows)
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
    yield from markdown_table(("mismatch", *heads), body)


def _cell(rows: Rows) -> str:
    text, rows = _metres(least_m(rows)), distinct(rows)
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
                body.append((scenario, plant, variant, axis, label, rate, _metres(least_m(part))))
    yield from markdown_table(("scenario", "plant", "law", "axis", "value", "failed", "least d_j (m)"), body)


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
    yield from markdown_table(
        ("verdict", "first broken", "runs"),
        [(verdict, first, n) for (verdict, first), n in counts.most_common()],
    )


def _collisions(rows: Rows) -> Iterator[str]:
    bodies = [row for row in distinct(rows) if row["min_clearance_m"] is not None]
    if not bodies:
        return
    touched = [row for row in bodies if row["first_contact_s"] is not None]
    in_margin, clear = (
        len(runs_with(name, bodies)) for name in ("touching_in_margin_s", "clear_without_margin_s")
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


def _ends(plan: Plan, rows: Rows) -> Iterator[str]:
    if not plan.ends:
        return
    known = [row for row in distinct(rows) if row["min_edge_distance_m"] is not None]
    off = [row for row in known if row["ran_off_at_s"] is not None]
    least = min((row["min_edge_distance_m"] for row in known), default=None)
    yield "## The end of the lane"
    yield ""
    yield (
        f"Of {len(known)} runs in which the ego's lane ends, it ran off in {len(off)}; its body came to "
        f"{_metres(least)} m from the edge at the least."
    )
    yield ""


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
        for name, numbers in own_metrics(plan, group).items()
    ]
    yield from markdown_table(
        ("scenario", "plant", "law", "metric", "least", "median", "most", "not known"), body
    )


def markdown_table(head: Sequence[str], body: Sequence[Sequence[object]]) -> Iterator[str]:
    """A table as Markdown, line by line, and an empty line after it."""
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in body:
        yield "| " + " | ".join(map(str, row)) + " |"
    yield ""


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
