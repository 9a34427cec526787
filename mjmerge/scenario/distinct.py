"""Which runs are one and the same: a sample is a distinct run, however often it is run.

Another seed gives another run only where something is random: a driver that draws, or noise and dropouts in
what the ego measures. Without, and wherever scenario, plant, mismatch and seed come up twice, runs are
copies: equal to the last bit, and no evidence of anything.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjmerge.config import shipped
from mjmerge.config.acts import BODIES
from mjmerge.drivers import ask
from mjmerge.law import OpinionDynamics
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.effect import acting, declared
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Road, Scenario
from mjmerge.vehicle.delay import steps_late

if TYPE_CHECKING:
    from mjmerge.sweep.plan import Batch, Case

SAME = "same_as"
"""Column of a table: the number of the first run that is the same run, its own if there is none before it."""


def random(scenario: Scenario, plant: str, *, continuous: bool = False) -> bool:
    """Whether another seed gives another run."""
    return _drawn(scenario) or _noisy(scenario, plant, continuous)


def _drawn(scenario: Scenario) -> bool:
    return any(ask(driver, "random", scenario.duration_s) for driver in scenario.neighbours)


def _noisy(scenario: Scenario, plant: str, continuous: bool) -> bool:
    return any(
        acts.random
        and getattr(scenario.mismatch, key.partition(".")[2])
        and acts.why_not(scenario, plant, continuous=continuous) is None
        for key, acts in declared().items()
    )


def same_as(cases: Sequence[Case]) -> tuple[int, ...]:
    """For each run, the index of the first that is the same run."""
    batches: dict[int, tuple[str, bool]] = {}
    truths: dict[tuple[int, int], tuple[Mismatch, bool]] = {}
    first: dict[object, int] = {}
    found = []
    for i, case in enumerate(cases):
        batch = case.batch
        if id(batch) not in batches:
            batches[id(batch)] = _content(batch), _drawn(batch.scenario)
        content, drawn = batches[id(batch)]
        truth = id(batch), id(case.mismatch)  # seeds of one point share it
        if truth not in truths:
            here = batch.scenario.model_copy(update={"mismatch": case.mismatch})
            acts_as = _in_steps(acting(here, batch.plant, continuous=batch.continuous), batch.plant)
            truths[truth] = acts_as, drawn or _noisy(here, batch.plant, batch.continuous)
        mismatch, seeded = truths[truth]
        found.append(first.setdefault((content, mismatch, case.seed if seeded else None), i))
    return tuple(found)


def _content(batch: Batch) -> str:
    """All that runs of a batch depend on but mismatch and seed; equal texts, equal runs."""
    scenario = acting(batch.scenario, batch.plant, continuous=batch.continuous)
    ego = car_sheets(scenario)[0]
    believed = {key: None if v == getattr(ego, key) else v for key, v in scenario.belief}
    where = {
        car: str(shipped.model_folder(model))
        for car, model in zip(scenario.roster.cars, scenario.car_models, strict=True)
    }
    plain: dict[str, Any] = {
        "description": "",
        "gate": (),
        "road": Road() if scenario.road.ends_m is None else scenario.road,
        "mismatch": Mismatch(),
        "belief": scenario.belief.model_copy(update=believed),
        "models": scenario.models.model_copy(update=where),
    }
    if isinstance(scenario.law, OpinionDynamics):
        variant = "+".join(sorted(scenario.law.variant.split("+")))
        plain["law"] = scenario.law.model_copy(update={"variant": variant})
    return f"{batch.plant} {batch.continuous}\n{scenario.model_copy(update=plain).model_dump_json()}"


def _in_steps(scenario: Scenario, plant: str) -> Mismatch:
    """Its mismatch with the dead time that a plant makes of it: physics has whole steps."""
    mismatch, step_s = scenario.mismatch, scenario.physics_step_s
    if plant not in BODIES or not mismatch.command_delay_s:
        return mismatch
    late_s = float(steps_late(mismatch.command_delay_s, step_s)) * step_s
    return mismatch.model_copy(update={"command_delay_s": late_s})


def distinct(rows: Sequence[Mapping[str, Any]]) -> list[Any]:
    """Of rows of a table, the first of each run."""
    found: dict[object, Mapping[str, Any]] = {}
    for i, row in enumerate(rows):
        found.setdefault(row.get(SAME, (i,)), row)
    return list(found.values())


def labels(sources: Sequence[str]) -> dict[str, str]:
    """What to call scenarios, given as on the command line: by name, and by path where names are not enough.

    The same file has the same label, however it is written; two files never have.
    """
    known = shipped.scenarios()
    paths = {source: _path(known.get(source, source)) for source in sources}
    found: dict[Path, str] = {}
    for path in dict.fromkeys(paths.values()):
        others = [other for other in dict.fromkeys(paths.values()) if other != path]
        parts = path.with_suffix("").parts
        found[path] = next(
            (
                tail
                for k in range(1, len(parts))
                if (tail := "/".join(parts[-k:]))
                not in {"/".join(o.with_suffix("").parts[-k:]) for o in others}
            ),
            str(path),
        )
    return {source: found[path] for source, path in paths.items()}


def _path(source: str | Path) -> Path:
    """Where it is, however it is written; a link is a file of its own."""
    return Path(os.path.abspath(source))  # noqa: PTH100 (resolve() follows links)
