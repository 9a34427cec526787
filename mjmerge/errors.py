"""Every error mjmerge raises on purpose: one root, and each builds its own message."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_LONGEST_NAME = 100  # that a message repeats


class MjmergeError(Exception):
    """Root of all errors that a user can cause or act on.

    Attributes:
        failed: whether the input was right, and something else went wrong: exit code 3 in place of 2.
    """

    failed = False

    def __reduce__(self) -> tuple[Any, ...]:
        """Errors cross from worker processes whatever their constructors take."""
        return _rebuilt, (type(self), self.args, self.__dict__)


def _rebuilt(kind: type[MjmergeError], arguments: tuple[Any, ...], state: dict[str, Any]) -> MjmergeError:
    error = kind.__new__(kind)
    error.args = arguments
    error.__dict__.update(state)
    return error


_ALIKE = 0.6  # difflib's own threshold
_MISSPELT = 0.85  # a letter or two of a name are wrong
_MOST_MEANT = 6  # names with a word are told of, at most


def nearest(name: str, valid: Iterable[str]) -> str:
    """``did you mean 'k_o' or 'k_p'?`` or the list of valid names, as the end of a message.

    A name that is misspelt comes first, then those that have all of its words: ``delay`` is in
    ``command_delay_s``.
    """
    names = sorted(valid)
    likeness = {other: difflib.SequenceMatcher(None, name, other).ratio() for other in names}
    best = max(likeness.values(), default=0.0)
    alike = [n for n in names if likeness[n] == best >= _ALIKE]
    with_words = [n for n in names if _words(name) <= _words(n)]
    if with_words and best < _MISSPELT and len(with_words) <= _MOST_MEANT:
        alike = with_words
    if alike:
        return "did you mean " + " or ".join(map(repr, alike)) + "?"
    return "valid names: " + ", ".join(names) if names else "there are none"


def _words(name: str) -> set[str]:
    return set(re.split(r"[^a-z0-9]+", name.lower())) - {""}


@dataclass(frozen=True)
class Problem:
    """One thing wrong with a scenario: where it stands and what to do.

    Attributes:
        message: what is wrong and what to do about it.
        key: dotted path of the key, ``law.k_o``; empty for the file as a whole.
        line: 1-based line in the file; ``None`` where there is none (``--set``, a mapping).
        source: where it stands if not in the scenario itself: a ``--set``, a data sheet.
    """

    message: str
    key: str = ""
    line: int | None = None
    source: str | None = None


_MOST_SHOWN = 50
"""Problems that a message lists; all of them are in ``ScenarioError.problems``."""


class ScenarioError(MjmergeError):
    """A scenario that cannot be run, with every problem found in it."""

    def __init__(self, source: str | Path, problems: Sequence[Problem]) -> None:
        self.source = str(source)
        self.problems = tuple(problems)
        lines = []
        for p in self.problems[:_MOST_SHOWN]:
            place = p.source or self.source
            if p.line is not None:
                place += f":{p.line}"
            lines.append(f"{place}: {p.key + ': ' if p.key else ''}{p.message}")
        if len(self.problems) > _MOST_SHOWN:
            lines.append(f"{self.source}: and {len(self.problems) - _MOST_SHOWN} more problems")
        super().__init__("\n".join(lines))


class UnknownNameError(MjmergeError):
    """A name (scenario, model, plant, run folder) that does not exist."""

    def __init__(self, kind: str, name: str, valid: Iterable[str]) -> None:
        called = name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..."
        super().__init__(f"no {kind} called {called!r}: {nearest(name, valid)}")


class BadNameError(MjmergeError):
    """A name that something new cannot have."""


class ModelError(MjmergeError):
    """A car model or a composed world that is not what the rest relies on."""


class OutputError(MjmergeError):
    """An output folder or file that cannot be written, or must not be overwritten."""


class RecordingError(MjmergeError):
    """A recorder that failed while the simulation went on."""


class WorkerError(MjmergeError):
    """A process that was to do a part of the work, and died."""

    failed = True


class UnreadableError(MjmergeError):
    """A file that is no recording, or of which nothing can be read."""

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(f"cannot read {path}: {why}")
        self.why = why
