"""The margin waterfall: a scenario from the paper's own world to physical cars, and what each rung costs."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.errors import MjmergeError
from mjmerge.figures.style import COLOURS, LINE, End, ends, head, length, save, save_rows, sheet, words
from mjmerge.outputs import put
from mjmerge.scenario.effect import told
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.ran import beneath
from mjmerge.scenario.schema import Scenario
from mjmerge.sweep.plan import MISMATCH, Batches, Case, acts, planned, size_of
from mjmerge.sweep.rows import METRIC, min_d_m
from mjmerge.sweep.sweep import measured
from mjmerge.sweep.workers import Progress, Workers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.table import Table

FILES = ("ladder.png", "ladder.csv", "ladder.md")
"""All that is written."""
RUNGS = ("ideal", "held", "delayed", "bicycle", "limited", "MuJoCo", "tyre slip", "mismatch")
"""From the proof to the car; the first only of a law that has a continuous time, the last only where the
scenario has a mismatch of its own."""
NOMINAL_DELAY_S = 0.24
"""Dead time of the commands of a full-size car where the scenario has none, s (see ``docs/mismatch.md``)."""
NOMINAL_DELAY_STEPS = 2
"""Dead time of the commands of a 1/10 car where the scenario has none, in control steps."""


@dataclass(frozen=True)
class Rung:
    """One step from the proof to the car.

    Attributes:
        name: in a word.
        adds: what is new on it.
        case: the run.
        row: what came of it, a row as in :mod:`mjmerge.sweep.rows`.
        cost_m: minimum distance lost since the rung before, m; ``None`` where either is unknown.
        idle: keys that were set, or stand in the scenario, and are without effect on it, and why.
    """

    name: str
    adds: str
    case: Case
    row: Mapping[str, Any]
    cost_m: float | None
    idle: Mapping[str, str]

    @property
    def command(self) -> str:
        """The command that gives this run alone."""
        return shlex.join(("mjmerge", *self.case.command))


@dataclass(frozen=True)
class Ladder:
    """All rungs of a scenario.

    Attributes:
        scenario: which.
        delay_s: dead time from the rung ``delayed`` on, s.
        nominal: whether that is a stated value and not the scenario's own.
        rungs: from the proof to the car.
    """

    scenario: Scenario
    delay_s: float
    nominal: bool
    rungs: tuple[Rung, ...]


def climb(
    source: str,
    settings: Mapping[str, Any],
    team: Workers,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Ladder:
    """Runs a scenario on every rung.

    Args:
        source: the scenario's name or path.
        settings: scenario keys that differ on all rungs.
        team: what runs it.
        seed: of every run.
        progress: called with the number of rungs done.

    Raises:
        MjmergeError: the scenario is not valid, or a rung has no cars of its size.
    """
    batches = Batches()
    whole = batches.case(source, "mujoco", settings, lenient=True)
    scenario, mine = whole.batch.scenario, whole.mismatch
    delay_s, nominal = mine.command_delay_s, mine.command_delay_s == 0
    if nominal:
        full = size_of(scenario) == "full"
        delay_s = NOMINAL_DELAY_S if full else NOMINAL_DELAY_STEPS * scenario.control_step_s
    own = {k: v for k, v in mine.model_dump().items() if v != Mismatch.model_fields[k].default}
    none = {MISMATCH + k: Mismatch.model_fields[k].default for k in own}
    late = none | {MISMATCH + "command_delay_s": delay_s}
    ideal = late | {MISMATCH + "tyres": "ideal"}
    steps: list[tuple[str, str, bool, dict[str, Any]]] = [
        ("the proof: double integrators in continuous time", "double_integrator", True, none),
        ("the command is held over a control step", "double_integrator", False, none),
        (f"the command is {delay_s:g} s late", "double_integrator", False, late),
        ("kinematic bicycles", "bicycle", False, late),
        ("mass, torque and steering within limits", "bicycle_limited", False, late),
        ("bodies, suspension, servos, friction", "mujoco", False, ideal),
        ("tyres that slip", "mujoco", False, late),
    ]
    names = RUNGS[: len(steps)]
    if scenario.law.flow() is None:  # it has no continuous time
        names, steps = names[1:], steps[1:]
    if set(own) - {"command_delay_s"}:
        keys = {MISMATCH + k: v for k, v in own.items()} | {MISMATCH + "command_delay_s": delay_s}
        names = (*names, RUNGS[-1])
        steps.append((f"its own: {', '.join(sorted(own))}", "mujoco", False, keys))
    cases = [
        batches.case(
            source,
            plant,
            {**settings, **keys},
            seed=seed,
            point=name,
            continuous=continuous,
            lenient=True,
        )
        for name, (_, plant, continuous, keys) in zip(names, steps, strict=True)
    ]
    _refuse_what_is_in_vain(cases, whole, settings)
    rows = measured(planned("ladder", "", cases), team, progress).to_pylist()
    rungs: list[Rung] = []
    for (adds, *_), case, row in zip(steps, cases, rows, strict=True):
        now, before = row["min_distance_m"], rungs[-1].row["min_distance_m"] if rungs else None
        cost = None if now is None or before is None else before - now
        rungs.append(Rung(case.point, adds, case, row, cost, {**case.idle, **_own_idle(case)}))
    return Ladder(scenario, delay_s, nominal, tuple(rungs))


def _refuse_what_is_in_vain(cases: Sequence[Case], whole: Case, settings: Mapping[str, Any]) -> None:
    """Raises MjmergeError if something that is set is without effect on every rung."""
    vain: dict[str, str] = {}
    for case in (*cases, whole):
        vain |= case.idle
    wrong = [
        f"--set {key}: on no rung, because it {why}"
        for key, why in vain.items()
        if key in settings and not any(acts(case, key) for case in cases)
    ]
    if wrong:
        raise MjmergeError("\n".join(wrong))


def _own_idle(case: Case) -> dict[str, str]:
    """What the scenario itself says and is without effect on a rung."""
    scenario = case.batch.scenario.model_copy(update={"mismatch": case.mismatch})
    return told(scenario, case.batch.plant, continuous=case.batch.continuous)


def write(ladder: Ladder, folder: Path) -> None:
    """Plot, numbers and text."""
    save(waterfall(ladder), folder / "ladder.png")
    own = (name for name in ladder.rungs[0].row if name.startswith(METRIC))
    columns = ("min_distance_m", *_each(ladder), "min_clearance_m", "verdict", "first_broken", *own)
    rows = [(r.name, r.adds, r.cost_m, *(r.row[c] for c in columns)) for r in ladder.rungs]
    save_rows([("rung", "adds", "cost_m", *columns), *rows], folder / "ladder.csv")
    put(folder / "ladder.md", markdown(ladder))


def _each(ladder: Ladder) -> list[str]:
    """Columns of the smallest d_j, neighbour by neighbour."""
    return [min_d_m(j) for j in range(1, len(ladder.scenario.roster.cars))]


def as_json(ladder: Ladder) -> dict[str, Any]:
    """What ``--json`` prints."""
    return {
        "scenario": ladder.scenario.name,
        "command_delay_s": ladder.delay_s,
        "command_delay_is_nominal": ladder.nominal,
        "rungs": [
            {
                "name": rung.name,
                "adds": rung.adds,
                "cost_m": rung.cost_m,
                **{k: rung.row[k] for k in ("min_distance_m", *_each(ladder), "verdict", "floor_held")},
                **{name: value for name, value in rung.row.items() if name.startswith(METRIC)},
                "held_back": _held_back(ladder, rung),
                "no_effect": list(rung.idle),
                "command": rung.command,
            }
            for rung in ladder.rungs
        ],
    }


def _held_back(ladder: Ladder, rung: Rung) -> list[str]:
    """Axes of mismatch that wait for a later rung."""
    last, here = ladder.rungs[-1].case.mismatch, rung.case.mismatch
    at_rest = Mismatch()
    return [MISMATCH + name for name, v in last if v not in (getattr(here, name), getattr(at_rest, name))]


def markdown(ladder: Ladder) -> str:
    """The ladder as a table, with the command of every rung."""
    each, last = _each(ladder), ladder.rungs[-1].case
    lines = [
        f"# The ladder of {ladder.scenario.name}",
        "",
        *beneath(ladder.scenario, last.batch.plant, last.mismatch),
        delay_line(ladder),
        "",
        f"| rung | adds | {' | '.join(f'min d_{j} (m)' for j, _ in enumerate(each, 1))} | least (m) "
        "| changes by | verdict |",
        "|---" * (5 + len(each)) + "|",
    ]
    for rung in ladder.rungs:
        row = rung.row
        numbers = (_metres(row[key]) for key in (*each, "min_distance_m"))
        lines.append(
            f"| {rung.name} | {rung.adds} | {' | '.join(numbers)} | {_change(rung)} | {row['verdict']} |"
        )
    idle = idle_lines(ladder)
    lines += ["", *idle, *([""] if idle else []), "![The ladder](ladder.png)", ""]
    lines += [line for rung in ladder.rungs for line in (f"    {rung.command}",)]
    return "\n".join(lines) + "\n"


def idle_lines(ladder: Ladder) -> list[str]:
    """What is without effect on which rungs, a line per key."""
    rungs: dict[str, list[str]] = {}
    for rung in ladder.rungs:
        for key in rung.idle:
            rungs.setdefault(key, []).append(rung.name)
    return [f"{key} is without effect on: {', '.join(names)}." for key, names in rungs.items()]


def rich_table(ladder: Ladder) -> Table:
    """The rungs as a table for the terminal."""
    from rich.table import Table

    each = _each(ladder)
    heads = (f"min d_{j}" for j, _ in enumerate(each, 1))
    grid = Table("rung", "adds", *heads, "changes by", "verdict", box=None, pad_edge=False)
    for rung in ladder.rungs:
        numbers = (_metres(rung.row[key]) for key in each)
        grid.add_row(rung.name, rung.adds, *numbers, _change(rung), rung.row["verdict"])
    return grid


def waterfall(ladder: Ladder) -> Figure:
    """Least d_j on every rung; below it, larger, what the step there took or gave."""
    figure, (axes, steps) = sheet((3, 2), 5.9)
    least = [rung.row["min_distance_m"] for rung in ladder.rungs]
    unit = length(
        max((abs(rung.cost_m) for rung in ladder.rungs if rung.cost_m is not None), default=0.0)
    ).split()[1]
    for i, (rung, now) in enumerate(zip(ladder.rungs, least, strict=True)):
        if now is None:
            axes.text(i, 0, "no data", ha="center", va="bottom", fontsize=9)
        else:
            axes.bar(i, now, color=COLOURS["vehicle_1"], alpha=0.85, width=0.7)
            _beyond(axes, i, now, f"{now:.3f} m")
        if rung.cost_m is not None:
            gain = -rung.cost_m * (1e3 if unit == "mm" else 1.0)
            steps.bar(i, gain, color=COLOURS["vehicle_2" if gain < 0 else "ego"], width=0.7)
            _beyond(steps, i, gain, length(-rung.cost_m, 2, "+"))
    axes.axhline(0, color=LINE, linewidth=1)
    floor = ladder.scenario.expect.min_distance_m.at_least
    if floor:
        axes.axhline(floor, color=LINE, linewidth=1, linestyle=":")
    steps.axhline(0, color="black", linewidth=0.7)
    for panel in (axes, steps):
        low, high = panel.get_ylim()
        panel.set_ylim(low - (0.2 * (high - low) if low < 0 else 0), high + 0.2 * (high - low))
        panel.grid(visible=False, axis="x")
    if floor:
        ends(axes, [End(f"floor {floor:g} m", np.array([floor]), LINE)])
    steps.set_xticks(range(len(ladder.rungs)), [rung.name for rung in ladder.rungs])
    steps.set_xlim(-0.5, len(ladder.rungs) - 0.5)
    axes.set_ylabel("least $d_j$ (m)")
    steps.set_ylabel(f"this step adds ({unit})")
    given = ladder.rungs[-1].case.batch.overrides
    head(
        figure,
        f"{ladder.scenario.name}: what is left of the margin, rung by rung",
        delay_line(ladder),
        *([f"set: {', '.join(given)}"] if given else []),
    )
    return figure


def _beyond(axes: Axes, at: int, value: float, text: str) -> None:
    """Writes what a bar comes to beyond its end."""
    up = value >= 0
    where, va = (0, 3 if up else -3), "bottom" if up else "top"
    axes.annotate(words(text), (at, value), where, textcoords="offset points", ha="center", va=va)


def delay_line(ladder: Ladder) -> str:
    """What of a mismatch is in force from which rung on, in words."""
    why = "nominal, because the scenario has none" if ladder.nominal else "the scenario's own"
    return f"The command delay is {ladder.delay_s:g} s ({why}); any other mismatch waits for the last rung."


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _change(rung: Rung) -> str:
    """What a rung gives to the least distance, or takes from it (-): the same sign in tables and figures."""
    return "" if rung.cost_m is None else length(-rung.cost_m, sign="+")
