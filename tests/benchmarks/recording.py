"""What recording costs: ``python tests/benchmarks/recording.py [SECONDS [REPEATS]]``. Tables, no test.

The ``paper`` scenario on MuJoCo's cars, after a shorter run that warms up. Times are of the processor, all
threads, inside a run: between two blocks it simulates half a second, and leaves little of the recorder in the
caches. Sizes are carried on to ten minutes with the slope between two lengths; ``recording.py 600`` measures
them, and the memory.

- both formats: at most 40 us per tick, and with opening and closing at most 10 % of the run's time;
- a file for ten minutes: at most 50 MB;
- memory of the process, all of it: at most 500 MB.

Beside them stands the floor: the encoders of Foxglove and Rerun alone. They get the same messages as ready
bytes and Arrow arrays, a block at a time, each block to be on disk; Rerun in the end also all chunks of the
finished file.
"""

from __future__ import annotations

import resource
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import foxglove
import quiet
import rerun as rr
import rerun_bindings
from mcap.records import Channel, Schema
from rerun.chunk import RrdReader
from rich.console import Console
from rich.table import Table

import mjmerge
from mjmerge.record import FORMATS, Factory, Header, Outcome, Recording, versions
from mjmerge.record.mcap.file import McapFile, Message
from mjmerge.record.mcap.recorder import writer_options
from mjmerge.record.posed import Posing
from mjmerge.record.rerun.draw import send_numbers
from mjmerge.record.rerun.recorder import Journal
from mjmerge.record.rerun.stream import new_stream
from mjmerge.record.scene import Scene
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.load import dump
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.log import Sink, TickBlock, block_ticks
from mjmerge.simulation.trace import Trace
from mjmerge.verdict.judge import judge
from mjmerge.verdict.metrics import events
from mjmerge.verdict.phases import phases
from mjmerge.world.compose import build
from mjmerge.world.model import World

SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
REPEATS = int(sys.argv[2]) if len(sys.argv) > 2 else 5
LONG_S = 600.0


@dataclass
class Clock:
    """Time of the processor, s."""

    spent_s: float = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        began = time.process_time()
        try:
            yield
        finally:
            self.spent_s += time.process_time() - began


@dataclass
class Timed:
    """A sink with a clock."""

    sink: Sink
    clock: Clock = field(default_factory=Clock)

    def write(self, block: TickBlock) -> None:
        with self.clock.running():
            self.sink.write(block)


@dataclass
class Kept:
    """A sink that keeps the blocks."""

    blocks: list[TickBlock] = field(default_factory=list)

    def write(self, block: TickBlock) -> None:
        self.blocks.append(block)


@dataclass
class Ready:
    """A sink that has been told what to make of each block."""

    of_blocks: Mapping[int, Any]
    encode: Callable[[Any], None]

    def write(self, block: TickBlock) -> None:
        self.encode(self.of_blocks[int(block.ticks[0])])


@dataclass
class Heard:
    """In the place of a Rerun stream: keeps what it is sent."""

    calls: list[tuple[Any, ...]] = field(default_factory=list)

    def send_columns(self, *call: Any) -> None:
        self.calls.append(call)


@dataclass(frozen=True)
class Cost:
    """What a recording takes, s: while it is written, and to open and close it; beside the run without."""

    writing_s: float
    ends_s: float
    run_s: float

    def row(self, ticks: int) -> list[str]:
        """Cells of the table."""
        writing_us, whole_us = (s / ticks * 1e6 for s in (self.writing_s, self.writing_s + self.ends_s))
        share = (self.writing_s + self.ends_s) / self.run_s
        return [f"{writing_us:.1f}", f"{self.ends_s * 1e3:.0f}", f"{whole_us:.1f}", f"{share:.1%}"]


def simulated(scenario: Scenario, world: World, sink: Timed) -> tuple[Trace, float]:
    """A run, and what it takes but for its sink, s."""
    with (clock := Clock()).running():
        trace = mjmerge.simulate(scenario, "mujoco", world=world, sink=sink, threads=1)
    return trace, clock.spent_s - sink.clock.spent_s


def recorded(
    scenario: Scenario, world: World, header: Header, folder: Path, formats: Mapping[str, Factory]
) -> Cost:
    """What it takes to record a run in a folder."""
    with (ends := Clock()).running():
        recording = Recording(folder, header, formats)
        recording.__enter__()
    trace, run_s = simulated(scenario, world, sink := Timed(recording))
    (verdict,) = judge(trace)
    happened = sorted([*events(trace), *verdict.events()], key=lambda event: event.time_s)
    with ends.running():
        recording.close(Outcome(happened, verdict.verdict, {}, phases(trace)))
    assert recording.failures == []
    return Cost(sink.clock.spent_s, ends.spent_s, run_s)


