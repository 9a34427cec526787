"""A task on its way to another process, and what is done with it there: only what computes the same does it.

A process may have begun long after the command, or on another machine; rows of other code, or of other
versions, would not compare.
"""

from __future__ import annotations

import pickle
import platform
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mjmerge.config import doors
from mjmerge.errors import MjmergeError
from mjmerge.sweep.folder import computing


@dataclass(frozen=True)
class Raised:
    """An error of a task: of the work, not of who does it."""

    error: Exception


def sent(task: Callable[..., Any], *given: Any) -> tuple[Any, ...]:
    """A task as :func:`do` takes it: what it is to be done with, code from outside, and itself."""
    return computing(), doors.let_in(), pickle.dumps((task, given))


def do(here: Mapping[str, Any], code: Mapping[str, str], payload: bytes) -> Any:
    """Does a task; what it raises is an answer, too, for what else is raised is no fault of the task.

    Args:
        here: what the command computes with; where this process has something else, nothing is done.
        code: of files from outside, their text by path.
        payload: the task, and what it is given.
    """
    other = unlike(platform.node(), here, computing())
    if other:
        return Raised(MjmergeError(other[0]))
    try:
        doors.carry(code)
        task, given = pickle.loads(payload)
    except Exception as error:
        return Raised(MjmergeError(f"a worker cannot read its task: {type(error).__name__}: {error}"))
    try:
        return task(*given)
    except Exception as error:
        error.add_note(traceback.format_exc())  # which a traceback is not: it stays where it was
        return Raised(_sendable(error))


def _sendable(error: Exception) -> Exception:
    """An error as it is, or, where that cannot be sent, in words."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        plain = RuntimeError(f"{type(error).__name__}: {error}")
        plain.__notes__ = error.__notes__
        return plain
    return error


def unlike(node: str, here: Mapping[str, Any], there: Mapping[str, Any]) -> list[str]:
    """In what a node computes with something else, as a line; an empty list if in nothing.

    Args:
        node: its name.
        here: what this process computes with, see :func:`mjmerge.sweep.folder.computing`.
        there: what the node does.
    """
    mine, theirs = here["versions"], there["versions"]
    found = [
        f"{name} {theirs.get(name, 'is missing')} (here {mine.get(name, 'missing')})"
        for name in {**mine, **theirs}
        if mine.get(name) != theirs.get(name)
    ]
    found += [f"another {name}" for name in here if name != "versions" and here[name] != there.get(name)]
    return [f"node {node} would compute other rows: {', '.join(found)}"] if found else []
