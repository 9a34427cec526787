"""One command's worth of work: simulate, judge, record, and leave a run folder."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjmerge import share
from mjmerge.acceptance import Acceptance, acceptance
from mjmerge.contract import Verdict, judge
from mjmerge.errors import OutputError
from mjmerge.loader import dump
from mjmerge.metrics import events
from mjmerge.phases import phases
from mjmerge.plant import check
from mjmerge.record import FORMATS, Header, Outcome, Recording, versions
from mjmerge.report import figure, summary, worst_run
from mjmerge.scenario import CARS, Scenario
from mjmerge.simulate import simulate
from mjmerge.trace import Trace
from mjmerge.world import World, build

FILES = (*FORMATS, "scenario.yaml", "world.xml", "summary.json", "figure.png")
"""What a run folder may hold; ``summary.json`` is written last and marks it as complete."""


@dataclass(frozen=True)
class Run:
    """What came of it.

    Attributes:
        trace: what happened.
        verdicts: one per simulation.
        summary: what ``--json`` prints.
        failures: recorders that broke, a line each.
        replaced: whether an earlier run in the same folder made way.
    """

    trace: Trace
    verdicts: list[Verdict]
    summary: dict[str, Any]
    failures: list[str]
    replaced: bool

    @property
    def exit_code(self) -> int:
        """0: the floor held; 1: it did not; 3: the simulation or a recorder failed."""
        if self.trace.stops or self.failures:
            return 3
        return 0 if self.summary["floor_held"] else 1


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
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Runs a scenario and leaves a run folder; of several simulations, the worst is recorded.

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
        progress: called now and then with the simulated time, s.

    Raises:
        OutputError: the folder cannot be written, or holds something that would be overwritten.
        ModelError: a car model cannot be built, or not for this plant.
        MjmergeError: the plant has no continuous time.
    """
    check(plant, scenario)
    if continuous:
        from mjmerge.continuous import check as check_continuous  # scipy takes its time to import

        check_continuous(plant)
    world = build(scenario) if plant == "mujoco" or (folder is not None and record) else None
    replaced = prepare(folder, replace) if folder is not None else False
    recording = None
    if folder is not None:
        (folder / "scenario.yaml").write_text(dump(scenario), encoding="utf-8")
        if plant == "mujoco" and world is not None:
            (folder / "world.xml").write_text(world.xml, encoding="utf-8")
        if record and runs == 1:
            recording = _recording(folder, scenario, plant, seed, world, continuous)

    began = time.perf_counter()
    with recording or nullcontext():
        trace = simulate(
            scenario,
            plant,
            runs=runs,
            seed=seed,
            threads=threads,
            world=world,
            sink=recording,
            progress=progress,
            continuous=continuous,
        )
        verdicts = judge(trace)
        found = summary(trace, verdicts, time.perf_counter() - began)
        found["run_dir"] = None if folder is None else str(folder)
        found["versions"] = versions()
        found |= _on_cars(found["verdict_reason"], _accepted(scenario, plant))
        if recording is not None:
            recording.close(_outcome(trace, verdicts[0], found))
    failures = recording.failures if recording is not None else []

    if folder is not None:
        worst = worst_run(trace)
        if record and runs > 1:
            failures = _record_again(folder, trace, worst, world)
        figure(trace, folder / "figure.png", worst)
        (folder / "summary.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return Run(trace, verdicts, found, failures, replaced)


def _accepted(scenario: Scenario, plant: str) -> list[Acceptance]:
    """What is known of the physical car models that a run is about; nothing where there are none."""
    names = dict.fromkeys(getattr(scenario.models, car) for car in CARS) if plant == "mujoco" else {}
    return [acceptance(share.model_folder(name)) for name in names]


def _provenance(cars: Sequence[Acceptance]) -> dict[str, Any]:
    """The same as JSON, by the model's name."""
    return {c.model: {"state": c.state, "failed": c.failed, "versions": dict(c.versions)} for c in cars}


def _on_cars(reason: str, cars: Sequence[Acceptance]) -> dict[str, Any]:
    """The part of the summary that says what its verdict stands on."""
    doubts = [car.sentence for car in cars if car.sentence]
    return {"verdict_reason": "; but ".join([reason, *doubts]), "acceptance": _provenance(cars)}


def _recording(
    folder: Path, scenario: Scenario, plant: str, seed: int, world: World | None, continuous: bool
) -> Recording:
    assert world is not None, "a recording shows the world"
    header = Header(
        scenario=scenario,
        scenario_yaml=dump(scenario),
        plant=plant,
        seed=seed,
        model=world.model,
        world_xml=world.xml,
        versions=versions(),
        control_step_s=scenario.control_step_s,
        continuous=continuous,
        acceptance=_provenance(_accepted(scenario, plant)),
    )
    return Recording(folder, header, FORMATS)


def _record_again(folder: Path, trace: Trace, run: int, world: World | None) -> list[str]:
    """Records one simulation of many by running it again alone: the same seed gives the same bits."""
    scenario, seed = trace.scenario, int(trace.seeds[run])
    with _recording(folder, scenario, trace.plant, seed, world, trace.continuous) as recording:
        alone = simulate(
            scenario, trace.plant, seed=seed, world=world, sink=recording, continuous=trace.continuous
        )
        (verdict,) = judge(alone)
        found = summary(alone, [verdict], 1.0)
        found |= _on_cars(found["verdict_reason"], _accepted(scenario, trace.plant))
        recording.close(_outcome(alone, verdict, found))
    return recording.failures


def _outcome(trace: Trace, verdict: Verdict, found: dict[str, Any]) -> Outcome:
    """What a recording of one simulation ends with; nothing that differs between two equal runs."""
    happened = sorted([*events(trace), *verdict.events()], key=lambda e: e.time_s)
    repeatable = {k: v for k, v in found.items() if k not in ("real_time_factor", "run_dir", "versions")}
    return Outcome(happened, verdict.verdict, repeatable, phases(trace))


def prepare(folder: Path, replace: bool, files: Collection[str] = FILES) -> bool:
    """Makes an empty folder; returns whether an earlier run's files made way.

    Args:
        folder: where it is to be.
        replace: whether they may.
        files: what they may be called.

    Raises:
        OutputError: it is no folder, cannot be written, or holds something that may not go.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        there = {p.name for p in folder.iterdir()}
        ours = {name for f in files for name in (f, f"{f}.partial")}
        if there and not replace:
            raise OutputError(f"{folder} is not empty, and nothing is overwritten: choose another --out")
        if there - ours:
            raise OutputError(
                f"{folder} holds files that are not an earlier run's ({min(there - ours)}): choose an --out"
            )
        for name in there:
            (folder / name).unlink()
        probe = folder / "summary.json.partial"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror or error}") from error
    return bool(there)
