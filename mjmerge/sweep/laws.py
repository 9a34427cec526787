"""What each law of a campaign came to, over all its scenarios and mismatches, and what it buys and pays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mjmerge.scenario.distinct import distinct
from mjmerge.sweep.rows import Rows, groups
from mjmerge.sweep.statistics import Rate
from mjmerge.sweep.tally import as_json, failure_rate, least_m, vacuous_runs

Table = Callable[[Sequence[str], Sequence[Sequence[object]]], Iterator[str]]


@dataclass(frozen=True)
class Standing:
    """What a law comes to in a campaign, over distinct runs.

    Attributes:
        law: what it is called.
        runs: how many.
        vacuous: of these, those that nothing put to the test.
        failed: of the others, those that failed.
        worst_m: least d_j of all, m; ``None`` where none is known.
        median_m: middle of the least d_j, m.
        merged: runs that ended merged.
        merged_s: middle of the times that took, s.
        peak_mps2: middle of the most that it asked for, m/s^2.
        jerk_mps3: middle of the root mean square jerk that it asked for, m/s^3.
        own_broken: runs in which a hypothesis of its own broke, and of how many; ``None`` where it has none.
        own_broken_s: for how long, all together, s.
    """

    law: str
    runs: int
    vacuous: int
    failed: Rate
    worst_m: float | None
    median_m: float | None
    merged: int
    merged_s: float | None
    peak_mps2: float | None
    jerk_mps3: float | None
    own_broken: int | None
    own_broken_s: float | None


def standings(rows: Rows) -> list[Standing]:
    """Every law of a campaign, in the order they come up."""
    found = []
    for (law,), group in groups(rows, ("variant",)).items():
        of = distinct(group)
        own_s = [row["own_broken_s"] for row in of if row["own_broken_s"] is not None]
        merged = [row for row in of if row["merged_at_s"] is not None]
        found.append(
            Standing(
                law=law,
                runs=len(of),
                vacuous=vacuous_runs(group),
                failed=failure_rate(group),
                worst_m=least_m(of),
                median_m=_median(of, "min_distance_m"),
                merged=len(merged),
                merged_s=_median(merged, "merged_at_s"),
                peak_mps2=_median(of, "peak_u_mps2"),
                jerk_mps3=_median(of, "rms_jerk_mps3"),
                own_broken=sum(s > 0 for s in own_s) if own_s else None,
                own_broken_s=sum(own_s) if own_s else None,
            )
        )
    return found


def _median(rows: Rows, column: str) -> float | None:
    known = [row[column] for row in rows if row[column] is not None]
    return float(np.median(known)) if known else None


def summary(rows: Rows) -> list[dict[str, Any]]:
    """Every law's standing, as JSON has it."""
    return [asdict(one) | {"failed": as_json(one.failed)} for one in standings(rows)]


def section(rows: Rows, table: Table) -> Iterator[str]:
    """The part of a report about laws, where there are several."""
    found = standings(rows)
    if len(found) < 2:
        return
    yield "## Laws"
    yield ""
    yield (
        "Over distinct runs, all scenarios and mismatches together; times, demand (the most that is asked "
        "for) and jerk (root mean square) are medians. Own: runs in which a hypothesis of its own broke."
    )
    yield ""
    yield from table(tuple(_row(found[0])), [tuple(_row(one).values()) for one in found])
    for one in found:
        yield f"- **{one.law}** {buys_and_pays(one)}"
    yield ""


def _row(one: Standing) -> dict[str, object]:
    """A law as a row of the table, by its heads."""
    return {
        "law": one.law,
        "runs": one.runs,
        "vacuous": one.vacuous,
        "failed": one.failed,
        "worst d_j (m)": _number(one.worst_m),
        "median d_j (m)": _number(one.median_m),
        "merged": f"{one.merged} of {one.runs}",
        "after (s)": _number(one.merged_s),
        "demand (m/s²)": _number(one.peak_mps2),
        "jerk (m/s³)": _number(one.jerk_mps3),
        "own broken": "-" if one.own_broken is None else f"{one.own_broken} of {one.runs}",
    }


def buys_and_pays(one: Standing) -> str:
    """What a law's numbers say, as the end of a sentence that its name begins."""
    tested = one.failed.of
    kept = f"keeps its floor in {tested - one.failed.count} of the {tested} runs that put it to the test"
    buys = kept if tested else "is put to the test by no run"
    margin = "" if one.worst_m is None else f", with {_number(one.worst_m)} m at worst"
    merges = f"merges in {one.merged} of {one.runs}, after {_number(one.merged_s)} s"
    after = merges if one.merged else "merges in none"
    asks = f"asking for up to {_number(one.peak_mps2)} m/s² with a jerk of {_number(one.jerk_mps3)} m/s³"
    own = ""
    if one.own_broken:
        own = f"; in {one.own_broken} runs its own hypotheses broke, for {_number(one.own_broken_s)} s in all"
    return f"{buys}{margin}; it {after}, {asks}{own}."


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
