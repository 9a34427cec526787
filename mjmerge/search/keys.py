"""Which keys of a law may be chosen, and between what: by default, or as somebody says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import isfinite
from typing import Any

from mjmerge.config.document import scalar
from mjmerge.errors import MjmergeError, Problem, ScenarioError, UnknownNameError
from mjmerge.scenario.effect import given_in_vain
from mjmerge.scenario.schema import Actuation, Scenario
from mjmerge.scenario.space import Distribution
from mjmerge.search.space import Ground, altered, checked

PARTS: Mapping[str, tuple[float, float]] = {
    "law.r_m": (0.9, 1.4),
    "law.k_o": (0.5, 4.0),
    "law.k_v": (0.5, 2.0),
}
"""Numbers that are chosen where nobody says, as parts of the scenario's own."""
CHOICES: Mapping[str, tuple[str, ...]] = {
    "law.variant": ("gated", "gated+one_sided"),
    "actuation.inverse": ("measured", "commanded"),
}
"""The same of names, beside the scenario's own."""
_NOT_CHOSEN = ("kind", "leader", "follower")
_DIGITS = 3
_FORM = "must be KEY=LOW:HIGH or KEY=ONE,OTHER,.. such as law.k_o=0.5:2 or law.variant=literal,gated"


def value_at(scenario: Scenario, key: str) -> Any:
    """What a scenario has at a key; ``None`` where it has no such key."""
    value: Any = scenario
    for name in key.split("."):
        value = getattr(value, name, None)
    return value


def choosable(scenario: Scenario) -> list[str]:
    """Every key that may be chosen: those of the scenario's law, and of its actuation."""
    law = [f"law.{name}" for name in type(scenario.law).model_fields if name not in _NOT_CHOSEN]
    return [*law, *(f"actuation.{name}" for name in Actuation.model_fields)]


def keys_of(ground: Ground, texts: Sequence[str] = ()) -> dict[str, Distribution]:
    """The keys that are chosen, and between what.

    Args:
        ground: the scenario, its plant, and what may be different in truth.
        texts: ``law.k_o=0.5:2`` or ``law.variant=literal,gated``; with none, those of the default keys that
            the law has and that act on the plant.

    Raises:
        UnknownNameError: the law has no such key.
        MjmergeError: a text is none of the two forms, or a key is chosen and may be different as well.
        ScenarioError: a value is none for its key, or the key has no effect on the plant.
    """
    if not texts:
        return _default(ground)
    found: dict[str, Distribution] = {}
    valid = choosable(ground.scenario)
    for text in texts:
        key, equals, values = (part.strip() for part in text.partition("="))
        if not equals:
            raise MjmergeError(f"--key {text}: {_FORM}")
        if key not in valid:
            raise UnknownNameError(f"key of the law {ground.scenario.law.label}", key, valid)
        if key in found:
            raise MjmergeError(f"--key {text}: {key} is given twice; keep one")
        if key in ground.space.axes:
            raise MjmergeError(f"--key {text}: {key} is among what may be different (search.axes)")
        found[key] = _read(text, values)
    problems = [problem for key in found for problem in _problems(ground, found, key)]
    if problems:
        raise ScenarioError(ground.scenario.name, list(dict.fromkeys(problems)))
    return found


def chosen(scenario: Scenario, keys: Mapping[str, Distribution], parts: Sequence[float]) -> dict[str, Any]:
    """The values of some keys, numbers to three digits; without those that are the scenario's own.

    Args:
        scenario: whose law it is.
        keys: between what, K of them.
        parts: of all values of each, (K,), each 0 to 1.
    """
    values = {key: _value(scenario, key, keys[key], part) for key, part in zip(keys, parts, strict=True)}
    return {key: value for key, value in values.items() if value != value_at(scenario, key)}


