"""One command's worth of work: simulate, judge, record, and leave a run folder."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.config import shipped
from mjmerge.config.bounds import check_runs
from mjmerge.config.doors import DoorError
from mjmerge.errors import MjmergeError, OutputError
from mjmerge.figures.overview import overview
from mjmerge.figures.style import save
from mjmerge.outputs import prepare, put
from mjmerge.plant import check
from mjmerge.record import FORMATS, Factory, Header, Keep, Outcome, Recording, open_rrd, versions
from mjmerge.record.manifest import EXPLANATION
from mjmerge.scenario.cars import car_sheets, codes, equipped
from mjmerge.scenario.distinct import random
from mjmerge.scenario.effect import check as check_effect
from mjmerge.scenario.load import dump
from mjmerge.scenario.schema import Scenario
from mjmerge.search.explain import Explanation, as_json
from mjmerge.search.explain import explain as explain_
from mjmerge.search.margin import margin
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Trace, worst_run
from mjmerge.state import Array
from mjmerge.vehicle.acceptance import Acceptance, acceptance
from mjmerge.verdict import own
from mjmerge.verdict.judge import Verdict, judge
from mjmerge.verdict.metrics import events
from mjmerge.verdict.phases import phases
from mjmerge.verdict.summary import ends_s, ground, summary

if TYPE_CHECKING:
    from mjmerge.record.rerun.live import Live
    from mjmerge.record.rerun.side_by_side import ShownSide
    from mjmerge.world.model import World

FILES = (
    *FORMATS,
    "median.rrd",
    "violation-*.rrd",
    "compare.rrd",
    "scenario.yaml",
    "world.xml",
    "summary.json",
    EXPLANATION,
    "figure.png",
)
"""What a run folder may hold; ``summary.json`` is written last and marks it as complete."""
_MOST_VIOLATIONS = 3
"""Runs that broke the floor, besides the worst, that are recorded."""
IDEAL = "double_integrator"
"""What is simulated beside the worst run."""


@dataclass(frozen=True)
class FinishedRun:
    """What came of it.

    Attributes:
        trace: what happened.
        verdicts: one per simulation.
        summary: what ``--json`` prints.
        failures: recorders that broke and files that could not be written, a line each.
        replaced: whether an earlier run in the same folder made way.
        unseen_s: simulated time that the live view did not show, s.
        explanation: why it fails, of several simulations the worst; ``None`` where nobody asked, or that one
            is safe.
    """

    trace: Trace
    verdicts: list[Verdict]
    summary: dict[str, Any]
    failures: list[str]
    replaced: bool
    unseen_s: float = 0.0
    explanation: Explanation | None = None

    @property
    def exit_code(self) -> int:
        """0: the floor and all bounds held; 1: they did not; 3: the simulation or a recorder failed."""
        if self.failures or any(not stop.touched for stop in self.trace.stops):
            return 3
        return 0 if self.summary["floor_held"] and self.summary.get("metrics_held", True) else 1


def run(
    scenario: Scenario,
    plant: str,
    *,
    runs: int = 1,
    seed: int = 0,
    threads: int = 0,
    continuous: bool = False,
    folder: Path | None = None,
    replace: bool = False,
    record: bool = True,
    explain: bool = False,
    live: Callable[[Header], Live] | None = None,
    progress: Callable[[float], None] | None = None,
) -> FinishedRun:
    """Runs a scenario and leaves a run folder.

    Of several simulations, the worst is recorded in both formats; for Rerun also the median, up to three more
    that broke the floor, and the worst beside the ideal of the same seed.

    Args:
        scenario: what to run.
        plant: what moves the cars.
        runs: number of simulations.
        seed: seed of the first.
        threads: threads for the physics, 0 for all cores.
        continuous: whether in continuous time, see :func:`simulate`.
        folder: where everything goes; ``None`` writes nothing.
        replace: whether an earlier run in that folder may make way.
        record: whether to write recordings.
        explain: whether to say why an unsafe run fails, of several simulations the worst: in the report of
            its recordings, and in a file beside them. It takes some tens of further runs.
        live: shows the first simulation while it goes on.
        progress: called now and then with the simulated time, s.

    Raises:
        OutputError: the folder cannot be written, or holds something that would be overwritten.
        ModelError: a car model cannot be built, or not for this plant.
        ScenarioError: a key that was given beside the scenario's file is without effect here.
        DoorError: a metric of the scenario's own fails; what was recorded stays unfinished.
        MjmergeError: the plant has no continuous time.
    """
    check(plant, scenario)
    check_runs(scenario, runs, (seed, seed + runs - 1), [scenario.mismatch])
    check_effect(scenario, plant, continuous=continuous)
    if continuous:
        from mjmerge.simulation.continuous import check as check_continuous  # scipy takes its time to import

        check_continuous(plant, scenario.law)
    scenario = equipped(scenario)
    shown = live is not None or (folder is not None and record)
    world = None
    if plant == "mujoco" or shown:
        from mjmerge.world.compose import build  # physics takes its time to import

        world = build(scenario)
    text = dump(scenario) if shown or folder is not None else ""
    replaced = prepare(folder, replace, FILES) if folder is not None else False
    recording = None
    if folder is not None:
        put(folder / "scenario.yaml", text)
        if plant == "mujoco" and world is not None:
            put(folder / "world.xml", world.xml)
        if record and runs == 1:
            assert world is not None, "a recording shows the world"
            recording = Recording(folder, _header(scenario, text, plant, seed, world, continuous), FORMATS)

    viewer = None
    if live is not None:
        assert world is not None, "a live view shows the world"
        viewer = live(_header(scenario, text, plant, seed, world, continuous))

    began = time.perf_counter()
    with recording or nullcontext(), viewer or nullcontext():
        trace = simulate(
            scenario,
            plant,
            runs=runs,
            seed=seed,
            threads=threads,
            world=world,
            sink=recording,
            live=viewer,
            progress=progress,
            continuous=continuous,
        )
        verdicts = judge(trace)
        wall_s = time.perf_counter() - began
        try:
            metrics = own.measured(trace)
        except DoorError as error:
            kept = "; what was recorded is kept as *.partial" if recording is not None else ""
            raise DoorError(f"{error}{kept}") from error
        found = summary(trace, verdicts, metrics)
        found["real_time_factor"] = float(ends_s(trace).sum()) / wall_s
        found["run_dir"] = None if folder is None else str(folder)
        found["versions"] = versions()
        found |= _ground(scenario, plant, found, continuous)
        found["distinct_runs"] = runs if random(scenario, plant, continuous=continuous) else 1
        why, unexplained = _why(trace) if explain else (None, [])
        for receiver in (recording, viewer):
            if receiver is not None:
                receiver.close(_outcome(trace, verdicts[0], found, why if runs == 1 else None))
    failures = list(recording.failures) if recording is not None else []
    failures += unexplained

    if folder is not None:
        worst = worst_run(trace)
        if record and runs > 1:
            assert world is not None, "a recording shows the world"
            failures += _record_selected(folder, trace, verdicts, metrics, world, why)
        try:  # the run is over, and its verdict is worth as much without them
            save(overview(trace, worst, verdict=verdicts[worst]), folder / "figure.png")
            if why is not None:
                put(folder / EXPLANATION, json.dumps(as_json(why), indent=2) + "\n")
            put(folder / "summary.json", json.dumps(found, indent=2) + "\n")
        except OutputError as error:
            failures.append(str(error))
    unseen_s = 0.0 if viewer is None else viewer.dropped_s
    return FinishedRun(trace, verdicts, found, failures, replaced, unseen_s, why)


def _why(trace: Trace) -> tuple[Explanation | None, list[str]]:
    """Why the worst simulation fails, ``None`` if it is safe; and what kept that from being found out."""
    run = worst_run(trace)
    if margin(trace.alone(run, trace.scenario)).kind is None:
        return None, []
    seed = int(trace.seeds[run])
    try:
        return explain_(trace.scenario, trace.plant, seed=seed, continuous=trace.continuous), []
    except MjmergeError as error:  # the run is over, and its verdict is worth as much without
        return None, [f"{EXPLANATION}: {error}"]


def _accepted(scenario: Scenario, plant: str) -> list[Acceptance]:
    """What is known of the physical car models that a run is about; nothing where there are none."""
    names = dict.fromkeys(scenario.car_models) if plant == "mujoco" else {}
    return [acceptance(shipped.model_folder(name)) for name in names]


def _provenance(cars: Sequence[Acceptance]) -> dict[str, Any]:
    """What is known of the cars' acceptance, as JSON, by the model's name."""
    return {c.model: {"state": c.state, "failed": list(c.failed), "versions": dict(c.versions)} for c in cars}


def _ground(scenario: Scenario, plant: str, found: Mapping[str, Any], continuous: bool) -> dict[str, Any]:
    """The part of the summary that says what its verdict stands on: the cars, and what is without effect."""
    known = _provenance(_accepted(scenario, plant))
    return ground(scenario, plant, known, found, continuous=continuous)


def _header(scenario: Scenario, text: str, plant: str, seed: int, world: World, continuous: bool) -> Header:
    return Header(
        scenario=scenario,
        scenario_yaml=text,
        plant=plant,
        seed=seed,
        model=world.drawn,
        world_xml=world.xml,
        versions=versions(),
        control_step_s=scenario.control_step_s,
        sheets=tuple(car_sheets(scenario)),
        continuous=continuous,
        acceptance=_provenance(_accepted(scenario, plant)),
        code={c.name: {"sha256": c.sha256, "source": c.source} for c in codes(scenario)},
        metrics=own.carried(scenario),
    )


def selected(
    trace: Trace, verdicts: Sequence[Verdict], metrics: Mapping[str, Array] | None = None
) -> dict[str, int]:
    """Which of many simulations are recorded: name of the recording, without ending, to simulation."""
    bounds = trace.scenario.expect.metrics
    worst = worst_run(trace)
    least = np.nan_to_num(trace.min_distance_m.min(axis=1), nan=-np.inf)
    order = np.argsort(least, kind="stable")
    median = int(order[(len(order) - 1) // 2])
    found = {"run": worst} | ({} if median == worst else {"median": median})  # of two it is the worst
    violations = [
        int(i)
        for i in order
        if i not in found.values()
        and not (verdicts[i].floor_held and (metrics is None or own.held(bounds, metrics, i)))
    ]
    return found | {f"violation-{trace.seeds[i]}": i for i in violations[:_MOST_VIOLATIONS]}


def _record_selected(
    folder: Path,
    trace: Trace,
    verdicts: Sequence[Verdict],
    metrics: Mapping[str, Array],
    world: World,
    why: Explanation | None,
) -> list[str]:
    """Records some simulations of many by running each again alone: the same seed gives the same bits."""
    failures: list[str] = []
    for name, run in selected(trace, verdicts, metrics).items():
        formats = FORMATS if name == "run" else {f"{name}.rrd": open_rrd}
        failures += _record_again(folder, trace, run, world, formats, why if name == "run" else None)
    if trace.plant != IDEAL:
        from mjmerge.record.rerun.side_by_side import write_comparison  # Rerun takes its time to import

        seed = int(trace.seeds[worst_run(trace)])
        try:
            sides = [_side(trace, plant, seed, world) for plant in (IDEAL, trace.plant)]
            write_comparison(folder / "compare.rrd", sides)
        except (MjmergeError, OSError) as error:
            failures.append(f"compare.rrd: {error}")
    return failures


def _record_again(
    folder: Path,
    trace: Trace,
    run: int,
    world: World,
    formats: Mapping[str, Factory],
    why: Explanation | None,
) -> list[str]:
    scenario, seed = trace.scenario, int(trace.seeds[run])
    header = _header(scenario, dump(scenario), trace.plant, seed, world, trace.continuous)
    with Recording(folder, header, formats) as recording:
        alone = simulate(
            scenario, trace.plant, seed=seed, world=world, sink=recording, continuous=trace.continuous
        )
        (verdict,) = judge(alone)
        found = summary(alone, [verdict], own.measured(alone))
        found |= _ground(scenario, trace.plant, found, trace.continuous) | {"distinct_runs": 1}
        recording.close(_outcome(alone, verdict, found, why))
    return recording.failures


def _side(trace: Trace, plant: str, seed: int, world: World) -> ShownSide:
    """One simulation, as a side of a comparison."""
    from mjmerge.record.rerun.side_by_side import ShownSide

    scenario = trace.scenario
    continuous = trace.continuous and plant != "mujoco"
    header = _header(scenario, dump(scenario), plant, seed, world, continuous)
    keep = Keep(header)
    alone = simulate(scenario, plant, seed=seed, world=world, sink=keep, continuous=continuous)
    (verdict,) = judge(alone)
    outcome = _outcome(alone, verdict, summary(alone, [verdict], own.measured(alone)))
    return ShownSide("ideal" if plant == IDEAL else plant, header, keep.posed(), outcome)


def _outcome(
    trace: Trace, verdict: Verdict, found: dict[str, Any], why: Explanation | None = None
) -> Outcome:
    """What a recording of one simulation ends with; nothing that differs between two equal runs."""
    happened = sorted([*events(trace), *verdict.events()], key=lambda e: e.time_s)
    repeatable = {k: v for k, v in found.items() if k not in ("real_time_factor", "run_dir", "versions")}
    said = None if why is None else as_json(why)
    return Outcome(happened, verdict.verdict, repeatable, phases(trace), said)
