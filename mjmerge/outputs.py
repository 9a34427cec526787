"""Files that are there whole or not at all, and errors that say which could not be written, and why."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mjmerge.errors import OutputError

PARTIAL = ".partial"
"""Ending of a file that is not complete."""
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
