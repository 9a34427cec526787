"""``mjmerge verify``: does a recording say the truth about itself? Read with nothing but the file.

What follows from other numbers is computed again from those and held against what the file says: damage and
contradiction show. What is absent is never right.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.law import AbsentLaw
from mjmerge.record.digest import digests
from mjmerge.record.manifest import CONVENTIONS, SCHEMA_VERSIONS
from mjmerge.record.read import Recorded, read
from mjmerge.review.check import Check, checked, some
from mjmerge.review.claims import claims
from mjmerge.review.derived import derived, end_of, geometry
from mjmerge.review.drawn import drawn
from mjmerge.review.explained import explained
from mjmerge.review.given import otherwise
from mjmerge.scenario.metrics import metric_name
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.trace import COLUMNS, Trace
from mjmerge.simulation.trace import own as beside
from mjmerge.state import NS_PER_S
from mjmerge.verdict import own
from mjmerge.verdict.judge import Verdict, judge
from mjmerge.versions import versions

if TYPE_CHECKING:
    from rich.table import Table


NOT_DERIVED = (
    "that the cars moved under the physics and the mismatch that the scenario says, but for bounds; how hard "
    "contacts were; why a run stopped; who recorded it with what; the layout: `mjmerge replay` runs it again"
)
"""What does not follow from the rest of a file, and what finds it."""


@dataclass(frozen=True)
class Verified:
    """What came of it.

    Attributes:
        recorded: the file as read.
        checks: in the order made; later ones are left out where an earlier one leaves them no ground.
        verdict: that of the recorded positions; ``None`` where they could not be judged.
    """

    recorded: Recorded
    checks: tuple[Check, ...]
    verdict: Verdict | None

    @property
    def right(self) -> bool:
        """Whether nothing is wrong, and the run was judged."""
        return self.verdict is not None and all(check.right is not False for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """What ``--json`` prints."""
        return {
            "file": str(self.recorded.path),
            "format": self.recorded.kind,
            "right": self.right,
            "finished": self.recorded.finished and self.recorded.verdict is not None,
            "ticks": len(self.recorded.ticks),
            "verdict": self.verdict.verdict if self.verdict else None,
            "claimed_verdict": self.recorded.verdict,
            "checks": [{"name": c.name, "right": c.right, "says": c.says} for c in self.checks],
        }


def verify(path: Path) -> Verified:
    """Checks a recording.

    Raises:
        UnreadableError: it is no recording, does not even say what the run was, or is another version's.
    """
    found = read(path)
    checks: list[Check] = []
    verdict = None
    for step in _steps(found):
        if isinstance(step, Verdict):
            verdict = step
        else:
            checks.append(step)
    return Verified(found, tuple(checks), verdict)


def _steps(found: Recorded) -> Iterator[Check | Verdict]:
    """The checks, one after the other, as far as the ground carries; and the verdict where there is one."""
    yield _file(found)
    yield (schema := _schema(found))
    if not schema.right:
        return
    yield _contents(found)
    yield (columns := _columns(found, found.scenario()))
    yield _versions(found)
    if not columns.right:
        return
    trace = found.trace()
    yield _manifest(found, trace)
    yield (time := _time(found, trace))
    if not time.right and np.isnan(trace.front_m[0, :, 0, 0]).all():
        return
    yield _length(found, trace)
    yield _fingerprints(found)
    yield from derived(found, trace)
    yield from drawn(found, trace)
    again = replace(
        trace,
        **geometry(trace.front_m, trace.velocity_mps, trace.scenario.r_m, trace.two),
        signals={**trace.signals, **end_of(trace)},
    )
    (verdict,) = judge(again)
    yield verdict
    yield from claims(found, again, verdict)
    yield from explained(found, again)
    yield Check("not derived", None, _not_derived(trace))


def _not_derived(trace: Trace) -> str:
    """What does not follow from the rest of this file."""
    names, what = own.names(trace.scenario), []
    if isinstance(trace.scenario.law, AbsentLaw):
        what.append(f"what the law {trace.scenario.law.label} decides")
    if names:
        what.append(f"what the scenario's own metrics came to ({', '.join(names)})")
    if not what:
        return NOT_DERIVED
    return f"{', and '.join(what)}: their code is in the file and is never run from it; {NOT_DERIVED}"


def _file(found: Recorded) -> Check:
    """The file is complete."""
    if found.finished and not found.fault and found.verdict is not None:
        return Check("file", True, f"complete, {found.kind}, {found.path.stat().st_size / 1e6:.1f} MB")
    reach = f"has data up to {found.last_s:.2f} s" if len(found.ticks) else "has no data yet"
    why = f" ({found.fault})" if found.fault else ""
    if not found.finished:
        return Check(
            "file", False, f"unfinished{why}: it {reach}; `mjmerge recover` makes a whole file of it"
        )
    if found.fault:
        return Check("file", False, f"damaged{why}; it {reach}")
    return Check("file", False, f"the run was cut off: it {reach} and no verdict; `mjmerge recover` adds one")


def _schema(found: Recorded) -> Check:
    """The file is of the schema that this version reads."""
    same = (
        found.schema_version in SCHEMA_VERSIONS and found.manifest["schema_version"] == found.schema_version
    )
    says, read = f"version {found.schema_version}", " and ".join(map(str, SCHEMA_VERSIONS))
    return Check("schema", same, says if same else f"{says}; this mjmerge reads versions {read}")


def _contents(found: Recorded) -> Check:
    """All that a recording has is there once, readable, and as its own index says."""
    wrong = list(found.flaws)
    if found.verdict is not None:
        if found.summary is None:
            wrong.append(f"it claims {found.verdict!r} and has no summary")
        if not len(found.ticks):
            wrong.append(f"it claims {found.verdict!r} without a whole tick of law and cars")
    if not found.world_xml:
        wrong.append("no world.xml")
    return checked("contents", wrong, "all there, once, and as its index says")


def _columns(found: Recorded, scenario: Scenario) -> Check:
    """Names with their units, axes and conventions are ours, and all of them are there."""
    ours = {c.name: [list(axis) for axis in c.names(found.roster)] for c in (*COLUMNS, *beside(scenario))}
    claimed = {str(c.get("name", "")): c.get("axes") for c in found.manifest["columns"]}
    wrong = sorted(n for n in ours.keys() | claimed.keys() if ours.get(n) != claimed.get(n))
    if wrong:
        return Check("columns", False, f"other names, units or axes than ours: {some(wrong)}")
    if found.manifest["conventions"] != CONVENTIONS:
        return Check("columns", False, "other conventions than ours about units, frames or time")
    missing = sorted(ours.keys() - found.columns.keys())
    if not len(found.ticks):
        return Check("columns", False, "not a whole tick of any of them")
    if missing:
        return Check("columns", False, f"not in the file: {some(missing)}")
    return Check("columns", True, f"{len(ours)}, names and units as declared")


def _versions(found: Recorded) -> Check:
    """Versions of the packages that matter; others than here are no mistake."""
    made, here = found.manifest["versions"], versions()
    other = [f"{n} {v} (here {here.get(n, 'none')})" for n, v in made.items() if here.get(n) != v]
    if other:
        return Check("versions", None, f"made with {', '.join(other)}")
    return Check("versions", True, f"all {len(made)} as here")


def _manifest(found: Recorded, trace: Trace) -> Check:
    """What the manifest says of the run is what the scenario says, wherever it is repeated."""
    about, scenario, wrong = found.manifest, trace.scenario, []
    if about["description"] != scenario.description:
        wrong.append("the description is not the scenario's")
    wrong += _metrics(about, scenario)
    wrong += otherwise(found)
    repeated = {
        "mjmerge": {
            "schema_version": str(about["schema_version"]),
            **{k: str(about[k]) for k in ("scenario", "description", "plant", "seed", "control_step_s")},
            **CONVENTIONS,
        },
        "versions": about["versions"],
    }
    if found.kind == "rrd":
        repeated = {
            "run": {
                **{k: about[k] for k in ("scenario", "plant", "seed", "continuous")},
                **{k: about[k] for k in ("versions", "conventions")},
            }
        }
    for name, said in repeated.items():
        for key, value in said.items():
            there = found.properties.get(name, {}).get(key)
            if there != value:
                wrong.append(f"{name}.{key} is {there!r}, and the manifest says {value!r}")
    return checked("manifest", wrong, "as the scenario says, in every place")


def _metrics(about: Mapping[str, Any], scenario: Scenario) -> Iterator[str]:
    """Where the metrics in a manifest are not those of the scenario, or code is not what its digest says."""
    carried, code = about.get("metrics", ()), about.get("code") or {}
    if tuple(metric["reference"] for metric in carried) != scenario.metrics:
        yield "its metrics are not the scenario's"
    for metric in carried:
        if metric["name"] != metric_name(metric["reference"]):
            yield f"the metric {metric['name']!r} is called otherwise"
        if metric["reference"] not in code:
            yield f"the code of {metric['name']} is not in it"
    for name, text in code.items():
        if sha256(text["source"].encode()).hexdigest() != text["sha256"]:
            yield f"the code of {name} is not what its digest says"


def _time(found: Recorded, trace: Trace) -> Check:
    """Every series has every tick once, at its time, and the run has no others."""
    wrong = []
    last = max(int(ticks.max()) for ticks, _ in found.grids.values())
    if found.verdict is None:  # cut off: some series may have a block that others have not
        last = int(found.ticks[-1])
    for name, (ticks, time_ns) in found.grids.items():
        outside = np.flatnonzero((ticks < 0) | (ticks >= trace.scenario.ticks))
        wrong += [
            f"{name} has a tick outside the scenario, at {time_ns[k] / NS_PER_S:.2f} s" for k in outside[:1]
        ]
        there, counts = np.unique(ticks[ticks <= last], return_counts=True)
        lacks = np.flatnonzero(there != np.arange(len(there)))
        if lacks.size or len(there) <= last:
            wrong.append(f"{name} lacks tick {lacks[0] if lacks.size else len(there)}")
        wrong += [f"{name} has tick {there[k]} more than once" for k in np.flatnonzero(counts > 1)[:1]]
        if np.any(np.diff(time_ns) < 0):
            wrong.append(f"{name} goes back in time")
        off = np.flatnonzero(time_ns != np.rint(ticks * found.step_s * NS_PER_S))
        wrong += [f"{name} has tick {ticks[k]} at {time_ns[k]} ns" for k in off[:1]]
    if not np.array_equal(found.columns["time_s"], found.ticks * found.step_s):
        wrong.append("time_s is not the tick's number times the control step")
    wrong += [
        f"{name} has another time_s than /law"
        for name, own in found.own_time_s.items()
        if not np.array_equal(own, found.columns["time_s"])
    ]
    return checked("time", wrong, f"{len(found.ticks)} ticks of {found.step_s:g} s, no gaps, none twice")


def _length(found: Recorded, trace: Trace) -> Check:
    """The run goes to its end, or to where the file says that it stopped."""
    step_s, last = trace.scenario.control_step_s, int(found.ticks[-1])
    if abs(step_s - found.step_s) > 0:
        return Check("length", False, f"ticks of {found.step_s:g} s, but the scenario has {step_s:g} s")
    if found.verdict is None:
        return Check("length", None, f"{found.last_s:.2f} s of {trace.scenario.duration_s:g} s")
    end, why = trace.scenario.ticks - 1, "the scenario"
    if trace.stops:
        end = round(trace.stops[0].time_s / step_s) - 1
        why = f"that it stopped: {trace.stops[0].car}, {trace.stops[0].reason}"
    if last != end:
        return Check("length", False, f"it ends at {last * step_s:.2f} s, not at {end * step_s:.2f} s: {why}")
    return Check("length", True, f"{last * step_s:.2f} s, as it says" + (f" {why}" if trace.stops else ""))


def _fingerprints(found: Recorded) -> Check:
    """No number and no text was changed after it was written."""
    if not found.sha256:
        says = "none in the file" if found.verdict is not None else "none yet: they are written at the end"
        return Check("fingerprints", False if found.verdict is not None else None, says)
    now = digests(found.columns, found.texts)
    changed = sorted(n for n in now.keys() | found.sha256.keys() if now.get(n) != found.sha256.get(n))
    says = f"of {len(found.columns)} columns, scenario, world and manifest as recorded, SHA-256"
    wrong = [f"changed since they were recorded: {some(changed)}"] if changed else []
    return checked("fingerprints", wrong, says)


def table(verified: Verified) -> Table:
    """The checks, for the terminal."""
    from rich.table import Table
    from rich.text import Text

    marks = {True: "[green]right[/]", False: "[bold red]WRONG[/]", None: "[yellow]note[/]"}
    grid = Table(show_header=False, box=None, pad_edge=False)
    grid.add_column(style="bold")
    grid.add_column()
    grid.add_column()
    for check in verified.checks:
        grid.add_row(check.name, marks[check.right], Text(check.says))
    return grid
