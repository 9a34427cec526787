"""Tasks as they are asked for: by scenario, plant, action and cases, checked before anything runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjmerge.config.document import copied, described
from mjmerge.config.read import raise_problems, validated
from mjmerge.envs.adversary import Adversary
from mjmerge.envs.merge import Merge
from mjmerge.envs.task import Task
from mjmerge.errors import MjmergeError
from mjmerge.scenario.effect import check as check_effect
from mjmerge.scenario.load import load
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.arguments import check_scenario

Given = Scenario | str | Path | Mapping[str, Any]
"""A scenario, or what :func:`mjmerge.load` takes for one."""
Cases = Sequence[Mismatch | Mapping[str, Any]]
"""Mismatch of episodes: whole, or the keys of the section ``mismatch`` that are not the scenario's."""


def merging(
    scenario: Given = "paper",
    plant: str = "mujoco",
    action: str = "acceleration",
    settings: Sequence[str] = (),
) -> Merge:
    """The merge.

    Args:
        scenario: where.
        plant: what moves the cars.
        action: ``acceleration`` u of the front axle, or ``steering``: acceleration along the car and angle.
        settings: keys of the scenario that are different, such as ``"duration_s=20"``.

    Raises:
        MjmergeError: one of them is none; with the nearest that is.
    """
    return Merge(_loaded(scenario, settings), plant, action)


def opposing(
    scenario: Given = "paper",
    plant: str = "mujoco",
    car: str | None = None,
    settings: Sequence[str] = (),
) -> Adversary:
    """The mirror image.

    Args:
        scenario: where.
        plant: what moves the cars.
        car: the neighbour that the agent drives; the law's follower, if none is named.
        settings: as of :func:`merging`.

    Raises:
        MjmergeError: one of them is none; with the nearest that is.
    """
    return Adversary(_loaded(scenario, settings), plant, car)


def _loaded(scenario: Given, settings: Sequence[str]) -> Scenario:
    if not isinstance(scenario, Scenario):
        return load(scenario, settings)
    check_scenario(scenario)
    if settings:
        raise MjmergeError("settings are of a scenario by its name or path; one that is loaded has its own")
    return scenario


def cases_of(task: Task, cases: Cases) -> tuple[Mismatch, ...]:
    """Mismatches to draw from; the scenario's own where none are given.

    Raises:
        MjmergeError: one of them is none, or changes nothing on the plant; with every problem, and its key.
    """
    if isinstance(cases, str | Mapping) or not isinstance(cases, Sequence):
        raise MjmergeError(f"cases must be a list of mismatches, got {described(cases)}")
    own, found = task.scenario.mismatch, []
    for i, case in enumerate(cases):
        if isinstance(case, Mapping):
            document = copied({**own.model_dump(), **case})
            mismatch = validated(Mismatch, document)
            raise_problems(f"cases[{i}]", document)
            assert mismatch is not None, "what is not valid has problems"
            found.append(mismatch)
        elif isinstance(case, Mismatch):
            found.append(case)
        else:
            raise MjmergeError(f"cases[{i}] must be a mismatch or a mapping, got {described(case)}")
    check_effect(task.scenario, task.plant, mismatches=found)
    return tuple(found) or (own,)


def draw(
    rng: np.random.Generator, cases: Sequence[Mismatch], seed: int | None = None
) -> tuple[int, Mismatch]:
    """Seed and mismatch of the next episode.

    Args:
        rng: of the environment.
        cases: to draw from.
        seed: of the simulation, where it is given.
    """
    case = cases[int(rng.integers(len(cases)))]
    return int(rng.integers(2**32)) if seed is None else seed, case
