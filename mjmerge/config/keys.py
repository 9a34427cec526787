"""The keys of a section of a file as they are shown: name, unit, default and meaning."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic.fields import FieldInfo

from mjmerge.config.frozen import Frozen
from mjmerge.config.meanings import meanings
from mjmerge.config.units import written


class Key(NamedTuple):
    """A key.

    Attributes:
        unit: as it is written in tables; 1 of a plain number, - of what is none.
        required: whether it must be given.
        default: what it is otherwise.
        meaning: what it is, on a line.
    """

    unit: str
    required: bool
    default: Any
    meaning: str


def keys(model: type[Frozen]) -> dict[str, Key]:
    """Every key of a section but its ``kind``, in the order of their declaration, and below it what it holds.

    By name: ``gap_m``; ``sway.period_s``; of each of several, ``moves[].start_s``.
    """
    said, found = meanings(model), {}
    for name, field in model.model_fields.items():
        if name == "kind":
            continue
        sections, many = _sections(field.annotation)
        unit = "-" if sections or _is_text(field.annotation) else written(name)
        required = field.is_required()
        default = None if required else _plain(field)
        found[name] = Key(unit, required, default, " ".join(said.get(name, "").split()))
        for section in sections:
            found |= {f"{name}{'[]' if many else ''}.{key}": of for key, of in keys(section).items()}
    return found


def _sections(annotation: Any) -> tuple[list[type[Frozen]], bool]:
    """The sections that a type is made of, and whether there may be several."""
    if isinstance(annotation, type) and issubclass(annotation, Frozen):
        return [annotation], False
    found = [_sections(part) for part in get_args(annotation)]
    many = get_origin(annotation) is tuple or any(several for _, several in found)
    return [section for sections, _ in found for section in sections], many


def _is_text(annotation: Any) -> bool:
    return annotation is str or get_origin(annotation) is Literal


def _plain(field: FieldInfo) -> Any:
    value = field.get_default(call_default_factory=True)
    return value.model_dump(mode="json") if isinstance(value, Frozen) else value
