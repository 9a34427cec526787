"""``mjmerge replay``: the attached scenario run again, and compared with the recording bit for bit.

With the world and the data sheets that are in the file, so that a car of one's own needs no folder; and those
are compared with what this version has under the same names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjmerge.config import shipped
from mjmerge.config.doors import DoorError, code_of
from mjmerge.drivers import Absent
from mjmerge.errors import MjmergeError, UnknownNameError, UnreadableError
from mjmerge.law import AbsentLaw
from mjmerge.record import content
from mjmerge.record.attached import compiled
from mjmerge.record.read import Recorded, read
from mjmerge.review.check import differing
from mjmerge.review.claims import what_follows
from mjmerge.review.recover import CUT_OFF
from mjmerge.scenario.cars import equipped
from mjmerge.scenario.metrics import find, metric_name
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Trace, own
from mjmerge.state import NS_PER_S, Array
from mjmerge.verdict.judge import judge
from mjmerge.verdict.own import run
from mjmerge.versions import versions
from mjmerge.world.compose import attached, build
from mjmerge.world.model import World

_MOST_NAMED = 5
_RELATIVE = 1e-9


@dataclass(frozen=True)
class Difference:
    """A column that came out differently.

    Attributes:
        column: its name.
        first_s: time of the first tick that differs, s.
        ticks: how many do.
        most: largest difference, in the column's unit; infinite where only one of the two is a number.
    """

    column: str
    first_s: float
    ticks: int
    most: float


@dataclass(frozen=True)
class Replayed:
    """What came of it.

    Attributes:
        recorded: the file as read.
        differences: columns that differ, the earliest first.
        lengths: ticks in the file and in the run again, where the file is finished and they differ.
        other_versions: packages of another version than the file's, a phrase each.
        claims: where what the file claims of the run is not what the run again says.
        other_world: whether this version composes another world of the same models, or has other data sheets
            of them; ``None`` where they are not here.
        ours: whether all those models are shipped, and of the versions in the file: then another world is a
            contradiction.
        left_out: metrics of the scenario's own that were not run, and why, a phrase each.
    """

    recorded: Recorded
    differences: tuple[Difference, ...]
    lengths: tuple[int, int] | None
    other_versions: tuple[str, ...]
    claims: tuple[str, ...]
    other_world: bool | None
    ours: bool
    left_out: tuple[str, ...] = ()

    @property
    def same(self) -> bool:
        """Whether every bit is the same, and all that is claimed of them."""
        wrong_world = self.ours and bool(self.other_world)
        return not (self.differences or self.lengths or self.claims or wrong_world)

    def as_dict(self) -> dict[str, Any]:
        """What ``--json`` prints."""
        metrics = {"metrics_left_out": list(self.left_out)} if self.recorded.manifest.get("metrics") else {}
        return {
            "file": str(self.recorded.path),
            "same": self.same,
            "ticks": len(self.recorded.ticks),
            "differences": [vars(d) for d in self.differences],
            "other_versions": list(self.other_versions),
            "claims": list(self.claims),
            "other_world": self.other_world,
            **metrics,
        }

    def lines(self) -> list[str]:
        """In words."""
        found, out = self.recorded, []
        if self.same:
            part = "" if found.verdict is not None else f", as far as it goes ({found.last_s:.2f} s)"
            out.append(
                f"same, bit for bit: {len(found.ticks)} ticks of {len(found.columns) - 1} columns{part}"
            )
        if self.lengths is not None:
            out.append(f"DIFFERENT: {self.lengths[0]} ticks in the file, {self.lengths[1]} in the run again")
        for d in self.differences[:_MOST_NAMED]:
            out.append(
                f"DIFFERENT: {d.column} at {d.ticks} ticks from {d.first_s:.2f} s on, by up to {d.most:.3g}"
            )
        if len(self.differences) > _MOST_NAMED:
            out.append(f"DIFFERENT: and {len(self.differences) - _MOST_NAMED} more columns")
        out += [f"DIFFERENT: {claim}" for claim in self.claims[:_MOST_NAMED]]
        out += [f"another version: {other}" for other in self.other_versions]
        out += [f"left out: the metric {why}" for why in self.left_out]
        if self.other_world and self.ours:
            out.append("DIFFERENT: the attached world or data sheets are not those of the models it names")
        elif self.other_world:
            out.append("the models of those names are others here; it was run with the attached ones")
        elif self.other_world is None:
            out.append("its models are not here; it was run with the attached world and data sheets")
        if self.differences and not self.other_versions:
            out.append("the versions are the same: the file was changed, or the processor is another kind")
        return out


def replay(
    path: Path,
    threads: int = 0,
    progress: Callable[[float], None] | None = None,
    *,
    any_code: bool = False,
) -> Replayed:
    """Runs a recording's scenario again with its plant and seed, and compares.

    Code from outside is run as it is here, and only where it is what the recording carries.

    Args:
        path: the recording.
        threads: threads for the physics, 0 for all cores; does not change the result.
        progress: called now and then with the part that is done, 0 to 1.
        any_code: whether code from outside is run though it is another here.

    Raises:
        UnreadableError: it is no recording, or has nothing to compare; or its scenario runs code from outside
            that is not here, or is another.
        ModelError: its world is none that this version can run.
    """
    found = read(path)
    if not found.columns or not len(found.ticks):
        raise UnreadableError(path, f"no columns that we know (schema {found.schema_version})")
    _check_code(found, any_code)
    scenario, plant = found.scenario(code=True), str(found.manifest["plant"])
    world = _world(found, scenario) if plant == "mujoco" else None
    again = simulate(
        scenario,
        plant,
        seed=int(found.manifest["seed"]),
        threads=threads,
        world=world,
        progress=None if progress is None else lambda t: progress(t / scenario.duration_s),
        continuous=bool(found.manifest["continuous"]),
    )
    known = ~np.isnan(again.front_m[0, :, 0, 0])
    ran = int(known.sum())
    cut_off = any(stop["reason"] == CUT_OFF for stop in (found.summary or {}).get("stops", ()))
    whole = found.verdict is not None and not cut_off
    inside = (found.ticks >= 0) & (found.ticks < scenario.ticks)
    if not inside.any():
        raise UnreadableError(path, "none of its ticks is at a time of its scenario")
    odd = len(found.ticks) != ran or not inside.all()
    lengths = (int(inside.sum()), ran) if whole and odd else None
    differences = []
    beside = {c.name for c in own(scenario)}
    if beside != {c.name for c in content.own_columns(found.manifest)}:
        raise UnreadableError(
            path, f"its law {scenario.law.label} records other signals here than in the file"
        )
    for column in again.columns:
        there = found.columns[column.name][inside]
        new = again.column(column.name)[0, found.ticks[inside]]
        difference = _difference(column.name, there, new, found.time_ns[inside] / NS_PER_S)
        if difference is not None:
            differences.append(difference)
    metrics, left_out = _metrics(found, again, any_code) if whole else ({}, ())
    made, here = found.manifest.get("versions", {}), versions()
    other = tuple(f"{n} {v} then, {here.get(n, 'none')} now" for n, v in made.items() if here.get(n) != v)
    return Replayed(
        found,
        tuple(sorted(differences, key=lambda d: d.first_s)),
        lengths,
        other,
        tuple(_claims(found, again, metrics)) if whole else (),
        _other_world(found, scenario),
        not other and all(model in shipped.models() for model in scenario.car_models),
        left_out,
    )


def _check_code(found: Recorded, any_code: bool) -> None:
    """Lets code from outside be run where it is here, and is what the recording carries.

    Raises:
        UnreadableError: it is not.
    """
    scenario = found.scenario()
    named = {driver.kind: "driver" for driver in scenario.neighbours if isinstance(driver, Absent)}
    if isinstance(scenario.law, AbsentLaw):
        named[scenario.law.kind] = "law"
    for kind, what in named.items():
        why = _other_code(found, kind, any_code)
        if why:
            raise UnreadableError(found.path, f"its {what} {kind} {why}")


def _metrics(found: Recorded, again: Trace, any_code: bool) -> tuple[dict[str, Array], tuple[str, ...]]:
    """What the scenario's own metrics say of the run again, (1,), and which were not run, and why.

    A metric is run as it is here, and only where that is the code that the recording carries.
    """
    values: dict[str, Array] = {}
    left_out = []
    for reference in again.scenario.metrics:
        why = _other_code(found, reference, any_code)
        if why:
            left_out.append(f"{metric_name(reference)}: {reference} {why}")
        else:
            values[metric_name(reference)] = run(find(reference), again)
    return values, tuple(left_out)


def _other_code(found: Recorded, name: str, any_code: bool) -> str:
    """Why code from outside is not run, as the end of a sentence that its name begins; empty if it may be."""
    carried = (found.manifest.get("code") or {}).get(name, {}).get("sha256")
    place, _, _ = name.rpartition(":")
    if not (place.endswith(".py") or any_code):
        return "is in a module; --any-code runs it"
    try:
        here = code_of(name).sha256
    except (DoorError, ImportError, ValueError):
        return "is not here"
    same = here == carried or any_code
    return "" if same else "is other code here than in the recording; --any-code runs it"


def _world(found: Recorded, scenario: Scenario) -> World:
    """The attached world, to be run."""
    model = compiled(found.path, found.world_xml)
    return attached(model, found.world_xml, found.sheets(), scenario)


def _other_world(found: Recorded, scenario: Scenario) -> bool | None:
    """Whether the models of these names give another world here, or have other data sheets."""
    try:
        here = equipped(scenario.with_sheets(None))
        world = build(here)
    except UnknownNameError:
        return None
    except MjmergeError:  # they are here, and no longer what they must be
        return True
    return found.world_xml != world.xml or found.sheets() != here.sheets


def _claims(found: Recorded, again: Trace, metrics: Mapping[str, Array]) -> list[str]:
    """Where verdict and summary are not those of the run again."""
    (verdict,) = judge(again)
    wrong = []
    if verdict.verdict != found.verdict:
        wrong.append(f"the file says {found.verdict!r}, the run again {verdict.verdict!r}")
    claimed, expected = found.summary or {}, what_follows(found, again, verdict, metrics)
    for key in sorted(claimed.keys() | expected.keys()):
        wrong += differing(key, claimed.get(key), expected.get(key), _RELATIVE, "the run again says")
    return wrong


def _difference(name: str, there: Array, new: Array, time_s: Array) -> Difference | None:
    """How a column differs in its bits, if it does, (T, ...)."""
    bits = [np.ascontiguousarray(a).view(np.uint64).reshape(len(a), -1) for a in (there, new)]
    rows = np.flatnonzero(np.any(bits[0] != bits[1], axis=1))
    if not rows.size:
        return None
    a, b = there[rows], new[rows]
    with np.errstate(invalid="ignore"):
        off = np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0.0, np.abs(a - b))
    most = float(np.max(np.nan_to_num(off, nan=np.inf)))
    return Difference(name, float(time_s[rows[0]]), len(rows), most)
