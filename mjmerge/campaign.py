"""A campaign: which scenarios to run how often with what different, as one YAML file, and its list of runs.

A campaign is a list of blocks. Each block is a product: scenarios x plants x law variants x points x seeds. A
point is a set of scenario keys and their values: named by hand, one of a grid, or drawn at random.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import log
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from mjmerge import share
from mjmerge.checks import check
from mjmerge.document import Document, copied, parse, scalar
from mjmerge.errors import MjmergeError, Problem, ScenarioError, UnknownNameError, nearest
from mjmerge.frozen import Frozen
from mjmerge.levels import LEVELS
from mjmerge.levels import NAMES as LEVEL_NAMES
from mjmerge.loader import Source, data_sheet, file_of, load, raise_problems, read, validated
from mjmerge.mismatch import Mismatch
from mjmerge.plant import PLANTS
from mjmerge.plant import check as check_plant
from mjmerge.scenario import Scenario

MISMATCH, VARIANT = "mismatch.", "law.variant"
NONE, GRID, RANDOM = "none", "grid", "random"
"""Names of points that nobody named: the scenario as it is, one of a grid, one drawn at random."""
FULL_SIZE_M = 1.0
"""Wheelbase from which a car's levels of mismatch are those of a full-size car, m."""
MOST_RUNS = 1_000_000

Values = Annotated[tuple[Any, ...], Field(strict=False, min_length=1)]
Pair = Annotated[tuple[float, float], Field(strict=False)]


class Axis(Frozen):
    """How one key is drawn; one of the three."""

    uniform: Pair | None = None
    """From the first number to the second."""
    log_uniform: Pair | None = None
    """The same with a uniform logarithm; both positive."""
    choice: Values | None = None
    """One of these values, equally likely."""


class Random(Frozen):
    """Points drawn at random: the same seed gives the same ones."""

    draws: Annotated[int, Field(gt=0, le=MOST_RUNS)]
    """How many points; each is run with seeds of its own."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the draws; that of the runs is first_seed."""
    axes: Annotated[dict[str, Axis], Field(min_length=1)]
    """Scenario keys, and how each is drawn."""


class Block(Frozen):
    """Scenarios x plants x law variants x points x seeds."""

    scenarios: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    """Shipped names, or paths (relative ones from the campaign's folder)."""
    plants: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = ("mujoco",)
    """What moves the cars."""
    variants: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Variants of the law, in place of the scenarios' own."""
    seeds: Annotated[int, Field(gt=0, le=MOST_RUNS)] = 1
    """Runs of each point, each with another seed."""
    first_seed: Annotated[int, Field(ge=0)] = 0
    """The first of those."""
    set: dict[str, Any] = Field(default_factory=dict)
    """Scenario keys that have another value in all runs."""
    mismatches: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """Points by name, each some scenario keys and their values."""
    levels: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Points that are one axis of mismatch each, at these levels: mild, realistic, severe."""
    grid: dict[str, Values] = Field(default_factory=dict)
    """Points that are all combinations: scenario keys and the values of each."""
    random: Random | None = None
    """Points drawn at random."""


class Campaign(Frozen):
    """What a campaign file says."""

    description: str = ""
    """One line on what it is for."""
    blocks: Annotated[tuple[Block, ...], Field(strict=False, min_length=1)]
    """Each is a product of its own; their runs follow one another."""


class Setting(NamedTuple):
    """A scenario key that has another value, and where the campaign says so."""

    key: str
    value: Any
    at: str


class Point(NamedTuple):
    """Some settings under a name; ``draw`` counts the random ones."""

    name: str
    settings: tuple[Setting, ...]
    draw: int = 0


@dataclass(frozen=True)
class Batch:
    """What runs together share.

    Attributes:
        scenario: with every key that is not a mismatch in place.
        source: the scenario's name or path, as on the command line.
        plant: what moves the cars.
        overrides: keys that differ from the file, as ``--set`` takes them; the mismatch is not among them.
        continuous: whether in continuous time.
    """

    scenario: Scenario
    source: str
    plant: str
    overrides: tuple[str, ...]
    continuous: bool = False


@dataclass(frozen=True)
class Case:
    """One run of a campaign.

    Attributes:
        batch: what it shares with others.
        point: name of its mismatch.
        seed: its seed.
        mismatch: how the truth differs from what the law is told.
        differs: keys of that which differ from the file, as ``--set`` takes them.
    """

    batch: Batch
    point: str
    seed: int
    mismatch: Mismatch
    differs: tuple[str, ...]

    @property
    def overrides(self) -> tuple[str, ...]:
        """Everything that differs from the file, as ``--set`` takes it."""
        return (*self.batch.overrides, *self.differs)

    @property
    def command(self) -> tuple[str, ...]:
        """The arguments of ``mjmerge`` that give this run alone."""
        b = self.batch
        keys = [word for text in self.overrides for word in ("--set", text)]
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
    """

    name: str
    description: str
    axes: tuple[str, ...]
    cases: tuple[Case, ...]


