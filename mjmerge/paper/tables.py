"""What was found of the paper, as tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from mjmerge.paper.facts import FACTS, FactCheck

if TYPE_CHECKING:
    from rich.table import Table

    from mjmerge.paper.survey import SurveyCounts
    from mjmerge.paper.theorem import Tally


_STYLES = {True: "green", False: "red", None: "dim"}  # of a fact that was reproduced, was not, says nothing


def facts_table(findings: Mapping[str, Sequence[FactCheck]]) -> Table:
    """Each published fact, and whether it was reproduced on each plant, for the terminal."""
    from rich.table import Table

    grid = Table(box=None, pad_edge=False, leading=1)
    grid.add_column("published", style="bold", ratio=3)
    for plant in findings:
        grid.add_column(plant, ratio=4)
    for fact, *found in zip(FACTS, *findings.values(), strict=True):
        grid.add_row(fact.claim, *(f"[{_STYLES[f.holds]}]{f.word}[/]  {f.number}" for f in found))
    return grid


def theorem_table(tally: Tally) -> Table:
    """What came of a campaign, for the terminal."""
    from rich.table import Table

    grid = Table(show_header=False, box=None, pad_edge=False)
    grid.add_column(style="bold")
    grid.add_column(justify="right")
    grid.add_column()
    colour = "red" if tally.violated else "green"
    grid.add_row("worlds", f"{tally.runs}", "in which every hypothesis of the theorem holds")
    grid.add_row("violations", f"[{colour}]{tally.violated}[/]", "d_j <= 0")
    grid.add_row("close", f"{tally.close}", "d_j < r, and less than half of what it had been")
    grid.add_row(
        "unresolved", f"{tally.unresolved}", "d_j < 1e-5 m: too little to tell from 0, and left there"
    )
    grid.add_row("stuck", f"{tally.stuck}", "the solver gave up: says nothing")
    grid.add_row("smallest d_j", f"{tally.least_m:.2g} m", "of those that are resolved")
    return grid


def survey_table(found: Sequence[SurveyCounts]) -> Table:
    """How often the decision went wrong, variant by variant, for the terminal."""
    from rich.table import Table

    rows: dict[str, Callable[[SurveyCounts], str]] = {
        "runs": lambda s: f"{s.runs}",
        "mu driven the wrong way in": lambda s: f"{s.wrong_sign / s.runs:.1%}",
        "  there on average for": lambda s: f"{s.wrong_sign_s:.2f} s",
        "d_j <= 0 in": lambda s: f"{s.violated} ({s.violated / s.runs:.2%})",
        "merged at the end in": lambda s: f"{s.merged / s.runs:.1%}",
        "refusal memory, median": lambda s: f"{s.refusal_memory_s:.2f} s",
        "time to abort, median": lambda s: f"{s.abort_s:.2f} s",
    }
    grid = Table(box=None, pad_edge=False)
    grid.add_column(style="bold")
    for survey in found:
        grid.add_column(survey.variant, justify="right")
    for name, value in rows.items():
        grid.add_row(name, *(value(survey) for survey in found))
    return grid


def facts_markdown(findings: Mapping[str, Sequence[FactCheck]]) -> str:
    """The table of facts in Markdown."""
    lines = [
        "| published | " + " | ".join(findings) + " |",
        "|---|" + "---|" * len(findings),
        *(
            f"| {fact.claim} | " + " | ".join(f"{f.word}: {f.number}" for f in found) + " |"
            for fact, *found in zip(FACTS, *findings.values(), strict=True)
        ),
    ]
    return "\n".join(lines) + "\n"
