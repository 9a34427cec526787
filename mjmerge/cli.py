"""The command line: ``mjmerge run paper``. It parses, prints and picks the exit code, and nothing else."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mjmerge import share
from mjmerge.errors import MjmergeError, OutputError, UnknownNameError

if TYPE_CHECKING:
    from mjmerge.record import Header
    from mjmerge.record.live import Live

_BAD_INPUT = 2
_PATIENCE_S = 1.0  # a run that takes longer gets a progress bar

PlantName = Literal["double_integrator", "bicycle", "bicycle_limited", "mujoco"]


@dataclass(frozen=True)
class Run:
    """Run a scenario, judge it, and record it. Exit code 0: the safety floor held; 1: it did not."""

    scenario: Annotated[str, tyro.conf.Positional]
    """Name of a shipped scenario (see `mjmerge list`), or the path of a YAML file."""
    plant: PlantName = "mujoco"
    """What moves the cars."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Seed of the first run; run i has seed + i."""
    runs: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Number of simulations, each with its own seed; those worth a look are recorded."""
    duration: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """Simulated time, in place of the scenario's."""
    set_: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="KEY=VALUE"), tyro.conf.UseAppendAction
    ] = ()
    """Any scenario key, as in `--set law.k_o=0`; repeatable."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Run folder; by default runs/<scenario>-<plant>-<seed>, where an earlier run makes way."""
    threads: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Threads for the physics, 0 for all cores; does not change the result."""
    continuous: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Law and plant as one differential equation, solved to 1e-10; for the plants other than mujoco."""
    live: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Show the run in a Rerun viewer while it goes on, in real time."""
    live_at: Annotated[str | None, tyro.conf.arg(metavar="127.0.0.1:PORT")] = None
    """Like --live, in a viewer that is open already."""
    live_fast: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Like --live, as fast as possible."""
    record: bool = True
    """Write run.rrd, run.mcap and the rest of the run folder."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object and nothing else on standard output."""


@dataclass(frozen=True)
class Reproduce:
    """Redraw the paper's figures and check its published facts. Exit code 0: all reproduced; 1: not all."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for figures, tables and animation; by default reproduced, where an earlier one makes way."""


@dataclass(frozen=True)
class Theorem:
    """Look for a counterexample to the theorem in random worlds. Exit code 0: there is none; 1: there is."""

    runs: Annotated[int, tyro.conf.arg(metavar="N")] = 1000
    """Number of worlds."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Seed of the first 50 worlds; the next 50 have the next one."""
    duration: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 12.0
    """Simulated time of each."""


@dataclass(frozen=True)
class Survey:
    """Count how often the decision goes wrong among random merges: the printed mu-law and the gated one."""

    runs: Annotated[int, tyro.conf.arg(metavar="N")] = 1000
    """Number of merges for each variant."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Seed of the first."""
    variants: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME")] = ("literal", "gated")
    """Variants of the law; see `mjmerge list laws`."""


@dataclass(frozen=True)
class Identify:
    """Measure a car model by driving it, against its data sheet. Exit code 0: all holds; 1: not all."""

    model: Annotated[str, tyro.conf.Positional]
    """Name of a shipped model (see `mjmerge list models`), or the path of its folder."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for table and plots; by default identified/<model>, where an earlier one makes way."""
    accept: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Also store the table beside the model, where every run finds whether its cars were accepted."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object and nothing else on standard output."""