def written(value: Any) -> str:
    """A value as YAML on one line, which reads as the same value."""
    if isinstance(value, str) and re.fullmatch(r"[A-Za-z_][\w+]*", value) and scalar(value) == value:
        return value
    return json.dumps(value, ensure_ascii=False)


def plan(source: Source) -> Plan:
    """Reads a campaign and lists its runs, every one of them checked.

    Args:
        source: a shipped campaign's name, a path, or a mapping of plain values.

    Raises:
        ScenarioError: with every problem found, each with its key and line.
        UnknownNameError: there is no campaign of that name.
    """
    near: Path | None
    if isinstance(source, Mapping):
        document, where, name, near = copied(source), "campaign", "campaign", None
    else:
        path = file_of("campaign", source, share.campaigns())
        document, where, name, near = read(path), str(path), path.stem, path.parent
    campaign = validated(Campaign, document)
    raise_problems(where, document)
    assert campaign is not None, "what is not valid has problems"
    cases: list[Case] = []
    batches = Batches()
    for i, block in enumerate(campaign.blocks):
        cases += _Block(block, f"blocks.{i}", near, document, batches).cases(MOST_RUNS - len(cases))
    raise_problems(where, document)
    return planned(name, campaign.description, cases)


def planned(name: str, description: str, cases: Sequence[Case]) -> Plan:
    """A plan of these runs."""
    keys = dict.fromkeys(text.partition("=")[0] for case in cases for text in case.overrides)
    return Plan(name, description, tuple(key for key in keys if key != VARIANT), tuple(cases))


class Batches:
    """Scenarios that are loaded, so that runs that can share one do."""

    def __init__(self) -> None:
        self._found: dict[tuple[object, ...], Batch] = {}

    def of(self, source: str, plant: str, overrides: tuple[str, ...], *, continuous: bool = False) -> Batch:
        """The batch of a scenario with these keys different.

        Raises:
            MjmergeError: there is none.
        """
        key = (source, plant, overrides, continuous)
        if key not in self._found:
            scenario = load(source, overrides)
            check_plant(plant, scenario)
            self._found[key] = Batch(scenario, source, plant, overrides, continuous)
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
    ) -> Case:
        """One run.

        Args:
            source: the scenario's name or path.
            plant: what moves the cars.
            settings: scenario keys that differ, and their values.
            seed: its seed.
            point: name of what differs.
            continuous: whether in continuous time.

        Raises:
            MjmergeError: it cannot be; with every problem found.
        """
        other = {k: v for k, v in settings.items() if not _is_mismatch(k)}
        batch = self.of(source, plant, _texts(other), continuous=continuous)
        mine = {k: v for k, v in settings.items() if _is_mismatch(k)}
        document = Document({k.removeprefix(MISMATCH): v for k, v in mine.items()})
        mismatch = _mismatch(batch.scenario, document)
        document.problems = [replace(p, key=MISMATCH + p.key) for p in document.problems]
        raise_problems(source, document)
        assert mismatch is not None, "what is not valid has problems"
        return Case(batch, point, seed, mismatch, _texts(mine))


