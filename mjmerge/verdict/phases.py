"""A run as phases: what state each thing that is watched was in, and when it changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjmerge.law import Law
from mjmerge.simulation.trace import Trace
from mjmerge.state import Mask
from mjmerge.verdict.hypotheses import HYPOTHESES, broken, own
from mjmerge.verdict.metrics import intends, merged, saturated

DECISION = ("keeps its lane", "merging", "merged")
SAFETY = ("outside both margins", "inside a margin", "touching")
ACTUATION = ("within limits", "saturated")
CONTRACT = ("holds", "broken")
ENDED = "ended"
"""State of everything once a simulation has stopped before its time."""
WATCHED = {"decision": DECISION, "safety": SAFETY, "actuation": ACTUATION}
"""What is watched beside the hypotheses."""
ROAD = {"road": ("on the road", "off the end")}
"""What else is watched where the ego's lane ends."""

NAMES: dict[str, tuple[str, ...]] = {
    **WATCHED,
    **ROAD,
    **dict.fromkeys(HYPOTHESES, CONTRACT),
}
"""What can be watched, whatever the law, and the states it can be in, from the calmest on."""


def names(law: Law, *, ends: bool = False) -> dict[str, tuple[str, ...]]:
    """What is watched under a law, and the states it can be in.

    Args:
        law: which.
        ends: whether the ego's lane ends.
    """
    of = [name for name, one in HYPOTHESES.items() if one.of(law, ends=ends)]
    return {**WATCHED, **(ROAD if ends else {}), **dict.fromkeys((*of, *own(law)), CONTRACT)}


@dataclass(frozen=True)
class Phase:
    """A state that begins.

    Attributes:
        subject: what is watched, a key of ``NAMES`` or a hypothesis of the law's own.
        time_s: when, s.
        state: one of its states, or ``ENDED``.
    """

    subject: str
    time_s: float
    state: str


def phases(trace: Trace, run: int = 0) -> list[Phase]:
    """Every change of state in one simulation, subject by subject; the first of each is at t = 0."""
    data = ~np.isnan(trace.front_m[run, :, 0, 0])
    end = len(data) if data.all() else int(np.argmin(data))
    found = []
    for subject, index in _states(trace, run).items():
        changes = np.flatnonzero(np.diff(index[:end], prepend=-1))
        found += [
            Phase(subject, float(trace.time_s[k]), NAMES.get(subject, CONTRACT)[index[k]]) for k in changes
        ]
        if end < len(data):
            found.append(Phase(subject, float(trace.time_s[end]), ENDED))
    return found


def _states(trace: Trace, run: int) -> dict[str, NDArray[np.int64]]:
    """The state of each subject at every tick, as an index into its names, (T,)."""
    inside: Mask = np.any(trace.distance_m[run] <= 0, axis=1)
    touching: Mask = np.any(trace.touching_ego[run], axis=1)
    merging = intends(trace)[run]
    return {
        "decision": np.where(merged(trace)[run] & merging, 2, merging.astype(np.int64)),
        "safety": np.where(touching, 2, inside.astype(np.int64)),
        "actuation": saturated(trace)[run, :, 0].astype(np.int64),
        **({} if trace.edge_distance_m is None else {"road": trace.off_the_end[run].astype(np.int64)}),
        **{name: marks[run].astype(np.int64) for name, marks in broken(trace).items()},
    }
