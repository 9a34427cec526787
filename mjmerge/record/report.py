"""The report inside a recording, as Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from mjmerge.record.base import Header, Outcome


def unfinished(header: Header) -> str:
    """The report of a run that has not come to its end."""
    note = "**This run did not finish**; what was recorded of it is here."
    return f"{_title(header)}\n\n{note}\n\n{_origin(header)}"


def finished(header: Header, outcome: Outcome) -> str:
    """The report of a run: verdict, events that matter, summary, origin."""
    worst = [f"- {e.time_s:.2f} s, {e.car or 'run'}: {e.text}" for e in outcome.events if e.level != "info"]
    rows = [f"| {key} | {value} |" for key, value in _flat(outcome.summary)]
    return "\n".join(
        [
            _title(header),
            "",
            f"**Verdict: {outcome.verdict}**",
            "",
            *worst,
            "",
            "| | |",
            "|---|---|",
            *rows,
            "",
            _origin(header),
        ]
    )


def _title(header: Header) -> str:
    scenario = header.scenario
    return f"### {scenario.name} on {header.plant}, seed {header.seed}\n\n{scenario.description}"


def _origin(header: Header) -> str:
    return "Made with " + ", ".join(f"{name} {version}" for name, version in header.versions.items()) + "."


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested keys joined by dots, numbers to four digits."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", f"{value:.4g}" if isinstance(value, float) else str(value)