def _is_mismatch(key: str) -> bool:
    return key.startswith(MISMATCH)


def _texts(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Settings as ``--set`` takes them."""
    return tuple(f"{key}={written(value)}" for key, value in settings.items())


def _mismatch(scenario: Scenario | None, document: Document) -> Mismatch | None:
    """The scenario's mismatch with a document's values in place; problems are reported there."""
    if validated(Mismatch, document) is None or scenario is None:
        return None
    whole = Mismatch.model_validate(scenario.mismatch.model_dump() | document.value)
    sections = {name: getattr(scenario, name) for name in Scenario.model_fields} | {"mismatch": whole}
    for problem in check(sections):
        if problem.key.startswith(MISMATCH):
            document.report(problem.message, problem.key.removeprefix(MISMATCH))
    return None if document.problems else whole


class _Block:
    """Lists the runs of one block, and reports what keeps them from running into the campaign's document."""

    def __init__(
        self, block: Block, at: str, near: Path | None, document: Document, batches: Batches
    ) -> None:
        self._block, self._at, self._near, self._document = block, at, near, document
        self._batches = batches

    def cases(self, most: int) -> Iterator[Case]:
        """Every run, as far as it is valid."""
        block = self._block
        for i, name in enumerate(block.plants):
            if name not in PLANTS:
                self._report(f"no plant called {name!r}: {nearest(name, PLANTS)}", f"plants.{i}")
        plants = [name for name in block.plants if name in PLANTS]
        shared = tuple(Setting(k, v, self._below(f"set.{k}")) for k, v in block.set.items())
        variants: list[tuple[Setting, ...]] = [
            (Setting(VARIANT, v, self._below(f"variants.{i}")),) for i, v in enumerate(block.variants)
        ] or [()]
        for i, name in enumerate(block.scenarios):
            where = f"scenarios.{i}"
            source = self._source(name, where)
            if source is None:
                continue
            points = list(self._points(source, where))
            if len(plants) * len(variants) * len(points) * block.seeds > most:
                self._report(f"more than {MOST_RUNS} runs", where)
                continue
            for plant, variant, point in product(plants, variants, points):
                settings = {s.key: s for s in (*shared, *variant, *point.settings)}
                found = self._case(source, plant, point.name, list(settings.values()), where)
                if found is not None:
                    first = block.first_seed + point.draw * block.seeds
                    yield from (replace(found, seed=first + k) for k in range(block.seeds))

    def _source(self, name: str, where: str) -> str | None:
        """A scenario's name, or its path as seen from here."""
        try:
            path = file_of("scenario", name, share.scenarios(), self._near)
        except UnknownNameError as error:
            self._report(str(error), where)
            return None
        return name if name in share.scenarios() else str(path)

    def _case(
        self, source: str, plant: str, point: str, settings: Sequence[Setting], where: str
    ) -> Case | None:
        """One run with seed 0; ``None`` where it cannot be."""
        other = [s for s in settings if not _is_mismatch(s.key)]
        mine = [s for s in settings if _is_mismatch(s.key)]
        batch = None
        try:
            batch = self._batches.of(source, plant, _texts({s.key: s.value for s in other}))
        except ScenarioError as error:
            for problem in error.problems:
                self._blame(problem, other, source, where)
        except MjmergeError as error:
            self._report(str(error), where)
        document = Document({s.key.removeprefix(MISMATCH): s.value for s in mine})
        mismatch = _mismatch(batch.scenario if batch else None, document)
        for problem in document.problems:
            self._blame(replace(problem, key=MISMATCH + problem.key), mine, source, where)
        if batch is None or mismatch is None:
            return None
        return Case(batch, point, 0, mismatch, _texts({s.key: s.value for s in mine}))

    def _blame(self, problem: Problem, settings: Sequence[Setting], source: str, where: str) -> None:
        """Report a scenario's problem where the campaign causes it."""
        hit = [s for s in settings if problem.key == s.key or problem.key.startswith(f"{s.key}.")]
        if hit:
            known = {(p.message, p.key) for p in self._document.problems}
            if (problem.message, hit[-1].at) not in known:
                self._document.report(problem.message, hit[-1].at)
            return
        place = f"{source}:{problem.line}" if problem.line else source
        message = f"{problem.source or place}: {problem.key + ': ' if problem.key else ''}{problem.message}"
        self._report(message, where)

    def _report(self, message: str, key: str) -> None:
        self._document.report(message, self._below(key))

    def _below(self, key: str) -> str:
        return f"{self._at}.{key}"

    def _points(self, source: str, where: str) -> Iterator[Point]:
        """Every set of values that the block's runs differ in."""
        block = self._block
        if not (block.mismatches or block.grid or block.random or block.levels):
            yield Point(NONE, ())
        for name, keys in block.mismatches.items():
            at = self._below(f"mismatches.{name}")
            yield Point(name, tuple(Setting(k, v, f"{at}.{k}") for k, v in keys.items()))
        yield from self._levels(source, where)
        if block.grid:
            columns = [
                [Setting(k, v, self._below(f"grid.{k}.{i}")) for i, v in enumerate(values)]
                for k, values in block.grid.items()
            ]
            yield from (Point(GRID, settings) for settings in product(*columns))
        if block.random is not None:
            yield from self._drawn(block.random)

    def _levels(self, source: str, where: str) -> Iterator[Point]:
        names = self._block.levels
        wrong = [i for i, name in enumerate(names) if name not in LEVEL_NAMES]
        for i in wrong:
            message = f"no level called {names[i]!r}: {nearest(names[i], LEVEL_NAMES)}"
            self._report(message, f"levels.{i}")
        if wrong or not names:
            return
        try:
            scenario = load(source)
        except MjmergeError:
            return  # it is reported when the block's runs are made
        for axis, values in LEVELS[size_of(scenario)].items():
            for name in names:
                keys = values[LEVEL_NAMES.index(name)]
                yield Point(f"{axis} {name}", tuple(Setting(MISMATCH + k, v, where) for k, v in keys.items()))

    def _drawn(self, random: Random) -> Iterator[Point]:
        at = {key: self._below(f"random.axes.{key}") for key in random.axes}
        draws = {}
        for key, axis in random.axes.items():
            ways = axis.model_dump(exclude_none=True)
            if len(ways) != 1:
                self._document.report("must be one of uniform, log_uniform and choice", at[key])
            elif axis.log_uniform is not None and min(axis.log_uniform) <= 0:
                self._document.report("both must be positive", f"{at[key]}.log_uniform")
            else:
                draws[key] = axis
        for i in range(random.draws):
            rng = np.random.default_rng([random.seed, i])  # a draw does not depend on how many there are
            yield Point(RANDOM, tuple(Setting(k, _draw(a, rng), at[k]) for k, a in draws.items()), i)


def _draw(axis: Axis, rng: np.random.Generator) -> Any:
    if axis.uniform is not None:
        return float(rng.uniform(*axis.uniform))
    if axis.log_uniform is not None:
        low, high = map(log, axis.log_uniform)
        return float(np.exp(rng.uniform(low, high)))
    assert axis.choice is not None, "one of the three is given"
    return axis.choice[rng.integers(len(axis.choice))]


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


def described(path: Path) -> str:
    """A campaign file's description."""
    value = read(path).value
    return str(value.get("description", "")) if isinstance(value, dict) else ""


def size_of(scenario: Scenario) -> Literal["rc", "full"]:
    """Which size of car the levels of mismatch are to be those of."""
    wheelbase_m = data_sheet(scenario.models.ego).sized(scenario.models.size).wheelbase_m
    return "full" if wheelbase_m >= FULL_SIZE_M else "rc"
