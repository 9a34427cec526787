"""What a recorder is, what it gets, and the driver that keeps recorders from stopping a run."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self

from mjmerge.errors import OutputError, RecordingError
from mjmerge.outputs import PARTIAL
from mjmerge.record.digest import Digest, of_texts
from mjmerge.record.manifest import EXPLANATION, canonical, manifest
from mjmerge.record.posed import PosedBlock, Posing, join
from mjmerge.record.scene import Scene
from mjmerge.scenario.ran import ran
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.log import TickBlock
from mjmerge.simulation.sensing import exact
from mjmerge.simulation.trace import COLUMNS, Column, own
from mjmerge.vehicle.datasheet import DataSheet
from mjmerge.verdict.metrics import Event
from mjmerge.verdict.phases import Phase

if TYPE_CHECKING:
    import mujoco

    from mjmerge.record.schema import Wire

_SPARE_BYTES = 32 * 2**20
"""Recorders stop before the disk is full: a writer that hits its end can hang for good."""


@dataclass(frozen=True)
class Header:
    """What is known of a run before it starts.

    Attributes:
        scenario: the scenario.
        scenario_yaml: the same, resolved, as text: running it again gives the same run.
        plant: name of the plant.
        seed: seed of this simulation.
        model: the composed MuJoCo world.
        world_xml: the MJCF it was compiled from.
        versions: package name to version.
        control_step_s: simulated time between ticks, s.
        sheets: data sheet of each car at its size.
        continuous: whether law and plant were one differential equation.
        acceptance: what is known of each physical car model's acceptance tests, by its name.
        code: text and SHA-256 of the code from outside that the scenario runs, by its located name.
        metrics: name, reference and description of each metric of the scenario's own.
    """

    scenario: Scenario
    scenario_yaml: str
    plant: str
    seed: int
    model: mujoco.MjModel
    world_xml: str
    versions: Mapping[str, str]
    control_step_s: float
    sheets: tuple[DataSheet, ...]
    continuous: bool = False
    acceptance: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    code: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    metrics: Sequence[Mapping[str, str]] = ()

    @property
    def ran(self) -> list[str]:
        """What ran, in words, a line each."""
        return ran(self.scenario, self.plant, self.seed, continuous=self.continuous)

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns of the run, those that not every run has last."""
        return (*COLUMNS, *self.signals)

    @property
    def signals(self) -> tuple[Column, ...]:
        """Those that not every run has: signals of its law, and the end of the ego's lane."""
        return own(self.scenario)

    @property
    def told(self) -> bool:
        """Whether what the ego was told is not the truth, and recorded."""
        return not (self.continuous or exact(self.scenario.mismatch))

    @property
    def wire(self) -> Wire:
        """The messages of the run."""
        from mjmerge.record.schema import Wire  # protobuf takes its time to import

        return Wire(self.scenario.roster, self.signals, self.told)

    @property
    def texts(self) -> dict[str, str]:
        """What goes into a recording as text, by name, and its manifest as its fingerprint wants it."""
        return {
            "scenario.yaml": self.scenario_yaml,
            "world.xml": self.world_xml,
            "manifest.json": canonical(manifest(self)),
        }


@dataclass(frozen=True)
class Outcome:
    """What is known of a run once it is over.

    Attributes:
        events: in order of time.
        verdict: the contract's word for it.
        summary: what ``summary.json`` holds.
        phases: every change of state, subject by subject.
        explanation: why it fails, as JSON, see :mod:`mjmerge.search.explain`; ``None`` where nobody asked, or
            there is nothing to explain.
        digests: fingerprint of every column and text; :class:`Recording` fills it in.
    """

    events: Sequence[Event]
    verdict: str
    summary: Mapping[str, Any]
    phases: Sequence[Phase] = ()
    explanation: Mapping[str, Any] | None = None
    digests: Mapping[str, str] = field(default_factory=dict)


class Keep:
    """A sink that keeps a run, with what is drawn of it."""

    def __init__(self, header: Header) -> None:
        """Args: what is known of the run."""
        self._posing = Posing(header, Scene(header.model, header.scenario.r_m))
        self._parts: list[PosedBlock] = []

    def write(self, block: TickBlock) -> None:
        """Takes the next ticks."""
        self._parts.append(self._posing.block(block))

    def posed(self) -> PosedBlock:
        """The whole run, as far as it came."""
        return join(self._parts)


