"""Which run is meant by a scenario's name or file, the folder of a run or of a finding, or a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjmerge.config import shipped
from mjmerge.config.document import parse
from mjmerge.drivers import Absent
from mjmerge.errors import MjmergeError, UnreadableError
from mjmerge.law import AbsentLaw
from mjmerge.plant import PLANTS
from mjmerge.record import content
from mjmerge.record.content import ContentError
from mjmerge.record.read import read, recording
from mjmerge.scenario.load import load
from mjmerge.scenario.schema import Scenario

_RECORDINGS = (".mcap", ".rrd", ".partial")


@dataclass(frozen=True)
class Meant:
    """A run, as far as it is said what it is.

    Attributes:
        scenario: of it.
        plant: what moved the cars.
        seed: of it; of several, of the worst.
        continuous: whether in continuous time.
        runs: how many there were together.
        min_distance_m: the least d_j that it came to, m; ``None`` where nobody says.
    """

    scenario: Scenario
    plant: str = "mujoco"
    seed: int = 0
    continuous: bool = False
    runs: int = 1
    min_distance_m: float | None = None


def meant(name: str, overrides: Sequence[str] = ()) -> Meant:
    """The run that is meant.

    Args:
        name: a shipped scenario's name, a scenario's file, the folder of a run or of a finding (which has no
            plant or seed of its own), or a recording.
        overrides: keys that are different, as ``--set`` takes them.

    Raises:
        MjmergeError: there is nothing of that name, or it does not say what the run was.
    """
    if name in shipped.scenarios():
        return Meant(load(name, overrides))
    for place in (Path(name), Path("runs") / name):
        if os.path.isdir(place):  # noqa: PTH112 (a name may be too long)
            return _of_folder(place, overrides)
        if place.suffix in _RECORDINGS and os.path.isfile(place):  # noqa: PTH113
            return _of_recording(place, overrides)
    if Path(name).suffix in _RECORDINGS:
        raise UnreadableError(Path(name), "there is no recording of that name")
    return Meant(load(name, overrides))


def _of_folder(folder: Path, overrides: Sequence[str]) -> Meant:
    """The run that left a folder; of several the worst."""
    if not (folder / "scenario.yaml").is_file():
        raise MjmergeError(f"{folder} is not the folder of a run: there is no scenario.yaml in it")
    scenario = load(folder / "scenario.yaml", overrides)
    path = folder / "summary.json"
    if not path.exists():
        try:  # what was not finished says in its recording what it was
            found = read(recording(folder))
        except UnreadableError:  # a finding has none
            return Meant(scenario.named(folder.resolve().name))
        return _from(found.manifest, scenario.named(str(found.manifest["scenario"])))
    try:
        said = content.json_of(path.read_text(encoding="utf-8"), path.name)
        runs = int(said["runs"])
        about = {key: said[key] for key in ("plant", "continuous")}
        seed = said["worst_seed"] if runs > 1 else said["seed"]
        name, least_m = str(said["scenario"]), _least_m(said)
    except (OSError, ValueError, KeyError, TypeError, ContentError) as error:
        raise MjmergeError(f"{path} does not say what the run was: {error}") from error
    return _from(about | {"seed": seed}, scenario.named(name), runs, None if overrides else least_m)


def _of_recording(path: Path, overrides: Sequence[str]) -> Meant:
    """The run in a recording; with the cars' data sheets that are in it, and the models that are here."""
    found = read(path)
    scenario = found.scenario()
    absent = [driver.kind for driver in scenario.neighbours if isinstance(driver, Absent)]
    absent += [scenario.law.kind] * isinstance(scenario.law, AbsentLaw)
    if absent:
        why = f"the code of {absent[0]} is in it and is never run from it: give the run's folder or scenario"
        raise UnreadableError(path, why)
    if overrides:
        given = parse(found.scenario_yaml).value
        scenario = load(given, overrides, code=False).named(scenario.name)
    summary = found.summary or {}
    return _from(found.manifest, scenario, 1, None if overrides else _least_m(summary))


def _from(
    about: Mapping[str, Any], scenario: Scenario, runs: int = 1, min_distance_m: float | None = None
) -> Meant:
    plant, seed, continuous = about["plant"], about["seed"], about["continuous"]
    if plant not in PLANTS or type(seed) is not int or seed < 0:
        raise MjmergeError(f"no run can have been on {plant!r} with seed {seed!r}")
    return Meant(scenario, str(plant), seed, bool(continuous), runs, min_distance_m)


def _least_m(summary: Mapping[str, Any]) -> float | None:
    """The least d_j of all neighbours, m."""
    known = [float(d) for d in summary.get("min_distance_m", {}).values() if d is not None]
    return min(known, default=None)
