"""Tables of traffic, CSV with a header, read into tracks and straight lanes by a map of their columns.

Maps of NGSIM and highD ship, in ``maps/``; another one is a YAML file like theirs.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from mjmerge.config.frozen import Frozen, Positive
from mjmerge.config.read import file_of, raise_problems, validated
from mjmerge.config.read import read as read_document
from mjmerge.errors import Problem, ScenarioError, nearest
from mjmerge.state import Array
from mjmerge.traffic.plausible import biased, doubts_of_units
from mjmerge.traffic.tracks import (
    LONGEST_HOLE_S,
    ONE_STATE,
    OUTSIDE,
    Lane,
    Track,
    Tracks,
    Unused,
    read_bytes,
    refuse,
    track,
)

if TYPE_CHECKING:
    import pyarrow as pa

LARGEST_BYTES = 64_000_000
MOST_LANES = 100
_ALONE_M = 3.5  # width of a lane that has none beside it
_WIDEST_M = 6.0
_NUMBER = r"^\s*[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?\s*$"


class Columns(Frozen):
    """Which column of a table means what, and in which unit."""

    description: str = ""
    """In a line."""
    id: str
    """Column of the road user's name."""
    time: str
    """Column of the time."""
    time_s: Positive
    """Seconds in one of its units."""
    step_s: Positive | None = None
    """Time between two states of a road user, s; one unit of time by default."""
    along: str
    """Column of the position along the road."""
    across: str
    """Column of the position across it."""
    across_to: Literal["left", "right"]
    """Which way that grows, seen along the road."""
    unit_m: Positive
    """Metres in one of its units of length."""
    reference: Literal["centre", "front", "rear", "corner"]
    """Which point of the rectangle is given: its centre, the middle of its front or of its rear as it drives,
    or the corner where both columns are least."""
    length: str
    """Column of its length."""
    width: str
    """Column of its width."""
    lane: str
    """Column of the lane's name."""
    kind: str | None = None
    """Column of what it is."""
    kinds: dict[str, str] = Field(default_factory=dict)
    """What the values of that column mean: car, truck, motorcycle, pedestrian."""
    speed: str | None = None
    """Column of its speed, in units of length a second: held against the positions."""
    acceleration: str | None = None
    """Column of its acceleration, likewise."""
    place: str | None = None
    """Column that says where it is: the same on all rows, where the table has it."""
    separator: Annotated[str, Field(min_length=1, max_length=1)] = ","
    """Between two columns."""

    @property
    def needed(self) -> tuple[str, ...]:
        """Columns that a table must have."""
        return (self.id, self.time, self.along, self.across, self.length, self.width, self.lane)

    @property
    def used(self) -> tuple[str, ...]:
        """Those, and whatever else is read where it is there."""
        further = (self.kind, self.speed, self.acceleration, self.place)
        return (*self.needed, *(name for name in further if name is not None))

    def __hash__(self) -> int:
        return hash(self.model_dump_json())


def maps() -> dict[str, Path]:
    """Shipped maps, name to file."""
    return {path.stem: path for path in sorted((Path(__file__).parent / "maps").glob("*.yaml"))}


def column_map(name: str) -> Columns:
    """A map by the name of a shipped one, or by its path.

    Raises:
        ScenarioError: with everything that is wrong with it.
        UnknownNameError: there is none of that name.
    """
    path = file_of("map of columns", name, maps())
    document = read_document(path)
    found = validated(Columns, document)
    raise_problems(path, document)
    assert found is not None, "what is not valid has problems"
    return found


def read_columns(path: Path, name: str = "") -> Tracks:
    """A table of traffic.

    Args:
        path: the file.
        name: of a map of its columns; by default the shipped one that its header fits.

    Raises:
        ScenarioError: with what is wrong with it, with lines.
    """
    given = column_map(name) if name else None
    advice = "cut it down to one place and the minutes that matter"
    data = read_bytes(path, LARGEST_BYTES, "a table of traffic", advice)
    header = _header(path, data, given.separator if given else ",")
    columns, called = (given, name) if given is not None else _fitting(path, header)
    missing = [one for one in columns.needed if one.lower() not in header]
    if missing:
        places = [Problem(f"no column {one!r}: {nearest(one, header.values())}", "", 1) for one in missing]
        refuse(path, places)
    if b"\n" not in data.strip():
        refuse(path, [Problem("has no rows below its header")])
    table = _table(path, data, columns, header)
    return _tracks(path, columns, called, table)


