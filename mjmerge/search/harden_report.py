"""What hardening a law leaves: ``report.md`` with its figure of what margin costs, law and all numbers."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.figures.style import COLOURS, LINE, MU, head, save, sheet
from mjmerge.outputs import put
from mjmerge.scenario.ran import beneath, ran
from mjmerge.search.candidate import LEAST_STOOD, LONGER, Candidate
from mjmerge.search.falsify import SCREEN_S
from mjmerge.search.harden import Fresh, Hardened
from mjmerge.search.hardened import metres, options, or_none, results, section, sentences
from mjmerge.search.keys import words as between
from mjmerge.sweep.report import markdown_table
from mjmerge.versions import versions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REPORT, FRONTIER, LAW, RESULTS = "report.md", "frontier.png", "law.yaml", "results.json"
FILES = (REPORT, FRONTIER, LAW, RESULTS)
"""All that is written; only the first and the last where there was nothing to harden against."""


def write(found: Hardened, folder: Path) -> None:
    """Report, frontier, the law's section, and all numbers; into an empty folder."""
    if found.winner is not None:
        save(frontier(found), folder / FRONTIER)
        put(folder / LAW, section(found))
    put(folder / REPORT, "\n".join(_report(found)) + "\n")
    put(folder / RESULTS, json.dumps(results(found), indent=2) + "\n")


def _report(found: Hardened) -> Iterator[str]:
    ground = found.ground
    yield f"# {ground.scenario.name}, hardened on {ground.plant}"
    yield ""
    yield from beneath(ground.scenario, ground.plant)
    yield " ".join(sentences(found))
    yield ""
    yield "Made with " + ", ".join(f"{name} {version}" for name, version in versions().items()) + "."
    yield ""
    if found.winner is not None:
        yield from _worth(found)
        yield from _chosen(found)
        yield from _frontier(found)
        yield from _rounds(found)
    yield "## What was chosen, and between what"
    yield ""
    rows = [(f"`{key}`", _own(found, key), between(spread)) for key, spread in found.keys.items()]
    yield from markdown_table(("key", "as it is", "between"), rows)
    yield "## What this does not say"
    yield ""
    for line in _limits(found):
        yield f"- {line}"


def _worth(found: Hardened) -> Iterator[str]:
    winner, last = found.winner, found.rounds[-1]
    assert winner is not None, "there was something to choose"
    yield "## What it is worth"
    yield ""
    yield (
        "Fresh searches look for failures anew, with seeds that no round used, the same for both laws. A "
        "margin is the least of every d_j and every clearance of the ego's body; a failure counts as 0 at "
        f"most. All are measured with the scenario's r, {found.ground.scenario.r_m:g} m."
    )
    yield ""
    rows: list[tuple[object, ...]] = []
    for k, (one, other) in enumerate(zip(found.fresh, found.hardened, strict=True), 1):
        name = f"fresh search {k}, seed {one.search.seed}"
        rows.append((f"{name}: worst margin (m)", _number(one.worst_m), _number(other.worst_m)))
        if one.own_step is not None or other.own_step is not None:
            at_own = "the same run at the scenario's own step (m)"
            rows.append((at_own, _number(one.own_step_m), _number(other.own_step_m)))
        for what, of in (("failures", _count), ("fair runs", _fair)):
            rows.append((f"{what} of {len(one.search.looks)}", of(one), of(other)))
    both = (last.before, winner)
    rows += [
        (f"worst margin over the {last.cases} cases (m)", *(_number(law.worst_m) for law in both)),
        ("cases that are not fair to it, left out", *(law.left_out for law in both)),
        ("cases in which the ego gets more than half way in", *(law.enters for law in both)),
        ("without mismatch: merged at (s)", *(_number(law.merged_s) for law in both)),
        ("without mismatch: most that it asks for (m/s^2)", *(_number(law.peak_mps2) for law in both)),
        ("without mismatch: margin (m)", *(_number(law.nominal_m) for law in both)),
    ]
    yield from markdown_table(("", "as it is", "chosen"), rows)


def _chosen(found: Hardened) -> Iterator[str]:
    winner = found.winner
    assert winner is not None, "there was something to choose"
    yield "## The law"
    yield ""
    if not winner.settings:
        yield "The law as it is: no better one was found."
        yield ""
        return
    yield f"To be pasted over the sections of these names, and also in `{LAW}`:"
    yield ""
    yield "```yaml"
    yield section(found).rstrip()
    yield "```"
    yield ""
    yield f"Or on the command line: `{options(winner)}`."
    yield ""
    r_m, own_m = found.scenario.r_m, found.ground.scenario.r_m
    if r_m != own_m:
        yield (
            f"It has an r of its own: once it is pasted, d_j is measured from r = {r_m:g} m, and every "
            f"d_j is {abs(r_m - own_m):.3g} m {'smaller' if r_m > own_m else 'larger'} than here for "
            "the same path."
        )
        yield ""


def _frontier(found: Hardened) -> Iterator[str]:
    yield "## What margin costs"
    yield ""
    yield (
        "Laws of the last round that no other beats in both, worst margin over its cases and time to merge "
        "without mismatch:"
    )
    yield ""
    head = ("law", "worst margin (m)", "merged at (s)", "asks for (m/s^2)", "left out")
    body = [
        (one.words, _number(one.worst_m), _number(one.merged_s), _number(one.peak_mps2), one.left_out)
        for one in found.frontier
    ]
    yield from markdown_table(head, body)
    yield f"![What margin costs]({FRONTIER})"
    yield ""