class Recorder(Protocol):
    """Writes one file. Whatever it raises ends that file and nothing else."""

    def write(self, posed: PosedBlock) -> None:
        """Adds consecutive ticks of the one simulation it records."""

    def close(self, outcome: Outcome) -> None:
        """Adds the outcome and completes the file."""

    def abort(self) -> None:
        """Closes what is there, so that it stays readable."""


Factory = Callable[[Path, Header, Scene], Recorder]


def _why(error: BaseException) -> str:
    """What to say of a recorder that broke."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


class Recording:
    """Hands a run to its recorders: ``with Recording(...) as r``, then ``write`` and, once, ``close``.

    Every file is ``<name>.partial`` until it is complete. A recorder that fails is dropped, its file stays
    ``.partial``, and the run goes on. Leaving the context without ``close`` leaves readable partial files.

    Attributes:
        files: the files that are complete.
    """

    def __init__(self, folder: Path, header: Header, factories: Mapping[str, Factory]) -> None:
        """Args: the run folder, which exists; what is known of the run; file name to what writes it."""
        self.files: list[Path] = []
        self._folder = folder
        self._header = header
        self._factories = factories
        self._scene = Scene(header.model, header.scenario.r_m)
        self._posing = Posing(header, self._scene)
        self._digest = Digest(header.texts, [c.name for c in header.columns])
        self._live: dict[str, Recorder] = {}
        self._failed: dict[str, str] = {}

    @property
    def failures(self) -> list[str]:
        """What went wrong, a line per file."""
        return [f"{name}: {reason}" for name, reason in self._failed.items()]

    def __enter__(self) -> Self:
        for name, factory in self._factories.items():
            self._attempt(name, self._open, name, factory)
        return self

    def write(self, block: TickBlock) -> None:
        """Hands a block to every recorder that is still well."""
        if not self._live:
            return
        self._digest.add(block)
        posed = self._posing.block(block)
        for name, recorder in list(self._live.items()):
            self._attempt(name, self._write, recorder, posed)

    def close(self, outcome: Outcome) -> None:
        """Completes every file that is still well and gives it its name."""
        said = {} if outcome.explanation is None else {EXPLANATION: canonical(outcome.explanation)}
        outcome = replace(outcome, digests=self._digest.hex() | of_texts(said))
        for name, recorder in list(self._live.items()):
            self._attempt(name, self._finish, name, recorder, outcome)
        self._live.clear()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for name in list(self._live):
            self._drop(name)

    def _partial(self, name: str) -> Path:
        return self._folder / f"{name}{PARTIAL}"

    def _open(self, name: str, factory: Factory) -> None:
        for path in (self._folder / name, self._partial(name)):
            if path.exists():
                raise OutputError(f"{path} exists; recordings are not overwritten")
        self._live[name] = factory(self._partial(name), self._header, self._scene)

    def _write(self, recorder: Recorder, posed: PosedBlock) -> None:
        if shutil.disk_usage(self._folder).free < _SPARE_BYTES:
            raise OutputError(f"the disk of {self._folder} is full")
        recorder.write(posed)

    def _finish(self, name: str, recorder: Recorder, outcome: Outcome) -> None:
        recorder.close(outcome)
        partial, final = self._partial(name), self._folder / name
        if not partial.is_file():
            raise RecordingError("nothing was written (RERUN=off in the environment does that to run.rrd)")
        if final.exists():
            raise OutputError(f"{final} has appeared meanwhile; recordings are not overwritten")
        partial.rename(final)
        self.files.append(final)

    def _attempt(self, name: str, action: Callable[..., None], *arguments: object) -> None:
        """Runs what a recorder does; a failure ends that recorder, and is kept."""
        try:
            action(*arguments)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # a panic in a writer made of Rust is no Exception
            self._failed.setdefault(name, _why(error))
            self._drop(name)

    def _drop(self, name: str) -> None:
        recorder = self._live.pop(name, None)
        if recorder is not None:
            self._attempt(name, recorder.abort)
