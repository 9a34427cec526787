"""A plan: which runs there are to be, each a scenario with other keys, a plant, a seed and a mismatch."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

from mjmerge.config.document import Document, parse, scalar
from mjmerge.config.read import raise_problems, validated
from mjmerge.errors import Problem, ScenarioError
from mjmerge.plant import check as check_plant
from mjmerge.roster import EGO
from mjmerge.scenario.cars import sheet_of
from mjmerge.scenario.checks import check
from mjmerge.scenario.distinct import labels, same_as
from mjmerge.scenario.effect import covers, defaults, given_in_vain
from mjmerge.scenario.load import load
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.sweep.fidelity import Fidelity, first
from mjmerge.verdict import own

MISMATCH, VARIANT, KIND = "mismatch.", "law.variant", "law.kind"
NONE = "none"
"""Name of a mismatch that nobody named: the scenario as it is."""
FULL_SIZE_M = 1.0
"""Wheelbase from which a car's levels of mismatch are those of a full-size car, m."""


@dataclass(frozen=True)
class Batch:
    """What runs together share.

    Attributes:
        scenario: with every key that is not a mismatch in place.
        source: the scenario's name or path, as on the command line.
        plant: what moves the cars.
        overrides: keys that differ from the file, as ``--set`` takes them; the mismatch is not among them.
        continuous: whether in continuous time.
        fidelity: whether larger steps of the physics come first; ``None``: all runs are at their own.
    """

    scenario: Scenario
    source: str
    plant: str
    overrides: tuple[str, ...]
    continuous: bool = False
    fidelity: Fidelity | None = None

    @property
    def begun(self) -> Scenario | None:
        """The scenario as its runs are made first, with larger steps; ``None`` where they are not."""
        found = first(self.scenario, self.plant, self.fidelity)
        return None if found is self.scenario else found


@dataclass(frozen=True)
class Case:
    """One run of a campaign.

    Attributes:
        batch: what it shares with others.
        point: name of its mismatch.
        seed: its seed.
        mismatch: how the truth differs from what the law is told.
        differs: keys of that which differ from the file, as ``--set`` takes them.
        idle: keys that were to differ and are left out, because here they are without effect, and why.
        of_block: of what differs, what its block sets in all its runs.
    """

    batch: Batch
    point: str
    seed: int
    mismatch: Mismatch
    differs: tuple[str, ...]
    idle: Mapping[str, str] = field(default_factory=dict)
    of_block: tuple[str, ...] = ()

    @property
    def overrides(self) -> tuple[str, ...]:
        """Everything that differs from the file, as ``--set`` takes it."""
        return (*self.batch.overrides, *self.differs)

    @property
    def command(self) -> tuple[str, ...]:
        """The arguments of ``mjmerge`` that give this run alone."""
        return self.command_at(None)

    def command_at(self, physics_step_s: float | None) -> tuple[str, ...]:
        """The same, of a run that was made with that step of the physics, s; ``None``: it has none."""
        b = self.batch
        other = physics_step_s is not None and physics_step_s != b.scenario.physics_step_s
        coarse = (f"physics_step_s={physics_step_s:g}",) if other else ()
        keys = [word for text in (*self.overrides, *coarse) for word in ("--set", text)]
        time = ["--continuous"] if b.continuous else []
        return ("run", b.source, "--plant", b.plant, *time, "--seed", str(self.seed), *keys)

    def value(self, key: str) -> Any:
        """What a scenario key is in this run; ``None`` where there is no such key."""
        value: Any = self.mismatch if key.startswith(MISMATCH) else self.batch.scenario
        for part in key.removeprefix(MISMATCH).split("."):
            if isinstance(value, tuple) and part.isdigit():
                value = value[int(part)] if int(part) < len(value) else None
            else:
                value = getattr(value, part, None)
        return value


@dataclass(frozen=True)
class Plan:
    """A campaign as its list of runs.

    Attributes:
        name: of the campaign.
        description: what it is for, in a line.
        axes: scenario keys that some run sets, in the order they come up.
        cases: every run.
        left_out: why, and axes of ``levels`` that were left out for it.
        same_as: of each run, the first that is the same run, see :mod:`mjmerge.scenario.distinct`.
        labels: what each source of a scenario is called.
    """

    name: str
    description: str
    axes: tuple[str, ...]
    cases: tuple[Case, ...]
    left_out: Mapping[str, tuple[str, ...]]
    same_as: tuple[int, ...]
    labels: Mapping[str, str]

    @cached_property
    def batches(self) -> list[Batch]:
        """What runs share, each once, in the order they come up."""
        return list({id(case.batch): case.batch for case in self.cases}.values())

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """What the scenarios' own metrics are called, each once, in the order they come up."""
        return tuple(dict.fromkeys(name for batch in self.batches for name in own.names(batch.scenario)))

    @cached_property
    def neighbours(self) -> int:
        """How many neighbours the scenario with most of them has."""
        return max(len(batch.scenario.roster.neighbours) for batch in self.batches)

    @cached_property
    def ends(self) -> bool:
        """Whether some scenario has an end of the ego's lane."""
        return any(batch.scenario.road.ends_m is not None for batch in self.batches)

    @cached_property
    def bounds(self) -> bool:
        """Whether some scenario has bounds of its own metrics."""
        return any(batch.scenario.expect.metrics for batch in self.batches)


