"""Every lane change of a file: as a scenario that was run and judged, or as a reason why it is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mjmerge.errors import ModelError, ScenarioError
from mjmerge.merges.event import Event, event
from mjmerge.merges.margins import Margins, margins
from mjmerge.merges.scenario import scenario, source
from mjmerge.merges.tighten import tightened
from mjmerge.plant import check
from mjmerge.scenario.load import load
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Trace
from mjmerge.traffic.changes import Change, Skipped, lane_changes
from mjmerge.traffic.tracks import Tracks
from mjmerge.verdict.judge import VACUOUS, Verdict, judge


@dataclass(frozen=True)
class Merge:
    """An event, its scenario, and the law in the human's place.

    Attributes:
        event: what happened.
        keys: of the scenario.
        scenario: the same, loaded.
        trace: the law's run.
        verdict: on it.
        human: the human's margins; against the follower as recorded.
        law: the law's.
    """

    event: Event
    keys: dict[str, Any]
    scenario: Scenario
    trace: Trace
    verdict: Verdict
    human: Margins
    law: Margins


@dataclass(frozen=True)
class Merges:
    """What a file of traffic comes to.

    Attributes:
        traffic: the file.
        changes: how many lane changes there are in it, used or not.
        merges: scenarios; those of an event stand together, as recorded first.
        skipped: lane changes, and road users, that make none.
        plant: what moved the cars.
    """

    traffic: Tracks
    changes: int
    merges: tuple[Merge, ...]
    skipped: tuple[Skipped, ...]
    plant: str


def merges(
    traffic: Tracks, plant: str, steps: int = 0, told: Callable[[int, int], None] | None = None
) -> Merges:
    """Every lane change of a file as a scenario, or why it is none; each is run once.

    Cars have the sizes of the record; physical ones can be stretched to some only.

    Args:
        traffic: the file.
        plant: what moves the cars.
        steps: in how many steps each follower is tightened; 0 leaves it.
        told: called with how many scenarios were run, of how many.
    """
    found, skipped, names = [], [], set[str]()
    changes = list(lane_changes(traffic))
    for change in changes:
        one = event(traffic, change) if isinstance(change, Change) else change
        if isinstance(one, Skipped):
            skipped.append(one)
            continue
        while one.name in names:
            one = replace(one, name=f"{one.name}_")
        names.add(one.name)
        human = margins(one.time_s, one.front_m, one.bodies, one.r_m, one.lane_m)
        for version in (one, *tightened(one, steps)):
            keys = scenario(version, traffic)
            try:
                loaded = load(keys).named(version.name)
                check(plant, loaded)
                found.append((version, keys, loaded, human))
            except (ScenarioError, ModelError) as error:
                skipped.append(Skipped(version.name, _why(error)))
    skipped += [Skipped(f"road user {one.id}", one.why) for one in traffic.unused]
    ran = []
    for version, keys, loaded, human in found:
        ran.append(_run(version, keys, loaded, human, plant))
        if told is not None:
            told(len(ran), len(found))
    return Merges(traffic, len(changes), tuple(ran), tuple(skipped), plant)


def _run(one: Event, keys: dict[str, Any], loaded: Scenario, human: Margins, plant: str) -> Merge:
    trace = simulate(loaded, plant)
    known = int(np.isfinite(trace.front_m[0]).all(axis=(1, 2)).sum())  # a run may stop early
    time_s, front_m = trace.time_s[:known], trace.front_m[0, :known]
    law = margins(time_s, front_m, one.bodies, one.r_m, one.lane_m)
    return Merge(one, keys, loaded, trace, judge(trace)[0], human, law)


def _why(error: Exception) -> str:
    """The first problem of a scenario that is none, in words."""
    if isinstance(error, ScenarioError):
        first = error.problems[0]
        return f"makes no scenario: {first.key}: {first.message}"
    return f"makes no scenario: {error}"


def as_json(found: Merges, folder: str) -> dict[str, Any]:
    """What ``--json`` prints."""
    return {
        "file": str(found.traffic.path),
        "format": found.traffic.format,
        "road_users": found.traffic.road_users,
        "tracks": len(found.traffic.tracks),
        "lane_changes": found.changes,
        "plant": found.plant,
        "scenarios": [_scenario_json(one, found, folder) for one in found.merges],
        "skipped": [vars(one) for one in found.skipped],
        "notes": list(found.traffic.notes),
        "out": folder,
    }


def _scenario_json(one: Merge, found: Merges, folder: str) -> dict[str, Any]:
    what = one.event
    return {
        "path": f"{folder}/{what.name}.yaml",
        "ego": what.change.car,
        "leader": what.change.leader,
        "follower": what.change.follower,
        "from_s": what.from_s,
        "crossed_s": what.crossed_s,
        "duration_s": one.scenario.duration_s,
        "smoothing_m": what.smoothing_m,
        "length_m": [body.length_m for body in what.bodies],
        "sources": [source(what, found.traffic, j) for j in range(3)],
        "first_mps2": what.first_mps2,
        "least_gap_m": float(what.gap_m.min()),
        "r_m": what.r_m,
        "breaks_assumption": bool(what.breaks),
        "why": what.breaks or None,
        "tightened": what.tightened or None,
        "tightened_part": what.step,
        "others_left_out": what.change.others,
        "between": list(what.change.between),
        "verdict": one.verdict.verdict,
        "reason": one.verdict.reason,
        "vacuous": one.verdict.verdict == VACUOUS,
        "human": one.human.as_json(),
        "law": one.law.as_json(),
    }
