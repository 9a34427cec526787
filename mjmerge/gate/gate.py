"""The regression gate: how much of the guarantee is left, row by row, against floors and baselines.

A scenario lists its rows under ``gate``: itself with some keys different, and the least distance that must
remain. That floor is one-sided and set by hand. Beside it stands a baseline, a CSV per scenario with what was
measured last time: two-sided, rewritten only on demand. A row that is safe without having been put to the
test is vacuous, and fails.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from mjmerge.config import shipped
from mjmerge.config.acts import BODIES, listed
from mjmerge.config.document import Document
from mjmerge.config.read import raise_problems, read
from mjmerge.errors import MjmergeError, Problem, ScenarioError, UnknownNameError
from mjmerge.gate import baseline
from mjmerge.gate.baseline import RowMargins
from mjmerge.gate.result import Result, RowResult
from mjmerge.plant import PLANTS
from mjmerge.plant import check as check_plant
from mjmerge.scenario.distinct import labels
from mjmerge.scenario.effect import acting, covers, given_in_vain
from mjmerge.scenario.load import load
from mjmerge.scenario.mismatch import column
from mjmerge.scenario.schema import GateRow, Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Trace
from mjmerge.state import G_MPS2, Array, Mask, norm
from mjmerge.verdict import own
from mjmerge.verdict.judge import Verdict, judge
from mjmerge.versions import versions

TOLERANCE_M = 2e-4
"""A margin that differs from its baseline by more has moved."""
RATE_DEFECT_MPS = 0.1
"""The recorded d_j' must be the rate of the recorded d_j to within this much: it tells the sign of g_j."""
_NEVER: tuple[None, Mapping[str, str]] = (None, {})


def rows(places: Sequence[Path]) -> list[RowResult]:
    """All rows of scenarios, each loaded and checked before any is run.

    Args:
        places: scenario files, folders of them, or names of shipped scenarios.

    Raises:
        MjmergeError: a place is none, or no scenario has a row.
        ScenarioError: a scenario, or one with a row's keys, is not valid; with every problem and its line.
    """
    files: list[Path] = []
    known = shipped.scenarios()
    for place in places:
        if not os.path.exists(place):  # noqa: PTH110 (Path's raises where a name is too long)
            if str(place) not in known:
                raise UnknownNameError("scenario, file or folder", str(place), known)
            place = known[str(place)]
        files += sorted(place.glob("*.yaml")) if place.is_dir() else [place]
    found = []
    called = labels([str(file) for file in files])
    for file in _once(files):
        found += _rows_of(file, called[str(file)])
    if not found:
        raise MjmergeError(
            f"no scenario in {', '.join(map(str, places))} has a gate, a list of rows to check"
        )
    return found


def _once(files: Sequence[Path]) -> Iterator[Path]:
    """Each file once, however it is written."""
    seen: set[str] = set()
    for file in files:
        where = os.path.abspath(file)  # noqa: PTH100 (resolve() follows links)
        if where not in seen:
            seen.add(where)
            yield file


def _rows_of(file: Path, label: str) -> list[RowResult]:
    """The rows of one scenario."""
    scenario, document = load(file), read(file)
    names: dict[str, int] = {}
    found = []
    for i, check in enumerate(scenario.gate):
        if names.setdefault(check.name, i) != i:
            document.report(f"two rows are called {check.name!r}", f"gate.{i}.name")
        if check.plant not in PLANTS:
            message = f"no plant called {check.plant!r}; the plants are {', '.join(PLANTS)}"
            document.report(f"row {check.name!r}: {message}", f"gate.{i}.plant")
            continue
        try:
            row = RowResult(file, label, check, load(file, check.set))
            check_plant(check.plant, row.scenario)
        except ScenarioError as error:
            for problem in error.problems:
                _blame(problem, check, i, document)
        except MjmergeError as error:
            document.report(f"row {check.name!r}: {error}", f"gate.{i}")
        else:
            found.append(row)
    raise_problems(file, document)
    _refuse_what_is_in_vain(file, found, document)
    return found


def _blame(problem: Problem, check: GateRow, i: int, document: Document) -> None:
    """Report what is wrong with a row's scenario where the row says so."""
    hit = [k for k, text in enumerate(check.set) if problem.source == f"--set {text}"]
    at = f"gate.{i}.set.{hit[-1]}" if hit else f"gate.{i}"
    document.report(f"row {check.name!r}: {problem.key + ': ' if problem.key else ''}{problem.message}", at)


