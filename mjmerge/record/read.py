"""Recordings back into numbers, finished or not.

Nothing but the file is read, by ``mcap/reader.py`` or ``rerun/reader.py``. What a killed run left is read up
to where it was cut off.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from mjmerge.config.document import parse
from mjmerge.errors import ScenarioError, UnreadableError, nearest
from mjmerge.law import AbsentLaw
from mjmerge.law.choice import LEADER
from mjmerge.record import content
from mjmerge.record.content import ContentError
from mjmerge.record.contents import Found, Said, Ticks
from mjmerge.record.manifest import EXPLANATION, canonical
from mjmerge.record.mcap.file import TooLargeError
from mjmerge.record.mcap.reader import gather_mcap
from mjmerge.record.rerun.reader import gather_rrd, survives
from mjmerge.roster import Roster, slot
from mjmerge.scenario.cars import believed_sheets
from mjmerge.scenario.load import load
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.trace import COLUMNS, Stop, Trace, own, place_of, the_truth
from mjmerge.state import NS_PER_S, Array
from mjmerge.vehicle.datasheet import DataSheet

_MCAP_MAGIC, _RRD_MAGIC = b"\x89MCAP0\r\n", b"RRF2"
MOST_TICKS = 400_000
"""Of a run that is read: an hour at 0.01 s has 360,000. Longer ones must have their ticks in the file."""
_RUN_FILES = ("run.mcap", "run.rrd", "run.mcap.partial", "run.rrd.partial")


@dataclass(frozen=True)
class Recorded:
    """One recording, as it is in its file.

    Attributes:
        path: the file.
        kind: ``mcap`` or ``rrd``.
        schema_version: of the file; ``None`` where it says none.
        finished: whether the file ends as its format wants it.
        fault: why reading ended before the end of the file; empty if it did not.
        flaws: what is in it and cannot be right, whatever the run was, in words.
        manifest: where the run comes from, see ``record/manifest.py``.
        properties: what the file says beside that, in words, by name and key.
        scenario_yaml: the scenario, resolved.
        world_xml: the composed MJCF.
        verdict: what the file claims; ``None`` where the run did not end.
        summary: likewise.
        explanation: why it fails, as the file says; ``None`` where it says nothing of that.
        sha256: fingerprint of every column, as the file claims.
        said: events: time in ns, level, text.
        states: changes of state: time in ns, subject, state.
        grids: ticks of every series, in the order of the file, and their times, ns.
        ticks: the ticks that every series has, (T,).
        time_ns: their times, (T,).
        own_time_s: what each series says itself that its times are, s, (T,).
        columns: each column of the trace and ``time_s`` at those ticks, (T, ...); what is not there is left
            out, and a file of another schema has none.
    """

    path: Path
    kind: str
    schema_version: int | None
    finished: bool
    fault: str
    flaws: tuple[str, ...]
    manifest: dict[str, Any]
    properties: Mapping[str, Mapping[str, Any]]
    scenario_yaml: str
    world_xml: str
    verdict: str | None
    summary: Mapping[str, Any] | None
    explanation: Mapping[str, Any] | None
    sha256: Mapping[str, str]
    said: list[Said]
    states: list[Said]
    grids: Mapping[str, tuple[Ticks, Ticks]]
    ticks: Ticks
    time_ns: Ticks
    own_time_s: Mapping[str, Array] = field(repr=False)
    columns: Mapping[str, Array] = field(repr=False)

    @property
    def step_s(self) -> float:
        """Simulated time between ticks, s."""
        return float(self.manifest["control_step_s"])

    @property
    def last_s(self) -> float:
        """Simulated time of the last tick, s."""
        return float(self.time_ns[-1]) / NS_PER_S

    def scenario(self, *, code: bool = False) -> Scenario:
        """The attached scenario.

        Args:
            code: whether drivers and a law from outside are let in, as they are here; see
                :func:`~mjmerge.load`.

        Raises:
            UnreadableError: it is damaged, or none that this version can run.
        """
        document = parse(self.scenario_yaml)
        if document.problems or not isinstance(document.value, dict):
            raise UnreadableError(self.path, "its scenario is damaged")
        try:
            scenario = load(document.value, sheets=self.sheets(), code=code)
        except ScenarioError as error:
            first, *more = error.problems
            rest = f", and {len(more)} more problems" if more else ""
            why = f"its scenario cannot be run: {first.key + ': ' if first.key else ''}{first.message}{rest}"
            raise UnreadableError(self.path, why) from error
        if isinstance(scenario.law, AbsentLaw):
            law = scenario.law.with_signals(content.signals_of(self.manifest))
            scenario = scenario.model_copy(update={"law": law})
        if scenario.roster != self.roster:
            raise UnreadableError(self.path, "its scenario has other cars than its manifest")
        scenario = scenario.named(str(self.manifest["scenario"]))
        scenario = scenario.recalling(tuple(self.manifest.get("set", ())))
        if scenario.ticks > max(MOST_TICKS, 2 * len(self.ticks)):
            raise UnreadableError(
                self.path, f"its scenario has {scenario.ticks} ticks; up to {MOST_TICKS} can be read"
            )
        return scenario

    @property
    def roster(self) -> Roster:
        """Who is in it."""
        return content.roster_of(self.manifest)

    def sheets(self) -> tuple[DataSheet, ...]:
        """The data sheet of each car, at its size.

        Raises:
            UnreadableError: they are not in it, or damaged.
        """
        try:
            given = self.manifest["sheets"]
            return tuple(DataSheet.model_validate(given[car]) for car in self.roster.cars)
        except (KeyError, TypeError, ValidationError) as error:
            why = "the data sheets of its cars are not in it: was it recorded by an earlier version?"
            raise UnreadableError(self.path, why) from error

    @property
    def texts(self) -> dict[str, str]:
        """What is in it as text, by name, as its fingerprints want it."""
        return {
            "scenario.yaml": self.scenario_yaml,
            "world.xml": self.world_xml,
            "manifest.json": canonical(self.manifest),
            **({} if self.explanation is None else {EXPLANATION: canonical(self.explanation)}),
        }

    def run(self) -> Trace:
        """The same as :meth:`trace` of a file that has something of the run.

        Raises:
            UnreadableError: there is no tick in it, or none at a time of its scenario.
        """
        trace = self.trace()
        if np.isnan(trace.front_m[0, :, 0, 0]).all():
            raise UnreadableError(self.path, "none of its ticks is at a time of its scenario")
        return trace

    def trace(self) -> Trace:
        """The run as a trace of one simulation, NaN where the file has nothing.

        Raises:
            UnreadableError: a column is missing, or the scenario is none that this version can run.
        """
        scenario = self.scenario()
        every = (*COLUMNS, *own(scenario))
        missing = [c.name for c in every if c.name not in self.columns]
        if missing or not len(self.ticks):
            raise UnreadableError(self.path, f"it lacks {', '.join(missing) or 'any tick'}")
        inside = (self.ticks >= 0) & (self.ticks < scenario.ticks)
        columns: dict[str, Any] = {}
        for c in every:
            columns[c.name] = np.full((1, scenario.ticks, *c.shape(self.roster)), np.nan)
            columns[c.name][0, self.ticks[inside]] = self.columns[c.name][inside]
        signals = {c.name: columns.pop(c.name) for c in own(scenario)}
        stops = (self.summary or {}).get("stops", ())
        return Trace(
            scenario=scenario,
            plant=str(self.manifest["plant"]),
            seeds=np.array([self.manifest["seed"]]),
            sheets=tuple(believed_sheets(scenario)),
            mismatch=(scenario.mismatch,),
            stops=tuple(
                Stop(0, s["time_s"], s["car"], s["reason"], s.get("touched", False), s.get("crossing", False))
                for s in stops
            ),
            continuous=bool(self.manifest["continuous"]),
            time_s=np.arange(scenario.ticks, dtype=np.float64) * scenario.control_step_s,
            **columns,
            signals=signals,
        )


def recording(path: Path) -> Path:
    """The recording meant by the path of a file or a run folder.

    Raises:
        UnreadableError: there is none.
    """
    for place in [path, Path("runs") / path]:
        if os.path.isfile(place):  # noqa: PTH113 (a name may be too long)
            return place
        for name in _RUN_FILES:
            if os.path.isfile(place / name):  # noqa: PTH113
                return place / name
        if os.path.isdir(place):  # noqa: PTH112
            raise UnreadableError(path, "there is no recording in that folder")
    raise UnreadableError(path, f"there is no recording of that name{_meant(path)}")


def _meant(path: Path) -> str:
    """What there is beside a path, or in ``runs/``, that is spelt nearly so, as the end of a message."""
    there: set[str] = set()
    for folder in (path.parent, Path("runs") / path.parent):
        with suppress(OSError):
            there |= {one.name for one in folder.iterdir()}
    said = nearest(path.name, there)
    return f"; {said}" if said.startswith("did") else ""


def read(path: Path, *, wary: bool = True) -> Recorded:
    """Reads a recording, up to its end or to where it was cut off.

    Args:
        path: the file.
        wary: whether a damaged file is to be expected. Rerun's reader can take the process down with it on
            one, so that another process tries first, which takes a second.

    Raises:
        UnreadableError: it is no recording, or nothing of the run is in it.
    """
    try:
        kind, found = _gather(path, wary)
        summary = content.summary_of(found.texts.get("summary.json", "null"))
        explanation = content.explanation_of(found.texts.get(EXPLANATION, "null"))
    except (ContentError, TooLargeError) as error:
        raise UnreadableError(path, str(error)) from error
    if "control_step_s" not in found.manifest or "scenario.yaml" not in found.texts:
        why = [found.fault] if found.fault else found.flaws[:1]
        raise UnreadableError(path, ": ".join(["what the run was is not in it", *why]))
    grids = {name: (ticks, time_ns) for name, (ticks, time_ns, _) in found.series.items()}
    common = reduce(np.intersect1d, (t for t, _ in grids.values())) if grids else np.empty(0, np.int64)
    times, columns, own_time_s = np.empty(0, np.int64), {}, {}
    rows = {name: _rows(ticks, common) for name, (ticks, _) in grids.items()}
    if grids:
        first = next(iter(grids))
        times = grids[first][1][rows[first]]
        values = {name: series[rows[name]] for name, (_, _, series) in found.series.items()}
        own_time_s = {name: series[:, 0] for name, series in values.items()}
        columns = _split(values, found.manifest, _leader(found.texts["scenario.yaml"]))
    return Recorded(
        path=path,
        kind=kind,
        schema_version=found.schema_version,
        finished=found.finished,
        fault=found.fault,
        flaws=tuple(dict.fromkeys(found.flaws)),
        manifest=found.manifest,
        properties=found.properties,
        scenario_yaml=found.texts["scenario.yaml"],
        world_xml=found.texts.get("world.xml", ""),
        verdict=found.verdict,
        summary=summary,
        explanation=explanation,
        sha256=found.sha256,
        said=sorted(found.said),
        states=sorted(found.states),
        grids=grids,
        ticks=common,
        time_ns=times,
        own_time_s=own_time_s,
        columns=columns,
    )


def read_mcap(path: Path) -> dict[str, Array]:
    """Columns of an MCAP recording by name, (T, ...), and ``time_s``, (T,)."""
    return dict(read(path, wary=False).columns)


def read_rrd(path: Path) -> dict[str, Array]:
    """Columns of a Rerun recording by name, (T, ...), and ``time_s``, (T,)."""
    return dict(read(path, wary=False).columns)


def _gather(path: Path, wary: bool) -> tuple[str, Found]:
    """What kind of file it is, and what is in it."""
    try:
        with path.open("rb") as file:
            magic = file.read(8)
    except OSError as error:
        raise UnreadableError(path, error.strerror or str(error)) from error
    if magic == _MCAP_MAGIC:
        return "mcap", gather_mcap(path)
    if magic.startswith(_RRD_MAGIC):
        if wary and not survives(path):
            raise UnreadableError(path, "it is damaged: Rerun's reader breaks down on it")
        return "rrd", gather_rrd(path)
    raise UnreadableError(path, "it is neither a Rerun nor an MCAP recording")


def _rows(ticks: Ticks, wanted: Ticks) -> NDArray[np.intp]:
    """Where in ``ticks`` each wanted one is first."""
    order = np.argsort(ticks, kind="stable")
    rows: NDArray[np.intp] = order[np.searchsorted(ticks[order], wanted)]
    return rows


def _leader(scenario_yaml: str) -> int:
    """Where the law's leader is along the axis of neighbours, by the text of a scenario."""
    said = parse(scenario_yaml).value
    law = said.get("law") if isinstance(said, dict) else None
    name = law.get("leader") if isinstance(law, dict) else None
    return (slot(name) if isinstance(name, str) else None) or 0


