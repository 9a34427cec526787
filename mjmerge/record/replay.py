"""``mjmerge replay``: the attached scenario run again, and compared with the recording bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjmerge.errors import UnreadableError
from mjmerge.record.manifest import versions
from mjmerge.record.read import Recorded, read
from mjmerge.simulate import simulate
from mjmerge.trace import COLUMNS, Array
from mjmerge.world import build

_MOST_NAMED = 5


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
        other_world: whether the composed world is another one: the car models have changed.
    """

    recorded: Recorded
    differences: tuple[Difference, ...]
    lengths: tuple[int, int] | None
    other_versions: tuple[str, ...]
    other_world: bool

    @property
    def same(self) -> bool:
        """Whether every bit is the same."""
        return not self.differences and self.lengths is None

    def as_dict(self) -> dict[str, Any]:
        """What ``--json`` prints."""
        return {
            "file": str(self.recorded.path),
            "same": self.same,
            "ticks": len(self.recorded.ticks),
            "differences": [vars(d) for d in self.differences],
            "other_versions": list(self.other_versions),
            "other_world": self.other_world,
        }

    def lines(self) -> list[str]:
        """In words."""
        found, out = self.recorded, []
        if self.same:
            part = "" if found.verdict is not None else f", as far as it goes ({found.last_s:.2f} s)"
            out.append(f"same, bit for bit: {len(found.ticks)} ticks of {len(COLUMNS)} columns{part}")
        if self.lengths is not None:
            out.append(f"DIFFERENT: {self.lengths[0]} ticks in the file, {self.lengths[1]} in the run again")
        for d in self.differences[:_MOST_NAMED]:
            out.append(
                f"DIFFERENT: {d.column} at {d.ticks} ticks from {d.first_s:.2f} s on, by up to {d.most:.3g}"
            )
        if len(self.differences) > _MOST_NAMED:
            out.append(f"DIFFERENT: and {len(self.differences) - _MOST_NAMED} more columns")
        out += [f"another version: {other}" for other in self.other_versions]
        if self.other_world:
            out.append("another world: the car models have changed since (see the attached world.xml)")
        if not self.same and not self.other_versions and not self.other_world:
            out.append("the versions are the same: the file was changed, or the processor is another kind")
        return out


def replay(path: Path, threads: int = 0, progress: Callable[[float], None] | None = None) -> Replayed:
    """Runs a recording's scenario again with its plant and seed, and compares.

    Args:
        path: the recording.
        threads: threads for the physics, 0 for all cores; does not change the result.
        progress: called now and then with the part that is done, 0 to 1.

    Raises:
        UnreadableError: it is no recording, or has nothing to compare.
        ScenarioError: its scenario is none that this version can run.
    """
    found = read(path)
    if not found.columns:
        raise UnreadableError(path, f"no columns that we know (schema {found.schema_version})")
    scenario, plant = found.scenario(), str(found.manifest["plant"])
    world = build(scenario)
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
    whole = found.verdict is not None
    lengths = (len(found.ticks), ran) if whole and len(found.ticks) != ran else None
    inside = found.ticks < scenario.ticks
    differences = []
    for column in COLUMNS:
        there = found.columns[column.name][inside]
        new = getattr(again, column.name)[0, found.ticks[inside]]
        difference = _difference(column.name, there, new, found.time_ns[inside] / 1e9)
        if difference is not None:
            differences.append(difference)
    made, here = found.manifest.get("versions", {}), versions()
    other = tuple(f"{n} {v} then, {here.get(n, 'none')} now" for n, v in made.items() if here.get(n) != v)
    return Replayed(
        found,
        tuple(sorted(differences, key=lambda d: d.first_s)),
        lengths,
        other,
        bool(found.world_xml) and found.world_xml != world.xml,
    )


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
