"""A campaign: which scenarios to run how often with what different, as one YAML file, and its plan.

A campaign is a list of blocks. Each block is a product: scenarios x plants x laws x points x seeds. A
point is a set of scenario keys and their values: named by hand, one of a grid, or drawn at random.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import log
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from mjmerge.config import shipped
from mjmerge.config.bounds import MOST_RUNS
from mjmerge.config.document import Document, copied
from mjmerge.config.doors import DoorError, from_outside, located
from mjmerge.config.frozen import Frozen
from mjmerge.config.read import file_of, raise_problems, read, validated
from mjmerge.errors import MjmergeError, Problem, ScenarioError, UnknownNameError, nearest
from mjmerge.law.outside import DEFAULT
from mjmerge.law.outside import GROUP as LAWS
from mjmerge.plant import PLANTS
from mjmerge.scenario.effect import covers
from mjmerge.scenario.levels import LEVELS
from mjmerge.scenario.levels import NAMES as LEVEL_NAMES
from mjmerge.scenario.load import Source, load
from mjmerge.scenario.space import Distribution, Values
from mjmerge.sweep.extent import too_much
from mjmerge.sweep.fidelity import Fidelity
from mjmerge.sweep.plan import (
    MISMATCH,
    NONE,
    VARIANT,
    Batches,
    Case,
    Plan,
    acts,
    as_overrides,
    in_vain,
    is_mismatch,
    mismatch_of,
    planned,
    size_of,
)

GRID, RANDOM = "grid", "random"
"""Names of points that nobody named: one of a grid, one drawn at random."""


class Random(Frozen):
    """Points drawn at random: the same seed gives the same ones."""

    draws: Annotated[int, Field(gt=0, le=MOST_RUNS)]
    """How many points; each is run with seeds of its own."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the draws; that of the runs is first_seed."""
    axes: Annotated[dict[str, Distribution], Field(min_length=1)]
    """Scenario keys, and how each is drawn."""


class Block(Frozen):
    """Scenarios x plants x laws (variants of the paper's, and others) x points x seeds."""

    scenarios: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    """Shipped names, or paths (relative ones from the campaign's folder)."""
    plants: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] = ("mujoco",)
    """What moves the cars."""
    variants: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Variants of the law, in place of the scenarios' own."""
    laws: Annotated[tuple[str | dict[str, Any], ...], Field(strict=False)] = ()
    """Laws beside these: kinds, or mappings with a kind and other keys of the section law."""
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
    fidelity: Fidelity | None = None
    """Where larger steps of the physics are enough; null: nowhere."""


class Setting(NamedTuple):
    """A scenario key that has another value, where the campaign says so, and the axis that is part of."""

    key: str
    value: Any
    at: str
    axis: str


class Point(NamedTuple):
    """Some settings under a name; ``draw`` counts the random ones, ``level`` is the axis of a level."""

    name: str
    settings: tuple[Setting, ...]
    draw: int = 0
    level: str = ""


class _Use(NamedTuple):
    """What became of an axis on one plant: where it was in vain, why, and whether it ever acted."""

    vain: dict[str, str]
    acted: list[bool]


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
        path = file_of("campaign", source, shipped.campaigns())
        document, where, name, near = read(path), str(path), path.stem, path.parent
    campaign = validated(Campaign, document)
    raise_problems(where, document)
    assert campaign is not None, "what is not valid has problems"
    for message, key in too_much(campaign):
        document.report(message, key)
    raise_problems(where, document)
    cases: list[Case] = []
    batches = Batches(campaign.fidelity)
    left_out: dict[str, dict[str, None]] = {}
    for i, block in enumerate(campaign.blocks):
        listing = _Block(block, f"blocks.{i}", near, document, batches)
        cases += listing.cases(MOST_RUNS - len(cases))
        for why, axis in listing.left_out:
            left_out.setdefault(why, {})[axis] = None
    raise_problems(where, document)
    return planned(name, campaign.description, cases, {why: tuple(axes) for why, axes in left_out.items()})