def _split(series: Mapping[str, Array], manifest: Mapping[str, Any], j_1: int) -> dict[str, Array]:
    """Columns from the numbers of each topic, which are in the order of its message.

    Args:
        series: those numbers.
        manifest: where the run comes from.
        j_1: where the law's leader is along the axis of neighbours.
    """
    from mjmerge.record import schema

    there, law = content.roster_of(manifest), series[schema.LAW_TOPIC]
    cars = np.stack([series[schema.car_topic(car)] for car in there.cars], axis=1)
    columns = {"time_s": law[:, 0]}
    parts = [(law, schema.LAW_COLUMNS, 0), (cars, schema.CAR_COLUMNS, 1)]
    told = series.get(schema.TOLD_TOPIC)
    if schema.SIGNAL_TOPIC in series:
        parts.append((series[schema.SIGNAL_TOPIC], content.own_columns(manifest), 0))
    if told is not None:
        parts.append((told, schema.TOLD_COLUMNS, 0))
    for values, declared, leading in parts:
        at = 1
        for c in declared:
            shape = c.shape(there)
            size = int(np.prod(shape[leading:]))
            columns[c.name] = values[..., at : at + size].reshape(len(values), *shape)
            at += size
    if told is not None:
        return columns
    last = len(there.neighbours) - 1
    leader = place_of(columns, LEADER, min(j_1, last))
    return columns | the_truth(columns, leader if isinstance(leader, int) else np.clip(leader, 0, last))