def _rounds(found: Hardened) -> Iterator[str]:
    yield "## Rounds"
    yield ""
    yield (
        "Each begins with a search against the law at hand, at first the scenario's own. Its worst runs, and "
        "those of the rounds before, are the cases; every law is held against all that are fair to it."
    )
    yield ""
    head = ("round", "seed", "runs", "fair", "failures", "cases", "laws", "no scenario", "no solution")
    body: list[Sequence[object]] = []
    for k, one in enumerate(found.rounds, 1):
        counts = (len(one.search.looks), one.search.valid, len(one.search.failures), one.cases)
        no = sum(not law.solves for law in one.candidates)
        body.append((k, one.search.seed, *counts, len(one.candidates), one.refused, no))
    yield from markdown_table(head, body)
    for k, one in enumerate(found.rounds, 1):
        yield (
            f"- Round {k}: worst margin {metres(or_none(one.before.worst_m))} as it is, "
            f"{metres(or_none(one.chosen.worst_m))} with {one.chosen.words}."
        )
    yield ""


def _limits(found: Hardened) -> Iterator[str]:
    yield (
        "A search that finds nothing worse is no proof: it looked at "
        f"{len(found.first.looks)} points of a space of {found.ground.size} coordinates."
    )
    if found.winner is None:
        return
    yield (
        "No solution is a law that does not merge without mismatch within "
        f"{LONGER * found.ground.scenario.duration_s:g} s, does not keep the scenario's floor there, or to "
        f"which less than {LEAST_STOOD:.0%} of the cases are fair. A case is fair to a law if the same "
        "behaviour, on the plant of the proof and under that law, keeps the floor with every hypothesis true."
    )
    if found.winner.left_out > found.rounds[-1].before.left_out:
        yield (
            f"To the chosen law {found.winner.left_out} of {len(found.winner.margins_m)} cases are not fair, "
            f"to the law as it is {found.rounds[-1].before.left_out}: it asks for more of the others."
        )
    if found.ground.plant == "mujoco" and found.ground.scenario.physics_step_s < SCREEN_S:
        yield (
            f"Searches and cases run at a physics step of {SCREEN_S:g} s; only the worst of each fresh "
            "search was run again at the scenario's own."
        )
    yield (
        "Time to merge and demand are of one run, the scenario's own without mismatch. Another scenario may "
        "cost more, and its own failures are not looked for here."
    )
    yield "Runs on the plant of the proof, which say what is fair, are not counted."


def frontier(found: Hardened) -> Figure:
    """Worst margin over the cases of the last round, against time to merge, and against peak demand."""
    last, winner = found.rounds[-1], found.winner
    good = [one for one in last.candidates if one.solves]
    figure, (left, right) = sheet((1,), 4.2, columns=2)
    for axes, name, label in (
        (left, "merged_s", "merged at, without mismatch (s)"),
        (right, "peak_mps2", "most that is asked for, without mismatch (m/s²)"),
    ):
        x = [getattr(one, name) for one in good]
        axes.scatter(x, [one.worst_m for one in good], s=16, color=MU, linewidth=0)
        if name == "merged_s":
            edge = found.frontier
            axes.plot(
                [one.merged_s for one in edge],
                [one.worst_m for one in edge],
                color=COLOURS["vehicle_1"],
                linewidth=1,
                drawstyle="steps-post",
            )
        axes.axhline(0, color=LINE, linewidth=1)
        axes.margins(0.15)
        marked = [("as it is", last.before, COLOURS["vehicle_2"])]
        if winner is not None and winner.settings:
            marked.append(("chosen", winner, COLOURS["ego"]))
        _mark(axes, name, marked)
        axes.set_xlabel(label)
        axes.set_ylabel(f"worst margin over {last.cases} cases (m)")
    head(
        figure,
        *ran(found.ground.scenario, found.ground.plant),
        "dots are laws that were tried; those on the line no other beats in both margin and time",
    )
    return figure


def _mark(axes: Axes, name: str, marked: Sequence[tuple[str, Candidate, str]]) -> None:
    """Points with their names beside them, on the side where there is room."""
    known = [one for one in marked if getattr(one[1], name) is not None and np.isfinite(one[1].worst_m)]
    for _, law, colour in known:
        axes.scatter([getattr(law, name)], [law.worst_m], s=48, color=colour, zorder=3)
    low, high = axes.get_xlim()
    for k, (text, law, colour) in enumerate(known):
        x = getattr(law, name)
        right = x > (low + high) / 2
        axes.annotate(
            text,
            (x, law.worst_m),
            xytext=(-7 if right else 7, 7 if k else -7),
            textcoords="offset points",
            ha="right" if right else "left",
            va="bottom" if k else "top",
            color=colour,
            fontweight="bold",
        )


def _own(found: Hardened, key: str) -> str:
    value: Any = found.ground.scenario
    for name in key.split("."):
        value = getattr(value, name, None)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _count(one: Fresh) -> int:
    return len(one.search.failures)


def _fair(one: Fresh) -> int:
    return one.search.valid


def _number(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:.3f}"