@dataclass(frozen=True)
class Sweep:
    """Run a campaign, a ladder or a search for breaking points.

    A campaign is many runs: a table, a report, and failure rates with intervals. Interrupted, it goes on
    where it was when it is run again. Exit code 0: all runs ended, whatever came of them (`mjmerge check` is
    the gate); 2: bad input; 3: some simulation ended early.
    """

    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CAMPAIGN|SCENARIO")]
    """Name of a shipped campaign (see `mjmerge list campaigns`) or the path of a YAML file; with --ladder and
    --break, a scenario."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for everything; by default sweeps/<campaign>, ladders/<scenario> or breaking/<scenario>."""
    workers: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Processes to spread over, 0 for one per core; does not change the result."""
    ladder: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Run the scenario from the paper's own world to physical cars, rung by rung: what each costs."""
    break_: Annotated[
        tuple[str, ...], tyro.conf.arg(name="break", metavar="AXIS"), tyro.conf.UseAppendAction
    ] = ()
    """Find the smallest mismatch that breaks the scenario, as in `--break mismatch.friction` or, with a
    range, `--break mismatch.friction=1:0.1`; repeatable. `--break AXIS,OTHER` finds the frontier of two."""
    until: Literal["unsafe", "floor"] = "unsafe"
    """With --break, what counts as broken: d_j <= 0 or touching bodies, or the scenario's safety floor."""
    plant: str = "mujoco"
    """With --break, what moves the cars."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """With --ladder and --break, seed of the runs (a campaign has its own)."""
    seeds: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """With --break, run each point with so many seeds: it breaks if one does."""
    set_: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="KEY=VALUE"), tyro.conf.UseAppendAction
    ] = ()
    """With --ladder and --break, any scenario key; repeatable."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object and nothing else on standard output."""


@dataclass(frozen=True)
class Check:
    """Run the regression gate. Exit code 0: floors and baselines hold; 1: not all; 3: a run stopped."""

    scenarios: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Scenario files with a gate, or folders of them; by default the shipped ones."""
    baselines: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of the baselines; by default baselines/ beside each scenario."""
    only: Annotated[str, tyro.conf.arg(metavar="TEXT")] = ""
    """Only rows with this in `scenario, row`."""
    update: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Rewrite the baselines with what is measured now, and print what changed. Floors stay as they are."""
    threads: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Threads for the physics, 0 for all cores; does not change the result."""
    junit: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Also write JUnit XML."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object and nothing else on standard output."""


@dataclass(frozen=True)
class List:
    """List what there is: scenarios, campaigns, models, laws, drivers and plants, with a line on each."""

    what: Annotated[
        Literal["all", "scenarios", "campaigns", "models", "laws", "drivers", "plants"], tyro.conf.Positional
    ] = "all"
    """Which kind to list."""


@dataclass(frozen=True)
class View:
    """Open a recording in the Rerun viewer."""

    run: Annotated[Path, tyro.conf.Positional]
    """A run folder, or a recording in it."""


@dataclass(frozen=True)
class Verify:
    """Check a recording with nothing but the file. Exit code 0: right; 1: something wrong; 2: unreadable."""

    file: Annotated[Path, tyro.conf.Positional]
    """A .mcap or .rrd file, finished or not, or a run folder."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object and nothing else on standard output."""


@dataclass(frozen=True)
class Replay:
    """Run a recording's scenario again and compare bit for bit. Exit code 0: same; 1: not; 2: unreadable."""

    file: Annotated[Path, tyro.conf.Positional]
    """A .mcap or .rrd file, finished or not, or a run folder."""
    threads: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """Threads for the physics, 0 for all cores; does not change the result."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object and nothing else on standard output."""


@dataclass(frozen=True)
class Compare:
    """Show two recordings side by side: a table, figure.png, and compare.rrd with both in one scene."""

    a: Annotated[Path, tyro.conf.Positional]
    """A .mcap or .rrd file, or a run folder."""
    b: Annotated[Path, tyro.conf.Positional]
    """Another."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for figure and recording; by default compared, where an earlier one makes way."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print one JSON object and nothing else on standard output."""


@dataclass(frozen=True)
class Video:
    """Make an mp4 of a recording: the cars drawn by MuJoCo, opinion and distances beside them."""

    file: Annotated[Path, tyro.conf.Positional]
    """A .mcap or .rrd file, finished or not, or a run folder."""
    camera: Literal["chase", "overhead"] = "chase"
    """From behind the ego, or from above."""
    speed: Annotated[float, tyro.conf.arg(metavar="FACTOR")] = 1.0
    """Simulated seconds per second of the video."""
    fps: Annotated[int, tyro.conf.arg(metavar="N")] = 30
    """Pictures per second."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write; by default beside the recording, with the ending .mp4."""


