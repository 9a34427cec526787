"""The findings of a search, recorded: each beside the run that is safe, in a scene and in a figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from mjmerge.errors import MjmergeError, OutputError
from mjmerge.outputs import prepare
from mjmerge.record.read import read, recording
from mjmerge.review.compare import Side, figure, recording_of_both
from mjmerge.run import FILES, run
from mjmerge.search.falsify import Search
from mjmerge.search.falsify_report import FIGURE, SCENARIO, SENTENCE, named, place
from mjmerge.search.findings import Finding

_RUN, _IDEAL, _BOTH = "run", "ideal", "compare.rrd"


def cleared(folder: Path) -> None:
    """Takes earlier findings out of a folder.

    Raises:
        OutputError: one of them holds what is not ours.
    """
    for old in sorted(folder.glob("finding-*")):
        for sub in (_RUN, _IDEAL, ""):
            if (old / sub).is_dir():
                prepare(old / sub, True, FILES if sub else (SCENARIO, SENTENCE, FIGURE, _BOTH))
                with suppress(OSError):
                    (old / sub).rmdir()


def record(
    found: Search, findings: Sequence[Finding], folder: Path, told: Callable[[int], None] | None = None
) -> list[str]:
    """Runs each finding, and the same where it is safe, and records both.

    Args:
        found: what was looked at.
        findings: the different failures of it.
        folder: where the folders of the findings go.
        told: called with the number of findings that are there so far.

    Returns:
        What could not be recorded, a line each.

    Raises:
        OutputError: a file cannot be written.
    """
    failures = []
    for k, one in enumerate(findings, 1):
        failures += _record(found, one, k, place(folder, k))
        if told is not None:
            told(k)
    return failures


def _record(found: Search, one: Finding, k: int, at: Path) -> list[str]:
    scenario, seed = named(found, one, k), one.shrunk.pair.seed
    ideal = one.against.of(scenario).model_copy(update={"gate": ()})
    sides = ((_IDEAL, ideal, one.against.plant(one.plant)), (_RUN, scenario, one.plant))
    failures = []
    for name, what, plant in sides:
        failures += run(what, plant, seed=seed, folder=at / name, explain=name == _RUN).failures
    if failures:
        return [f"{at.name}: {failure}" for failure in failures]
    try:
        a, b = (Side.of(read(recording(at / name))) for name in (_IDEAL, _RUN))
        figure(a, b, at / FIGURE)
        recording_of_both(a, b, at / _BOTH)
    except OutputError:
        raise
    except MjmergeError as error:
        return [f"{at.name}: {_BOTH}: {error}"]
    return []
