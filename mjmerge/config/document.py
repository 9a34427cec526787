"""YAML 1.2 read into plain values that remember where they came from.

ruamel.yaml scans and parses; the values are built here, from its events, because a scenario wants less than
YAML offers (no anchors, tags or merge keys) and more than a loader gives: every problem at once, with lines.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)
from ruamel.yaml.reader import ReaderError

from mjmerge.errors import Problem

DEEPEST = 20
"""Levels of nesting that are read; a scenario has six."""


class _Unreadable:
    """There is one, and its copy is itself."""

    def __deepcopy__(self, memo: object) -> _Unreadable:
        return self


UNREADABLE = _Unreadable()
"""Stands for a value already reported as a problem, so that it is not reported twice."""

_INT = re.compile(r"[-+]?[0-9]{1,300}|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS = {"": None, "~": None} | {
    spelling: value
    for word, value in (("null", None), ("true", True), ("false", False))
    for spelling in (word, word.capitalize(), word.upper())
}


def scalar(text: str) -> bool | int | float | str | None:
    """What a plain scalar means in YAML 1.2's core schema: ``1e-3`` is a number, ``no`` is text."""
    if text in _WORDS:
        return _WORDS[text]
    if _INT.fullmatch(text):
        return int(text, 0 if text.startswith(("0o", "0x")) else 10)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", ""))
    return text


def described(value: object) -> str:
    """A value in words, to end a sentence with ``got ...``."""
    match value:
        case None:
            return "nothing (null)"
        case bool():
            return str(value).lower()
        case str():
            return f"the text {value!r}" if len(value) <= 40 else f"the text {value[:40]!r}..."
        case float():
            return repr(value)
        case int():
            return str(value) if abs(value) < 10**18 else "a huge whole number"
        case Mapping():
            return "a mapping"
        case list() | tuple():
            return f"a list of {len(value)}"
    return f"a {type(value).__name__}"


@dataclass
class Document:
    """Plain values, where each came from, and what was wrong with them so far.

    Attributes:
        value: nested dicts, lists and scalars; ``UNREADABLE`` where nothing sensible was written.
        origins: by dotted key, the line it stands on, or the text of the ``--set`` that put it there.
        problems: found while reading, in the order found.
    """

    value: Any = UNREADABLE
    origins: dict[str, int | str] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)

    def report(self, message: str, key: str) -> None:
        """Note a problem, placed where its key, or the closest parent that was written, stands."""
        written = key
        while written and written not in self.origins:
            written = written.rpartition(".")[0]
        origin = self.origins.get(written)
        if isinstance(origin, str):
            self.problems.append(Problem(message, key, source=origin))
        else:
            self.problems.append(Problem(message, key, origin))

    @property
    def given(self) -> dict[str, str]:
        """Keys that a ``--set`` put there, and its text."""
        return {key: origin for key, origin in self.origins.items() if isinstance(origin, str)}

    def rewrite(self, key: str, origin: int | str) -> None:
        """Say where ``key`` now comes from, and forget where the old value's parts came from."""
        below = f"{key}."
        for old in [k for k in self.origins if k.startswith(below)]:
            del self.origins[old]
        self.origins[key] = origin

    def override(self, text: str) -> None:
        """Apply one ``law.k_o=0``: the value is YAML, and parents that are missing are made."""
        origin = f"--set {text}"
        key, equals, written = text.partition("=")
        key = key.strip()
        if not equals or not key:
            self.problems.append(Problem("must be KEY=VALUE, such as law.k_o=0", source=origin))
            return
        new = parse(written)
        self.problems += [replace(p, key=key, line=None, source=origin) for p in new.problems]
        *parents, last = key.split(".")
        holder, here = self.value, ""
        try:
            for name in parents:
                here, slot = _below(here, name), _slot(holder, name)
                if isinstance(holder, dict):
                    holder.setdefault(slot, None)
                if not isinstance(holder[slot], dict | list):
                    holder[slot] = {}
                    self.rewrite(here, origin)
                holder = holder[slot]
            holder[_slot(holder, last)] = new.value
            self.rewrite(key, origin)
        except IndexError as error:
            self.problems.append(Problem(str(error), key, source=origin))


def parse(text: str) -> Document:
    """Read one YAML 1.2 document; nothing is raised, everything wrong is in ``problems``."""
    document = Document()
    try:
        composer = _Composer(text, document)
        document.value = composer.document()
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        message = f"not text: it contains the character U+{error.character:04X}"
        document.problems.append(Problem(message, "", line))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        message = f"not valid YAML: {error.problem or error.context}"
        if error.context_mark and mark and error.context_mark.line != mark.line:
            message += f" ({error.context}, from line {error.context_mark.line + 1})"
        if "'\\t'" in message:
            message += "; use spaces, not tabs"
        document.problems.append(Problem(message, "", mark.line + 1 if mark else None))
    except (YAMLError, ValueError, OverflowError) as error:  # ruamel lets some of chr()'s errors through
        document.problems.append(Problem(f"not valid YAML: {error}"))
    return document