@dataclass(frozen=True)
class Recover:
    """Rewrite the recording of a run that was killed as a whole file; the old one stays."""

    file: Annotated[Path, tyro.conf.Positional]
    """An unfinished .mcap or .rrd file (*.partial), or a run folder."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write; by default run.recovered.mcap or run.recovered.rrd beside the old one."""


@dataclass(frozen=True)
class Convert:
    """Write a recording as a table, a row per tick, units in the column names."""

    file: Annotated[Path, tyro.conf.Positional]
    """A .mcap or .rrd file, finished or not, or a run folder."""
    csv: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Write CSV."""
    parquet: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Write Parquet."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write; by default beside the recording, with the ending .csv or .parquet."""


@dataclass(frozen=True)
class Export:
    """Print the composed MJCF world of a scenario, or write it to a file."""

    scenario: Annotated[str, tyro.conf.Positional]
    """Name of a shipped scenario, or the path of a YAML file."""
    set_: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="KEY=VALUE"), tyro.conf.UseAppendAction
    ] = ()
    """Any scenario key; repeatable."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write; standard output by default."""


@dataclass(frozen=True)
class Schema:
    """Print the JSON Schema of scenario or campaign files, for editors."""

    what: Annotated[Literal["scenario", "campaign"], tyro.conf.Positional] = "scenario"
    """Which kind of file."""


def _run(args: Run) -> int:
    from rich.console import Console

    from mjmerge.loader import load
    from mjmerge.report import table
    from mjmerge.run import run

    for name, value, least in (("runs", args.runs, 1), ("seed", args.seed, 0), ("threads", args.threads, 0)):
        if value < least:
            raise MjmergeError(f"--{name} is {value}; it must be at least {least}")
    overrides = list(args.set_)
    if args.duration is not None:
        overrides.append(f"duration_s={args.duration!r}")
    scenario = load(args.scenario, overrides)
    folder = args.out
    if folder is None and args.record:
        plant = f"{args.plant}_continuous" if args.continuous else args.plant
        folder = Path("runs") / f"{scenario.name}-{plant}-{args.seed}"

    with _progress(scenario.duration_s) as progress:
        done = run(
            scenario,
            args.plant,
            runs=args.runs,
            seed=args.seed,
            threads=args.threads,
            continuous=args.continuous,
            folder=folder,
            replace=args.out is None,
            record=args.record,
            live=_live(args),
            progress=progress,
        )
    if done.unseen_s:
        print(f"mjmerge: the live view did not show {done.unseen_s:.1f} s of the run", file=sys.stderr)
    for failure in done.failures:
        print(f"mjmerge: recorder failed: {failure}", file=sys.stderr)
    if args.json:
        print(json.dumps(done.summary))
        return done.exit_code
    console = Console(highlight=False)
    many = f", {args.runs} runs" if args.runs > 1 else ""
    time_ = ", continuous time" if args.continuous else ""
    console.print(f"[bold]{scenario.name}[/] on {args.plant}{time_}, seed {args.seed}{many}")
    for override in overrides:
        console.print(f"  {override}", markup=False)
    console.print(table(done.summary))
    if folder is not None:
        if done.replaced:
            console.print(f"the earlier run in {folder} was replaced")
        if args.record and not done.failures:
            console.print(f"look at it:  [bold]mjmerge view {folder}[/]", soft_wrap=True)
    return done.exit_code


def _live(args: Run) -> Callable[[Header], Live] | None:
    """What shows the run, if it is to be shown."""
    if not (args.live or args.live_fast or args.live_at is not None):
        return None
    from mjmerge.record.live import Live, port_of

    port = None if args.live_at is None else port_of(args.live_at)
    return partial(Live, port=port, real_time=not args.live_fast)


