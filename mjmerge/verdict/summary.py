"""What a person gets from a trace: the summary, the table, the figure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.figures.runs import overview, save
from mjmerge.gate.junit import junit
from mjmerge.paper.facts import FACTS, Finding
from mjmerge.record.manifest import versions
from mjmerge.scenario.effect import told
from mjmerge.scenario.schema import CARS, Scenario
from mjmerge.simulation.trace import NEIGHBOURS, Trace
from mjmerge.state import Array
from mjmerge.vehicle.acceptance import Acceptance
from mjmerge.verdict.decision import decision
from mjmerge.verdict.hypotheses import asked
from mjmerge.verdict.judge import VERDICTS, Verdict
from mjmerge.verdict.metrics import MERGED_M, TURNED_RAD, merged_at_s, saturated, turned_rad

if TYPE_CHECKING:
    from rich.table import Table

    from mjmerge.gate.gate import Result
    from mjmerge.paper.survey import Survey
    from mjmerge.paper.theorem import Tally

_STYLES = {True: "green", False: "red", None: "dim"}  # of a fact that was reproduced, was not, says nothing


def worst_run(trace: Trace) -> int:
    """The simulation that came closest to a neighbour; one without data is worse than any other."""
    least = trace.min_distance_m.min(axis=1)
    return int(np.argmin(np.where(np.isnan(least), -np.inf, least)))


def summary(trace: Trace, verdicts: Sequence[Verdict], wall_s: float) -> dict[str, Any]:
    """What ``--json`` prints and ``summary.json`` holds, but for the run folder and the versions.

    Distances are the smallest over all simulations; times, merge, hypotheses (when each first broke) and the
    decision are those of the worst one.
    """
    run = worst_run(trace)
    distance_m = trace.distance_m[run]
    known = ~np.isnan(trace.front_m[:, :, 0, 0])
    ends = np.where(known, trace.time_s, 0.0).max(axis=1).tolist()  # 0 where it stopped before its first tick
    worst = max(verdicts, key=lambda v: (VERDICTS.index(v.verdict), v.run == run))
    clearance = trace.min_clearance_m[:, :2]
    return {
        "scenario": trace.scenario.name,
        "plant": trace.plant,
        "continuous": trace.continuous,
        "seed": int(trace.seeds[0]),
        "runs": trace.runs,
        "verdict": worst.verdict,
        "reason": worst.reason,
        "verdicts": dict(Counter(v.verdict for v in verdicts)),
        "floor_m": trace.scenario.expect.min_distance_m.at_least,
        "floor_held": all(v.floor_held for v in verdicts),
        "floor_held_runs": sum(v.floor_held for v in verdicts),
        "worst_seed": int(trace.seeds[run]),
        "min_distance_m": {
            car: _number(least) for car, least in zip(NEIGHBOURS, _least(trace.min_distance_m), strict=True)
        },
        "t_min_distance_s": {
            car: _number(trace.time_s[np.argmin(np.where(np.isnan(d), np.inf, d))])
            for car, d in zip(NEIGHBOURS, distance_m.T, strict=True)
        },
        "min_clearance_m": _number(_least(clearance.reshape(-1, 1))[0]),
        "collisions": [
            {"seed": int(trace.seeds[v.run]), **asdict(collision)}
            for v in verdicts
            for collision in v.collisions
        ],
        "needed": verdicts[run].needed,
        "without_barrier_m": verdicts[run].without_barrier_m,
        "merged_at_s": _number(merged_at_s(trace)[run]),
        "turned_rad": _number(turned_rad(trace)[run]),
        "saturated_s": {
            car: _number(saturated(trace)[run, :, c].sum() * trace.scenario.control_step_s)
            for c, car in enumerate(CARS)
        },
        "peak_u_c_mps2": _number(-_least(-np.hypot(*trace.u_c_mps2[run].T)[:, None])[0]),
        "hypotheses": dict.fromkeys(asked(trace)) | {b.hypothesis: b.time_s for b in verdicts[run].breaches},
        "decision": {key: _plain(value) for key, value in decision(trace)[run].as_dict().items()},
        "stops": [
            {
                "seed": int(trace.seeds[s.run]),
                "time_s": s.time_s,
                "car": s.car,
                "reason": s.reason,
                "touched": s.touched,
                "crossing": s.crossing,
            }
            for s in trace.stops
        ],
        "duration_s": _number(max(ends)),
        "real_time_factor": _number(sum(ends) / wall_s),
    }


def ground(
    scenario: Scenario, plant: str, accepted: Mapping[str, Mapping[str, Any]], *, continuous: bool
) -> dict[str, Any]:
    """The part of a summary that says what its verdict stands on: the cars, and what is without effect.

    Args:
        scenario: what ran.
        plant: what moved the cars.
        accepted: what is known of each physical model's acceptance tests, as recorded, by its name.
        continuous: whether in continuous time.
    """
    idle = told(scenario, plant, continuous=continuous)
    cars = [Acceptance(name, known["state"], tuple(known["failed"])) for name, known in accepted.items()]
    doubts = [car.sentence for car in cars if car.sentence]
    doubts += [f"the scenario's {key} is without effect: it {why}" for key, why in idle.items()]
    return {"verdict_doubts": doubts, "no_effect": list(idle), "acceptance": dict(accepted)}


def _least(values: Array) -> Array:
    """Minimum over simulations that ignores NaN unless there is nothing else."""
    least: Array = np.where(np.isnan(values), np.inf, values).min(axis=0)
    return np.where(np.isinf(least), np.nan, least)


def _number(value: float) -> float | None:
    """A JSON number; JSON has no NaN."""
    return None if math.isnan(value) else float(value)


def _plain(value: float | bool | None) -> float | bool | None:
    """What JSON has: no infinity either, of what was never measured."""
    return value if value is None or math.isfinite(value) else None


def metres(value: float | None) -> str:
    """A length in words; a dash for none."""
    return "-" if value is None else f"{value:.3f} m"


def seconds(value: float | None) -> str:
    """A time in words; a dash for none."""
    return "-" if value is None else f"{value:.2f} s"


def table(found: dict[str, Any]) -> Table:
    """The summary as a table for the terminal."""
    from rich.markup import escape
    from rich.table import Table

    good = found["floor_held"]
    grid = Table(show_header=False, box=None, pad_edge=False)
    grid.add_column(style="bold")
    grid.add_column()
    for j, car in enumerate(NEIGHBOURS):
        least, at = found["min_distance_m"][car], found["t_min_distance_s"][car]
        grid.add_row(f"min d_{j + 1}", f"{metres(least)} at {seconds(at)}  (to {car})")
    clearance = found["min_clearance_m"]
    grid.add_row("body clearance", "- (no bodies)" if clearance is None else metres(clearance))
    if found["collisions"]:
        grid.add_row("collisions", _collided(found["collisions"], found["runs"]))
    merged = found["merged_at_s"]
    turned = found["turned_rad"]
    said = f"at {seconds(merged)} (lateral error < {MERGED_M} m)" if merged is not None else "no"
    if turned is not None and abs(turned) > TURNED_RAD:
        said += f"; it turned {degrees(turned):.0f} degrees off the road"
    grid.add_row("merged", said)
    busy = [f"{car} {seconds(s)}" for car, s in found["saturated_s"].items() if s]
    grid.add_row("saturated", ", ".join(busy) or "never")
    grid.add_row("hypotheses", _broken(found["hypotheses"]))
    grid.add_row("decision", _hesitation(found["decision"]))
    if found.get("distinct_runs", found["runs"]) < found["runs"]:
        grid.add_row("distinct runs", "1: nothing is random here, and every seed gives the same run")
    if found.get("no_effect"):
        grid.add_row("no effect", escape(", ".join(found["no_effect"])))
    reasons = [found["reason"], *found.get("verdict_doubts", ())]
    grid.add_row("verdict", escape(f"{found['verdict']}: {'; but '.join(reasons)}"))
    if found["runs"] > 1:
        grid.add_row("verdicts", ", ".join(f"{n} {v}" for v, n in found["verdicts"].items()))
        grid.add_row("worst run", f"seed {found['worst_seed']}")
    for stop in found["stops"][:5]:
        what = f"seed {stop['seed']} at {seconds(stop['time_s'])}: {stop['car']}, {stop['reason']}"
        grid.add_row("stopped", escape(what))
    floor = f"{found['floor_m']:.3f} m " + ("held" if good else "BROKEN")
    if found["runs"] > 1:
        floor += f" in {found['floor_held_runs']} of {found['runs']} runs"
    grid.add_row("safety floor", f"[{'green' if good else 'red'}]{floor}[/]")
    grid.add_row("real time", f"x {found['real_time_factor']:.1f}")
    return grid


def _collided(collisions: Sequence[Mapping[str, Any]], runs: int) -> str:
    """Who touched whom, when, and how fast; the first four of them."""
    said = []
    for c in collisions[:4]:
        fast = "" if c["speed_mps"] is None else f" at {c['speed_mps']:.2f} m/s"
        seed = f" (seed {c['seed']})" if runs > 1 else ""
        said.append(f"{c['a']} and {c['b']} at {seconds(c['time_s'])}{fast}{seed}")
    more = f" and {len(collisions) - 4} more" if len(collisions) > 4 else ""
    return ", ".join(said) + more


def _broken(hypotheses: Mapping[str, float | None]) -> str:
    """Which hypotheses broke, and when; the first three of them."""
    broke = sorted((at, name) for name, at in hypotheses.items() if at is not None)
    if not broke:
        return f"all {len(hypotheses)} held"
    more = f" and {len(broke) - 3} more" if len(broke) > 3 else ""
    return ", ".join(f"'{name}' broken at {at:.2f} s" for at, name in broke[:3]) + more


def _hesitation(found: Mapping[str, float | bool | None]) -> str:
    """The decision metrics in a line."""
    words = {
        "wrong_sign_s": "driven the wrong way for",
        "refusal_memory_s": "slow to trust again by",
        "abort_s": "slow to abort by",
        "straddling_s": "between the lanes for",
    }
    said = [f"{word} {found[key]:.2f} s" for key, word in words.items() if found[key]]
    return ", ".join(said + ["z underflowed"] * bool(found["underflow"])) or "nothing to report"


def facts_table(findings: Mapping[str, Sequence[Finding]]) -> Table:
    """Each published fact, and whether it was reproduced on each plant, for the terminal."""
    from rich.table import Table

    grid = Table(box=None, pad_edge=False, leading=1)
    grid.add_column("published", style="bold", ratio=3)
    for plant in findings:
        grid.add_column(plant, ratio=4)
    for fact, *found in zip(FACTS, *findings.values(), strict=True):
        grid.add_row(fact.claim, *(f"[{_STYLES[f.holds]}]{f.word}[/]  {f.number}" for f in found))
    return grid


def theorem_table(tally: Tally) -> Table:
    """What came of a campaign, for the terminal."""
    from rich.table import Table

    grid = Table(show_header=False, box=None, pad_edge=False)
    grid.add_column(style="bold")
    grid.add_column(justify="right")
    grid.add_column()
    colour = "red" if tally.violated else "green"
    grid.add_row("worlds", f"{tally.runs}", "in which every hypothesis of the theorem holds")
    grid.add_row("violations", f"[{colour}]{tally.violated}[/]", "d_j <= 0")
    grid.add_row("close", f"{tally.close}", "d_j < r, and less than half of what it had been")
    grid.add_row(
        "unresolved", f"{tally.unresolved}", "d_j < 1e-5 m: too little to tell from 0, and left there"
    )
    grid.add_row("stuck", f"{tally.stuck}", "the solver gave up: says nothing")
    grid.add_row("smallest d_j", f"{tally.least_m:.2g} m", "of those that are resolved")
    return grid


def survey_table(found: Sequence[Survey]) -> Table:
    """How often the decision went wrong, variant by variant, for the terminal."""
    from rich.table import Table

    rows: dict[str, Callable[[Survey], str]] = {
        "runs": lambda s: f"{s.runs}",
        "mu driven the wrong way in": lambda s: f"{s.wrong_sign / s.runs:.1%}",
        "  there on average for": lambda s: f"{s.wrong_sign_s:.2f} s",
        "d_j <= 0 in": lambda s: f"{s.violated} ({s.violated / s.runs:.2%})",
        "merged at the end in": lambda s: f"{s.merged / s.runs:.1%}",
        "refusal memory, median": lambda s: f"{s.refusal_memory_s:.2f} s",
        "time to abort, median": lambda s: f"{s.abort_s:.2f} s",
    }
    grid = Table(box=None, pad_edge=False)
    grid.add_column(style="bold")
    for survey in found:
        grid.add_column(survey.variant, justify="right")
    for name, value in rows.items():
        grid.add_row(name, *(value(survey) for survey in found))
    return grid


def facts_markdown(findings: Mapping[str, Sequence[Finding]]) -> str:
    """The table of facts in Markdown."""
    lines = [
        "| published | " + " | ".join(findings) + " |",
        "|---|" + "---|" * len(findings),
        *(
            f"| {fact.claim} | " + " | ".join(f"{f.word}: {f.number}" for f in found) + " |"
            for fact, *found in zip(FACTS, *findings.values(), strict=True)
        ),
    ]
    return "\n".join(lines) + "\n"


def gate_table(results: Sequence[Result]) -> Table:
    """Every row of the gate with its smallest distances, m, for the terminal."""
    from rich.markup import escape
    from rich.table import Table

    grid = Table(box=None, pad_edge=False)
    for name in ("scenario", "row"):
        grid.add_column(name, style="cyan" if name == "row" else None, no_wrap=True)
    for name in ("floor", "d_1", "d_2", "moved"):
        grid.add_column(name, justify="right", no_wrap=True, min_width=5)
    grid.add_column("", no_wrap=True, min_width=4)
    grid.add_column("verdict")
    for result in results:
        row, m, before = result.row, result.measured, result.baseline
        moved = "new"
        if before is not None:
            moved = f"{max(m.min_d_1_m - before.min_d_1_m, m.min_d_2_m - before.min_d_2_m, key=abs):+.4f}"
        good = not result.problems
        word = f"[{'green' if good else 'red'}]{'ok' if good else 'FAILED'}[/]"
        least = (f"{value:.3f}" for value in (row.check.at_least_m, m.min_d_1_m, m.min_d_2_m))
        names = map(escape, (row.label, row.check.name))
        grid.add_row(*names, *least, moved, word, result.verdict.verdict)
    return grid


def gate_failure(result: Result) -> str:
    """Why a row fails, and how to see it, in lines."""
    row, made = result.row, result.made_with
    now = {name: version for name, version in versions().items() if name in made}
    other = [f"{name} {made[name]} then, {now[name]} now" for name in now if now[name] != made[name]]
    return "\n".join(
        [
            f"{row.label}, {row.check.name}:",
            *(f"  {problem}" for problem in result.problems),
            *([f"  the baseline was made with other versions: {', '.join(other)}"] if other else []),
            f"  see it:  {row.command}",
        ]
    )


def gate_json(results: Sequence[Result], stale: Sequence[str] = ()) -> dict[str, Any]:
    """The gate for machines; ``stale`` says which rows of the baselines the gate does not have."""
    rows = [
        {
            "scenario": r.row.label,
            "row": r.row.check.name,
            "plant": r.row.check.plant,
            "set": list(r.row.check.set),
            "floor_m": r.row.check.at_least_m,
            "measured": {name: _number(value) for name, value in asdict(r.measured).items()},
            "baseline": r.baseline and {name: _number(value) for name, value in asdict(r.baseline).items()},
            "baseline_versions": dict(r.made_with),
            "verdict": r.verdict.verdict,
            "problems": list(r.problems),
            "command": r.row.command,
        }
        for r in results
    ]
    failed = sum(bool(r.problems) for r in results)
    return {
        "passed": not failed,
        "rows": rows,
        "failed": failed,
        "stale": list(stale),
        "versions": versions(),
    }


def gate_junit(results: Sequence[Result]) -> bytes:
    """The gate as JUnit XML, for continuous integration."""
    return junit(results, [gate_failure(result) for result in results])


def figure(trace: Trace, path: Path, run: int = 0) -> None:
    """Opinion, lateral position and distances over time, as the paper draws them."""
    save(overview(trace, run), path)