class _Composer:
    """Builds the values of one document from parser events, and reports into it."""

    def __init__(self, text: str, document: Document) -> None:
        events: Iterator[Event] = YAML(typ="safe", pure=True).parse(text)
        content = (
            AliasEvent,
            ScalarEvent,
            MappingStartEvent,
            MappingEndEvent,
            SequenceStartEvent,
            SequenceEndEvent,
        )
        self.events = (event for event in events if isinstance(event, content))
        self.to = document

    def document(self) -> Any:
        """The whole document; nothing at all reads as null."""
        first = next(self.events, None)
        if first is None:
            return None
        self.to.origins[""] = _line(first)
        value = self.node(first, "", 0)
        if (extra := next(self.events, None)) is not None:
            self.to.problems.append(Problem("a second document starts here; keep one", "", _line(extra)))
        return value

    def node(self, event: Any, key: str, depth: int) -> Any:  # ruamel declares no attributes of events
        """The value that starts with ``event``."""
        line = _line(event)
        if depth > DEEPEST:
            raise MarkedYAMLError(
                problem=f"nested deeper than {DEEPEST} levels", problem_mark=event.start_mark
            )
        if isinstance(event, AliasEvent):
            self.refuse(f"the alias *{event.anchor}", key, line)
            return UNREADABLE
        if event.anchor is not None:
            self.refuse(f"the anchor &{event.anchor}", key, line)
        if event.ctag is not None:
            self.refuse(f"the tag {event.ctag}", key, line)
        if isinstance(event, MappingStartEvent):
            return self.mapping(key, depth)
        if isinstance(event, SequenceStartEvent):
            return self.sequence(key, depth)
        value = scalar(event.value) if event.style is None else event.value
        if isinstance(value, str) and not is_text(value):
            self.to.problems.append(Problem("not text: half of a surrogate pair", key, line))
            return UNREADABLE
        return UNREADABLE if event.ctag is not None else value

    def mapping(self, key: str, depth: int) -> dict[str, Any]:
        """The keys and values up to the end of a mapping; of a key given twice, the last."""
        values: dict[str, Any] = {}
        lines: dict[str, int] = {}
        while not isinstance(event := next(self.events), MappingEndEvent):
            line = _line(event)
            name = self.node(event, key, depth + 1)
            if not isinstance(name, str) or name == "<<":
                if name == "<<":
                    self.refuse("the merge key <<", key, line)
                elif name is not UNREADABLE:
                    self.to.problems.append(Problem(f"a key must be text, got {described(name)}", key, line))
                self.node(next(self.events), _below(key, "?"), depth + 1)
                continue
            here = _below(key, name)
            if name in lines:
                message = f"given twice, on lines {lines[name]} and {line}; keep one"
                self.to.problems.append(Problem(message, here, line))
                self.to.rewrite(here, line)
            lines.setdefault(name, line)
            self.to.origins[here] = line
            values[name] = self.node(next(self.events), here, depth + 1)
        return values

    def sequence(self, key: str, depth: int) -> list[Any]:
        """The items up to the end of a sequence."""
        items: list[Any] = []
        while not isinstance(event := next(self.events), SequenceEndEvent):
            here = _below(key, len(items))
            self.to.origins[here] = _line(event)
            items.append(self.node(event, here, depth + 1))
        return items

    def refuse(self, what: str, key: str, line: int) -> None:
        """Report a part of YAML that a scenario does without."""
        self.to.problems.append(Problem(f"{what} is not supported; write the value out", key, line))


def copied(source: Mapping[Any, Any]) -> Document:
    """A document made of a mapping of plain Python values, which is left as it was."""
    document = Document()

    def copy(value: Any, key: str, depth: int) -> Any:
        if depth > DEEPEST:
            document.report(f"nested deeper than {DEEPEST} levels", key)
            return UNREADABLE
        if isinstance(value, str) and not is_text(value):
            document.report("not text: half of a surrogate pair", key)
            return UNREADABLE
        if isinstance(value, list | tuple):
            return [copy(item, _below(key, i), depth + 1) for i, item in enumerate(value)]
        if not isinstance(value, Mapping):
            return value
        for name in value:
            if not is_text(name):
                document.report(f"a key must be text, got {described(name)}", key)
        return {n: copy(v, _below(key, n), depth + 1) for n, v in value.items() if is_text(n)}

    document.value = copy(source, "", 0)
    return document


def _below(key: str, name: object) -> str:
    return f"{key}.{name}" if key else str(name)


def _slot(holder: dict[str, Any] | list[Any], name: str) -> Any:
    """The key or the index that one part of a dotted key means in ``holder``."""
    if isinstance(holder, dict):
        return name
    if name in map(str, range(len(holder))):
        return int(name)
    raise IndexError(f"no item {name!r} in a list of {len(holder)}; items count from 0")


def _line(event: Event) -> int:
    line: int = event.start_mark.line + 1
    return line


def is_text(value: object) -> bool:
    """Whether it is a string that can be written: half a surrogate pair cannot."""
    return isinstance(value, str) and not any("\ud800" <= c <= "\udfff" for c in value)
