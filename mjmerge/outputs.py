"""Files that are there whole or not at all, and errors that say which could not be written, and why."""

from __future__ import annotations

import errno
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from pathlib import Path

from mjmerge.errors import OutputError

PARTIAL, WHOLE = ".partial", ".whole"
"""Endings of a file that is not complete, and of what is about to take its place."""
ENDINGS = ("", PARTIAL, PARTIAL + WHOLE)
"""What may follow the name of a file while it is written."""
_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


@contextmanager
def written(path: Path) -> Iterator[Path]:
    """Yields where to write a file, which gets its name, and replaces an earlier one, once it is whole.

    Args:
        path: the file.

    Raises:
        OutputError: it cannot be written; nothing of it is left.
    """
    partial = path.with_name(path.name + PARTIAL)
    try:
        yield partial
        partial.replace(path)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise cannot_write(path, error) from error
        raise


def put(path: Path, content: str | bytes) -> None:
    """Writes a file, whole or not at all; text as UTF-8.

    Raises:
        OutputError: it cannot be written.
    """
    with written(path) as partial:
        partial.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def put_new(path: Path, content: str) -> None:
    """The same, but never in place of another file.

    Raises:
        OutputError: there is a file of that name, or it cannot be written.
    """
    if path.exists():
        raise OutputError(f"{path} exists, and nothing is overwritten: choose another --out")
    put(path, content)


def cannot_write(path: Path, error: OSError) -> OutputError:
    """What to say of a file that could not be written."""
    return OutputError(f"cannot write {path}: {error.strerror or type(error).__name__}")


def no_room(error: BaseException | None) -> bool:
    """Whether an error, or what it came from, is a full or a failing disk: not the input's fault."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, OSError) and error.errno in _NO_ROOM:
            return True
        error = error.__cause__ or error.__context__
    return False


def whole(path: Path, write: Callable[[Path], None]) -> None:
    """Writes a file under ``<name>.partial`` and gives it its name once it is whole.

    Raises:
        OutputError: there is a file of that name, or it cannot be written.
    """
    partial = path.with_name(path.name + PARTIAL)
    for there in (path, partial):
        if there.exists():
            raise OutputError(f"{there} exists, and nothing is overwritten: choose another --out")
    try:
        write(partial)
        partial.rename(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error


def prepare(folder: Path, replace: bool, files: Collection[str]) -> bool:
    """Makes an empty folder; returns whether an earlier run's files made way.

    Args:
        folder: where it is to be.
        replace: whether they may.
        files: what they may be called; ``*`` stands for anything.

    Raises:
        OutputError: it is no folder, cannot be written, or holds something that may not go.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        there = {p.name for p in folder.iterdir()}
        ours = {n for n in there for f in files for end in ENDINGS if fnmatchcase(n, f + end)}
        if there and not replace:
            raise OutputError(f"{folder} is not empty, and nothing is overwritten: choose another --out")
        if there - ours:
            raise OutputError(
                f"{folder} holds files that are not an earlier run's ({min(there - ours)}): choose an --out"
            )
        for name in there:
            (folder / name).unlink()
        probe = folder / "summary.json.partial"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror or error}") from error
    return bool(there)