def planned(
    name: str,
    description: str,
    cases: Sequence[Case],
    left_out: Mapping[str, tuple[str, ...]] | None = None,
) -> Plan:
    """A plan of these runs."""
    keys = dict.fromkeys(text.partition("=")[0] for case in cases for text in case.overrides)
    axes = tuple(key for key in keys if key not in (VARIANT, KIND))
    called = labels(list(dict.fromkeys(case.batch.source for case in cases)))
    return Plan(name, description, axes, tuple(cases), left_out or {}, same_as(cases), called)


class Batches:
    """Scenarios that are loaded, so that runs that can share one do."""

    def __init__(self, fidelity: Fidelity | None = None) -> None:
        self._found: dict[tuple[object, ...], Batch] = {}
        self._fidelity = fidelity

    def of(self, source: str, plant: str, overrides: tuple[str, ...], *, continuous: bool = False) -> Batch:
        """The batch of a scenario with these keys different.

        Raises:
            MjmergeError: there is none.
        """
        key = (source, plant, overrides, continuous)
        if key not in self._found:
            scenario = load(source, overrides).settled()  # what is without effect is told case by case
            check_plant(plant, scenario)
            self._found[key] = Batch(scenario, source, plant, overrides, continuous, self._fidelity)
        return self._found[key]

    def case(
        self,
        source: str,
        plant: str,
        settings: Mapping[str, Any],
        *,
        seed: int = 0,
        point: str = NONE,
        continuous: bool = False,
        lenient: bool = False,
    ) -> Case:
        """One run.

        Args:
            source: the scenario's name or path.
            plant: what moves the cars.
            settings: scenario keys that differ, and their values.
            seed: its seed.
            point: name of what differs.
            continuous: whether in continuous time.
            lenient: whether settings without effect are left out of the run, instead of refused.

        Raises:
            MjmergeError: it cannot be; with every problem found.
        """
        other = {k: v for k, v in settings.items() if not is_mismatch(k)}
        batch = self.of(source, plant, as_overrides(other), continuous=continuous)
        mine = {k: v for k, v in settings.items() if is_mismatch(k)}
        document = Document({k.removeprefix(MISMATCH): v for k, v in mine.items()})
        mismatch = mismatch_of(batch.scenario, document)
        document.problems = [replace(p, key=MISMATCH + p.key) for p in document.problems]
        raise_problems(source, document)
        assert mismatch is not None, "what is not valid has problems"
        idle = in_vain(batch, mismatch, settings)
        if idle and lenient and idle.keys() <= settings.keys():
            rest = {k: v for k, v in settings.items() if k not in idle}
            kept = self.case(source, plant, rest, seed=seed, point=point, continuous=continuous)
            return replace(kept, idle=idle)
        if idle:
            raise ScenarioError(
                source, [Problem(why, k, source=_set(k, settings)) for k, why in idle.items()]
            )
        return Case(batch, point, seed, mismatch, as_overrides(mine))


def in_vain(batch: Batch, mismatch: Mismatch, keys: Collection[str]) -> dict[str, str]:
    """Of the keys that a run sets, those that are without effect in it, and why."""
    scenario = batch.scenario.model_copy(update={"mismatch": mismatch})
    return given_in_vain(scenario, batch.plant, keys, continuous=batch.continuous)


def acts(case: Case, key: str) -> bool:
    """Whether a key has another value than its default in a run, and is not left out of it."""
    return key not in case.idle and case.value(key) != defaults().get(key)


def _set(key: str, settings: Mapping[str, Any]) -> str:
    """The setting that a key comes from, as on the command line."""
    name = max((name for name in settings if covers(name, key)), key=len)
    return f"--set {name}={written(settings[name])}"


def is_mismatch(key: str) -> bool:
    """Whether a scenario key is one of the mismatch."""
    return key.startswith(MISMATCH)


def as_overrides(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Settings as ``--set`` takes them."""
    return tuple(f"{key}={written(value)}" for key, value in settings.items())


def mismatch_of(scenario: Scenario | None, document: Document) -> Mismatch | None:
    """The scenario's mismatch with a document's values in place; problems are reported there."""
    if validated(Mismatch, document) is None or scenario is None:
        return None
    whole = Mismatch.model_validate(scenario.mismatch.model_dump() | document.value)
    sections = {name: getattr(scenario, name) for name in Scenario.model_fields} | {"mismatch": whole}
    for problem in check(sections):
        if problem.key.startswith(MISMATCH):
            document.report(problem.message, problem.key.removeprefix(MISMATCH))
    return None if document.problems else whole


def written(value: Any) -> str:
    """A value as YAML on one line, which reads as the same value."""
    if isinstance(value, str) and re.fullmatch(r"[A-Za-z_][\w+]*", value) and scalar(value) == value:
        return value
    return json.dumps(value, ensure_ascii=False)


def given(texts: Sequence[str]) -> dict[str, Any]:
    """Settings that stand on the command line, ``KEY=VALUE`` each.

    Raises:
        ScenarioError: one is none.
    """
    found: dict[str, Any] = {}
    document = Document()
    for text in texts:
        key, equals, value = text.partition("=")
        read_value = parse(value)
        document.problems += [replace(p, line=None, source=f"--set {text}") for p in read_value.problems]
        if not equals or not key.strip():
            problem = Problem("must be KEY=VALUE, such as law.k_o=0", source=f"--set {text}")
            document.problems.append(problem)
        found[key.strip()] = read_value.value
    raise_problems("command line", document)
    return found


def size_of(scenario: Scenario) -> Literal["rc", "full"]:
    """Which size of car the levels of mismatch are to be those of."""
    wheelbase_m = sheet_of(scenario.models, EGO).wheelbase_m
    return "full" if wheelbase_m >= FULL_SIZE_M else "rc"