def _header(path: Path, data: bytes, separator: str) -> dict[str, str]:
    """Names of the columns as they stand there, by their names in small letters."""
    first = data.split(b"\n", 1)[0]
    try:
        text = first[:100_000].decode("utf-8-sig").strip("\r")
    except UnicodeDecodeError as error:
        raise ScenarioError(path, [Problem("not text in UTF-8", "", 1)]) from error
    if "\0" in text:
        refuse(path, [Problem("not text: it has zero bytes", "", 1)])
    names = [name.strip().strip('"') for name in text.split(separator)]
    if all(re.fullmatch(_NUMBER, name) for name in names):
        refuse(path, [Problem("has no header: its first line must name the columns", "", 1)])
    twice = sorted({name for name in names if [n.lower() for n in names].count(name.lower()) > 1})
    refuse(path, [Problem(f"two columns are called {name[:60]!r}", "", 1) for name in twice])
    return {name.lower(): name for name in names}


def _fitting(path: Path, header: Mapping[str, str]) -> tuple[Columns, str]:
    """The shipped map whose columns are all there."""
    lacking = {}
    for name in maps():
        columns = column_map(name)
        lacking[name] = [one for one in columns.needed if one.lower() not in header]
        if not lacking[name]:
            return columns, name
    said = "; ".join(f"for {name} it lacks {', '.join(of)}" for name, of in lacking.items())
    message = f"no shipped map of columns fits its header: {said}. Write one, and give it as --map FILE"
    raise ScenarioError(path, [Problem(message, "", 1)])


