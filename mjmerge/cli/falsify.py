"""``mjmerge falsify``."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from mjmerge.cli.options import (
    Count,
    Flag,
    Machines,
    Overrides,
    PlantName,
    ScenarioName,
    at_least,
    team,
    unsaid,
)
from mjmerge.cli.progress import runs_bar
from mjmerge.cli.style import bold, plain
from mjmerge.errors import MjmergeError

if TYPE_CHECKING:
    from mjmerge.search.against import Against
    from mjmerge.search.falsify import Search
    from mjmerge.search.findings import Finding
    from mjmerge.search.methods import Method
    from mjmerge.search.space import Ground
    from mjmerge.sweep.workers import Workers


@dataclass(frozen=True)
class Falsify:
    """Look for the runs that break a scenario: mismatch and behaviour of the neighbours that nobody wrote.

    A failure counts if the same behaviour is safe, with every hypothesis true, where nothing is different in
    truth. Each different one is shrunk to the smallest that still fails, as a scenario that `mjmerge run`
    repeats. Interrupted, it goes on where it was when it is run again. Exit code 0: none found; 1: some; 2:
    bad input; 3: a finding could not be recorded.
    """

    kept: ClassVar[str] = "what was looked at is kept; run it again to go on"

    scenario: ScenarioName
    """Name of a shipped scenario or the path of a YAML file; its section `search` says where to look."""
    budget: Count = 512
    """Runs that are looked at, at most."""
    seed: Count = 0
    """Of the search; the same seed finds the same."""
    method: Literal["cma", "random"] = "cma"
    """How points are chosen: CMA-ES with restarts, or uniformly at random."""
    both: Flag = False
    """Look at as many points by the other method, too, to see what the first is worth."""
    plant: PlantName = "mujoco"
    """What moves the cars."""
    against: Annotated[str, tyro.conf.arg(metavar="PLANT|LAW")] = "double_integrator"
    """Where the same behaviour must be safe: a plant without mismatch, or another law with the same."""
    from_: Annotated[Path | None, tyro.conf.arg(name="from", metavar="DIR", help_behavior_hint="")] = None
    """Look at the samples that failed in an estimate of `mjmerge probability`, in place of a search."""
    findings: Count = 3
    """Different failures that are shrunk, at most."""
    record: bool = True
    """Record each of them, beside the run that is safe."""
    out: Annotated[Path | None, unsaid("DIR")] = None
    """Folder for everything; by default falsified/<scenario>-<plant> with what else was set in its name."""
    workers: Count = 0
    """Processes to spread over, 0 for one per core; does not change the result."""
    machines: Annotated[Machines, tyro.conf.arg(name="")] = Machines()  # noqa: RUF009
    """Who does the work."""
    set_: Overrides = ()
    """Any scenario key; repeatable."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        at_least(1, budget=self.budget)
        at_least(0, seed=self.seed, workers=self.workers, findings=self.findings)
        self.machines.check()
        from mjmerge.cli.places import falsified_folder
        from mjmerge.outputs import put
        from mjmerge.scenario.load import load
        from mjmerge.search.against import Against
        from mjmerge.search.falsify import again
        from mjmerge.search.falsify_report import as_json, write
        from mjmerge.search.findings import LOOKS, differing, log
        from mjmerge.search.kept import failing
        from mjmerge.search.methods import check
        from mjmerge.search.space import Ground

        if self.from_ is not None and self.both:
            raise MjmergeError("--from and --both are two things: choose one")
        for method in ("cma", "random") if self.both else (self.method,):
            if self.from_ is None:
                check(method)
        ground = Ground.around(load(self.scenario, self.set_), self.plant)
        samples = None if self.from_ is None else failing(self.from_, ground)[: self.budget]
        if samples == []:
            raise MjmergeError(f"nothing failed in {self.from_}")
        for key, why in ground.left_out:
            print(f"mjmerge: left out: {key} {why}", file=sys.stderr)
        against = Against.named(self.against, lambda key: load(self.scenario, [*self.set_, key]))
        how = self.method if samples is None else repr(samples)
        digest = ground.digest(how, str(self.seed), repr(against))
        name = ground.scenario.name
        folder = self.out or falsified_folder(name, self.plant, self._words(), digest)
        self._open(folder, digest)
        with team(self.workers, self.machines) as who:
            if samples is not None:
                found = again(ground, samples, against=against, team=who)
                put(folder / LOOKS, log(found, digest))
            else:
                found = self._search(self.method, ground, against, folder, digest, who)
            other: Method = "random" if self.method == "cma" else "cma"
            beside = self._search(other, ground, against, folder, digest, who) if self.both else None
            most = min(self.findings, len(found.failures))
            with runs_bar(most, "shrinking") as progress:
                findings = differing(
                    found, self.findings, against=against, team=who, told=lambda n: progress(n, 0)
                )
        failures = self._record(found, findings, folder)
        write(found, findings, folder, against=against, beside=beside)
        for failure in failures:
            print(f"mjmerge: {failure}", file=sys.stderr)
        if self.json:
            print(json.dumps(as_json(found, findings, folder, beside)))
        else:
            self._say(found, beside, findings, folder)
        if found.failures and self.findings and not findings:
            why = "none of them fails at the scenario's own step and at half of it, where the ideal is held"
            print(f"mjmerge: {why}", file=sys.stderr)
        return 3 if failures else 1 if findings or (found.failures and not self.findings) else 0

    def _say(self, found: Search, beside: Search | None, findings: list[Finding], folder: Path) -> None:
        from rich.console import Console

        from mjmerge.search.falsify_report import command, counted, place

        console = Console(highlight=False)
        console.print(f"{bold(found.ground.scenario.name)} on {self.plant}: {counted(found)}", soft_wrap=True)
        if beside is not None:
            console.print(f"beside it, by {beside.method}: {counted(beside)}", soft_wrap=True)
        if found.best is not None and found.best.margin_m is not None:
            console.print(f"least margin:  {found.best.margin_m:.4f} m")
        for k, one in enumerate(findings, 1):
            console.print(f"{k}.  {plain(one.sentence)}", soft_wrap=True)
            console.print(f"    {plain(command(one, place(folder, k)))}", soft_wrap=True)
        console.print(f"report and recordings:  {bold(folder)}", soft_wrap=True)

    def _words(self) -> tuple[str, ...]:
        """What of all that was given stands in the folder's name."""
        seed = f"seed_{self.seed}" if self.seed else ""
        against = "" if self.against == "double_integrator" else f"against_{self.against}"
        how = "" if self.method == "cma" else self.method
        return (how if self.from_ is None else "samples", seed, against, *self.set_)

    def _open(self, folder: Path, digest: str) -> None:
        """Makes the folder, or finds an earlier search of the same kind in it.

        Raises:
            OutputError: it holds something else.
        """
        from mjmerge.errors import OutputError
        from mjmerge.outputs import cannot_write
        from mjmerge.search.falsify_report import REPORT, RESULTS
        from mjmerge.search.findings import LOOKS, digest_of

        try:
            folder.mkdir(parents=True, exist_ok=True)
            there = any(folder.iterdir())
        except OSError as error:
            raise cannot_write(folder, error) from error
        if there and digest_of(folder / LOOKS) != digest:
            why = "holds something else, and nothing is overwritten"
            raise OutputError(f"{folder} {why}: choose another --out")
        for name in (REPORT, RESULTS):  # they are of what there was before
            (folder / name).unlink(missing_ok=True)

    def _record(self, found: Search, findings: list[Finding], folder: Path) -> list[str]:
        from mjmerge.cli.findings import cleared, record

        cleared(folder)
        if not self.record:
            return []
        with runs_bar(len(findings), "recording") as progress:
            return record(found, findings, folder, lambda n: progress(n, 0))

    def _search(
        self, method: Method, ground: Ground, against: Against, folder: Path, digest: str, who: Workers
    ) -> Search:
        from mjmerge.outputs import put
        from mjmerge.search.falsify import search
        from mjmerge.search.falsify_report import BESIDE
        from mjmerge.search.findings import LOOKS, log, logged

        looks = folder / (LOOKS if method == self.method else BESIDE)
        known = logged(looks, digest)
        with runs_bar(self.budget) as progress:

            def told(found: Search) -> None:
                put(looks, log(found, digest))
                least = "" if found.best is None else f", least margin {found.best.depth_m:.3f} m"
                progress(len(found.looks), len(known), f", {len(found.failures)} fail{least}")

            return search(
                ground,
                self.budget,
                method=method,
                seed=self.seed,
                against=against,
                team=who,
                before=known,
                told=told,
            )
