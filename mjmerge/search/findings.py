"""What a search comes to: the failures that differ, each shrunk, each a folder that anybody can run."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mjmerge.scenario.schema import GateRow, Scenario
from mjmerge.search.against import PROOF, Against
from mjmerge.search.falsify import Look, Search
from mjmerge.search.margin import KINDS, Kind, Margin
from mjmerge.search.parts import Parts
from mjmerge.search.shrink import Shrunk, shrink
from mjmerge.sweep.workers import HERE, Workers

LOOKS = "looks.jsonl"
"""All that a search looked at."""
ROW = "as found"
"""The row of the gate that pins a finding."""
MOST_SHRUNK = 12
"""Failures that are shrunk, at most, for as many different ones as somebody wants."""


@dataclass(frozen=True)
class Finding:
    """A failure, as small as it gets.

    Attributes:
        look: the point that it was found at.
        shrunk: what it came to.
        plant: what moves the cars.
        against: where the same behaviour is safe.
    """

    look: Look
    shrunk: Shrunk
    plant: str
    against: Against

    @property
    def real(self) -> Margin:
        """How close it comes on the plant."""
        assert self.shrunk.pair.real is not None, "a finding was run"
        return self.shrunk.pair.real

    @property
    def kind(self) -> Kind:
        """How it fails."""
        assert self.real.kind is not None, "a finding fails"
        return self.real.kind

    @property
    def signature(self) -> tuple[object, ...]:
        """What makes it another failure than others: how it fails, and what it takes."""
        parts = self.shrunk.parts
        moves = tuple((car, len(of)) for car, of in parts.moves.items() if of)
        return (self.kind, tuple(sorted(parts.axes)), moves)

    @property
    def sentence(self) -> str:
        """It in words: what is different, and what comes of it."""
        small, ideal = self.shrunk, self.shrunk.pair.ideal
        what = "; ".join(small.parts.sentence()) or "nothing differs but the plant"
        seed = f", with seed {small.pair.seed}" if small.pair.seed else ""
        also = [f"with {small.spare:.0%} less of it"] if small.spare else []
        also += ["at half the step"] if small.half else []
        too = f", and {' and '.join(also)} too" if also else ""
        return (
            f"{what}{seed}: {KINDS[self.kind]}{too}. "
            f"Least d_j {self.real.min_distance_m:.3f} m, least margin {self.real.least_m:.3f} m; "
            f"{self.against.words} least d_j {ideal.min_distance_m:.3f} m."
        )

    def scenario(self, name: str) -> Scenario:
        """The scenario that repeats it, with a row of the gate that pins it."""
        found, seed = self.shrunk.parts.scenario(), self.shrunk.pair.seed
        floor = found.expect.min_distance_m.at_least
        row = GateRow(name=ROW, plant=self.plant, seed=seed, at_least_m=floor, needs=())
        update = {"gate": (row,), "search": None, "description": self.sentence}
        return found.model_copy(update=update).named(name)


def differing(
    found: Search,
    many: int,
    *,
    against: Against = PROOF,
    team: Workers = HERE,
    told: Callable[[int], None] | None = None,
) -> list[Finding]:
    """The failures that differ, each shrunk; up to so many.

    The worst is shrunk first, then what is another kind, or else far from those, as long as it is no close
    call. What takes more than few axes and moves stands only where there is nothing smaller.

    Args:
        found: what a search found.
        many: how many different ones.
        against: where the same behaviour must be safe.
        team: who runs them; does not change the result.
        told: called with the number of failures that were shrunk so far.
    """
    left = _clear(found.failures)
    before: list[Look] = []
    kept: dict[tuple[object, ...], Finding] = {}
    large: dict[tuple[object, ...], Finding] = {}
    while left and len(kept) < many and len(before) < MOST_SHRUNK:
        look = _next(left, before)
        left.remove(look)
        before.append(look)
        ground, point = found.ground, np.array(look.point)
        parts = Parts.of(ground.scenario, ground.at(point), ground.axes(point))
        ends = ground.ends(point)
        small = shrink(parts, look.seed, ground.plant, ends=ends, against=against, team=team)
        if small is not None:
            finding = Finding(look, small, ground.plant, against)
            (kept if small.small else large).setdefault(finding.signature, finding)
        if told is not None:
            told(len(before))
    return [*kept.values(), *large.values()][:many]


def _clear(failures: Sequence[Look]) -> list[Look]:
    """Of each kind the worse half."""
    found: list[Look] = []
    for kind in dict.fromkeys(look.kind for look in failures):
        of = sorted((look for look in failures if look.kind == kind), key=lambda look: look.depth_m)
        found += of[: -(-len(of) // 2)]
    return found


def _next(left: Sequence[Look], before: Sequence[Look]) -> Look:
    """The worst at first, or of a kind that was not looked at closely; then what is furthest from those."""
    kinds = {look.kind for look in before}
    new = [look for look in left if look.kind not in kinds]
    if new:
        return min(new, key=lambda look: look.depth_m)
    near = np.array([look.point for look in before])
    return max(left, key=lambda look: float(np.linalg.norm(near - np.array(look.point), axis=1).min()))


def log(found: Search, digest: str) -> str:
    """Points as lines of JSON, which :func:`logged` reads, after one that says what they are points of."""
    lines = [{"of": digest}, *map(vars, found.looks)]
    return "".join(json.dumps(line) + "\n" for line in lines)


def logged(path: Path, digest: str) -> list[Look]:
    """What was written by :func:`log`, as far as it is whole; of another search nothing."""
    found: list[Look] = []
    if digest_of(path) != digest:
        return found
    for line in path.read_text(encoding="utf-8").splitlines()[1:]:
        try:
            given = json.loads(line)
            found.append(Look(**given | {"point": tuple(given["point"])}))
        except (ValueError, TypeError, KeyError, RecursionError):
            break
    return found


def digest_of(path: Path) -> str | None:
    """What the points in a file are points of; ``None`` where it has none."""
    try:
        with path.open(encoding="utf-8") as lines:
            found = json.loads(lines.readline())["of"]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    return found if isinstance(found, str) else None
