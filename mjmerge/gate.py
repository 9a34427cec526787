"""The regression gate: how much of the guarantee is left, row by row, against floors and baselines.

A scenario lists its rows under ``gate``: itself with some keys different, and the least distance that must
remain. That floor is one-sided and set by hand. Beside it stands a baseline, a CSV per scenario with what was
measured last time: two-sided, rewritten only on demand. A row that is safe without having been put to the
test is vacuous, and fails.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from mjmerge import share
from mjmerge.acts import BODIES, listed
from mjmerge.contract import Verdict, judge
from mjmerge.effect import acting, covers, given_in_vain
from mjmerge.errors import MjmergeError, UnknownNameError
from mjmerge.loader import load, raise_problems, read
from mjmerge.mismatch import column
from mjmerge.outputs import cannot_write, put
from mjmerge.plant import check as check_plant
from mjmerge.record.manifest import versions
from mjmerge.scenario import Check, Scenario
from mjmerge.simulate import simulate
from mjmerge.state import Array, Mask, norm
from mjmerge.trace import Trace

TOLERANCE_M = 2e-4
"""A margin that differs from its baseline by more has moved."""
RATE_DEFECT_MPS = 0.1
"""The recorded d_j' must be the rate of the recorded d_j to within this much: it tells the sign of g_j."""
G_MPS2 = 9.81
_VERSIONS = ("mjmerge", "mujoco", "numpy")


@dataclass(frozen=True)
class Row:
    """One row of the gate.

    Attributes:
        file: the scenario's file.
        check: what it says of this row.
        scenario: the scenario with the row's keys.
    """

    file: Path
    check: Check
    scenario: Scenario

    @property
    def command(self) -> str:
        """The command that runs this row alone, and records it."""
        where = (
            self.file.stem if share.scenarios().get(self.file.stem) == self.file.resolve() else str(self.file)
        )
        keys = "".join(f" --set {text}" for text in self.check.set)
        return f"mjmerge run {where} --plant {self.check.plant}{keys}"


@dataclass(frozen=True)
class Measured:
    """What a row came to.

    Attributes:
        min_d_1_m: smallest d_1, m.
        min_d_2_m: smallest d_2, m.
        min_clearance_m: smallest distance of the ego's body to another, m; NaN without bodies.
    """

    min_d_1_m: float
    min_d_2_m: float
    min_clearance_m: float


@dataclass(frozen=True)
class Result:
    """A row, measured and judged.

    Attributes:
        row: the row.
        measured: what it came to.
        baseline: what it came to when the baseline was made; ``None`` if there is none.
        made_with: the versions that was with.
        verdict: the contract's.
        stopped: why the simulation ended early; empty if it did not.
        problems: why the row fails; none if it passes.
    """

    row: Row
    measured: Measured
    baseline: Measured | None
    made_with: dict[str, str]
    verdict: Verdict
    stopped: str
    problems: tuple[str, ...]


def rows(places: Sequence[Path]) -> list[Row]:
    """All rows of scenarios, each loaded and checked before any is run.

    Args:
        places: scenario files, or folders of them.

    Raises:
        MjmergeError: a place is none, two rows share a name, or no scenario has a row.
        ScenarioError: a scenario, or one with a row's keys, is not valid.
    """
    files: list[Path] = []
    for place in places:
        if not place.exists():
            raise UnknownNameError("scenario file or folder", str(place), map(str, share.scenarios()))
        files += sorted(place.glob("*.yaml")) if place.is_dir() else [place]
    found = []
    for file in files:
        scenario = load(file)
        names = [check.name for check in scenario.gate]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise MjmergeError(f"{file}: gate: two rows are called {twice!r}")
        these = [Row(file, check, load(file, check.set)) for check in scenario.gate]
        for row in these:
            check_plant(row.check.plant, row.scenario)
        _refuse_what_is_in_vain(file, these)
        found += these
    if not found:
        raise MjmergeError(
            f"no scenario in {', '.join(map(str, places))} has a gate, a list of rows to check"
        )
    return found


def _refuse_what_is_in_vain(file: Path, these: Sequence[Row]) -> None:
    """Raises ScenarioError if a row sets, or needs, what is without effect on its plant."""
    document = read(file)
    for i, row in enumerate(these):
        plant, keys = row.check.plant, [text.partition("=")[0].strip() for text in row.check.set]
        vain = given_in_vain(row.scenario, plant, keys)
        for k, key in enumerate(keys):
            at, floor = f"gate.{i}.set.{k}", covers("expect", key)
            for name, why in vain.items():
                if covers(key, name):
                    document.report(f"row {row.check.name!r}: {name} {why}", at)
            if floor:
                document.report(f"row {row.check.name!r}: {key}: the floor of a row is its at_least_m", at)
        if "grip" in row.check.needs and plant not in BODIES:
            there = f"there is a road with grip on {listed(BODIES)} only, not on {plant}"
            document.report(f"row {row.check.name!r} needs grip: {there}", f"gate.{i}.needs")
    raise_problems(file, document)


