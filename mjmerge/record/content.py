"""What a recording says in words and JSON, checked before anything uses it.

Sizes and nesting are bounded, and every type is looked at: what does not fit is an error with the key in it,
whoever wrote the file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, ValidationError

from mjmerge.config.frozen import Frozen
from mjmerge.law import Signal
from mjmerge.law.asked import MOST_SIGNALS, is_name
from mjmerge.plant import PLANTS
from mjmerge.record.manifest import EXPLANATION
from mjmerge.roster import EGO, END, MOST_CARS, PER_NEIGHBOUR, PER_SENSED, XY, Axis, Roster, roster, slot
from mjmerge.simulation.trace import COLUMNS, END_COLUMNS, Column
from mjmerge.vehicle.datasheet import DataSheet

LARGEST_TEXT_BYTES = 8 * 2**20
"""Of a text in a recording: a scenario has 3 kB, a world 70 kB."""
_MOST_SET = 100
"""Of what was given beside a scenario's file."""
DEEPEST = 20
"""Levels of nesting in JSON; a manifest has five."""
LARGEST_NUMBER = 10**308
"""Of a metric; whole numbers in JSON have no end."""
_STRING = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)


_EVERY = {c.name for c in COLUMNS}
_END = {c.name: c for c in END_COLUMNS}


class ContentError(ValueError):
    """What a recording says and cannot mean."""


def _a_car(name: str) -> str:
    if name != EGO and slot(name) is None:
        raise ValueError(f"no car is called {name[:40]!r}")
    return name


class _Stop(Frozen):
    """Why the run ended before its time."""

    model_config = ConfigDict(extra="ignore")

    time_s: float
    car: Annotated[str, AfterValidator(_a_car)]
    reason: Annotated[str, Field(max_length=2000)]
    touched: bool = False


class _Accepted(Frozen):
    """What was known of a car model's acceptance tests."""

    state: Literal["passed", "failed", "stale", "missing"]
    failed: list[str]
    versions: dict[str, str]


class _Code(Frozen):
    """The text of code from outside, and its fingerprint."""

    sha256: str
    source: str


_Text = Annotated[str, Field(max_length=2000)]
_Number = Annotated[float, Field(allow_inf_nan=False)]


class _Broken(Frozen):
    """When a hypothesis broke."""

    hypothesis: _Text
    time_s: _Number


class _Ablation(Frozen):
    """What came of one thing taken back."""

    taken_back: _Text
    margin_m: _Number | None
    moves_m: _Number | None
    kind: _Text | None
    safe: bool
    then: _Text


class _Explanation(Frozen):
    """Why a run fails, as :mod:`mjmerge.search.explain` says it."""

    scenario: _Text
    plant: _Text
    seed: int
    continuous: bool
    unsafe: bool
    kind: _Text | None
    margin_m: _Number | None
    unsafe_at_s: _Number | None
    broken: list[_Broken]
    needs: list[_Text]
    enough: list[list[_Text]]
    complete: bool
    table: list[_Ablation]
    runs: int
    sentences: list[str]


class _Metric(Frozen):
    """A metric of the scenario's own; its code is beside it."""

    name: str
    reference: str
    description: str


def _a_signal(name: str) -> str:
    if not is_name(name) or name == "time_s":
        raise ValueError(f"no law can record {name[:40]!r}")
    return name


class _Column(Frozen):
    """How a column of a law's own is declared."""

    name: Annotated[str, AfterValidator(_a_signal)]
    symbol: Annotated[str, Field(max_length=100)]
    doc: Annotated[str, Field(max_length=2000)]
    axes: Annotated[list[list[str]], Field(max_length=1)]


class Manifest(Frozen):
    """Where a run comes from, as far as anything here relies on it; see ``record/manifest.py``."""

    model_config = ConfigDict(extra="ignore")

    schema_version: int
    cars: Annotated[list[str], Field(min_length=3, max_length=MOST_CARS)] | None = None
    scenario: Annotated[str, Field(max_length=500)]
    description: str
    plant: str
    seed: Annotated[int, Field(ge=-(2**63), lt=2**63)]
    control_step_s: Annotated[float, Field(ge=1e-6, le=1)]
    continuous: bool
    sensing: Literal["recorded", "exact"] = "exact"
    versions: dict[str, str]
    acceptance: dict[str, _Accepted]
    conventions: dict[str, str]
    columns: list[dict[str, Any]]
    asks: dict[str, Annotated[str, Field(max_length=2000)]] = Field(default_factory=dict)
    sheets: dict[str, DataSheet] | None = None
    code: dict[str, _Code] | None = None
    metrics: list[_Metric] = Field(default_factory=list)
    set: Annotated[list[_Text], Field(max_length=_MOST_SET)] = Field(default_factory=list)
    drawing: int = 1


def decoded(data: bytes, name: str) -> str:
    """A text.

    Raises:
        ContentError: it is too long, or none.
    """
    if len(data) > LARGEST_TEXT_BYTES:
        raise ContentError(
            f"{name} has {len(data) / 2**20:.3g} MiB; a text may have {LARGEST_TEXT_BYTES // 2**20} MiB"
        )
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise ContentError(f"{name} is not text in UTF-8") from error


def json_of(text: str, name: str) -> Any:
    """A JSON document.

    Raises:
        ContentError: it is none, too long, or too deep.
    """
    if len(text) > LARGEST_TEXT_BYTES:
        raise ContentError(f"{name} is longer than {LARGEST_TEXT_BYTES // 2**20} MiB")
    depth = deepest = 0
    for bracket in re.findall(r"[\[\]{}]", _STRING.sub("", text)):
        depth += 1 if bracket in "[{" else -1
        deepest = max(deepest, depth)
    if deepest > DEEPEST:
        raise ContentError(f"{name} is nested more than {DEEPEST} levels deep")
    try:
        return json.loads(text)
    except ValueError as error:
        raise ContentError(f"{name} is not JSON") from error


