"""What is left of a mistake of ours: one line, and a file with what is needed to mend it."""

from __future__ import annotations

import os
import platform
import shlex
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

PREFIX = "mjmerge-error-"
"""What the files are called, before date, time and process."""


def report(error: BaseException, arguments: Sequence[str]) -> str:
    """Writes the details of an unexpected error; returns the line that says what happened and where they are.

    Args:
        error: what was raised.
        arguments: of the command line.
    """
    what = f"a mistake of mjmerge, not of yours: {type(error).__name__} in {_place(error)}"
    name = f"{PREFIX}{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.txt"
    text = _details(error, arguments, what)
    for folder in (Path(), Path(tempfile.gettempdir())):
        path = folder / name
        try:
            path.write_text(text, encoding="utf-8", errors="backslashreplace")
        except OSError:
            continue
        return f"{what}; please report it with {path}"
    return f"{what}; its details could not be written, neither here nor in the folder for temporary files"


def _details(error: BaseException, arguments: Sequence[str], what: str) -> str:
    from mjmerge.versions import versions

    try:
        known = ", ".join(f"{name} {version}" for name, version in versions().items())
    except Exception as second:
        known = f"unknown ({type(second).__name__})"
    lines = [
        what,
        "",
        f"command:   {shlex.join(['mjmerge', *arguments])}",
        f"folder:    {_folder()}",
        f"versions:  {known}",
        f"python:    {sys.version.split()[0]} on {platform.platform()}",
        "",
        "".join(traceback.format_exception(error)),
    ]
    return "\n".join(lines)


def _folder() -> str:
    try:
        return str(Path.cwd())
    except OSError:
        return "gone"


def _place(error: BaseException) -> str:
    """The innermost line of ours that the error went through."""
    package = Path(__file__).parents[1]
    place = "mjmerge"
    for frame, line in traceback.walk_tb(error.__traceback__):
        file = Path(frame.f_code.co_filename)
        if package in file.parents and file != package / "cli" / "__init__.py":
            place = f"{file.relative_to(package.parent).as_posix()}:{line}"
    return place
