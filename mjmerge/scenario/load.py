"""From a file, a name or a mapping to a valid scenario, or to every reason why it is none."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, get_args, get_origin

from pydantic import ValidationError
from pydantic_core import ErrorDetails
from ruamel.yaml import YAML
from ruamel.yaml.representer import SafeRepresenter

from mjmerge.config import shipped
from mjmerge.config.document import UNREADABLE, Document, copied, described, is_text, parse, scalar
from mjmerge.config.frozen import Frozen
from mjmerge.errors import MjmergeError, ModelError, Problem, ScenarioError, UnknownNameError, nearest
from mjmerge.scenario.checks import check
from mjmerge.scenario.schema import CARS, Models, Scenario
from mjmerge.vehicle.datasheet import DataSheet

LARGEST_FILE_BYTES = 400_000
"""Of what people write: YAML takes ten seconds a megabyte."""

Source = str | Path | Mapping[str, Any]

_Model = TypeVar("_Model", bound=Frozen)


def load(
    source: Source, overrides: Sequence[str] = (), sheets: tuple[DataSheet, ...] | None = None
) -> Scenario:
    """Read and check a scenario.

    Args:
        source: a shipped scenario's name, a path, or a mapping of plain values.
        overrides: ``"law.k_o=0"``, applied in order before anything is checked; values are YAML. A plant on
            which one of them is without effect will refuse to run the scenario.
        sheets: data sheet of each car at its size, where they are known already: no model is looked for.

    Raises:
        ScenarioError: with every problem found, each with its key and line.
        UnknownNameError: there is no scenario of that name.
    """
    _check_texts(overrides)
    if isinstance(source, Mapping):
        document, where, name, near = copied(source), "scenario", "scenario", None
    elif not isinstance(source, str | os.PathLike) or isinstance(source, bytes):
        raise MjmergeError(
            f"expected a scenario's name, path or mapping of keys, got {described(source)}; what is loaded "
            'already is altered by load(name, ["law.k_o=0"])'
        )
    else:
        path = file_of("scenario", source, shipped.scenarios())
        document, where, name, near = read(path), str(path), path.stem, path.parent
        if not is_text(name):
            document.report("the name of the file is not text in UTF-8; rename it", "")
    if isinstance(document.value, dict):
        for text in overrides:
            document.override(text)

    sections: dict[str, Any] = {}
    scenario = validated(Scenario, document, sections)
    if sheets is not None:
        sections["sheets"] = dict(zip(CARS, sheets, strict=True))
    elif "models" in sections:
        sections["models"], read_sheets = _models(sections["models"], near, document)
        if len(read_sheets) == len(CARS):
            sections["sheets"] = read_sheets
    for problem in check(sections):
        document.report(problem.message, problem.key)
    raise_problems(where, document)
    assert scenario is not None, "what is not valid has problems"
    loaded = scenario.model_copy(update={"models": sections["models"]}).named(name).giving(document.given)
    return loaded if sheets is None else loaded.with_sheets(sheets)


def _check_texts(given: object) -> None:
    """Refuses overrides that are no ``KEY=VALUE`` texts.

    Raises:
        MjmergeError: with what to pass.
    """
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise MjmergeError(f'overrides are a list of texts, such as ["law.k_o=0"], got {described(given)}')
    for text in given:
        if not isinstance(text, str):
            raise MjmergeError(f'an override is a text, such as "law.k_o=0", got {described(text)}')


def data_sheet(model: str) -> DataSheet:
    """Read a car model's data sheet.

    Args:
        model: a shipped model's name, or the path of its folder.

    Raises:
        ScenarioError: with every problem found in it.
        UnknownNameError: there is no such model.
    """
    path = shipped.model_folder(model) / "datasheet.yaml"
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE_BYTES + 1)
    except OSError:
        content = b""
    return _data_sheet(path, content)


@lru_cache(maxsize=32)  # three cars, and the loader, the world, the belief and the judge ask for each
def _data_sheet(path: Path, content: bytes) -> DataSheet:
    """What the file says; by its content, so that a file that has changed is read again."""
    del content
    document = read(path)
    sheet = validated(DataSheet, document)
    raise_problems(path, document)
    assert sheet is not None, "what is not valid has problems"
    return sheet


def car_sheets(scenario: Scenario) -> list[DataSheet]:
    """The data sheet of each of a scenario's cars, at its size; as recorded, if it comes from a recording."""
    if scenario.sheets is not None:
        return list(scenario.sheets)
    return [data_sheet(getattr(scenario.models, car)).sized(scenario.models.size) for car in CARS]


def dump(scenario: Scenario) -> str:
    """The scenario as YAML with every default written out; loading it gives an equal scenario."""
    yaml = YAML(typ="safe", pure=True)
    yaml.Representer = _Representer
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # declared as None
    yaml.width = 2**31
    text = io.StringIO()
    yaml.dump(scenario.model_dump(mode="json"), text)
    return text.getvalue()


