"""The paper's Section 4 over again: its figures, its facts, and a film, from the one scenario ``paper``.

Ideal is the paper's own world: a double integrator in continuous time. Beside it are MuJoCo's cars under the
same law. Of each there is a second run with k_o = 0 and everything else the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.figures.animation import animate
from mjmerge.figures.runs import distances, opinion
from mjmerge.figures.style import save, save_columns, save_rows
from mjmerge.law import of_paper
from mjmerge.outputs import prepare, put
from mjmerge.paper.bifurcation import Branches, branches, converging
from mjmerge.paper.diagram import bifurcation, bifurcation_run
from mjmerge.paper.facts import FACTS, FactCheck, Pair, read
from mjmerge.paper.tables import facts_markdown
from mjmerge.scenario.load import load
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IDEAL, REAL = "ideal", "mujoco"
FIGURES = ("bifurcation", "opinion", "distances", "distances_no_barrier")
"""The paper's figures; each is drawn of the ideal, and of MuJoCo beside it with ``_mujoco`` in its name."""
FILES = (
    *(f"{name}{of}.{kind}" for name in FIGURES for of in ("", f"_{REAL}") for kind in ("png", "pdf", "csv")),
    "bifurcation_trajectories.csv",
    "merge.gif",
    "facts.csv",
    "facts.md",
)
"""All that is written; ``facts.md`` comes last and marks the folder as complete."""

_HELD_AT = np.array([-0.75, -0.5, -0.25, 0.25, 0.5, 0.75])  # of the largest |mu|, k_s/k_mu
_FROM = np.array([0.025, 0.6, 1.2])  # of the largest z, which is the same
_CONVERGES_S = 6.0
_SIMULATED, _DRAWN = 0.6, 0.6  # part of all work done after the simulations, of the rest after the figures

Progress = Callable[[float], None]
Draw = Callable[..., "Figure"]
Tabulate = Callable[[Trace], dict[str, Array]]


@dataclass(frozen=True)
class Reproduction:
    """What came of it.

    Attributes:
        findings: of each plant, whether each of ``facts.FACTS`` was reproduced.
        replaced: whether an earlier reproduction in the same folder made way.
    """

    findings: Mapping[str, Sequence[FactCheck]]
    replaced: bool

    @property
    def complete(self) -> bool:
        """Whether every published fact was reproduced, on every plant."""
        return all(f.holds is not False for found in self.findings.values() for f in found)


def reproduce(folder: Path, *, replace: bool = False, progress: Progress | None = None) -> Reproduction:
    """Simulates, draws and checks everything, and leaves it in a folder.

    Args:
        folder: where it goes.
        replace: whether an earlier reproduction in that folder may make way.
        progress: called with the part that is done, 0 to 1.

    Raises:
        OutputError: the folder cannot be written, or holds something that would be overwritten.
    """
    report = progress or (lambda _: None)
    replaced = prepare(folder, replace, FILES)
    pairs = runs(load("paper"), _part(report, 0.0, _SIMULATED))
    findings = {plant: read(pair) for plant, pair in pairs.items()}
    write(folder, pairs, findings, _part(report, _SIMULATED, 1.0))
    return Reproduction(findings, replaced)


def runs(scenario: Scenario, progress: Progress) -> dict[str, Pair]:
    """A scenario and the same with k_o = 0, ideal and on MuJoCo."""
    without = scenario.model_copy(update={"law": scenario.law.model_copy(update={"k_o": 0.0})})
    without = without.recalling((*scenario.changes, "law.k_o=0"))
    shares = {(IDEAL, False): 0.15, (IDEAL, True): 0.3, (REAL, False): 0.65, (REAL, True): 1.0}
    traces: dict[tuple[str, bool], Trace] = {}
    done = 0.0
    for (plant, open_), end in shares.items():
        traces[plant, open_] = simulate(
            without if open_ else scenario,
            "double_integrator" if plant == IDEAL else REAL,
            continuous=plant == IDEAL,
            progress=_part(progress, done, end, scenario.duration_s),
        )
        done = end
    return {plant: Pair(traces[plant, False], traces[plant, True]) for plant in (IDEAL, REAL)}


