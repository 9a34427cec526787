"""A law that was tried: how it stands what was found, and what it costs where nothing is different."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from mjmerge.config.bounds import LONGEST_S
from mjmerge.errors import ScenarioError
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.search.against import PROOF
from mjmerge.search.falsify import SCREEN_S
from mjmerge.search.margin import Kind, Margin, called, margin, margins
from mjmerge.search.space import Ground, altered, checked
from mjmerge.simulation.each import simulate_each
from mjmerge.sweep.fidelity import coarse
from mjmerge.sweep.plan import written
from mjmerge.sweep.workers import HERE, Workers
from mjmerge.verdict.metrics import lateral_error_m, merged_at_s, peak_u_mps2

LEAST_STOOD = 0.5
"""Part of the cases that must be fair to a law, or it is no solution: it would ask for too much."""

LONGER = 2
"""Times the scenario's duration that a law has for its merge where nothing is different."""

Case = tuple[int, Scenario]
"""Seed and scenario, under the scenario's own law."""


@dataclass(frozen=True)
class Candidate:
    """A law, how it stands some cases, and what it costs.

    Attributes:
        settings: keys that differ from the scenario's.
        holds: whether it keeps the scenario's floor without any mismatch, by the scenario's margin r and by
            its own.
        nominal_m: margin there, m.
        merged_s: when it has merged there, s; ``None`` if it has not after :data:`LONGER` times the duration.
        peak_mps2: most that it asks of the ego there, m/s^2.
        margins_m: of each case, m; ``None`` where it was not fair to it, and so was not run.
        enters: in how many of the cases that were run it gets more than half way into the leader's lane.
    """

    settings: Mapping[str, Any]
    holds: bool
    nominal_m: float
    merged_s: float | None
    peak_mps2: float
    margins_m: tuple[float | None, ...] = ()
    enters: int = 0

    @property
    def stood(self) -> tuple[float, ...]:
        """Margins of the cases that were fair to it, m."""
        return tuple(one for one in self.margins_m if one is not None)

    @property
    def left_out(self) -> int:
        """How many cases were not."""
        return len(self.margins_m) - len(self.stood)

    @property
    def worst_m(self) -> float:
        """Least margin over the cases, m; NaN without any."""
        return min(self.stood, default=float("nan"))

    @property
    def may_solve(self) -> bool:
        """Whether it merges and keeps the floor where nothing is different."""
        return self.merged_s is not None and self.holds

    @property
    def solves(self) -> bool:
        """Whether it does, and most cases were fair to it: only such a law can be chosen."""
        return self.may_solve and bool(self.stood) and len(self.stood) >= LEAST_STOOD * len(self.margins_m)

    @property
    def runs(self) -> int:
        """Runs that it took."""
        return 1 + len(self.stood)

    @property
    def words(self) -> str:
        """What differs."""
        return spelt(self.settings)


def spelt(settings: Mapping[str, Any]) -> str:
    """What differs, in words."""
    return ", ".join(f"{key}={written(value)}" for key, value in settings.items()) or "as it is"


def counted_m(margin_m: float | None, kind: Kind | None) -> float:
    """What a run counts for, m: its margin, and no more than 0 where it failed or nothing is known of it."""
    if margin_m is None or not np.isfinite(margin_m):
        return 0.0
    return margin_m if kind is None else min(margin_m, 0.0)