def _reproduce(args: Reproduce) -> int:
    from rich.console import Console

    from mjmerge.report import facts_table
    from mjmerge.reproduce import reproduce

    folder = args.out or Path("reproduced")
    with _progress(1.0, "reproducing") as progress:
        done = reproduce(folder, replace=args.out is None, progress=progress)
    console = Console(highlight=False)
    console.print(facts_table(done.findings))
    if done.replaced:
        console.print(f"what was in {folder} was replaced")
    console.print(f"figures, tables and animation:  [bold]{folder}[/]", soft_wrap=True)
    return 0 if done.complete else 1


def _sweep(args: Sweep) -> int:
    for name, value, least in (
        ("workers", args.workers, 0),
        ("seed", args.seed, 0),
        ("seeds", args.seeds, 1),
    ):
        if value < least:
            raise MjmergeError(f"--{name} is {value}; it must be at least {least}")
    if args.ladder and args.break_:
        raise MjmergeError("--ladder and --break are two things: choose one")
    if not (args.ladder or args.break_):
        if args.set_ or args.seed or args.seeds != 1:
            raise MjmergeError(
                "a campaign has its own keys and seeds: --set, --seed and --seeds are for --break"
            )
        return _campaign(args)
    return _ladder(args) if args.ladder else _break(args)


def _processes(args: Sweep) -> int:
    return args.workers or len(os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else [0])


def _campaign(args: Sweep) -> int:
    from rich.console import Console

    from mjmerge import sweep_report
    from mjmerge.campaign import plan
    from mjmerge.sweep import TABLE, sweep

    planned = plan(args.what)
    folder = args.out or Path("sweeps") / planned.name
    with _runs(len(planned.cases)) as progress:
        found = sweep(planned, folder, processes=_processes(args), progress=progress)
    sweep_report.write(planned, found, folder)
    summary = sweep_report.summary(planned, found)
    if args.json:
        print(json.dumps(summary | {"out": str(folder)}))
    else:
        console = Console(highlight=False)
        console.print(f"[bold]{planned.name}[/], {len(planned.cases)} runs")
        console.print(sweep_report.rich_table(found))
        if summary["worst"]:
            console.print("the worst run:  ", end="")
            console.print(summary["worst"][0]["command"], markup=False, soft_wrap=True)
        console.print(f"table and report:  [bold]{folder / TABLE}[/], {sweep_report.REPORT}", soft_wrap=True)
    return 3 if summary["stopped"] else 0


def _ladder(args: Sweep) -> int:
    from rich.console import Console

    from mjmerge import ladder
    from mjmerge.campaign import given
    from mjmerge.run import prepare
    from mjmerge.sweep import workers

    with workers(_processes(args)) as team, _runs(len(ladder.RUNGS)) as progress:
        found = ladder.climb(
            args.what, given(args.set_), team, seed=args.seed, progress=lambda done: progress(done, 0)
        )
    folder = args.out or Path("ladders") / found.scenario.name
    prepare(folder, args.out is None, ladder.FILES)
    ladder.write(found, folder)
    if args.json:
        print(json.dumps(ladder.as_json(found) | {"out": str(folder)}))
    else:
        console = Console(highlight=False)
        console.print(f"[bold]{found.scenario.name}[/], rung by rung")
        console.print(ladder.rich_table(found))
        console.print(f"plot and table:  [bold]{folder}[/]", soft_wrap=True)
    return 3 if any(rung.row["stopped"] for rung in found.rungs) else 0