def foxglove_alone(scenario: Scenario, world: World, done: Path, folder: Path) -> Cost:
    """Foxglove's encoder, given the messages of a finished ``run.mcap``."""
    ticks = block_ticks(scenario.control_step_s)
    records = list(McapFile(done / "run.mcap").read())
    schemas = {record.id: record for record in records if isinstance(record, Schema)}
    context = foxglove.Context()
    writer = foxglove.open_mcap(folder / "run.mcap", context=context, writer_options=writer_options())
    log = {}
    for channel in (record for record in records if isinstance(record, Channel)):
        of = schemas[channel.schema_id]
        described = foxglove.Schema(name=of.name, encoding=of.encoding, data=of.data)
        encoding = channel.message_encoding
        made = foxglove.Channel(channel.topic, message_encoding=encoding, schema=described, context=context)
        log[channel.id] = made.base.log
    blocks: dict[int, list[Message]] = defaultdict(list)
    for message in (record for record in records if isinstance(record, Message)):
        tick = round(message.time_ns / scenario.control_step_s / 1e9)
        blocks[tick // ticks * ticks].append(message)

    def encode(messages: list[Message]) -> None:
        for message in messages:
            log[message.channel](message.data, message.time_ns)
        writer.flush()

    _, run_s = simulated(scenario, world, sink := Timed(Ready(blocks, encode)))
    with (end := Clock()).running():
        writer.close()
    return Cost(sink.clock.spent_s, end.spent_s, run_s)


def rerun_alone(scenario: Scenario, world: World, header: Header, done: Path, folder: Path) -> Cost:
    """Rerun's encoder, given the columns of every block, and then the chunks of a finished ``run.rrd``."""
    simulated(scenario, world, Timed(kept := Kept()))
    posing, ready = Posing(header, Scene(world.drawn, scenario.r_m)), {}
    for block in kept.blocks:
        send_numbers(heard := Heard(), posing.block(block))
        ready[int(block.ticks[0])] = heard.calls
    stream = new_stream("floor")
    journal = Journal(folder / "run.rrd.partial", stream)

    def encode(calls: list[tuple[Any, ...]]) -> None:
        for call in calls:
            stream.send_columns(*call)
        journal.flush()

    _, run_s = simulated(scenario, world, sink := Timed(Ready(ready, encode)))
    chunks = RrdReader(done / "run.rrd").stream().to_chunks()
    with (end := Clock()).running():
        journal.close()
        whole = rr.RecordingStream("floor", send_properties=False)
        whole.save(folder / "run.rrd")
        whole.send_chunks(chunks)
        whole.flush()
        whole.disconnect()
    return Cost(sink.clock.spent_s, end.spent_s, run_s)


def main() -> None:
    """Prints the tables."""
    quiet.look()
    console = Console(width=110)
    scenario, half = (mjmerge.load("paper", [f"duration_s={s}"]) for s in (SECONDS, SECONDS / 2))
    world, sheets = build(scenario), tuple(car_sheets(scenario))

    def header(of: Scenario) -> Header:
        return Header(
            of, dump(of), "mujoco", 0, world.drawn, world.xml, versions(), of.control_step_s, sheets
        )

    about = header(scenario)
    kinds: dict[str, Callable[[Path, Path], Cost]] = {
        "both formats": lambda _, new: recorded(scenario, world, about, new, FORMATS),
        **{
            name: lambda _, new, name=name: recorded(scenario, world, about, new, {name: FORMATS[name]})
            for name in FORMATS
        },
        "run.rrd, its encoder alone": lambda done, new: rerun_alone(scenario, world, about, done, new),
        "run.mcap, its encoder alone": lambda done, new: foxglove_alone(scenario, world, done, new),
    }
    costs: dict[str, list[Cost]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as name:
        short, done = Path(name) / "short", Path(name) / "done"
        for folder, of in ((short, half), (done, scenario)):
            folder.mkdir()
            recorded(of, world, header(of), folder, FORMATS)
        for repeat in range(REPEATS):
            for kind, cost in kinds.items():
                new = Path(name) / f"{kind} {repeat}"
                new.mkdir()
                rerun_bindings.flush_and_cleanup_orphaned_recordings()  # those of the run before
                costs[kind].append(cost(done, new))
        sizes = {file: tuple((folder / file).stat().st_size for folder in (short, done)) for file in FORMATS}

    run_s = statistics.median(cost.run_s for some in costs.values() for cost in some)
    title = f"{SECONDS:g} s of paper, which take {run_s:.2f} s without recording; medians of {REPEATS}"
    heads = ("writing, us per tick", "opening, closing, ms", "all, us per tick", "share of the run")
    table = Table("what", *heads, title=title)
    for kind, some in costs.items():
        parts = (statistics.median(getattr(cost, of) for cost in some) for of in ("writing_s", "ends_s"))
        median = Cost(*parts, run_s)
        table.add_row(kind, *median.row(scenario.ticks), end_section=kind in ("both formats", "run.mcap"))
    table.add_row("target of both formats", "<= 40", "", "", "<= 10 %")
    console.print(table)

    table = Table("what", "measured", "target")
    for file, (less, more) in sizes.items():
        whole = more + (more - less) / (SECONDS / 2) * (LONG_S - SECONDS)
        table.add_row(f"{file}, ten minutes", f"{whole / 1e6:.1f} MB", "<= 50 MB")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    table.add_row(f"memory of this process, {SECONDS:g} s", f"{peak:.0f} MB", "<= 500 MB, ten minutes")
    console.print(table)


if __name__ == "__main__":
    main()