def json_schema(of: type[Frozen] = Scenario) -> str:
    """JSON Schema of scenario files, for editors; ``scenarios/schema.json`` is this text."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema"} | of.model_json_schema()
    return json.dumps(schema, indent=2) + "\n"


def file_of(kind: str, source: str | Path, shipped: Mapping[str, Path], near: Path | None = None) -> Path:
    """File of something given by name or path; a name is anything that does not look like a path.

    Args:
        kind: what it is, in words.
        source: name of something shipped, or a path.
        shipped: name to file.
        near: where a relative path is looked for first, before the current folder.

    Raises:
        UnknownNameError: there is nothing of that name.
    """
    if isinstance(source, str):
        if source in shipped:
            return shipped[source]
        if near is not None and os.path.isfile(near / source):  # noqa: PTH113 (a name may be too long)
            return near / source
        bare = Path(source).name == source and not source.endswith((".yaml", ".yml"))
        if bare and not os.path.exists(source):  # noqa: PTH110 (Path's raises where a name is too long)
            raise UnknownNameError(kind, source, shipped)
    return Path(source)


def read(path: Path) -> Document:
    """A file's values; whatever keeps them from being read is a problem of the document."""
    data = b""
    try:
        size = path.stat().st_size
        if size <= LARGEST_FILE_BYTES:
            with path.open("rb") as file:
                data = file.read(LARGEST_FILE_BYTES + 1)
            size = len(data)
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        return Document(problems=[Problem("not text in UTF-8: is it a recording?", "", line)])
    except (OSError, ValueError) as error:
        return Document(problems=[Problem(f"cannot be read: {getattr(error, 'strerror', error)}")])
    if size > LARGEST_FILE_BYTES:
        message = f"a scenario is a few kilobytes; this is {size / 1e6:.3g} MB: is it a recording?"
        return Document(problems=[Problem(message)])
    document = deepcopy(_parsed(text))
    if document.value is None and not document.problems:
        return Document(problems=[Problem("empty: there is no key in it")])
    return document


@lru_cache(maxsize=32)  # a campaign loads one scenario with a thousand different keys
def _parsed(text: str) -> Document:
    """What a text says; to be copied before it is changed."""
    return parse(text)


def validated(
    model: type[_Model], document: Document, sections: dict[str, Any] | None = None
) -> _Model | None:
    """An instance, or ``None`` with the reasons reported; ``sections`` receives the fields that are valid."""
    if document.value is UNREADABLE:
        return None
    valid: _Model | None = None
    try:
        valid = model.model_validate(document.value, context=sections)
    except ValidationError as invalid:
        for error in invalid.errors(include_url=False):
            given = error["input"]
            if error["type"] == "too_short" and given:
                continue  # it is too short because what is in it is not valid
            if given is not UNREADABLE and not (isinstance(given, dict) and given.get("kind") is UNREADABLE):
                document.report(*_explained(model, error))
    if sections is not None and isinstance(document.value, dict):
        defaults = {n: f.default for n, f in model.model_fields.items() if not f.is_required()}
        sections |= {name: value for name, value in defaults.items() if name not in document.value}
    return valid


def _models(models: Models, near: Path | None, document: Document) -> tuple[Models, dict[str, DataSheet]]:
    """The models with their paths made absolute, and their data sheets; problems are reported."""
    names, sheets = {}, {}
    for car in CARS:
        name = getattr(models, car)
        try:
            folder = str(shipped.model_folder(name, near))
            names[car] = name if name in shipped.models() else folder
            sheets[car] = data_sheet(names[car]).sized(models.size)
        except (ModelError, UnknownNameError) as error:
            document.report(str(error), f"models.{car}")
        except ScenarioError as error:
            document.problems += [replace(p, source=error.source) for p in error.problems]
    return models.model_copy(update=names), sheets


def raise_problems(where: str | Path, document: Document) -> None:
    """Raise what was found, if anything: the file's own problems by line, then those from elsewhere."""
    found = dict.fromkeys(document.problems)  # a sheet that two cars share is read twice
    if found:
        raise ScenarioError(where, sorted(found, key=lambda p: (p.source or "", p.line or 0)))


class _Spot(NamedTuple):
    """What stands at one of pydantic's locations: the key as the user knows it, and its schema."""

    key: str
    field: str
    holder: type[Frozen]
    inside: list[type[Frozen]]


def _spot(model: type[Frozen], location: tuple[int | str, ...]) -> _Spot:
    """Follow a location through the schema; at a choice of drivers, pydantic puts the kind in between."""
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
            info = holder.model_fields.get(part)
            inside = list(_models_in(info.annotation)) if info else []
            named = info is not None and get_origin(info.annotation) is dict
    return _Spot(".".join(keys), field, holder, inside)


def _models_in(annotation: Any) -> Iterator[type[Frozen]]:
    """The models that an annotation is made of: one for a section, several for a choice of drivers."""
    if isinstance(annotation, type) and issubclass(annotation, Frozen):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


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
            what = spot.holder.model_fields[spot.field].description
            if not what and len(spot.inside) == 1:
                what = (spot.inside[0].__doc__ or "").partition("\n")[0]
            return f"missing; {what}" if what else "missing", spot.key
        case "extra_forbidden":
            return f"unknown key; {nearest(spot.field, spot.holder.model_fields)}", spot.key
        case "union_tag_not_found":
            return f"missing; one of {', '.join(sorted(map(_kind, spot.inside)))}", f"{spot.key}.kind"
        case "union_tag_invalid":
            kind = str(given["kind"])
            kinds = map(_kind, spot.inside)
            return f"no driver kind called {kind!r}: {nearest(kind, kinds)}", f"{spot.key}.kind"
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


class _Representer(SafeRepresenter):
    """Puts lists of numbers on one line, quotes around all text but plain words, and null in words."""

    def text(self, value: str) -> Any:
        bare = value.isidentifier() and isinstance(scalar(value), str)
        return self.represent_scalar("tag:yaml.org,2002:str", value, style=None if bare else '"')

    def items(self, value: list[Any]) -> Any:
        short = not any(isinstance(item, dict) for item in value)
        return self.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=short)


_Representer.add_representer(str, _Representer.text)
_Representer.add_representer(list, _Representer.items)