def _table(path: Path, data: bytes, columns: Columns, header: Mapping[str, str]) -> dict[str, Any]:
    """The columns that are used, as numbers, and as text where they are names: by the map's names."""
    import pyarrow as pa
    from pyarrow import csv

    names = {one: header[one.lower()] for one in columns.used if one.lower() in header}
    try:
        read = csv.read_csv(
            io.BytesIO(data.rstrip()),
            read_options=csv.ReadOptions(use_threads=False),
            parse_options=csv.ParseOptions(delimiter=columns.separator, ignore_empty_lines=False),
            convert_options=csv.ConvertOptions(
                include_columns=list(dict.fromkeys(names.values())),
                column_types=dict.fromkeys(names.values(), pa.string()),
                strings_can_be_null=False,
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowKeyError) as error:
        raise ScenarioError(
            path, [Problem(f"not a whole table: {str(error).splitlines()[0][:200]}")]
        ) from error
    texts = {columns.id, columns.lane, columns.kind, columns.place}
    found, problems = {}, []
    for one, name in names.items():
        if one in texts:
            found[one] = _texts(read[name])
        else:
            found[one], wrong = _numbers(read[name], name)
            problems += wrong
    refuse(path, problems)
    return found


def _texts(column: pa.ChunkedArray) -> Any:
    import pyarrow.compute as pc

    trimmed = pc.utf8_trim_whitespace(column).combine_chunks().dictionary_encode()
    return np.array(trimmed.dictionary.to_pylist() or [""], dtype=str)[trimmed.indices.to_numpy()]


def _numbers(column: pa.ChunkedArray, name: str) -> tuple[Array, list[Problem]]:
    """A column as finite numbers, and the lines on which it has something else."""
    import pyarrow.compute as pc

    good = pc.match_substring_regex(column, _NUMBER).to_numpy()
    if not good.all():
        wrong = np.flatnonzero(~good)
        more = f" (and on {len(wrong) - 1} more lines)" if len(wrong) > 1 else ""
        return np.zeros(0), [
            Problem(
                f"must be a number, got {column[int(wrong[0])].as_py()[:40]!r}{more}", name, int(wrong[0]) + 2
            )
        ]
    values: Array = pc.cast(pc.utf8_trim_whitespace(column), "double").to_numpy()
    if not np.isfinite(values).all():
        return np.zeros(0), [Problem("too large a number", name, int(np.argmin(np.isfinite(values))) + 2)]
    return values, []


def _tracks(path: Path, columns: Columns, called: str, table: Mapping[str, Any]) -> Tracks:
    places = np.unique(table.get(columns.place or "", np.array([])))
    if len(places) > 1:
        said = ", ".join(map(str, places[:5]))
        refuse(path, [Problem(f"has several places ({said}); cut it to one", columns.place or "")])
    step_s = columns.step_s or columns.time_s
    time = table[columns.time]
    exact = (time - time.min()) * (columns.time_s / step_s)
    step = np.round(exact).astype(np.int64)
    off = np.flatnonzero(np.abs(exact - step) > 1e-3)
    if len(off):
        message = f"is no whole number of steps of {step_s:g} s after the first: is step_s right?"
        refuse(path, [Problem(message, columns.time, int(off[0]) + 2)])
    users = list(_users(columns, table, step, step_s))
    notes: list[str] = []
    problems: list[Problem] = []
    found: dict[str, Track] = {}
    unused: list[Unused] = []
    split = len(users) - len(np.unique(table[columns.id]))
    if split:
        notes.append(
            f"{split} road users have a name that was used before, {LONGEST_HOLE_S} s or more: told apart"
        )
    for given in users:
        one = track(given, step_s, f"road user {given.id}", notes, problems)
        if isinstance(one, Unused):
            unused.append(one)
        else:
            found[one.id] = one
    alone = [one for one in unused if one.why == ONE_STATE]  # common in a table that was cut
    problems = [one for one in problems if one.message != ONE_STATE or not found]
    notes += [f"{len(alone)} road users are seen once only"] * bool(alone)
    problems += doubts_of_units(list(found.values()), step_s)
    refuse(path, problems)
    lanes, more = _lanes(path, list(found.values()))
    every = (*notes, *more, *biased(list(found.values()), step_s))
    return Tracks(path, f"table, columns as {called}", step_s, found, lanes, tuple(unused), every)


def _users(columns: Columns, table: Mapping[str, Any], step: Any, step_s: float) -> Iterator[Track]:
    """Every road user, with its rows in order of time; one name for two is told apart."""
    ids = table[columns.id]
    order = np.lexsort((step, ids))
    change = np.flatnonzero(ids[order][1:] != ids[order][:-1]) + 1
    u, side = columns.unit_m, 1.0 if columns.across_to == "left" else -1.0
    nothing = np.full(len(ids), np.nan)
    speed = table.get(columns.speed or "", nothing)
    acceleration = table.get(columns.acceleration or "", nothing)
    for rows in np.split(order, change):
        holes = np.flatnonzero(np.diff(step[rows]) * step_s > 20 * LONGEST_HOLE_S) + 1
        for part, own in enumerate(np.split(rows, holes)):
            length, width = (float(np.median(table[c][own])) * u for c in (columns.length, columns.width))
            x, y = table[columns.along][own] * u, table[columns.across][own] * u
            ahead = -1.0 if x[-1] < x[0] else 1.0
            match columns.reference:
                case "front":
                    x = x - ahead * length / 2
                case "rear":
                    x = x + ahead * length / 2
                case "corner":
                    x, y = x + length / 2, y + width / 2
            lane = np.where(
                np.isin(table[columns.lane][own], ("", "0", "nan")), OUTSIDE, table[columns.lane][own]
            )
            kinds = table.get(columns.kind or "")
            kind = "vehicle" if kinds is None else str(kinds[own[0]])
            yield Track(
                id=f"{ids[own[0]]}{f'#{part + 1}' if part else ''}",
                kind=columns.kinds.get(kind, kind if not columns.kinds else "vehicle"),
                length_m=length,
                width_m=width,
                step=step[own],
                centre_m=np.stack([x, side * y], axis=1),
                lane=lane,
                speed_mps=np.abs(speed[own]) * u,
                acceleration_mps2=acceleration[own] * u,
                line=int(own[0]) + 2,
            )


def _lanes(path: Path, tracks: list[Track]) -> tuple[dict[str, Lane], list[str]]:
    """Straight lanes: the middle is the median of the positions in one, edges are half-way to the next."""
    if not tracks:
        return {}, []
    lane = np.concatenate([one.lane for one in tracks])
    centre = np.concatenate([one.centre_m for one in tracks])
    way = np.concatenate([np.full(len(one.lane), one.centre_m[-1, 0] - one.centre_m[0, 0]) for one in tracks])
    names = [str(name) for name in np.unique(lane) if name != OUTSIDE]
    if len(names) > MOST_LANES:
        refuse(path, [Problem(f"has {len(names)} lanes; at most {MOST_LANES}: is that the column of lanes?")])
    middle = {name: float(np.median(centre[lane == name, 1])) for name in names}
    ends = np.array([centre[:, 0].min(), centre[:, 0].max() + 1.0])
    found, most = {}, 0.0
    for name in names:
        apart = [abs(middle[name] - y) for other, y in middle.items() if other != name and y != middle[name]]
        half = min([_ALONE_M, *(a for a in apart if a <= _WIDEST_M)]) / 2
        x = ends if np.median(way[lane == name]) >= 0 else ends[::-1]
        side = half if x is ends else -half
        left, right = (np.stack([x, np.full(2, middle[name] + s)], axis=1) for s in (side, -side))
        found[name] = Lane(name, left, right)
        most = max(most, float(np.quantile(np.abs(centre[lane == name, 1] - middle[name]), 0.95)))
    note = f"lanes of a table are straight, through the medians of what is in them: 95 % within {most:.2f} m"
    return found, [note] if names else []
