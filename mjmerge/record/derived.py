"""Numbers that follow from other numbers of the same recording, computed again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mjmerge.law import Sensed, advance, decide
from mjmerge.record.check import Check, checked, compared
from mjmerge.record.read import Recorded
from mjmerge.sensing import exact
from mjmerge.state import dot, norm
from mjmerge.trace import Array, Trace

_DISTANCE_M = 1e-12
"""Distances follow from positions to the last bit on any processor; this much is allowed, or this part."""
_RELATIVE = 1e-9
"""Commands and opinion go through tanh and exp, whose last bits differ between processors."""


def derived(found: Recorded, trace: Trace) -> Iterator[Check]:
    """Every check of a number against others."""
    yield _distances(found, trace)
    yield _law(found, trace)
    yield _opinion(found, trace)


def geometry(front_m: Array, velocity_mps: Array, r_m: float) -> dict[str, Any]:
    """d_j, d_j' and the gap from positions and velocities, by column; (..., C, 2) -> (...)."""

    def apart(p: Array, v: Array) -> tuple[Array, Array]:
        length = norm(p)
        unit = p / np.where(length == 0, 1.0, length)[..., None]
        return length - r_m, dot(unit, v)

    def between(a: int, b: int) -> tuple[Array, Array]:
        return apart(
            front_m[..., a, :] - front_m[..., b, :], velocity_mps[..., a, :] - velocity_mps[..., b, :]
        )

    ones, twos = zip(between(0, 1), between(0, 2), strict=True)
    gap, gap_rate = between(2, 1)
    distance, rate = np.stack(ones, axis=-1), np.stack(twos, axis=-1)
    return {"distance_m": distance, "distance_rate_mps": rate, "gap_m": gap, "gap_rate_mps": gap_rate}


def _distances(found: Recorded, trace: Trace) -> Check:
    """d_j, d_j' and the gap follow from the positions and velocities."""
    c = found.columns
    expected = geometry(c["front_m"], c["velocity_mps"], trace.scenario.law.r_m)
    says = "d_j, d_j' and the gap, from positions and velocities"
    return _check("distances", says, found, expected, _DISTANCE_M, _DISTANCE_M)


def _law(found: Recorded, trace: Trace) -> Check:
    """The law says what the ego was told, from what it saw and its opinion."""
    if not exact(trace.scenario.mismatch):
        return Check(
            "law", None, "not checked: the ego was not told the truth, and what it was told is not here"
        )
    c = found.columns
    p, v, u = c["front_m"], c["velocity_mps"], c["u_mps2"]
    sensed = Sensed(p=p[:, 0], v=v[:, 0], p_j=p[:, 1:], v_j=v[:, 1:], u_1=u[:, 1])
    with np.errstate(all="ignore"):
        told = decide(trace.scenario.law, sensed, c["opinion"])
    expected = {
        "weight": told.w,
        "mu_input_per_s": told.mu_input,
        "target_m": p[:, 1] + told.e_1_star,
        "u_n_mps2": told.u_n,
        "u_c_mps2": told.u_c,
    }
    says = "target, u_n, u_c, w and the input of mu, from motion and opinion"
    return _check("law", says, found, expected, _RELATIVE, _RELATIVE)


def _opinion(found: Recorded, trace: Trace) -> Check:
    """Opinion z and mu follow from one tick to the next."""
    if trace.continuous:
        return Check("opinion", None, "not checked: in continuous time it has no steps")
    c, law, step_s = found.columns, trace.scenario.law, trace.scenario.control_step_s
    before = np.flatnonzero(np.diff(found.ticks) == 1)
    with np.errstate(all="ignore"):
        z, mu = advance(law, c["opinion"][before], c["mu"][before], c["mu_input_per_s"][before], step_s)
    expected = {"opinion": z, "mu": mu}
    return _check(
        "opinion", "z and mu, each from the tick before", found, expected, _RELATIVE, 1e-12, before + 1
    )


def _check(
    name: str,
    says: str,
    found: Recorded,
    expected: Mapping[str, Array],
    relative: float,
    absolute: float,
    rows: Any = slice(None),
) -> Check:
    """Recorded columns against what they should be."""
    columns = {column: found.columns[column][rows] for column in expected}
    time_s = found.ticks[rows] * found.step_s
    wrong, most = compared(columns, expected, time_s, relative, absolute)
    return checked(name, wrong, f"{says}: off by at most {most:.1g}")