def _break(args: Sweep) -> int:
    from rich.console import Console

    from mjmerge import breaking
    from mjmerge.campaign import given
    from mjmerge.loader import load
    from mjmerge.run import prepare
    from mjmerge.sweep import workers

    settings = given(args.set_)
    pairs = [text.split(",") for text in args.break_]
    if any(len(pair) > 2 for pair in pairs) or (len(pairs) > 1 and any(len(pair) == 2 for pair in pairs)):
        raise MjmergeError("--break takes axes one by one, or once two of them: --break AXIS,OTHER")
    axes = [breaking.ranged(pair[0], args.what, settings) for pair in pairs]
    across = breaking.ranged(pairs[0][1], args.what, settings) if len(pairs[0]) == 2 else None
    name = load(args.what).name
    folder = args.out or Path("breaking") / name
    prepare(folder, args.out is None, breaking.FILES)
    with workers(_processes(args)) as team:
        found = breaking.search(
            args.what,
            args.plant,
            axes,
            settings,
            team,
            across=across,
            until=args.until,
            seeds=range(args.seed, args.seed + args.seeds),
            progress=lambda text: print(text, file=sys.stderr),
        )
    title = f"{name} on {args.plant}"
    breaking.write(found, folder, title, args.until, across)
    if args.json:
        print(
            json.dumps(
                {"scenario": name, "plant": args.plant, "until": args.until, "out": str(folder)}
                | {"axes": breaking.as_json(found, across)}
            )
        )
    else:
        console = Console(highlight=False)
        console.print(f"[bold]{title}[/]: the smallest mismatch that breaks it")
        console.print(breaking.rich_table(found, across))
        console.print(f"plot and every point:  [bold]{folder}[/]", soft_wrap=True)
    return 0


