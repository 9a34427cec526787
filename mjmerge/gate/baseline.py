"""What the gate measured last time: a CSV per scenario, a row per row, with the versions it was made with.

People open it in spreadsheets, which save it with a byte-order mark, semicolons and decimal commas: it is
read all the same. What cannot be meant (a row twice, words for numbers) is refused with its line.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mjmerge.config.read import LARGEST_FILE_BYTES
from mjmerge.errors import Problem, ScenarioError
from mjmerge.outputs import cannot_write, put

VERSIONS = ("mjmerge", "mujoco", "numpy")
"""Packages whose versions a margin depends on."""
_CLEARANCE, _EDGE = "min_clearance_m", "min_edge_distance_m"
_DISTANCE = re.compile(r"min_d_([1-9][0-9]?)_m")
_NEEDED = ("row", "min_d_1_m", "min_d_2_m", _CLEARANCE)
_HEAD = (*_NEEDED, *VERSIONS)


@dataclass(frozen=True)
class RowMargins:
    """What a row came to.

    Attributes:
        min_d_m: smallest d_j of each neighbour, m, (C-1,).
        min_clearance_m: smallest distance of the ego's body to another, m; NaN without bodies.
        min_edge_m: smallest distance of it from the edge where its lane ends, m; ``None`` where it goes on.
    """

    min_d_m: tuple[float, ...]
    min_clearance_m: float
    min_edge_m: float | None = None

    @property
    def numbers(self) -> dict[str, float]:
        """By the name of their columns: ``min_d_1_m`` and so on, ``min_clearance_m``, then the edge's."""
        found = {f"min_d_{j}_m": d for j, d in enumerate(self.min_d_m, 1)} | {
            _CLEARANCE: self.min_clearance_m
        }
        return found if self.min_edge_m is None else found | {_EDGE: self.min_edge_m}


Entry = tuple[RowMargins, Mapping[str, str]]
"""What a row came to, and with which versions."""


def file_of(scenario: Path, baselines: Path | None) -> Path:
    """The CSV of a scenario's file; ``baselines`` is their folder if not the one beside it."""
    return (baselines or scenario.parent / "baselines") / f"{scenario.stem}.csv"


def read(file: Path) -> dict[str, Entry]:
    """What was measured before, by the row's name; empty if there is no file.

    Raises:
        ScenarioError: it is no baseline; with every problem and its line.
    """
    if not file.exists():
        return {}
    found: dict[str, Entry] = {}
    first: dict[str, int] = {}
    problems = []
    for number, row in _rows(file):
        name = row["row"]
        if name in first:
            message = f"{name!r} is there twice, on lines {first[name]} and {number}; keep one"
            problems.append(Problem(message, "", number))
            continue
        first[name] = number
        try:
            least = [
                _number(row[key]) for key in sorted(filter(_DISTANCE.fullmatch, row), key=_place) if row[key]
            ]
            clearance = _number(row[_CLEARANCE])
            edge = _number(row[_EDGE]) if row.get(_EDGE) else None
        except ValueError as error:
            problems.append(Problem(f"{name!r}: {error}", "", number))
            continue
        found[name] = (
            RowMargins(tuple(least), clearance, edge),
            {key: row.get(key) or "-" for key in VERSIONS},
        )
    if problems:
        raise ScenarioError(file, problems)
    return found


def write(file: Path, entries: Mapping[str, Entry]) -> None:
    """Writes what was measured, row by row.

    Raises:
        OutputError: it cannot be written.
    """
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    most = max((measured.numbers for measured, _ in entries.values()), key=len, default=())
    names = [*most] or list(_NEEDED[1:])
    rows.writerow(["row", *names, *VERSIONS])
    for name, (measured, versions) in entries.items():
        known = measured.numbers
        numbers = (f"{known[key]:.6f}" if key in known else "" for key in names)
        rows.writerow([name, *numbers, *(versions[key] for key in VERSIONS)])
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(file, error) from error
    put(file, text.getvalue())


def _rows(file: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """The rows of a table that some spreadsheet may have saved, and the line of each."""
    text = _text(file)
    head = text.partition("\n")[0]
    separator = max(";\t,", key=head.count)
    decimal = "," if separator == ";" else "."
    table = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    names: list[str] = []
    try:
        for cells in table:
            values = [cell.strip() for cell in cells]
            if not any(values):
                continue
            if not names:
                names = values
                lacking = [name for name in _NEEDED if name not in names]
                if lacking:
                    message = f"it has no column {', '.join(lacking)}; a baseline has {','.join(_HEAD)}"
                    raise ScenarioError(file, [Problem(message, "", table.line_num)])
                continue
            row = dict(zip(names, values, strict=False))
            short = [name for name in _NEEDED if name not in row]
            if short or len(values) > len(names):
                message = f"{len(values)} values in {len(names)} columns"
                raise ScenarioError(file, [Problem(message, "", table.line_num)])
            numbers = [key for key in row if key in (_CLEARANCE, _EDGE) or _DISTANCE.fullmatch(key)]
            yield table.line_num, row | {key: row[key].replace(decimal, ".") for key in numbers}
    except csv.Error as error:
        raise ScenarioError(file, [Problem(f"no table of values: {error}", "", table.line_num)]) from error


def _text(file: Path) -> str:
    try:
        with file.open("rb") as opened:
            data = opened.read(LARGEST_FILE_BYTES + 1)
        if len(data) > LARGEST_FILE_BYTES:
            most = f"{LARGEST_FILE_BYTES / 1e6:.1f} MB"
            raise ScenarioError(file, [Problem(f"a baseline is a few kilobytes; this is more than {most}")])
        if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return data.decode("utf-16")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = "not text in UTF-8: in a spreadsheet, save it as CSV UTF-8"
        raise ScenarioError(file, [Problem(message, "", line)]) from error
    except OSError as error:
        raise ScenarioError(file, [Problem(f"cannot be read: {error.strerror}")]) from error


def _place(key: str) -> int:
    """Which neighbour's distance a column has."""
    return int(key.split("_")[2])


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{text!r} is no number") from None
    if value in (float("inf"), float("-inf")):
        raise ValueError(f"{text!r} is no length")
    return value


def stale(entries: Mapping[str, Entry], names: Sequence[str]) -> list[str]:
    """Rows of a baseline that the gate does not have."""
    return [name for name in entries if name not in names]