class _Block:
    """Lists the runs of one block, and reports what keeps them from running into the campaign's document."""

    def __init__(
        self, block: Block, at: str, near: Path | None, document: Document, batches: Batches
    ) -> None:
        self._block, self._at, self._near, self._document = block, at, near, document
        self._batches = batches
        self._uses: dict[tuple[str, str, str], _Use] = {}
        self.left_out: list[tuple[str, str]] = []

    def cases(self, most: int) -> Iterator[Case]:
        """Every run, as far as it is valid; an axis that acts in none of them is a mistake."""
        yield from self._cases(most)
        for use in self._uses.values():
            if not any(use.acted):
                for at, why in use.vain.items():
                    self._document.report(why, at)

    def _cases(self, most: int) -> Iterator[Case]:
        block = self._block
        for i, name in enumerate(block.plants):
            if name not in PLANTS:
                self._report(f"no plant called {name!r}: {nearest(name, PLANTS)}", f"plants.{i}")
        plants = [name for name in block.plants if name in PLANTS]
        shared = tuple(_setting(k, v, self._below(f"set.{k}")) for k, v in block.set.items())
        variants: list[tuple[Setting, ...]] = [
            (_setting(VARIANT, v, self._below(f"variants.{i}")),) for i, v in enumerate(block.variants)
        ]
        variants += [self._law(law, f"laws.{i}") for i, law in enumerate(block.laws)]
        variants = variants or [()]
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
                found = self._case(source, plant, point, list(settings.values()), where)
                if found is not None:
                    first = block.first_seed + point.draw * block.seeds
                    yield from (replace(found, seed=first + k) for k in range(block.seeds))

    def _law(self, law: str | dict[str, Any], where: str) -> tuple[Setting, ...]:
        """The keys of one of the laws; the file of one from outside may be beside the campaign."""
        keys = {"kind": law} if isinstance(law, str) else dict(law)
        kind = keys.get("kind", DEFAULT)
        try:
            if isinstance(kind, str) and from_outside(kind):
                keys["kind"] = located(kind, self._near, LAWS)
        except DoorError as error:
            self._report(str(error), where)
        return tuple(
            Setting(f"law.{k}", v, self._below(where if isinstance(law, str) else f"{where}.{k}"), where)
            for k, v in ({"kind": DEFAULT} | keys).items()
        )

    def _source(self, name: str, where: str) -> str | None:
        """A scenario's name, or its path as seen from here."""
        try:
            path = file_of("scenario", name, shipped.scenarios(), self._near)
        except UnknownNameError as error:
            self._report(str(error), where)
            return None
        return name if name in shipped.scenarios() else str(path)

    def _case(
        self, source: str, plant: str, point: Point, settings: Sequence[Setting], where: str
    ) -> Case | None:
        """One run with seed 0, without the settings that are in vain; ``None`` where it cannot be."""
        other = [s for s in settings if not is_mismatch(s.key)]
        mine = [s for s in settings if is_mismatch(s.key)]
        batch = None
        try:
            batch = self._batches.of(source, plant, as_overrides({s.key: s.value for s in other}))
        except ScenarioError as error:
            for problem in error.problems:
                self._blame(problem, other, source, where)
        except MjmergeError as error:
            self._report(str(error), where)
        document = Document({s.key.removeprefix(MISMATCH): s.value for s in mine})
        mismatch = mismatch_of(batch.scenario if batch else None, document)
        for problem in document.problems:
            self._blame(replace(problem, key=MISMATCH + problem.key), mine, source, where)
        if batch is None or mismatch is None:
            return None
        of_block = as_overrides({s.key: s.value for s in settings if s.at == self._below(f"set.{s.key}")})
        differs = as_overrides({s.key: s.value for s in mine})
        found = Case(batch, point.name, 0, mismatch, differs, of_block=of_block)
        idle = in_vain(batch, mismatch, [s.key for s in settings])
        if MISMATCH + point.level in idle:
            self.left_out.append((idle[MISMATCH + point.level], point.level))
            return None
        self._note(found, settings, idle)
        rest = [s for s in settings if s.key not in idle]
        return found if len(rest) == len(settings) else self._case(source, plant, point, rest, where)

    def _note(self, case: Case, settings: Sequence[Setting], idle: Mapping[str, str]) -> None:
        """Remember which axes act in a run, and which are in vain."""
        for s in settings:
            hit = {key: text for key, text in idle.items() if covers(s.key, key)}
            why = [text if key == s.key else f"{key}: {text}" for key, text in hit.items()]
            use = self._uses.setdefault((case.batch.source, case.batch.plant, s.axis), _Use({}, []))
            if why:
                use.vain.setdefault(s.at, "; ".join(dict.fromkeys(why)))
            elif not use.acted and acts(case, s.key):
                use.acted.append(True)

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
            yield Point(name, tuple(_setting(k, v, f"{at}.{k}") for k, v in keys.items()))
        yield from self._levels(source, where)
        if block.grid:
            columns = [
                [Setting(k, v, self._below(f"grid.{k}.{i}"), f"grid.{k}") for i, v in enumerate(values)]
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
                settings = tuple(_setting(MISMATCH + k, v, where) for k, v in keys.items())
                yield Point(f"{axis} {name}", settings, level=axis)

    def _drawn(self, random: Random) -> Iterator[Point]:
        at = {key: self._below(f"random.axes.{key}") for key in random.axes}
        draws = {}
        for key, axis in random.axes.items():
            wrong = list(axis.problems())
            for below, message in wrong:
                self._document.report(message, f"{at[key]}.{below}" if below else at[key])
            if not wrong:
                draws[key] = axis
        for i in range(random.draws):
            rng = np.random.default_rng([random.seed, i])  # a draw does not depend on how many there are
            yield Point(RANDOM, tuple(_setting(k, _draw(a, rng), at[k]) for k, a in draws.items()), i)


def _setting(key: str, value: Any, at: str) -> Setting:
    """A setting that is an axis of its own."""
    return Setting(key, value, at, f"{at} {key}")


def _draw(axis: Distribution, rng: np.random.Generator) -> Any:
    """A value; what campaigns have always been able to say is drawn as it always was."""
    if axis.uniform is not None:
        return float(rng.uniform(*axis.uniform))
    if axis.log_uniform is not None:
        low, high = map(log, axis.log_uniform)
        return float(np.exp(rng.uniform(low, high)))
    if axis.choice is not None:
        return axis.choice[rng.integers(len(axis.choice))]
    return axis.at(rng.random())
