"""``mjmerge compare``: two recordings side by side, as a table, a figure and a recording with both in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import getitem
from pathlib import Path
from string import ascii_uppercase
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.figures.runs import comparison
from mjmerge.figures.style import save
from mjmerge.outputs import whole
from mjmerge.record.read import Recorded
from mjmerge.review.claims import claimed_metrics
from mjmerge.scenario.ran import given, ran
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array
from mjmerge.verdict.judge import Verdict, judge
from mjmerge.verdict.metrics import shared_ticks
from mjmerge.verdict.summary import summary
from mjmerge.verdict.table import metres, seconds

if TYPE_CHECKING:
    from rich.table import Table

_QUANTITIES: dict[str, tuple[str, Callable[[Trace], Array]]] = {
    "d_1": ("m", lambda t: t.distance_m[0, :, 0]),
    "d_2": ("m", lambda t: t.distance_m[0, :, 1]),
    "opinion z": ("", lambda t: t.opinion[0]),
    "ego, across": ("m", lambda t: t.front_m[0, :, 0, 1]),
    "ego, along": ("m", lambda t: t.front_m[0, :, 0, 0]),
    "ego, speed": ("m/s", lambda t: np.hypot(*t.velocity_mps[0, :, 0].T)),
    "ego, command": ("m/s²", lambda t: np.hypot(*t.u_mps2[0, :, 0].T)),
}
"""What two runs are compared by: unit, and the quantity over time, (T,)."""

AS_IT_IS = "as it is"
"""What a run is called that has nothing of what the others have."""


@dataclass(frozen=True)
class Side:
    """One of the two.

    Attributes:
        recorded: the file as read.
        trace: the run in it.
        verdict: of the run as recorded.
        summary: likewise.
    """

    recorded: Recorded
    trace: Trace
    verdict: Verdict
    summary: dict[str, Any]

    @classmethod
    def of(cls, recorded: Recorded) -> Side:
        """From a file.

        Raises:
            UnreadableError: there is no run in it.
        """
        trace = recorded.run()
        (verdict,) = judge(trace)
        metrics = claimed_metrics(recorded, trace)
        return cls(recorded, trace, verdict, summary(trace, [verdict], metrics))

    @property
    def ran(self) -> list[str]:
        """What ran, its mismatch, and what else was set, a line each."""
        it = self.trace
        return ran(it.scenario, it.plant, it.seeds[0], continuous=it.continuous, mismatch=it.mismatch[0])


@dataclass(frozen=True)
class Apart:
    """Where two runs are furthest apart in a quantity.

    Attributes:
        quantity: what.
        unit: its unit.
        most: how far at most.
        time_s: when, s; ``None`` if never.
    """

    quantity: str
    unit: str
    most: float
    time_s: float | None


def labels(*sides: Side) -> tuple[str, ...]:
    """Names that tell sides apart: what ran, or what differs of what was given, or else their files."""
    what = tuple(side.ran[0] for side in sides)
    every = [given(side.trace.scenario, side.trace.mismatch[0]) for side in sides]
    own = [[text for text in one if not all(text in other for other in every)] for one in every]
    differ = tuple(", ".join(texts) or AS_IT_IS for texts in own)
    if len({*what}) > 1:
        differ = tuple(map(", ".join, zip(what, differ, strict=True)))
    files = tuple(f"{k}: {side.recorded.path}" for k, side in zip(ascii_uppercase, sides, strict=False))
    return next((names for names in (what, differ) if len({*names}) == len(sides)), files)


def differences(a: Trace, b: Trace) -> list[Apart]:
    """How far two runs are apart, quantity by quantity, at the times that both have."""
    in_a, in_b = shared_ticks(a, b)
    time_s = a.time_s[in_a]
    found = []
    for name, (unit, values) in _QUANTITIES.items():
        if all(np.isnan(values(side)).all() for side in (a, b)):
            continue  # neither law has it
        off = np.nan_to_num(np.abs(values(a)[in_a] - values(b)[in_b]), nan=0.0)
        k = int(np.argmax(off))
        found.append(Apart(name, unit, float(off[k]), float(time_s[k]) if off[k] > 0 else None))
    return found


def identical(a: Recorded, b: Recorded) -> bool:
    """Whether every column is the same, bit for bit."""
    if len(a.ticks) != len(b.ticks):
        return False
    names = ["time_s", *a.columns]
    return a.columns.keys() == b.columns.keys() and all(
        a.columns[n].tobytes() == b.columns[n].tobytes() for n in names
    )


def as_dict(a: Side, b: Side) -> dict[str, Any]:
    """What ``--json`` prints."""
    return {
        "identical": identical(a.recorded, b.recorded),
        "a": {"file": str(a.recorded.path), **a.summary},
        "b": {"file": str(b.recorded.path), **b.summary},
        "differences": {
            d.quantity: {"most": d.most, "time_s": d.time_s} for d in differences(a.trace, b.trace)
        },
    }


def table(a: Side, b: Side) -> Table:
    """Both beside each other, for the terminal."""
    from rich.markup import escape
    from rich.table import Table

    grid = Table(box=None, pad_edge=False)
    grid.add_column()
    for side in "AB":
        grid.add_column(side, justify="right")
    grid.add_column("B - A", justify="right")

    def row(name: str, word: Callable[[Any], str], *keys: str) -> None:
        ones: Any = reduce(getitem, keys, a.summary)
        twos: Any = reduce(getitem, keys, b.summary)
        numbers = isinstance(ones, float) and isinstance(twos, float)
        grid.add_row(name, escape(word(ones)), escape(word(twos)), f"{twos - ones:+.3g}" if numbers else "")

    for name in ("scenario", "plant", "seed", "verdict"):
        row(name, str, name)
    given = [dict(line.split(": ", 1) for line in side.ran[1:]) for side in (a, b)]
    for name in ("mismatch", "set"):
        if any(name in one for one in given):
            grid.add_row(name, *(escape(one.get(name, "-")) for one in given), "")
    fewest = min((side.trace.roster for side in (a, b)), key=lambda there: len(there.cars))
    for j, car in enumerate(fewest.neighbours, start=1):
        row(f"min d_{j}", metres, "min_distance_m", car)
        row("  at", seconds, "t_min_distance_s", car)
    row("body clearance", metres, "min_clearance_m")
    row("merged at", seconds, "merged_at_s")
    row("saturated, ego", seconds, "saturated_s", "ego")
    row("hypotheses broken", lambda found: str(sum(at is not None for at in found.values())), "hypotheses")
    for name in {**a.summary.get("metrics", {}), **b.summary.get("metrics", {})}:
        one, two = (side.summary.get("metrics", {}).get(name) for side in (a, b))
        apart = "" if one is None or two is None else f"{two - one:+.3g}"
        words = ("-" if value is None else f"{value:.4g}" for value in (one, two))
        grid.add_row(f"{escape(name)}, as recorded", *words, apart)
    grid.add_row()
    grid.add_row("furthest apart", "", "at", "by", style="bold")
    for d in differences(a.trace, b.trace):
        grid.add_row(f"  {d.quantity}", "", seconds(d.time_s), f"{d.most:.3g} {d.unit}".strip())
    return grid


def figure(a: Side, b: Side, path: Path) -> None:
    """Draws both over each other, and their difference, as PNG.

    Raises:
        OutputError: the file is there already, or cannot be written.
    """
    names = labels(a, b) if a.ran == b.ran else (a.ran[0], b.ran[0])  # the title says what else ran
    drawn = comparison(a.trace, b.trace, names)
    whole(path, lambda partial: save(drawn, partial, path.suffix))


def recording_of_both(a: Side, b: Side, path: Path) -> None:
    """Writes a Rerun recording with the cars of both in one scene and their lines in one plot.

    Raises:
        UnreadableError: there is no world in one of them.
        OutputError: the file is there already, or cannot be written.
    """
    from mjmerge.record.rerun.side_by_side import ShownSide, write_comparison
    from mjmerge.record.scene import Scene
    from mjmerge.review.poses import header, outcome, posed

    shown = []
    for side, label in zip((a, b), labels(a, b), strict=True):
        about = header(side.recorded)
        block = posed(side.recorded, about, Scene(about.model, about.scenario.r_m))
        shown.append(ShownSide(label, about, block, outcome(side.recorded, side.trace)))
    write_comparison(path, shown)