def write(
    folder: Path, pairs: Mapping[str, Pair], findings: Mapping[str, Sequence[FactCheck]], progress: Progress
) -> None:
    """Figures with their numbers, the film, the tables of facts."""
    ideal, real = pairs[IDEAL], pairs[REAL]
    law = of_paper(ideal.barrier.scenario.law)
    most = law.k_s / law.k_mu
    mu, time_s = most * _HELD_AT, np.linspace(0.0, _CONVERGES_S, 601)
    z = converging(law, mu, most * _FROM, time_s)
    found = branches(law, np.linspace(-most, most, 81))
    save_columns(_held_columns(mu, time_s, z), folder / "bifurcation_trajectories.csv")
    _save(folder / "bifurcation", bifurcation(found, mu, time_s, z), _branch_columns(found))
    _save(
        folder / f"bifurcation_{REAL}",
        bifurcation_run(found, real.barrier, ideal.barrier),
        _beside(_run_columns, real.barrier, ideal.barrier),
    )
    rows: tuple[tuple[str, Draw, Tabulate, Trace, Trace], ...] = (
        ("opinion", opinion, opinion_columns, ideal.barrier, real.barrier),
        ("distances", distances, distance_columns, ideal.barrier, real.barrier),
        ("distances_no_barrier", distances, distance_columns, ideal.no_barrier, real.no_barrier),
    )
    for i, (name, draw, columns, of_ideal, of_real) in enumerate(rows):
        _save(folder / name, draw(of_ideal), columns(of_ideal))
        _save(folder / f"{name}_{REAL}", draw(of_real, of_ideal), _beside(columns, of_real, of_ideal))
        progress(_DRAWN * (i + 1) / len(rows))
    animate(real.barrier, folder / "merge.gif", _part(progress, _DRAWN, 1.0))
    _save_facts(folder, findings)


def opinion_columns(trace: Trace) -> dict[str, Array]:
    """What :func:`opinion` draws; a name without a unit is a pure number."""
    return {"time_s": trace.time_s, "z": trace.opinion[0], "ego_lateral_m": trace.front_m[0, :, 0, 1]}


def distance_columns(trace: Trace) -> dict[str, Array]:
    """What :func:`distances` draws."""
    return {"time_s": trace.time_s, "d_1_m": trace.distance_m[0, :, 0], "d_2_m": trace.distance_m[0, :, 1]}


def _run_columns(trace: Trace) -> dict[str, Array]:
    return {"time_s": trace.time_s, "mu": trace.mu[0], "z": trace.opinion[0]}


def _branch_columns(found: Branches) -> dict[str, Array]:
    """A slope below zero is a stable equilibrium."""
    columns = {"mu": found.mu}
    for branch, name in enumerate(("z_a", "z_b")):
        columns[name], columns[f"{name}_slope_per_s"] = found.z[:, branch], found.slope_per_s[:, branch]
    return columns


def _held_columns(mu: Array, time_s: Array, z: Array) -> dict[str, Array]:
    """One trajectory after the other."""
    held, start, time = np.broadcast_arrays(mu[:, None, None], z[0, :, :, None], time_s)
    return {
        "mu": held.ravel(),
        "z_start": start.ravel(),
        "time_s": time.ravel(),
        "z": np.moveaxis(z, 0, -1).ravel(),
    }


def _beside(columns: Tabulate, real: Trace, ideal: Trace) -> dict[str, Array]:
    """Both runs' columns, with ``ideal_`` and ``mujoco_`` before their names."""
    both = {"time_s": real.time_s}
    for of, trace in ((IDEAL, ideal), (REAL, real)):
        both |= {f"{of}_{name}": values for name, values in columns(trace).items() if name != "time_s"}
    return both


def _save(stem: Path, figure: Figure, columns: Mapping[str, Array]) -> None:
    """A figure as PNG and PDF, and what it draws as CSV."""
    for kind in (".png", ".pdf"):
        save(figure, stem.with_suffix(kind))
    save_columns(columns, stem.with_suffix(".csv"))


def _save_facts(folder: Path, findings: Mapping[str, Sequence[FactCheck]]) -> None:
    """The table of facts, for machines and for people."""
    header = ["published", "source", *(name for of in findings for name in (of, f"{of}_number"))]
    rows = [
        [fact.claim, fact.source, *(text for f in found for text in (f.word, f.number))]
        for fact, *found in zip(FACTS, *findings.values(), strict=True)
    ]
    save_rows([header, *rows], folder / "facts.csv")
    put(folder / "facts.md", facts_markdown(findings))


def _part(progress: Progress, begin: float, end: float, total: float = 1.0) -> Progress:
    """Progress of a part, 0 to its total, as progress of the whole."""
    return lambda done: progress(begin + (end - begin) * done / total)
