"""A command that runs no code but ours does without pandas.

pyarrow imports it, where it is installed, when it makes its first array of anything. That takes as long as
recording a run of ten seconds, and here nobody has a table of it to convert.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from types import ModuleType

import pyarrow as pa

from mjmerge.interrupts import is_command


class _Absent(MetaPathFinder):
    """Finds that there is no pandas."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> None:
        del path, target
        if name == "pandas":
            raise ModuleNotFoundError("not needed", name=name)


def skip() -> None:
    """Lets pyarrow look for pandas, which it does once, while there is none; in commands only.

    What asks pyarrow for pandas by name gets it all the same.
    """
    if not is_command() or "pandas" in sys.modules:
        return
    finder = _Absent()
    sys.meta_path.insert(0, finder)
    try:
        pa.array([0.0])
    finally:
        sys.meta_path.remove(finder)
