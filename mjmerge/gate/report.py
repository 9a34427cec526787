"""What came of the gate: for the terminal, as JSON, and as JUnit XML."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from mjmerge.gate.junit import junit
from mjmerge.verdict.summary import number
from mjmerge.versions import versions

if TYPE_CHECKING:
    from rich.table import Table

    from mjmerge.gate.result import Result


def gate_table(results: Sequence[Result]) -> Table:
    """Every row of the gate with its smallest distances, m, for the terminal."""
    from rich.markup import escape
    from rich.table import Table

    grid = Table(box=None, pad_edge=False)
    for name in ("scenario", "row"):
        grid.add_column(name, style="cyan" if name == "row" else None, no_wrap=True)
    most = max((len(result.measured.min_d_m) for result in results), default=2)
    for name in ("floor", *(f"d_{j}" for j in range(1, most + 1)), "moved"):
        grid.add_column(name, justify="right", no_wrap=True, min_width=5)
    grid.add_column("", no_wrap=True, min_width=4)
    grid.add_column("verdict")
    for result in results:
        row, m, before = result.row, result.measured, result.baseline
        moved = "new"
        if before is not None:
            changes = (now - then for now, then in zip(m.min_d_m, before.min_d_m, strict=False))
            moved = f"{max(changes, key=abs):+.4f}"
        good = not result.problems
        word = f"[{'green' if good else 'red'}]{'ok' if good else 'FAILED'}[/]"
        least = [f"{value:.3f}" for value in (row.check.at_least_m, *m.min_d_m)]
        least += [""] * (most - len(m.min_d_m))
        names = map(escape, (row.label, row.check.name))
        grid.add_row(*names, *least, moved, word, result.verdict.verdict)
    return grid


def gate_failure(result: Result) -> str:
    """Why a row fails, and how to see it, in lines."""
    row, made = result.row, result.made_with
    now = {name: version for name, version in versions().items() if name in made}
    other = [f"{name} {made[name]} then, {now[name]} now" for name in now if now[name] != made[name]]
    return "\n".join(
        [
            f"{row.label}, {row.check.name}:",
            *(f"  {problem}" for problem in result.problems),
            *([f"  the baseline was made with other versions: {', '.join(other)}"] if other else []),
            f"  see it:  {row.command}",
        ]
    )


def gate_json(results: Sequence[Result], stale: Sequence[str] = ()) -> dict[str, Any]:
    """The gate for machines; ``stale`` says which rows of the baselines the gate does not have."""
    rows = [
        {
            "scenario": r.row.label,
            "row": r.row.check.name,
            "plant": r.row.check.plant,
            "set": list(r.row.check.set),
            "floor_m": r.row.check.at_least_m,
            "measured": {name: number(value) for name, value in r.measured.numbers.items()},
            "baseline": r.baseline and {name: number(value) for name, value in r.baseline.numbers.items()},
            "baseline_versions": dict(r.made_with),
            **({"metrics": {name: number(value) for name, value in r.metrics.items()}} if r.metrics else {}),
            "verdict": r.verdict.verdict,
            "problems": list(r.problems),
            "command": r.row.command,
        }
        for r in results
    ]
    failed = sum(bool(r.problems) for r in results)
    return {
        "passed": not failed,
        "rows": rows,
        "failed": failed,
        "stale": list(stale),
        "versions": versions(),
    }


def gate_junit(results: Sequence[Result]) -> bytes:
    """The gate as JUnit XML, for continuous integration."""
    return junit(results, [gate_failure(result) for result in results])
