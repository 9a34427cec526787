"""Default folders: named after what they hold, so that nothing makes way for something else.

What a command is given beside its scenario stands in the name of the folder. What a name does not say (an
edited file, another length) is told by what lies there: a folder that holds another run is left alone, and
the new one gets a digest at the end of its name.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from mjmerge.config import shipped
from mjmerge.scenario.load import dump
from mjmerge.scenario.schema import Scenario

_LONGEST = 80
_DIGITS = 8


def slug(*parts: str) -> str:
    """Words as the end of a folder's name, each after a dash; other words give another one."""
    text = "".join(f"-{part}" for part in parts if part)
    short = re.sub(r"[^\w.,=+-]+", "_", text)[:_LONGEST]
    return short if short == text else f"{short}-{_digest(text)}"


def run_folder(
    scenario: Scenario, plant: str, seed: int, runs: int, *, continuous: bool, overrides: Sequence[str]
) -> Path:
    """Where a run goes that nobody gave a folder.

    Args:
        scenario: what is run.
        plant: what moves the cars.
        seed: of the first simulation.
        runs: number of simulations.
        continuous: whether in continuous time.
        overrides: keys that differ from the file, as ``--set`` takes them.
    """
    moved_by = f"{plant}_continuous" if continuous else plant
    folder = Path("runs") / f"{scenario.name}-{moved_by}-{seed}{slug(*overrides)}"
    what = dump(scenario)
    there = _what_is_in(folder)
    if there is None or there == (what, runs):
        return folder
    return folder.with_name(f"{folder.name}-{_digest(f'{runs} {what}')}")


def _what_is_in(folder: Path) -> tuple[str, int] | None:
    """The scenario of the run that a folder holds, and how often it was run; ``None`` if it holds none."""
    try:
        scenario = (folder / "scenario.yaml").read_text(encoding="utf-8")
    except (OSError, ValueError):
        return None
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        return scenario, int(json.loads((folder / "summary.json").read_text(encoding="utf-8"))["runs"])
    return None  # it was never finished


def ladder_folder(scenario: str, seed: int, overrides: Sequence[str]) -> Path:
    """Where a ladder goes."""
    return Path("ladders") / f"{scenario}{slug(f'seed_{seed}' if seed else '', *overrides)}"


def breaking_folder(
    scenario: str, plant: str, axes: Sequence[str], until: str, seeds: range, overrides: Sequence[str]
) -> Path:
    """Where a search for breaking points goes."""
    few = "" if seeds == range(1) else f"seeds_{seeds.start}_to_{seeds.stop - 1}"
    floor = "" if until == "unsafe" else until
    return Path("breaking") / f"{scenario}-{plant}{slug(*axes, floor, few, *overrides)}"


def falsified_folder(scenario: str, plant: str, words: Sequence[str], digest: str) -> Path:
    """Where a search for failures goes; one that holds another search, as of an edited file, is left alone.

    Args:
        scenario: its name.
        plant: what moves the cars.
        words: what else was given.
        digest: of what is searched.
    """
    from mjmerge.search.findings import LOOKS, digest_of

    folder = Path("falsified") / f"{scenario}-{plant}{slug(*words)}"
    if not folder.is_dir() or digest_of(folder / LOOKS) == digest:
        return folder
    return folder.with_name(f"{folder.name}-{digest[:_DIGITS]}")


def probability_folder(scenario: str, plant: str, words: Sequence[str]) -> Path:
    """Where the estimate of a probability goes."""
    return Path("probabilities") / f"{scenario}-{plant}{slug(*words)}"


def hardened_folder(scenario: str, plant: str, words: Sequence[str]) -> Path:
    """Where a law that was hardened goes."""
    return Path("hardened") / f"{scenario}-{plant}{slug(*words)}"


def traffic_folder(file: Path, words: Sequence[str]) -> Path:
    """Where the scenarios of a file of traffic go."""
    return Path("traffic") / f"{slug(file.stem)[1:]}{slug(*words)}"


def identified_folder(place: Path) -> Path:
    """Where what was measured of a car goes; one's own is told apart from a shipped one of that name."""
    own = shipped.models().get(place.name, place) != place
    return Path("identified") / (f"{place.name}-{_digest(str(place))}" if own else place.name)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]
