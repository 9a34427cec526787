"""The report inside a recording, as Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from mjmerge.record.recording import Header, Outcome


def unfinished(header: Header) -> str:
    """The report of a run that has not come to its end."""
    note = "**This run has not finished**: what there is of it so far is here."
    return f"{_title(header)}\n\n{note}\n\n{_origin(header)}"


def finished(header: Header, outcome: Outcome) -> str:
    """The report of a run: verdict, what decides it, events that matter, everything else, origin."""
    found = outcome.summary
    worst = [f"- {e.time_s:.2f} s, {e.car or 'run'}: {e.text}" for e in outcome.events if e.level != "info"]
    return "\n".join(
        [
            _title(header),
            "",
            f"**Verdict: {outcome.verdict}**{_reason(found)}",
            "",
            *_table(_main(found)),
            "",
            *why(outcome.explanation),
            *worst,
            "",
            LEGEND,
            "",
            *_table(_flat(found)),
            "",
            *_outside(header),
            _origin(header),
        ]
    )


def of(
    ran: Sequence[str],
    description: str,
    found: Mapping[str, Any] | None,
    verdict: str | None,
    explanation: Mapping[str, Any] | None = None,
) -> str:
    """The report of a run that was read from a file; ``ran`` says what ran, a line each."""
    found = found or {}
    said = (
        f"**Verdict: {verdict}**{_reason(found)}"
        if verdict
        else "**Verdict: none, the run has not finished**"
    )
    head = [title(ran), "", description, "", said, ""]
    main = [*_table(_main(found)), "", *why(explanation)]
    return "\n".join([*head, *main, LEGEND, "", *_table(_flat(found))])


def why(explanation: Mapping[str, Any] | None) -> Iterator[str]:
    """Why a run fails, as a section of its own; nothing where nobody asked."""
    if explanation is None:
        return
    yield from ("#### Why", "")
    yield from (f"- {cell(one)}" for one in explanation["sentences"])
    yield ""
    if explanation["table"]:
        yield from ("| taken back | margin, m | moves it by, m | then |", "|---|---|---|---|")
        for one in explanation["table"]:
            margin, moved = (one[key] for key in ("margin_m", "moves_m"))
            numbers = ["-" if margin is None else f"{margin:.3f}", "-" if moved is None else f"{moved:+.3f}"]
            yield "| " + " | ".join([cell(one["taken_back"]), *numbers, cell(one["then"])]) + " |"
        yield ""


def cell(text: str) -> str:
    """A text on a line of its own or in a table."""
    return " ".join(text.split()).replace("|", "\\|")


LEGEND = (
    "The ego's front axle must stay out of the discs, which have the radius r: *green* where d_j is r or "
    "more, *amber* at r/2, *red* where it is inside. Where bodies touch, a *pin* stays at the place, and "
    "their discs are *bright red* for 2 s. The *ghost* is where the nominal law wants the ego. Arrows at "
    "the ego, r long for 2 m/s²: *blue* u_n, *pink* u_c, *yellow* u = u_n + u_c."
)
"""What is drawn, in words."""


def _main(found: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What the verdict is about."""
    least, at = found.get("min_distance_m", {}), found.get("t_min_distance_s", {})
    for j, car in enumerate(least, start=1):
        when = f" at {_number(at[car], 's')}" if at.get(car) is not None else ""
        yield f"min d_{j}", f"{_number(least[car], 'm')}{when}"
    for key, name, unit in (
        ("min_clearance_m", "body clearance", "m"),
        ("floor_m", "safety floor", "m"),
        ("merged_at_s", "merged at", "s"),
    ):
        if key in found:
            yield name, _number(found[key], unit)


def _reason(found: Mapping[str, Any]) -> str:
    """Grounds of a verdict, and what speaks against it."""
    reasons = [*([found["reason"]] if "reason" in found else []), *found.get("verdict_doubts", ())]
    return f": {'; but '.join(reasons)}" if reasons else ""


def _number(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.3f} {unit}"


def _table(rows: Iterable[tuple[str, str]]) -> list[str]:
    return ["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in rows)]


def _title(header: Header) -> str:
    return f"{title(header.ran)}\n\n{header.scenario.description}"


def title(ran: Sequence[str]) -> str:
    """What ran, mismatch and settings below it."""
    head, *more = ran
    return "\n\n".join([f"### {head}", *([f"**{cell('; '.join(more))}**"] if more else [])])


def _outside(header: Header) -> Iterator[str]:
    """What the scenario's own metrics are, in words, and all code from outside."""
    for metric in header.metrics:
        yield f"`{metric['name']}` is {metric['reference']}: {metric['description']}"
        yield ""
    for source in dict.fromkeys(code["source"] for code in header.code.values()):
        fence = "`" * (1 + max(map(len, re.findall("`+", source)), default=2))
        yield from (f"{fence}python", source.rstrip("\n"), fence, "")


def _origin(header: Header) -> str:
    return "Made with " + ", ".join(f"{name} {version}" for name, version in header.versions.items()) + "."


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested keys joined by dots, numbers to four digits."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", f"{value:.4g}" if isinstance(value, float) else str(value)
