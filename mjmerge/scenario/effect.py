"""What of a scenario is without effect on a plant, so that nothing is in silence.

A value that somebody gives for one run (on the command line, in Python, in a row of the gate, along an axis
of a campaign) and that can change nothing there is a mistake, and refused. What stands in a scenario's own
file belongs to all its runs, on any plant: there it is said beside the verdict.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

from mjmerge.config.acts import Acts
from mjmerge.config.frozen import Frozen
from mjmerge.errors import Problem, ScenarioError
from mjmerge.law import kinds as laws
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario

CLAIMS = ("mismatch.", "belief.")
"""Sections that say how the truth differs from what is believed; not true of a run that they leave alone."""


class _Key(NamedTuple):
    """A key that says where it acts, and the value that it has where nobody gives it one."""

    name: str
    parts: tuple[str, ...]
    default: Any
    acts: Acts

    def value(self, scenario: Scenario) -> Any:
        value: Any = scenario
        for part in self.parts:
            value = getattr(value, part, self.default)  # a law of another kind has it not
        return value


@cache
def _keys() -> tuple[_Key, ...]:
    return tuple(_below(Scenario, ()))


def _below(model: type[Frozen], above: tuple[str, ...]) -> Iterator[_Key]:
    for name, field in model.model_fields.items():
        parts = (*above, name)
        acts = next((m for m in field.metadata if isinstance(m, Acts)), None)
        if acts is not None:
            yield _Key(".".join(parts), parts, field.default, acts)
        elif isinstance(field.annotation, type) and issubclass(field.annotation, Frozen):
            yield from _below(field.annotation, parts)
        elif name == "law":
            found = {key.name: key for kind in laws().values() for key in _below(kind, parts)}
            yield from found.values()


def declared() -> dict[str, Acts]:
    """Every key that does not act everywhere, and where it does."""
    return {key.name: key.acts for key in _keys()}


def defaults() -> dict[str, Any]:
    """What each of these keys is where nobody gives it a value."""
    return {key.name: key.default for key in _keys()}


def without(scenario: Scenario, plant: str, *, continuous: bool = False) -> dict[str, str]:
    """Keys whose values are not their defaults and change nothing on a plant, and why, in words."""
    return {
        key.name: why
        for key in _keys()
        if key.value(scenario) != key.default
        and (why := key.acts.why_not(scenario, plant, continuous=continuous)) is not None
    }


def told(scenario: Scenario, plant: str, *, continuous: bool = False) -> dict[str, str]:
    """Of these, what a scenario claims of the truth and is not true of its run: for beside its verdict."""
    found = without(scenario, plant, continuous=continuous)
    return {key: why for key, why in found.items() if key.startswith(CLAIMS)}


def given_in_vain(
    scenario: Scenario, plant: str, given: Collection[str], *, continuous: bool = False
) -> dict[str, str]:
    """Of these, what is among the keys that somebody gave for this run.

    Args:
        scenario: with all of them in place.
        plant: what moves the cars.
        given: keys, or sections, or parts of keys.
        continuous: whether in continuous time.
    """
    beside = {key.name: key.acts.beside for key in _keys()}
    return {
        key: why
        for key, why in without(scenario, plant, continuous=continuous).items()
        if any(covers(name, key) for name in given) and beside[key] not in given
    }


def covers(given: str, key: str) -> bool:
    """Whether who gives the one gives the other: the same key, its section, or a part of its value."""
    return given == key or key.startswith(f"{given}.") or given.startswith(f"{key}.")


def acting(scenario: Scenario, plant: str, *, continuous: bool = False) -> Scenario:
    """The scenario with what is without effect at its default: two that are equal then run alike."""
    update: dict[str, Any] = {}
    for name in without(scenario, plant, continuous=continuous):
        section, _, key = name.partition(".")
        if key:
            default = type(getattr(scenario, section)).model_fields[key].default
            holder = update.get(section, getattr(scenario, section))
            update[section] = holder.model_copy(update={key: default})
        else:
            update[section] = Scenario.model_fields[section].default
    return scenario.model_copy(update=update) if update else scenario


def check(
    scenario: Scenario,
    plant: str,
    *,
    continuous: bool = False,
    mismatches: Sequence[Mismatch] = (),
) -> None:
    """Refuses what was given for a run and changes nothing in it.

    Args:
        scenario: what is to run; it knows which of its keys were given beside its file.
        plant: what moves the cars.
        continuous: whether in continuous time.
        mismatches: of the simulations, where they are not the scenario's.

    Raises:
        ScenarioError: with every such key and where it does act.
    """
    vain = given_in_vain(scenario, plant, scenario.given, continuous=continuous)
    problems = [Problem(why, key, source=_origin(scenario.given, key)) for key, why in vain.items()]
    for i, mismatch in enumerate(mismatches):
        if mismatch == scenario.mismatch:
            continue
        case = scenario.model_copy(update={"mismatch": mismatch})
        differs = {f"mismatch.{n}" for n, v in mismatch if v != getattr(scenario.mismatch, n)}
        vain = given_in_vain(case, plant, differs, continuous=continuous)
        problems += [Problem(why, key, source=f"cases[{i}]") for key, why in vain.items()]
    if problems:
        raise ScenarioError(scenario.name, problems)


def _origin(given: Mapping[str, str], key: str) -> str:
    """The text that gave a key, the closest of those that cover it."""
    return given[max((name for name in given if covers(name, key)), key=len)]
