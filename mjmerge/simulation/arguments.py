"""What the functions of ``mjmerge`` are called with, checked before anything is done with it.

The type checker of whoever annotates finds these mistakes first; in a notebook nobody does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mjmerge.config.bounds import MOST_RUNS, MOST_SEED, most_threads, whole
from mjmerge.config.document import copied, described
from mjmerge.config.doors import DoorError
from mjmerge.config.frozen import Frozen, PerCar
from mjmerge.config.read import raise_problems, validated
from mjmerge.errors import MjmergeError, Problem, ScenarioError, nearest
from mjmerge.law import AbsentLaw, lacking
from mjmerge.plant import PLANTS
from mjmerge.roster import slot
from mjmerge.scenario.checks import check
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.trace import Trace


def check_scenario(given: object) -> None:
    """Refuses what is no scenario, and one that was altered into something that no file could say.

    Raises:
        MjmergeError: it is none; with what to pass.
        ScenarioError: it is none any more; with every problem and its key.
    """
    if isinstance(given, Trace):
        raise MjmergeError("expected a scenario, got a trace; the scenario of a trace is trace.scenario")
    if not isinstance(given, Scenario):
        as_name = repr(given) if isinstance(given, str) else '"paper"'
        raise MjmergeError(
            f"expected a scenario, got {described(given)}; pass one that was loaded: mjmerge.load({as_name})"
        )
    if isinstance(given.law, AbsentLaw):
        raise DoorError(
            f"what {given.law.kind} decides is not known without its code: it is from a recording"
        )
    where = f"scenario {given.name!r}, altered"
    strangers = list(_strangers(given, ""))
    if strangers:
        raise ScenarioError(where, strangers)
    document = copied(given.model_dump(warnings=False))
    again = validated(Scenario, document)
    if again is not None:
        for problem in check({name: getattr(again, name) for name in Scenario.model_fields}):
            document.report(problem.message, problem.key)
    raise_problems(where, document)
    for name in Scenario.model_fields:
        mine, theirs = getattr(given, name), getattr(again, name)
        if isinstance(theirs, Frozen) and type(mine) is not type(theirs):
            message = f"expected {type(theirs).__name__}, got {described(mine)}; alter it by model_copy"
            raise ScenarioError(where, [Problem(message, name)])


def _strangers(model: Frozen, key: str) -> Any:
    """Keys that an alteration made up."""
    fields = type(model).model_fields
    further = model.further if isinstance(model, PerCar) else {}
    for name, value in (vars(model) | further).items():
        here = f"{key}.{name}" if key else name
        if name not in fields and (name not in further or slot(name) is None):
            yield Problem(f"unknown key; {nearest(name, fields)}", here)
        elif isinstance(value, Frozen):
            yield from _strangers(value, here)


def check_run(
    scenario: object,
    plant: object,
    runs: object,
    seed: object,
    threads: object,
    cases: object,
    **more: object,
) -> None:
    """Refuses what :func:`mjmerge.simulate` cannot run; its arguments, under their names.

    Raises:
        MjmergeError: with what to pass.
    """
    check_scenario(scenario)
    assert isinstance(scenario, Scenario)
    for message in lacking(scenario.law):
        raise MjmergeError(message)
    if not isinstance(plant, str):
        raise MjmergeError(f"the plant must be one of {', '.join(PLANTS)}, got {described(plant)}")
    whole("threads", threads, 0, most_threads())
    kinds: dict[str, type] = {"continuous": bool}
    if more.get("world") is None:
        more.pop("world", None)
    else:
        from mjmerge.world.model import World  # physics takes its time to import

        kinds["world"] = World
    for name, value in more.items():
        if not isinstance(value, kinds[name]):
            raise MjmergeError(f"{name} must be a {kinds[name].__name__}, got {described(value)}")
    if cases is None:
        whole("seed", seed, 0, MOST_SEED)
        whole("runs", runs, 1, MOST_RUNS)
        return
    if not isinstance(cases, Sequence) or isinstance(cases, str) or not cases:
        raise MjmergeError(f"cases must be a list of pairs (seed, mismatch), got {described(cases)}")
    for case in cases:
        if not isinstance(case, tuple) or len(case) != 2 or not isinstance(case[1], Mismatch):
            raise MjmergeError(
                f"a case must be a pair (seed, mismatch), got {described(case)}; a scenario's mismatch "
                "is scenario.mismatch"
            )
        whole("a seed", case[0], 0, MOST_SEED)
    for mismatch in {case[1] for case in cases}:
        document = copied(mismatch.model_dump(warnings=False))
        validated(Mismatch, document)
        raise_problems("mismatch, altered", document)