@contextmanager
def _runs(total: int) -> Iterator[Callable[[float, int], None]]:
    """A progress bar of runs on standard error, with their rate and the time left."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console, began = Console(stderr=True), time.monotonic()
    columns = (TextColumn("running"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"))
    with Progress(
        *columns, TimeRemainingColumn(), console=console, transient=True, disable=not console.is_terminal
    ) as bars:
        task = bars.add_task("running", total=total, rate="")

        def advance(done: float, before: int) -> None:
            rate = (done - before) / max(time.monotonic() - began, 1e-9)
            bars.update(task, completed=int(done), rate=f"{rate:.3g} runs/s")

        yield advance


def _check(args: Check) -> int:
    from rich.console import Console

    from mjmerge import gate
    from mjmerge.report import gate_failure, gate_json, gate_junit, gate_table

    places = args.scenarios or (share.folder("scenarios"),)
    rows = [r for r in gate.rows(places) if args.only in f"{r.file.stem}, {r.check.name}"]
    if not rows:
        raise MjmergeError(f"no row of the gate has {args.only!r} in its name")
    with _progress(len(rows), "checking") as progress:
        results = list(gate.run(rows, args.baselines, threads=args.threads, progress=progress))
    said = gate.update(results, args.baselines) if args.update else []
    if args.junit is not None:
        try:
            args.junit.write_bytes(gate_junit(results))
        except OSError as error:
            raise OutputError(f"cannot write {args.junit}: {error.strerror or error}") from error
    failed = [result for result in results if result.problems]
    if args.json:
        print(json.dumps(gate_json(results)))
    else:
        console = Console(highlight=False)
        if not args.update:
            console.print(gate_table(results))
        for line in said or [gate_failure(result) for result in failed]:
            console.print(line, markup=False, soft_wrap=True)
    if any(result.stopped for result in results):
        return 3
    return 1 if failed and not args.update else 0


def _theorem(args: Theorem) -> int:
    from rich.console import Console

    from mjmerge.report import theorem_table
    from mjmerge.theorem import tally

    if args.runs < 1 or args.seed < 0 or not 0 < args.duration < float("inf"):
        raise MjmergeError("--runs must be at least 1, --seed at least 0, --duration positive and finite")
    with _progress(args.runs, "looking for a counterexample") as progress:
        done = tally(args.runs, args.seed, args.duration, progress)
    Console(highlight=False).print(theorem_table(done))
    for seed, i, world, duration_s in done.counterexamples:
        print(f"counterexample (seed {seed}, world {i}), after {duration_s} s: {world}")
    if done.violated:
        return 1
    return 3 if done.stuck else 0


def _survey(args: Survey) -> int:
    from rich.console import Console

    from mjmerge.report import survey_table
    from mjmerge.survey import Survey as Found
    from mjmerge.survey import survey

    if args.runs < 1 or args.seed < 0:
        raise MjmergeError("--runs must be at least 1, --seed at least 0")
    found: list[Found] = []
    with _progress(args.runs * len(args.variants), "surveying") as progress:
        for variant in args.variants:
            before = args.runs * len(found)
            found.append(survey(args.runs, args.seed, variant, partial(_further, progress, before)))
    Console(highlight=False).print(survey_table(found))
    return 0


def _further(progress: Callable[[float], None], before: int, done: int) -> None:
    progress(before + done)


def _identify(args: Identify) -> int:
    from rich.console import Console

    from mjmerge import identified
    from mjmerge.acceptance import store
    from mjmerge.identify import identify
    from mjmerge.record.manifest import versions
    from mjmerge.run import prepare
    from mjmerge.world import single

    place = share.model_folder(args.model)
    single(args.model)  # a bad car is refused before anything is written
    folder = args.out or Path("identified") / place.name
    replaced = prepare(folder, args.out is None, identified.FILES)
    with _progress(1.0, "driving") as progress:
        found = identify(args.model, progress)
    identified.write(folder, found)
    if args.accept:
        try:
            store(place, found.table, versions())
        except OSError as error:
            raise OutputError(f"cannot write to {place}: {error.strerror or error}") from error
    if args.json:
        print(json.dumps(identified.as_json(found) | {"out": str(folder), "versions": versions()}))
        return 0 if found.passed else 1
    console = Console(highlight=False)
    console.print(identified.rich_table(found.table))
    if replaced:
        console.print(f"what was in {folder} was replaced")
    console.print(f"table and plots:  [bold]{folder}[/]", soft_wrap=True)
    return 0 if found.passed else 1


@contextmanager
def _progress(total: float, doing: str = "simulating") -> Iterator[Callable[[float], None]]:
    """A progress bar on standard error, once it is worth one."""
    from rich.console import Console
    from rich.progress import Progress

    began, console = time.monotonic(), Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        task = None

        def advance(done: float) -> None:
            nonlocal task
            if task is None and time.monotonic() - began > _PATIENCE_S:
                task = bars.add_task(doing, total=total)
            if task is not None:
                bars.update(task, completed=done)

        yield advance


def _list(args: List) -> int:
    from rich.console import Console
    from rich.table import Table

    from mjmerge.acceptance import acceptance
    from mjmerge.campaign import described as campaign_line
    from mjmerge.drivers import kinds
    from mjmerge.law import VARIANTS
    from mjmerge.loader import data_sheet, load
    from mjmerge.plant import PLANTS

    def first_line(text: str | None) -> str:
        return (text or "").strip().splitlines()[0]

    def described(name: str, folder: Path) -> str:
        state = acceptance(folder).state
        return f"{data_sheet(name).description} (acceptance tests: {state})"

    what: dict[str, Callable[[], dict[str, str]]] = {
        "scenarios": lambda: {name: load(name).description for name in share.scenarios()},
        "campaigns": lambda: {name: campaign_line(path) for name, path in share.campaigns().items()},
        "models": lambda: {name: described(name, folder) for name, folder in share.models().items()},
        "laws": lambda: VARIANTS,
        "drivers": lambda: {name: first_line(cls.__doc__) for name, cls in sorted(kinds().items())},
        "plants": lambda: PLANTS,
    }
    console = Console(highlight=False)
    for kind, entries in what.items():
        if args.what in ("all", kind):
            grid = Table(title=kind, title_justify="left", title_style="bold", show_header=False, box=None)
            grid.add_column(style="cyan", no_wrap=True)
            grid.add_column()
            for name, line in entries().items():
                grid.add_row(name, line)
            console.print(grid)
    return 0


def _view(args: View) -> int:
    places = (args.run, Path("runs") / args.run)
    files = [p / "run.rrd" if p.is_dir() else p for p in places]
    file = next((f for f in files if f.is_file() and f.suffix in (".rrd", ".mcap")), None)
    if file is None:
        raise UnknownNameError(
            "recording", str(args.run), [str(p.parent) for p in Path("runs").glob("*/run.rrd")]
        )
    with tempfile.TemporaryDirectory() as folder:
        shown = file
        if file.suffix == ".mcap":
            from mjmerge.record.mcap_view import write_view

            shown = Path(folder) / "mcap.rrd"
            write_view(file, shown)
        viewer = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(shown)]
        code = subprocess.run(viewer, check=False).returncode
    if code:
        print(
            "mjmerge: the Rerun viewer needs a display; without one, open the recording on another machine "
            f"(`rerun {file.name}`, same Rerun version), or its run.mcap in Foxglove",
            file=sys.stderr,
        )
        return 3
    return 0


def _verify(args: Verify) -> int:
    from rich.console import Console

    from mjmerge.record.read import recording
    from mjmerge.record.verify import table, verify

    found = verify(recording(args.file))
    if args.json:
        print(json.dumps(found.as_dict()))
    else:
        console = Console(highlight=False)
        console.print(f"[bold]{found.recorded.path}[/]", soft_wrap=True)
        console.print(table(found))
    return 0 if found.right else 1


def _replay(args: Replay) -> int:
    from rich.console import Console

    from mjmerge.record.read import recording
    from mjmerge.record.replay import replay

    if args.threads < 0:
        raise MjmergeError(f"--threads is {args.threads}; it must be at least 0")
    path = recording(args.file)
    with _progress(1.0, "replaying") as progress:
        done = replay(path, args.threads, progress)
    if args.json:
        print(json.dumps(done.as_dict()))
    else:
        console = Console(highlight=False, soft_wrap=True)
        console.print(f"[bold]{path}[/]")
        for line in done.lines():
            console.print(line, markup=False)
    return 0 if done.same else 1


def _compare(args: Compare) -> int:
    from rich.console import Console

    from mjmerge.compare import Side, as_dict, figure, identical, recording_of_both, table
    from mjmerge.record.read import read, recording
    from mjmerge.run import prepare

    a, b = (Side.of(read(recording(path))) for path in (args.a, args.b))
    folder = args.out or Path("compared")
    prepare(folder, args.out is None, ("figure.png", "compare.rrd"))
    figure(a, b, folder / "figure.png")
    recording_of_both(a, b, folder / "compare.rrd")
    if args.json:
        print(json.dumps(as_dict(a, b)))
        return 0
    console = Console(highlight=False)
    for side, name in ((a, "A"), (b, "B")):
        console.print(f"[bold]{name}[/]  {side.recorded.path}", soft_wrap=True)
    console.print(table(a, b))
    if identical(a.recorded, b.recorded):
        console.print("every column is the same, bit for bit")
    console.print(f"figure and both cars in one scene:  [bold]{folder}[/]", soft_wrap=True)
    return 0


def _video(args: Video) -> int:
    from mjmerge.record.read import recording
    from mjmerge.video import Options, video

    if not 0 < args.speed < float("inf") or not 1 <= args.fps <= 240:
        raise MjmergeError("--speed must be positive and finite, --fps from 1 to 240")
    path = recording(args.file)
    out = args.out or (path.with_suffix("") if path.suffix == ".partial" else path).with_suffix(".mp4")
    with _progress(1.0, "drawing") as progress:
        backend = video(path, out, Options(args.camera, args.fps, args.speed), progress)
    print(f"{out} (drawn with {backend})")
    return 0


def _recover(args: Recover) -> int:
    from mjmerge.record.read import recording
    from mjmerge.record.recover import recover, recovered_name

    path = recording(args.file)
    out = args.out or recovered_name(path)
    found = recover(path, out)
    print(f"{out}: {len(found.ticks)} ticks, up to {found.last_s:.2f} s")
    return 0


def _convert(args: Convert) -> int:
    from mjmerge.record.convert import to_csv, to_parquet
    from mjmerge.record.read import read, recording

    if not args.csv and not args.parquet:
        raise MjmergeError("say what to write: --csv, --parquet or both")
    if args.csv and args.parquet and args.out is not None:
        raise MjmergeError("--out names one file: with it, choose either --csv or --parquet")
    path = recording(args.file)
    found = read(path)
    beside = path.with_suffix("") if path.suffix == ".partial" else path
    for wanted, ending, write in ((args.csv, ".csv", to_csv), (args.parquet, ".parquet", to_parquet)):
        if wanted:
            out = args.out or beside.with_suffix(ending)
            write(found, out)
            print(out)
    return 0


def _export(args: Export) -> int:
    from mjmerge.loader import load
    from mjmerge.world import build

    xml = build(load(args.scenario, args.set_)).xml
    if args.out is None:
        print(xml)
        return 0
    try:
        with args.out.open("x", encoding="utf-8") as file:
            file.write(xml)
    except OSError as error:
        raise OutputError(f"cannot write {args.out}: {error.strerror or error}") from error
    return 0


def _schema(args: Schema) -> int:
    from mjmerge.campaign import Campaign
    from mjmerge.loader import json_schema
    from mjmerge.scenario import Scenario

    print(json_schema(Scenario if args.what == "scenario" else Campaign), end="")
    return 0


_COMMANDS: dict[type, Callable[..., int]] = {
    Run: _run,
    Reproduce: _reproduce,
    Sweep: _sweep,
    Check: _check,
    Theorem: _theorem,
    Survey: _survey,
    Identify: _identify,
    List: _list,
    View: _view,
    Verify: _verify,
    Replay: _replay,
    Compare: _compare,
    Video: _video,
    Recover: _recover,
    Convert: _convert,
    Export: _export,
    Schema: _schema,
}


def _terminate(signum: int, frame: FrameType | None) -> None:
    """SIGTERM as an exception, so that recordings are closed."""
    del frame
    raise SystemExit(128 + signum)


def main(argv: list[str] | None = None) -> None:
    """Entry point of the ``mjmerge`` command."""
    signal.signal(signal.SIGTERM, _terminate)
    args = tyro.cli(
        Annotated[Run, tyro.conf.subcommand("run")]
        | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
        | Annotated[Sweep, tyro.conf.subcommand("sweep")]
        | Annotated[Check, tyro.conf.subcommand("check")]
        | Annotated[Theorem, tyro.conf.subcommand("theorem")]
        | Annotated[Survey, tyro.conf.subcommand("survey")]
        | Annotated[Identify, tyro.conf.subcommand("identify")]
        | Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[View, tyro.conf.subcommand("view")]
        | Annotated[Verify, tyro.conf.subcommand("verify")]
        | Annotated[Replay, tyro.conf.subcommand("replay")]
        | Annotated[Compare, tyro.conf.subcommand("compare")]
        | Annotated[Video, tyro.conf.subcommand("video")]
        | Annotated[Recover, tyro.conf.subcommand("recover")]
        | Annotated[Convert, tyro.conf.subcommand("convert")]
        | Annotated[Export, tyro.conf.subcommand("export")]
        | Annotated[Schema, tyro.conf.subcommand("schema")],
        prog="mjmerge",
        description="Does the merge that a paper proves safe survive real cars?",
        args=argv,
    )
    try:
        sys.exit(_COMMANDS[type(args)](args))
    except MjmergeError as error:
        print(f"mjmerge: {error}", file=sys.stderr)
        sys.exit(_BAD_INPUT)
    except KeyboardInterrupt:
        kept = (
            "what is finished is kept; run it again to go on"
            if isinstance(args, Sweep)
            else "what was recorded is kept as *.partial"
        )
        print(f"mjmerge: interrupted; {kept}", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