def run(
    these: Sequence[Row],
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
    """
    done = 0
    for (file, plant, _), group in groupby(these, _alike):
        batch = list(group)
        known = read_baseline(baseline_file(file, baselines))
        scenario = batch[0].scenario
        cases = [(0, acting(row.scenario, plant).mismatch) for row in batch]
        trace = simulate(scenario.settled(), plant, cases=cases, threads=threads)
        verdicts = judge(trace)
        found = zip(
            batch,
            verdicts,
            _measured(trace),
            _rate_defect(trace),
            _untested(trace, verdicts, batch),
            strict=True,
        )
        stops = {stop.run: f"{stop.car}: {stop.reason}" for stop in trace.stops}
        for i, (row, verdict, measured, defect, untested) in enumerate(found):
            before, made_with = known.get(row.check.name, (None, {}))
            problems = (
                *_below(row, measured, verdict, stops.get(i, "")),
                *(
                    [f"d_j' is off the rate of d_j by {defect:.3f} m/s"]
                    if not defect < RATE_DEFECT_MPS
                    else []
                ),
                *untested,
                *_moved(measured, before),
            )
            yield Result(row, measured, before, made_with, verdict, stops.get(i, ""), problems)
            done += 1
            if progress is not None:
                progress(done)


def _alike(row: Row) -> tuple[Path, str, str]:
    """What rows of one batch share."""
    rest = row.scenario.model_copy(update={"mismatch": None, "expect": None})
    return row.file, row.check.plant, repr(rest)


def _measured(trace: Trace) -> list[Measured]:
    clearance = trace.min_clearance_m[:, :2].min(axis=1)
    return [
        Measured(float(d_1), float(d_2), float(c))
        for (d_1, d_2), c in zip(trace.min_distance_m, clearance, strict=True)
    ]


def _rate_defect(trace: Trace) -> Array:
    """How far the recorded d_j' is from the rate of the recorded d_j, m/s, (N,)."""
    d, rate = trace.distance_m, trace.distance_rate_mps
    defect = np.diff(d, axis=1) / trace.scenario.control_step_s - (rate[:, 1:] + rate[:, :-1]) / 2
    touching = np.any(trace.touching, axis=2)  # an impact is faster than a tick
    near = touching[:, 1:] | touching[:, :-1]
    worst: Array = np.abs(np.where(near[..., None], 0.0, np.nan_to_num(defect))).max(axis=(1, 2))
    return worst


def _untested(trace: Trace, verdicts: Sequence[Verdict], batch: Sequence[Row]) -> Iterator[list[str]]:
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


def _below(row: Row, measured: Measured, verdict: Verdict, stopped: str) -> Iterator[str]:
    floor = row.check.at_least_m
    for j, least in ((1, measured.min_d_1_m), (2, measured.min_d_2_m)):
        if not least >= floor:  # NaN fails
            yield f"min d_{j} is {least:.4f} m, below the floor of {floor} m"
    if verdict.unsafe_at_s is not None:
        yield verdict.reason
    if stopped:
        yield f"the simulation stopped: {stopped}"


def _moved(measured: Measured, before: Measured | None) -> Iterator[str]:
    """Where a margin is not what it was, in either direction."""
    if before is None:
        yield "there is no baseline for this row: look at it, then make one with --update"
        return
    for name in ("min_d_1_m", "min_d_2_m", "min_clearance_m"):
        now, then = getattr(measured, name), getattr(before, name)
        if not (abs(now - then) <= TOLERANCE_M or (np.isnan(now) and np.isnan(then))):
            yield f"{name} was {then:.4f}, is {now:.4f} ({now - then:+.4f} m)"


def baseline_file(scenario: Path, baselines: Path | None) -> Path:
    """The CSV of a scenario."""
    return (baselines or scenario.parent / "baselines") / f"{scenario.stem}.csv"


def read_baseline(file: Path) -> dict[str, tuple[Measured, dict[str, str]]]:
    """What was measured before, and with which versions, by the row's name; empty if there is no file.

    Raises:
        MjmergeError: it is not such a CSV.
    """
    if not file.is_file():
        return {}
    found = {}
    try:
        for line in csv.DictReader(io.StringIO(file.read_text(encoding="utf-8"))):
            numbers = (float(line[name]) for name in ("min_d_1_m", "min_d_2_m", "min_clearance_m"))
            found[line["row"]] = Measured(*numbers), {name: line[name] for name in _VERSIONS}
    except (KeyError, TypeError, ValueError, UnicodeError) as error:
        raise MjmergeError(f"{file} is no baseline: {error!r}") from error
    return found


def update(results: Sequence[Result], baselines: Path | None = None) -> list[str]:
    """Rewrites the baselines of the scenarios of these results; says what changed, a line per row.

    Rows of a scenario that are not among the results stay as they are.

    Raises:
        OutputError: a file cannot be written.
    """
    said = []
    now = {name: versions().get(name, "-") for name in _VERSIONS}
    for file, group in groupby(results, lambda result: result.row.file):
        target = baseline_file(file, baselines)
        entries = read_baseline(target)
        names = [check.name for check in load(file).gate]
        for result in group:
            name, before = result.row.check.name, result.baseline
            moved = "new" if before is None else "; ".join(_moved(result.measured, before)) or "as before"
            said.append(f"{file.stem}, {name}: {moved}")
            entries[name] = result.measured, now
        said += [f"{file.stem}, {name}: gone" for name in entries if name not in names]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["row", "min_d_1_m", "min_d_2_m", "min_clearance_m", *_VERSIONS])
        for name in names:
            if name in entries:
                measured, made_with = entries[name]
                numbers = (measured.min_d_1_m, measured.min_d_2_m, measured.min_clearance_m)
                writer.writerow([name, *(f"{number:.6f}" for number in numbers), *made_with.values()])
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(target, error) from error
        put(target, text.getvalue())
    return said