def _refuse_what_is_in_vain(file: Path, these: Sequence[RowResult], document: Document) -> None:
    """Raises ScenarioError if a row sets, or needs, what is without effect on its plant."""
    for i, row in enumerate(these):
        plant, keys = row.check.plant, [text.partition("=")[0].strip() for text in row.check.set]
        vain = given_in_vain(row.scenario, plant, keys)
        for k, key in enumerate(keys):
            at, floor = f"gate.{i}.set.{k}", covers("expect", key)
            for name, why in vain.items():
                if covers(key, name):
                    document.report(f"row {row.check.name!r}: {name} {why}", at)
            if floor:
                own_key = "the floor of a row is its at_least_m"
                if key.startswith("expect.metrics"):
                    own_key = "the bounds of a row are its metrics"
                document.report(f"row {row.check.name!r}: {key}: {own_key}", at)
        if "grip" in row.check.needs and plant not in BODIES:
            there = f"there is a road with grip on {listed(BODIES)} only, not on {plant}"
            document.report(f"row {row.check.name!r} needs grip: {there}", f"gate.{i}.needs")
    raise_problems(file, document)


def run(
    these: Sequence[RowResult],
    baselines: Path | None = None,
    *,
    threads: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Iterator[Result]:
    """Runs rows, those that differ in nothing but their mismatch together, and judges them.

    Args:
        these: what to run, in the order of :func:`rows`.
        baselines: folder of the baselines; by default ``baselines`` beside each scenario.
        threads: threads for the physics, 0 for all cores.
        progress: called with the number of rows done.

    Raises:
        ScenarioError: a baseline is none.
        DoorError: a metric of a scenario's own fails.
        MjmergeError: two scenarios would have the same one.
    """
    before_all = {file: baseline.read(place) for file, place in _places(these, baselines).items()}
    done = 0
    for (file, plant, _), group in groupby(these, _alike):
        batch, known, began = list(group), before_all[file], time.perf_counter()
        scenario = batch[0].scenario
        cases = [(row.check.seed, acting(row.scenario, plant).mismatch) for row in batch]
        trace = simulate(scenario.settled(), plant, cases=cases, threads=threads)
        verdicts, metrics = judge(trace), own.measured(trace)
        found = zip(
            batch,
            verdicts,
            _measured(trace),
            _rate_defect(trace),
            _untested(trace, verdicts, batch),
            strict=True,
        )
        wall_s = time.perf_counter() - began
        stops = {stop.run: f"{stop.car}: {stop.reason}" for stop in trace.stops}
        for i, (row, verdict, measured, defect, untested) in enumerate(found):
            before, made_with = known.get(row.check.name, _NEVER)
            problems = (
                *_below(row, measured, verdict, stops.get(i, "")),
                *(
                    [f"d_j' is off the rate of d_j by {defect:.3f} m/s"]
                    if not defect < RATE_DEFECT_MPS
                    else []
                ),
                *untested,
                *own.broken(row.check.metrics, mine := own.one(metrics, i)),
                *_moved(measured, before, known, row),
            )
            stopped, each_s = stops.get(i, ""), wall_s / len(batch)
            yield Result(row, measured, before, made_with, verdict, stopped, problems, each_s, mine)
            done += 1
            if progress is not None:
                progress(done)


def _alike(row: RowResult) -> tuple[Path, str, Scenario]:
    """What rows of one batch share."""
    rest = row.scenario.settled().model_copy(update={"mismatch": None, "expect": None})
    return row.file, row.check.plant, rest


def _measured(trace: Trace) -> list[RowMargins]:
    clearance = trace.min_clearance_m[:, : len(trace.roster.neighbours)].min(axis=1)
    edge: list[float | None] = [None] * trace.runs
    if trace.edge_distance_m is not None:
        edge = trace.least_m[:, -1].tolist()
    return [
        RowMargins(tuple(least), float(c), e)
        for least, c, e in zip(trace.min_distance_m.tolist(), clearance, edge, strict=True)
    ]


def _rate_defect(trace: Trace) -> Array:
    """How far the recorded d_j' is from the rate of the recorded d_j, m/s, (N,)."""
    d, rate = trace.distance_m, trace.distance_rate_mps
    defect = np.diff(d, axis=1) / trace.scenario.control_step_s - (rate[:, 1:] + rate[:, :-1]) / 2
    touching = np.any(trace.touching, axis=2)  # an impact is faster than a tick
    near = touching[:, 1:] | touching[:, :-1]
    worst: Array = np.abs(np.where(near[..., None], 0.0, np.nan_to_num(defect))).max(axis=(1, 2))
    return worst


def _untested(trace: Trace, verdicts: Sequence[Verdict], batch: Sequence[RowResult]) -> Iterator[list[str]]:
    """What of each row's needs was not put to the test, in words."""
    slides = _slides(trace)
    for verdict, slid, row in zip(verdicts, slides.tolist(), batch, strict=True):
        untested = []
        if "barrier" in row.check.needs and verdict.needed is False:
            untested.append(f"vacuous: {verdict.reason}")
        if "grip" in row.check.needs and not slid:
            untested.append("vacuous: no car was asked for more than the road gives")
        yield untested


def _slides(trace: Trace) -> Mask:
    """Whether some car was asked for more than mu g, wherever it was, (N,)."""
    grip = np.stack([column(trace.mismatch, n) for n in ("friction", "left_friction", "patch_friction")])
    asked = np.nanmax(norm(trace.u_mps2), axis=(1, 2))
    slides: Mask = asked > np.nanmin(grip, axis=0) * G_MPS2
    return slides


def _below(row: RowResult, measured: RowMargins, verdict: Verdict, stopped: str) -> Iterator[str]:
    floor = row.check.at_least_m
    for j, least in enumerate(measured.min_d_m, 1):
        if not least >= floor:  # NaN fails
            yield f"min d_{j} is {least:.4f} m, below the floor of {floor} m"
    if verdict.unsafe_at_s is not None:
        yield verdict.reason
    if stopped:
        yield f"the simulation stopped: {stopped}"


def _moved(
    measured: RowMargins, before: RowMargins | None, known: Mapping[str, baseline.Entry], row: RowResult
) -> Iterator[str]:
    """Where a margin is not what it was, in either direction."""
    if before is None:
        names = [check.name for check in row.scenario.gate]
        gone = baseline.stale(known, names)
        renamed = f"; was it {' or '.join(map(repr, gone))}, which the gate does not have" if gone else ""
        yield f"there is no baseline for this row{renamed}: look at it, then make one with --update"
        return
    if len(measured.min_d_m) != len(before.min_d_m):
        yield f"there are {len(measured.min_d_m)} neighbours, and there were {len(before.min_d_m)}"
        return
    if (measured.min_edge_m is None) != (before.min_edge_m is None):
        yield (
            "the ego's lane ends, and did not"
            if before.min_edge_m is None
            else "the ego's lane no longer ends"
        )
        return
    for name, now in measured.numbers.items():
        then = before.numbers[name]
        if not (abs(now - then) <= TOLERANCE_M or (np.isnan(now) and np.isnan(then))):
            yield f"{name} was {then:.4f}, is {now:.4f} ({now - then:+.4f} m)"


def _places(these: Sequence[RowResult], baselines: Path | None) -> dict[Path, Path]:
    """The baseline of each scenario's file."""
    places = {row.file: baseline.file_of(row.file, baselines) for row in these}
    for place in places.values():
        same = [str(file) for file, there in places.items() if there == place]
        if len(same) > 1:
            raise MjmergeError(f"{' and '.join(same)} would share the baseline {place}: check one at a time")
    return places


def stale(these: Sequence[RowResult], baselines: Path | None = None) -> list[str]:
    """Rows of the baselines that no row of the gate goes by, a line each."""
    found = []
    for file, place in _places(these, baselines).items():
        row = next(row for row in these if row.file == file)
        names = [check.name for check in row.scenario.gate]
        found += [
            f"{place}: the gate of {row.label} has no row {name!r}; --update takes it out"
            for name in baseline.stale(baseline.read(place), names)
        ]
    return found


def update(results: Sequence[Result], baselines: Path | None = None) -> list[str]:
    """Rewrites the baselines of the scenarios of these results; says what changed, a line per row.

    Rows of a scenario that are not among the results stay as they are.

    Raises:
        OutputError: a file cannot be written.
    """
    said = []
    now = {name: versions().get(name, "-") for name in baseline.VERSIONS}
    for (file, label), group in groupby(results, lambda result: (result.row.file, result.row.label)):
        target = baseline.file_of(file, baselines)
        entries = baseline.read(target)
        names = [check.name for check in load(file).gate]
        for result in group:
            name, before = result.row.check.name, result.baseline
            moved = "; ".join(_moved(result.measured, before, entries, result.row)) or "as before"
            moved = "new" if before is None else moved
            said.append(f"{label}, {name}: {moved}")
            entries[name] = result.measured, now
        said += [f"{label}, {name}: gone" for name in baseline.stale(entries, names)]
        baseline.write(target, {name: entries[name] for name in names if name in entries})
    return said
