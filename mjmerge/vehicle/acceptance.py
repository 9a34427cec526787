"""Whether a car model has been measured and found sound: a table beside it, and what it is a table of.

``models/<name>/acceptance.json`` is written by ``mjmerge identify NAME --accept`` and read into the
provenance of every run. It holds a hash over the files that make the car, so a car that was edited since
says so.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from mjmerge.outputs import put

FILE = "acceptance.json"

_REFERENCE = re.compile(rb"""\bfile\s*=\s*["']([^"']+)["']""")
_ASSETS = re.compile(rb"""\b(?:mesh|texture|asset)dir\s*=\s*["']([^"']+)["']""")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)


@dataclass(frozen=True)
class Measured:
    """One row of the table.

    Attributes:
        name: what was measured.
        unit: of all numbers in the row; empty for a pure number.
        measured: what came out.
        expected: what the data sheet, or physics from its numbers, says; ``None`` if it says nothing.
        tolerance: how far off it may be, in the same unit; ``None`` where nothing is asked.
        how: how it was measured, and where ``expected`` comes from.
    """

    name: str
    unit: str
    measured: float
    expected: float | None
    tolerance: float | None
    how: str

    @property
    def passed(self) -> bool | None:
        """Whether it is within its tolerance; ``None`` where nothing is asked."""
        if self.expected is None or self.tolerance is None:
            return None
        return bool(abs(self.measured - self.expected) <= self.tolerance)  # not for NaN

    @property
    def off(self) -> float | None:
        """Error as a part of what was expected; ``None`` where that is nothing or zero."""
        return (self.measured - self.expected) / abs(self.expected) if self.expected else None


@dataclass(frozen=True)
class Acceptance:
    """What is known of a model's acceptance.

    Attributes:
        model: the model's name.
        state: ``stale`` if the car was edited after it was measured, ``missing`` if it never was.
        failed: names of the rows that are out of tolerance.
        versions: of the packages that it was measured with.
    """

    model: str
    state: Literal["passed", "failed", "stale", "missing"]
    failed: tuple[str, ...] = ()
    versions: tuple[tuple[str, str], ...] = ()

    @property
    def sentence(self) -> str:
        """For a verdict: empty if the car passed."""
        match self.state:
            case "passed":
                return ""
            case "failed":
                return f"{self.model} fails its acceptance tests: {', '.join(self.failed)}"
            case "stale":
                return f"{self.model} was edited after its acceptance tests"
            case "missing":
                return f"{self.model} has never passed acceptance tests"


def acceptance(folder: Path) -> Acceptance:
    """What is stored of a model, in its folder; a file that cannot be read counts as missing."""
    try:
        stored = json.loads((folder / FILE).read_text(encoding="utf-8"))
        failed = tuple(str(row["name"]) for row in stored["table"] if row["passed"] is False)
        versions = tuple((str(k), str(v)) for k, v in stored["versions"].items())
        same = stored["sha256"] == fingerprint(folder)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return Acceptance(folder.name, "missing")
    state: Literal["passed", "failed", "stale"] = "stale" if not same else "failed" if failed else "passed"
    return Acceptance(folder.name, state, failed, versions)


def store(folder: Path, table: Sequence[Measured], versions: dict[str, str]) -> None:
    """Writes what was measured beside the model.

    Raises:
        OutputError: the folder cannot be written.
    """
    document: dict[str, Any] = {
        "model": folder.name,
        "sha256": fingerprint(folder),
        "versions": versions,
        "table": [rounded(asdict(row)) | {"passed": row.passed} for row in table],
    }
    put(folder / FILE, json.dumps(document, indent=2) + "\n")


def rounded(row: dict[str, Any]) -> dict[str, Any]:
    """Numbers to six digits: what is below comes from the processor, not from the car."""
    return {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in row.items()}


def fingerprint(folder: Path) -> str:
    """SHA-256 over the data sheet, the MJCF and every file that it names, by name and content.

    Raises:
        OSError: one of them cannot be read.
    """
    digest, base = hashlib.sha256(), folder.resolve()
    waiting, seen = [base / "datasheet.yaml", base / f"{base.name}.xml"], set[Path]()
    found: dict[str, bytes] = {}
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        data = path.read_bytes()
        found[path.name if path.parent == base else f"{path.parent.name}/{path.name}"] = data
        if path.suffix == ".xml":
            waiting += _named(path, data)
    for name in sorted(found):
        digest.update(f"{name}\0{len(found[name])}\0".encode() + found[name])
    return digest.hexdigest()


def _named(path: Path, data: bytes) -> list[Path]:
    """Files that an MJCF names, beside it or in one of the folders that it says its assets are in."""
    said = _COMMENT.sub(b"", data)
    places = [path.parent, *(path.parent / folder.decode() for folder in _ASSETS.findall(said))]
    names = [name.decode() for name in _REFERENCE.findall(said)]
    return [next((p / n for p in places if (p / n).is_file()), path.parent / n).resolve() for n in names]
