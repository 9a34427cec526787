"""What pydantic found wrong, in our words: the key as written, what it must be, what was there instead."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from mjmerge.config.document import described, scalar
from mjmerge.config.frozen import Frozen, PerCar
from mjmerge.config.meanings import meanings
from mjmerge.errors import nearest
from mjmerge.roster import neighbour, slot


class _Spot(NamedTuple):
    """What stands at one of pydantic's locations: the key as the user knows it, and its schema."""

    key: str
    field: str
    holder: type[Frozen]
    inside: list[type[Frozen]]


def _spot(model: type[Frozen], location: tuple[int | str, ...]) -> _Spot:
    """Follow a location through the schema; at a choice of kinds, pydantic puts the kind in between."""
    keys: list[str] = []
    field, holder, inside = "", model, [model]
    named = False  # whether the next part is a name that the user chose
    for part in location:
        if isinstance(part, int) or named or not inside:
            keys.append(str(part))
            named = False
        elif len(inside) > 1:
            inside = [kind for kind in inside if _kind(kind) == part]
        else:
            field, holder = part, inside[0]
            keys.append(part)
            info = _field(holder, part)
            inside = list(_models_in(info.annotation)) if info else []
            named = info is not None and get_origin(info.annotation) is dict
    return _Spot(".".join(keys), field, holder, inside)


def _field(holder: type[Frozen], name: str) -> FieldInfo | None:
    """What a section says of a key of it; ``None`` if it has none of that name."""
    info = holder.model_fields.get(name)
    if info is None and issubclass(holder, PerCar) and slot(name) is not None:
        return holder.model_fields[neighbour(0)]  # as which every further one is
    return info


def unknown(model: type[Frozen], key: str, sections: Mapping[str, Any]) -> str | None:
    """What is wrong with a dotted key that is named in a file, if nothing can stand at it; else ``None``.

    What any kind of a law or a driver has, can. Names and places in a list are not looked at.

    Args:
        model: of the file.
        key: such as law.k_o.
        sections: those of the file that are valid, for what is of a kind from outside.
    """
    value: Any = SimpleNamespace(**sections)
    kinds, at = [model], ""
    for part in key.split("."):
        if isinstance(value, Frozen):
            kinds = [*kinds, type(value)]
        at = f"{at}.{part}".removeprefix(".")
        found = [info for kind in kinds if (info := _field(kind, part)) is not None]
        if kinds and not found:
            return f"unknown key; {nearest(part, _meant(model, _Spot(at, part, kinds[-1], [])))}"
        if any(get_origin(info.annotation) in (dict, tuple) for info in found):
            return None
        kinds = [kind for info in found for kind in _models_in(info.annotation)]
        value = getattr(value, part, None)
    return None


def _models_in(annotation: Any) -> Iterator[type[Frozen]]:
    """The models that an annotation is made of: one for a section, several for a choice of kinds."""
    if isinstance(annotation, type) and issubclass(annotation, Frozen):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def _meant(model: type[Frozen], spot: _Spot) -> Iterable[str]:
    """Keys of that very name that stand elsewhere, the least deep; where another kind has it, this one's."""
    found = {*_keys(model, spot.field)}
    least = min((key.count(".") for key in found), default=0)
    elsewhere = [key for key in found if key.count(".") == least]
    return elsewhere if elsewhere and spot.key not in found else spot.holder.model_fields


def _keys(model: type[Frozen], name: str, at: str = "") -> Iterator[str]:
    """Every key of the model that ends with this name, but for those in lists and of names of one's own."""
    for field, info in model.model_fields.items():
        if field == name:
            yield f"{at}{field}"
        if get_origin(info.annotation) not in (tuple, dict):
            for section in _models_in(info.annotation):
                yield from _keys(section, name, f"{at}{field}.")


def _kind(driver: type[Frozen]) -> str:
    kind: str = driver.model_fields["kind"].default
    return kind


_MUST = {
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "string_type": "must be text",
    "tuple_type": "must be a list",
    "too_long": "must have {max_length} items",
    "string_too_short": "must not be empty",
    "string_too_long": "must have at most {max_length} letters",
    "bool_type": "must be true or false",
    "int_from_float": "must be a whole number",
    "too_short": "must have at least {min_length} item",
    "int_type": "must be a whole number",
    "dict_type": "must be a mapping of keys",
    "model_type": "must be a mapping of keys",
    "model_attributes_type": "must be a mapping of keys",
    "literal_error": "must be {expected}",
    "greater_than": "must be greater than {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be at most {le:g}",
}
"""The start of a message, by pydantic's type of error; its end says what was there instead."""


def _explained(model: type[Frozen], error: ErrorDetails) -> tuple[str, str]:
    """Message and key of one of pydantic's errors."""
    spot, given = _spot(model, error["loc"]), error["input"]
    match error["type"]:
        case "missing":
            what = meanings(spot.holder).get(spot.field, "")
            if not what and len(spot.inside) == 1:
                what = (spot.inside[0].__doc__ or "").partition("\n")[0]
            return f"missing; {what}".replace("``", "`").removesuffix("; "), spot.key
        case "extra_forbidden":
            return f"unknown key; {nearest(spot.field, _meant(model, spot))}", spot.key
        case "union_tag_not_found":
            return f"missing; one of {', '.join(sorted(map(_kind, spot.inside)))}", f"{spot.key}.kind"
        case "union_tag_invalid":
            kind = str(given["kind"])
            kinds = map(_kind, spot.inside)
            what = "law" if spot.key == "law" else "driver kind"
            return f"no {what} called {kind!r}: {nearest(kind, kinds)}", f"{spot.key}.kind"
    if error["type"] in _MUST:
        must = _MUST[error["type"]].format(**error.get("ctx", {}))
    else:
        must = error["msg"].removeprefix("Value error, ")
    return f"{must}, got {described(given)}{_hint(error['type'], given)}", spot.key


def _hint(error: str, given: object) -> str:
    """What was probably meant by a value of the wrong type."""
    if error == "float_type" and isinstance(given, str):
        if isinstance(scalar(given), int | float):
            return "; drop the quotes"
        if given.lower() in ("yes", "no", "on", "off", "y", "n"):
            return "; YAML 1.2 reads that as text"
    if error == "string_type" and isinstance(given, int | float):
        return "; put it in quotes"
    return ""
