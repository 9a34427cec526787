"""Files that people write, read into frozen values, or refused with every problem and its line."""

from __future__ import annotations

import os
from collections.abc import Mapping
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from mjmerge.config.document import UNREADABLE, Document, parse
from mjmerge.config.explain import _explained
from mjmerge.config.frozen import Frozen
from mjmerge.errors import Problem, ScenarioError, UnknownNameError

LARGEST_FILE_BYTES = 400_000
"""Of what people write: YAML takes ten seconds a megabyte."""


_Model = TypeVar("_Model", bound=Frozen)
_NO_KEY = ("extra_forbidden", "too_many")


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
        errors = invalid.errors(include_url=False)
        unknown = {error["loc"] for error in errors if error["type"] in _NO_KEY}
        for error in errors:
            given = error["input"]
            if error["type"] not in _NO_KEY and any(error["loc"][: len(key)] == key for key in unknown):
                continue  # of what stands at a key that is none
            if error["type"] == "too_short" and given:
                continue  # it is too short because what is in it is not valid
            if given is not UNREADABLE and not (isinstance(given, dict) and given.get("kind") is UNREADABLE):
                document.report(*_explained(model, error))
    if sections is not None and isinstance(document.value, dict):
        defaults = {n: f.default for n, f in model.model_fields.items() if not f.is_required()}
        sections |= {name: value for name, value in defaults.items() if name not in document.value}
    return valid


def validated_part(model: type[_Model], value: object, document: Document, where: str) -> _Model | None:
    """An instance of what stands at a key of a document, or ``None`` with the reasons reported."""
    try:
        return model.model_validate(value)
    except ValidationError as invalid:
        for error in invalid.errors(include_url=False):
            message, key = _explained(model, error)
            document.report(message, f"{where}.{key}" if key else where)
    return None


def raise_problems(where: str | Path, document: Document) -> None:
    """Raise what was found, if anything: the file's own problems by line, then those from elsewhere."""
    found = dict.fromkeys(document.problems)  # a sheet that two cars share is read twice
    if found:
        raise ScenarioError(where, sorted(found, key=lambda p: (p.source or "", p.line or 0)))