def manifest_of(text: str) -> dict[str, Any]:
    """A manifest, as written.

    Raises:
        ContentError: something in it is missing or of a wrong type.
    """
    value = json_of(text, "manifest.json")
    if not isinstance(value, dict):
        raise ContentError("manifest.json is not a mapping")
    try:
        valid = Manifest.model_validate(value)
    except ValidationError as invalid:
        raise ContentError(f"manifest.json: {_first(invalid)}") from invalid
    if valid.plant not in PLANTS:
        raise ContentError(f"manifest.json: plant: no plant called {valid.plant[:40]!r}")
    there = roster_of(value)
    if valid.cars is not None and tuple(valid.cars) != there.cars:
        raise ContentError("manifest.json: cars: not an ego and numbered neighbours")
    signals_of(value)
    if valid.sheets is not None and set(valid.sheets) != set(there.cars):
        raise ContentError("manifest.json: sheets: not one of each car")
    return value


def roster_of(manifest: Mapping[str, Any]) -> Roster:
    """Who is in a recording: as many as its manifest says, and two neighbours where it says nothing."""
    return roster(len(manifest.get("cars") or roster().cars) - 1)


def signals_of(manifest: Mapping[str, Any]) -> tuple[Signal, ...]:
    """What the law of a recording recorded of its own: whatever of its columns is not one of ours.

    Raises:
        ContentError: it can be none.
    """
    there, asks = roster_of(manifest), manifest.get("asks") or {}
    axes: dict[tuple[str, ...], Axis] = {there.neighbours: PER_NEIGHBOUR, XY: XY}
    axes[(*there.neighbours, END)] = PER_SENSED
    found: dict[str, Signal] = {}
    for column in manifest.get("columns", ()):  # of a file that has lost its manifest, nothing is known
        if str(column.get("name")) in _EVERY | _END.keys():
            continue
        try:
            valid = _Column.model_validate(column)
        except ValidationError as invalid:
            raise ContentError(f"manifest.json: columns: {_first(invalid)}") from invalid
        name, of = valid.name, tuple(tuple(axis) for axis in valid.axes)
        if name in found or not axes.keys() >= set(of):
            raise ContentError(f"manifest.json: columns: {name} is there twice, or has axes that are none")
        found[name] = Signal(name, valid.doc, valid.symbol, tuple(axes[a] for a in of), asks.get(name, ""))
    if len(found) > MOST_SIGNALS:
        raise ContentError(f"manifest.json: columns: more than {MOST_SIGNALS} signals")
    return tuple(found.values())


def own_columns(manifest: Mapping[str, Any]) -> tuple[Column, ...]:
    """Columns of a recording that not every one has: signals of its law, and the end of the ego's lane."""
    names = [str(column.get("name")) for column in manifest.get("columns", ())]
    ends = [_END[name] for name in names if name in _END]
    return (*(Column(s.name, s.axes, s.symbol, s.doc, told=False) for s in signals_of(manifest)), *ends)


def summary_of(text: str) -> dict[str, Any] | None:
    """A summary, as written; ``None`` for one that says nothing.

    Raises:
        ContentError: it is no summary, or why the run stopped is damaged.
    """
    value = json_of(text, "summary.json")
    if value is None:
        return None
    if not isinstance(value, dict):
        raise ContentError("summary.json is not a mapping")
    for key in ("min_distance_m", "t_min_distance_s"):
        of_cars = value.get(key, {})
        if not isinstance(of_cars, dict) or not all(map(_is_number, of_cars.values())):
            raise ContentError(f"summary.json: {key}: not a number per car")
    for key in ("min_clearance_m", "floor_m", "merged_at_s", "min_edge_distance_m"):
        if not _is_number(value.get(key)):
            raise ContentError(f"summary.json: {key}: not a number")
    metrics = value.get("metrics", {})
    if not isinstance(metrics, dict) or not all(
        v is None or (_is_number(v) and abs(v) < LARGEST_NUMBER) for v in metrics.values()
    ):
        raise ContentError("summary.json: metrics: not a number per metric")
    stops = value.get("stops", [])
    if not isinstance(stops, list) or len(stops) > 1:
        raise ContentError("summary.json: stops: not a list of at most one")
    for stop in stops:
        try:
            _Stop.model_validate(stop)
        except ValidationError as invalid:
            raise ContentError(f"summary.json: stops: {_first(invalid)}") from invalid
    return value


def explanation_of(text: str) -> dict[str, Any] | None:
    """An explanation, as written; ``None`` for one that says nothing.

    Raises:
        ContentError: something in it is missing or of a wrong type.
    """
    value = json_of(text, EXPLANATION)
    if value is None:
        return None
    try:
        _Explanation.model_validate(value)
    except ValidationError as invalid:
        raise ContentError(f"{EXPLANATION}: {_first(invalid)}") from invalid
    return dict(value)


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def texts_of(value: Any, name: str) -> dict[str, str]:
    """A mapping of text to text.

    Raises:
        ContentError: it is none.
    """
    if not isinstance(value, Mapping) or not all(isinstance(v, str) for v in value.values()):
        raise ContentError(f"{name} is not a mapping of text")
    return dict(value)


def version_of(text: str) -> int:
    """A schema version.

    Raises:
        ContentError: it is no number.
    """
    if not re.fullmatch(r"\d{1,9}", text):
        raise ContentError(f"its schema version is {text[:20]!r}")
    return int(text)


def _first(invalid: ValidationError) -> str:
    """The first thing that is wrong, with its key."""
    error = invalid.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, error['loc']))}: {error['msg'][:200]}"