def words(spread: Distribution) -> str:
    """Between what a key is chosen."""
    pair = spread.uniform or spread.log_uniform
    if pair is not None:
        return f"{pair[0]:.4g} to {pair[1]:.4g}"
    return ", ".join(map(str, spread.choice or ()))


def _default(ground: Ground) -> dict[str, Distribution]:
    scenario, found = ground.scenario, {}
    for key, (low, high) in PARTS.items():
        own = value_at(scenario, key)
        if isinstance(own, int | float) and own > 0:
            found[key] = Distribution(log_uniform=(low * own, high * own))
    for key, names in CHOICES.items():
        own = value_at(scenario, key)
        if isinstance(own, str):
            found[key] = Distribution(choice=tuple(dict.fromkeys((own, *names))))
    mine = choosable(scenario)
    return {
        key: spread
        for key, spread in found.items()
        if key in mine and key not in ground.space.axes and not any(_problems(ground, found, key))
    }


def _read(text: str, values: str) -> Distribution:
    ends = [scalar(end.strip()) for end in values.split(":")]
    if len(ends) == 2 and all(isinstance(e, int | float) and not isinstance(e, bool) for e in ends):
        low, high = float(ends[0]), float(ends[1])  # type: ignore[arg-type]
        if not low < high or not isfinite(high - low):
            raise MjmergeError(f"--key {text}: goes from {low:g} to {high:g}; the smaller number comes first")
        return Distribution(log_uniform=(low, high)) if low > 0 else Distribution(uniform=(low, high))
    names = [scalar(name.strip()) for name in values.split(",")]
    if len(set(map(str, names))) < 2:
        raise MjmergeError(f"--key {text}: {_FORM}")
    return Distribution(choice=tuple(names))


def _value(scenario: Scenario, key: str, spread: Distribution, part: float) -> Any:
    found = spread.at(part)
    pair = spread.uniform or spread.log_uniform
    if pair is None:
        return found
    own = value_at(scenario, key)
    whole = isinstance(own, int) and not isinstance(own, bool)
    near = round(found) if whole else float(f"{found:.{_DIGITS}g}")
    return near if pair[0] <= near <= pair[1] else found


def _problems(ground: Ground, keys: Mapping[str, Distribution], key: str) -> Iterator[Problem]:
    """What is wrong with a key: values that are none, or that have no effect whatever else is chosen."""
    spread = keys[key]
    parts = [(k + 0.5) / len(spread.choice) for k in range(len(spread.choice))] if spread.choice else []
    refused: list[list[Problem]] = []
    for part in parts or (0.0, 0.5, 1.0):
        settings = {key: _value(ground.scenario, key, spread, part)}
        try:
            other = altered(ground.scenario, settings)
        except ScenarioError as error:
            yield from (replace(problem, source="--key") for problem in error.problems)
            return
        try:
            checked(other)
            refused.append([])
        except ScenarioError as error:
            refused.append([replace(problem, source="--key") for problem in error.problems])
    for found in refused if parts or all(refused) else ():
        yield from found
    if any(refused) and (parts or all(refused)):
        return
    why = _in_vain(ground, keys, key)
    if why is not None:
        yield Problem(why, key, source="--key")


def _in_vain(ground: Ground, keys: Mapping[str, Distribution], key: str) -> str | None:
    """Why a key changes nothing on the plant, whatever is chosen with it; ``None`` if it does."""
    beside = {name: spread.choice for name, spread in keys.items() if spread.choice and name != key}
    ends = keys[key].choice or tuple(_value(ground.scenario, key, keys[key], part) for part in (0.0, 1.0))
    why: str | None = None
    for value in ends:
        for values in product(*beside.values()):
            settings = {key: value, **dict(zip(beside, values, strict=True))}
            try:
                other = altered(ground.scenario, settings)
            except ScenarioError:
                continue
            if value == value_at(ground.scenario, key):
                continue
            vain = given_in_vain(other, ground.plant, [key])
            if not vain:
                return None
            why = next(iter(vain.values()))
    return why
