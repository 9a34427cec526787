"""What an axis of mismatch says of itself, once, where its field is declared: all else reads it there.

The field has the name, which ends in the unit, the range and the default; its :class:`Axis` has where it
acts, what it needs to mean anything, its levels for both sizes of car and where these numbers come from. The
JSON schema, ``levels``, ``mjmerge list axes``, the tables of ``docs/mismatch.md`` and all messages follow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from pydantic.fields import FieldInfo

from mjmerge.config.acts import Acts
from mjmerge.config.frozen import Frozen

LEVEL_NAMES = ("mild", "realistic", "severe")
"""Names of the levels."""
SIZES = {"rc": "1/10", "full": "full size"}
"""Sizes of cars that have levels of their own, and what they are called."""
Part = Literal["the road", "the air", "the ego", "what the ego measures"]
"""What is different: in the last of these what the ego is told, in all others what is."""
Value = float | str
Level = Mapping[str, Value]
"""Keys of a mismatch and their values: the axis, and what it needs to mean anything."""


class Step(NamedTuple):
    """A level of an axis: its value, and keys that go with it and theirs."""

    value: Value
    also: tuple[tuple[str, Value], ...] = ()


Three = tuple[Step, Step, Step]


def three(mild: Value, realistic: Value, severe: Value, **also: tuple[Value, Value, Value] | float) -> Three:
    """The levels of an axis, with keys that go with it: one value each, or one for all."""

    def step(i: int, value: Value) -> Step:
        return Step(value, tuple((key, v[i] if isinstance(v, tuple) else v) for key, v in also.items()))

    return step(0, mild), step(1, realistic), step(2, severe)


@dataclass(frozen=True, kw_only=True)
class Axis(Acts):
    """An axis of mismatch: where it acts, and what else there is to know of it.

    Attributes:
        part: what is different.
        changes: what it changes, in a line.
        source: where its levels come from; of an axis without any, why it has none.
        rc: its levels for cars of 1/10 size.
        full: for cars of full size.
    """

    part: Part
    changes: str
    source: str
    rc: Three | None = None
    full: Three | None = None


def axes(model: type[Frozen]) -> dict[str, Axis]:
    """What each axis of a mismatch says of itself, by name."""
    found = {name: of(field) for name, field in model.model_fields.items()}
    return {name: axis for name, axis in found.items() if axis is not None}


def of(field: FieldInfo) -> Axis | None:
    """What a field says of itself as an axis; ``None`` if it is none."""
    return next((m for m in field.metadata if isinstance(m, Axis)), None)


def levels(model: type[Frozen]) -> Mapping[str, Mapping[str, tuple[Level, ...]]]:
    """By size of the cars and axis that has any: its levels, in the order of :data:`LEVEL_NAMES`."""
    return MappingProxyType(
        {
            size: MappingProxyType(
                {
                    name: tuple(MappingProxyType({name: step.value, **dict(step.also)}) for step in steps)
                    for name, axis in axes(model).items()
                    if (steps := getattr(axis, size)) is not None
                }
            )
            for size in SIZES
        }
    )


_BOUNDS = ("minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum", "enum")


def ranges(model: type[Frozen]) -> dict[str, dict[str, Any]]:
    """By axis: its bounds, or its choices, under the names that JSON Schema has for them."""
    properties = model.model_json_schema()["properties"]
    found = {}
    for name in axes(model):
        kinds = (properties[name], *properties[name].get("anyOf", ()))
        found[name] = {key: kind[key] for kind in kinds for key in _BOUNDS if key in kind}
    return found