def held_against(
    ground: Ground,
    laws: Sequence[Mapping[str, Any]],
    cases: Sequence[Case],
    *,
    anyway: bool = False,
    team: Workers = HERE,
) -> list[Candidate | None]:
    """How laws stand some cases, and what they cost where nothing is different.

    A law that never merges there, or does not keep the floor, is not held against any case. A case that is
    not fair to a law (on the plant of the proof it does not keep the floor under it, or a hypothesis breaks)
    does not count against it.

    Args:
        ground: the scenario, and the margin by which all are judged.
        laws: the keys of each that differ, L of them.
        cases: seed and scenario of each, N of them.
        anyway: whether all cases are run with every law.
        team: who runs them; does not change the result.

    Returns:
        Each of the laws, (L,); ``None`` for one with which the scenario is none.
    """
    plain = _plain(ground.scenario)
    made = [_or_none(plain, settings) for settings in laws]
    nominal = iter(_read([(0, one) for one in made if one is not None], ground, team))
    found = [
        None if one is None else _costs(settings, next(nominal))
        for settings, one in zip(laws, made, strict=True)
    ]
    runs: dict[tuple[int, int], Case] = {}  # by law and case
    for i, law in enumerate(found):
        for k, (seed, scenario) in enumerate(cases):
            if law is not None and (anyway or law.may_solve):
                other = _or_none(scenario, laws[i])
                if other is not None:
                    runs[i, k] = seed, other
    there = [(seed, PROOF.of(scenario)) for seed, scenario in runs.values()]
    ideal = margins(there, PROOF.plant(ground.plant), r_m=ground.r_m, team=team)
    fair = [at for at, one in zip(runs, ideal, strict=True) if one.holds and not one.broken]
    real = dict(zip(fair, _read([runs[at] for at in fair], ground, team), strict=True))
    for i, law in enumerate(found):
        if law is not None and (anyway or law.may_solve):
            found[i] = replace(law, **_stood([real.get((i, k)) for k in range(len(cases))]))
    return found


@dataclass(frozen=True)
class _Reading:
    """A run.

    Attributes:
        margin: by the ground's margin r.
        own: by that of its own law.
        merged_s: when it has merged, s; ``None`` if never.
        enters: whether the ego gets more than half way into the leader's lane.
        peak_mps2: most that was asked of the ego, m/s^2.
    """

    margin: Margin
    own: Margin
    merged_s: float | None
    enters: bool
    peak_mps2: float


def _costs(settings: Mapping[str, Any], run: _Reading) -> Candidate:
    holds = run.margin.holds and run.own.holds
    return Candidate(dict(settings), holds, run.margin.least_m, run.merged_s, run.peak_mps2)


def _stood(runs: Sequence[_Reading | None]) -> dict[str, Any]:
    margins_m = tuple(None if one is None else counted_m(one.margin.least_m, one.margin.kind) for one in runs)
    return {"margins_m": margins_m, "enters": sum(one is not None and one.enters for one in runs)}


def _or_none(scenario: Scenario, settings: Mapping[str, Any]) -> Scenario | None:
    try:
        return checked(altered(scenario, settings))
    except ScenarioError:
        return None


def _plain(scenario: Scenario) -> Scenario:
    """Where nothing is different, and longer, if it can be."""
    plain = scenario.model_copy(update={"mismatch": Mismatch()})
    longer_s = min(LONGER * scenario.duration_s, LONGEST_S)
    return _or_none(plain, {"duration_s": longer_s}) or plain


def _read(cases: Sequence[Case], ground: Ground, team: Workers) -> list[_Reading]:
    """Runs some cases on the plant; the same for any number of workers."""
    made = [(seed, coarse(scenario, ground.plant, SCREEN_S)) for seed, scenario in cases]
    return team.each(partial(_readings, ground.plant, ground.r_m), made, called)


def _readings(plant: str, r_m: float | None, cases: Sequence[Case], threads: int) -> list[_Reading]:
    found = []
    for trace in simulate_each(cases, plant, threads=threads):
        merged = float(merged_at_s(trace)[0])
        when = merged if np.isfinite(merged) else None
        across_m = np.abs(lateral_error_m(trace)[0])
        enters = bool(np.nanmin(across_m) < across_m[0] / 2)
        peak_mps2 = float(peak_u_mps2(trace)[0])
        found.append(_Reading(margin(trace, r_m), margin(trace), when, enters, peak_mps2))
    return found
