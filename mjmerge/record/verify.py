"""``mjmerge verify``: does a recording say the truth about itself? Read with nothing but the file.

The distances are computed again from the recorded positions, the commands from positions, velocities and
opinion, and margins, contract and verdict from those; each is held against what the file claims.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.contract import INCOMPLETE, Verdict, judge
from mjmerge.errors import MjmergeError
from mjmerge.law import Sensed, advance, decide
from mjmerge.metrics import events
from mjmerge.phases import phases
from mjmerge.record.digest import digests
from mjmerge.record.manifest import CONVENTIONS, SCHEMA_VERSION, versions
from mjmerge.record.read import Recorded, read
from mjmerge.report import summary
from mjmerge.sensing import exact
from mjmerge.state import dot, norm
from mjmerge.trace import COLUMNS, Array, Trace

if TYPE_CHECKING:
    from rich.table import Table

_DISTANCE_M = 1e-12
"""Distances follow from positions to the last bit on any processor; this much is allowed, or this part."""
_RELATIVE = 1e-9
"""Commands and opinion go through tanh and exp, whose last bits differ between processors."""
_MARGINS = ("min_distance_m", "t_min_distance_s", "min_clearance_m", "floor_m", "floor_held")
_VERDICT = ("verdict", "verdict_reason", "verdicts")
_MOST_NAMED = 3
_NOTHING = "nothing to report"


@dataclass(frozen=True)
class Check:
    """One thing looked at.

    Attributes:
        name: what.
        right: whether it is right; ``None`` for what is worth knowing and neither.
        says: what was found, in words.
    """

    name: str
    right: bool | None
    says: str


@dataclass(frozen=True)
class Verified:
    """What came of it.

    Attributes:
        recorded: the file as read.
        checks: in the order made; later ones are left out where an earlier one leaves them no ground.
        verdict: that of the recorded positions; ``None`` where they could not be judged.
    """

    recorded: Recorded
    checks: tuple[Check, ...]
    verdict: Verdict | None

    @property
    def right(self) -> bool:
        """Whether nothing is wrong."""
        return all(check.right is not False for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """What ``--json`` prints."""
        return {
            "file": str(self.recorded.path),
            "format": self.recorded.kind,
            "right": self.right,
            "finished": self.recorded.finished and self.recorded.verdict is not None,
            "ticks": len(self.recorded.ticks),
            "verdict": self.verdict.verdict if self.verdict else None,
            "claimed_verdict": self.recorded.verdict,
            "checks": [{"name": c.name, "right": c.right, "says": c.says} for c in self.checks],
        }


def verify(path: Path) -> Verified:
    """Checks a recording.

    Raises:
        UnreadableError: it is no recording, or it does not even say what the run was.
    """
    found = read(path)
    checks = [_file(found), _schema(found)]
    if not checks[-1].right:
        return Verified(found, tuple(checks), None)
    checks += [_columns(found), _versions(found)]
    if not checks[-2].right or not len(found.ticks):
        return Verified(found, tuple(checks), None)
    try:
        trace = found.trace()
    except MjmergeError as error:
        return Verified(found, (*checks, Check("scenario", False, str(error))), None)
    checks += [_time(found), _length(found, trace), _fingerprints(found)]
    checks += [_distances(found, trace), _commands(found, trace), _opinion(found, trace)]

    again = _judged_from_positions(trace)
    (verdict,) = judge(again)
    return Verified(found, (*checks, *_claims(found, again, verdict)), verdict)


def _file(found: Recorded) -> Check:
    """The file is complete."""
    if found.finished and not found.fault and found.verdict is not None:
        return Check("file", True, f"complete, {found.kind}, {found.path.stat().st_size / 1e6:.1f} MB")
    reach = f"has data up to {found.last_s:.2f} s" if len(found.ticks) else "has no data yet"
    why = f" ({found.fault})" if found.fault else ""
    if not found.finished:
        return Check(
            "file", False, f"unfinished{why}: it {reach}; `mjmerge recover` makes a whole file of it"
        )
    if found.fault:
        return Check("file", False, f"damaged{why}; it {reach}")
    return Check("file", False, f"the run was cut off: it {reach} and no verdict; `mjmerge recover` adds one")


def _schema(found: Recorded) -> Check:
    """The file is of the schema that this version reads."""
    same = found.schema_version == SCHEMA_VERSION
    says = f"version {found.schema_version}"
    return Check("schema", same, says if same else f"{says}; this mjmerge reads version {SCHEMA_VERSION}")


def _columns(found: Recorded) -> Check:
    """Names with their units, axes and conventions are ours, and all of them are there."""
    ours = {c.name: [list(axis) for axis in c.axes] for c in COLUMNS}
    claimed = {c.get("name", ""): c.get("axes") for c in found.manifest.get("columns", ())}
    wrong = sorted(n for n in ours.keys() | claimed.keys() if ours.get(n) != claimed.get(n))
    if wrong:
        return Check("columns", False, f"other names, units or axes than ours: {_some(wrong)}")
    if found.manifest.get("conventions") != CONVENTIONS:
        return Check("columns", False, "other conventions than ours about units, frames or time")
    missing = sorted(ours.keys() - found.columns.keys())
    if missing and len(found.ticks):
        return Check("columns", False, f"not in the file: {_some(missing)}")
    if missing:
        return Check("columns", None, "not a tick of any of them")
    return Check("columns", True, f"{len(ours)}, names and units as declared")


def _versions(found: Recorded) -> Check:
    """Versions of the packages that matter; others than here are no mistake."""
    made, here = found.manifest.get("versions", {}), versions()
    other = [f"{n} {v} (here {here.get(n, 'none')})" for n, v in made.items() if here.get(n) != v]
    if other:
        return Check("versions", None, f"made with {', '.join(other)}")
    return Check("versions", True, f"all {len(made)} as here")


def _time(found: Recorded) -> Check:
    """Every series has every tick once, at its time."""
    wrong = []
    last = max(int(ticks.max()) for ticks, _ in found.grids.values())
    if found.verdict is None:  # cut off: some series may have a block that others have not
        last = int(found.ticks[-1])
    for name, (ticks, time_ns) in found.grids.items():
        there, counts = np.unique(ticks[ticks <= last], return_counts=True)
        lacks = np.flatnonzero(there != np.arange(len(there)))
        if lacks.size or len(there) <= last:
            wrong.append(f"{name} lacks tick {lacks[0] if lacks.size else len(there)}")
        wrong += [f"{name} has tick {there[k]} more than once" for k in np.flatnonzero(counts > 1)[:1]]
        if np.any(np.diff(time_ns) < 0):
            wrong.append(f"{name} goes back in time")
        off = np.flatnonzero(time_ns != np.rint(ticks * found.step_s * 1e9))
        wrong += [f"{name} has tick {ticks[k]} at {time_ns[k]} ns" for k in off[:1]]
    if not np.array_equal(found.columns["time_s"], found.ticks * found.step_s):
        wrong.append("time_s is not the tick's number times the control step")
    if wrong:
        return Check("time", False, _some(wrong))
    return Check("time", True, f"{len(found.ticks)} ticks of {found.step_s:g} s, no gaps, none twice")


def _length(found: Recorded, trace: Trace) -> Check:
    """The run goes to its end, or to where the file says that it stopped."""
    step_s, last = trace.scenario.control_step_s, int(found.ticks[-1])
    if abs(step_s - found.step_s) > 0:
        return Check("length", False, f"ticks of {found.step_s:g} s, but the scenario has {step_s:g} s")
    if found.verdict is None:
        return Check("length", None, f"{found.last_s:.2f} s of {trace.scenario.duration_s:g} s")
    end, why = trace.scenario.ticks - 1, "the scenario"
    if trace.stops:
        end = round(trace.stops[0].time_s / step_s) - 1
        why = f"that it stopped: {trace.stops[0].car}, {trace.stops[0].reason}"
    if last != end:
        return Check("length", False, f"it ends at {last * step_s:.2f} s, not at {end * step_s:.2f} s: {why}")
    return Check("length", True, f"{last * step_s:.2f} s, as it says" + (f" {why}" if trace.stops else ""))


def _fingerprints(found: Recorded) -> Check:
    """No number was changed after it was written."""
    if not found.sha256:
        says = "none in the file" if found.verdict is not None else "none yet: they are written at the end"
        return Check("fingerprints", False if found.verdict is not None else None, says)
    now = digests(found.columns, found.texts)
    changed = sorted(n for n in now.keys() | found.sha256.keys() if now.get(n) != found.sha256.get(n))
    if changed:
        return Check("fingerprints", False, f"changed since they were recorded: {_some(changed)}")
    return Check(
        "fingerprints", True, f"of {len(found.columns)} columns, scenario and world as recorded, SHA-256"
    )


def _geometry(front_m: Array, velocity_mps: Array, r_m: float) -> dict[str, Array]:
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
    expected = _geometry(c["front_m"], c["velocity_mps"], trace.scenario.law.r_m)
    says = "d_j, d_j' and the gap, from positions and velocities"
    return _compared("distances", says, found, expected, _DISTANCE_M, _DISTANCE_M)


def _commands(found: Recorded, trace: Trace) -> Check:
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
    return _compared("law", says, found, expected, _RELATIVE, _RELATIVE)


def _opinion(found: Recorded, trace: Trace) -> Check:
    """Opinion z and mu follow from one tick to the next."""
    if trace.continuous:
        return Check("opinion", None, "not checked: in continuous time it has no steps")
    c, law, step_s = found.columns, trace.scenario.law, trace.scenario.control_step_s
    before = np.flatnonzero(np.diff(found.ticks) == 1)
    with np.errstate(all="ignore"):
        z, mu = advance(law, c["opinion"][before], c["mu"][before], c["mu_input_per_s"][before], step_s)
    expected = {"opinion": z, "mu": mu}
    return _compared(
        "opinion", "z and mu, each from the tick before", found, expected, _RELATIVE, 1e-12, before + 1
    )


def _compared(
    name: str,
    says: str,
    found: Recorded,
    expected: Mapping[str, Array],
    relative: float,
    absolute: float,
    rows: Any = slice(None),
) -> Check:
    """Recorded columns against what they should be; says which is off most, by how much, and when."""
    wrong, most = [], 0.0
    for column, value in expected.items():
        there = found.columns[column][rows]
        with np.errstate(invalid="ignore"):
            off = np.where((there == value) | (np.isnan(there) & np.isnan(value)), 0.0, np.abs(there - value))
            bad = ~(off <= absolute + relative * np.abs(value))
        most = max(most, float(np.nanmax(off, initial=0.0)))
        if bad.any():
            bad_rows = np.flatnonzero(bad.reshape(len(bad), -1).any(axis=1))
            time_s = found.ticks[rows][bad_rows[0]] * found.step_s
            worst = float(np.max(np.where(bad, np.nan_to_num(off, nan=np.inf), 0)))
            wrong.append(
                f"{column} is off at {len(bad_rows)} ticks, first at {time_s:.2f} s, by up to {worst:.3g}"
            )
    return Check(name, not wrong, _some(wrong) if wrong else f"{says}: off by at most {most:.1g}")


def _judged_from_positions(trace: Trace) -> Trace:
    """The trace with its distances computed from its positions."""
    expected: dict[str, Any] = _geometry(trace.front_m, trace.velocity_mps, trace.scenario.law.r_m)
    return replace(trace, **expected)


def _claims(found: Recorded, trace: Trace, verdict: Verdict) -> Iterator[Check]:
    """Margins, contract, verdict and what happened, against what the file says of them."""
    expected = summary(trace, [verdict], 1.0)
    if found.verdict is None or found.summary is None:
        least = expected["min_distance_m"]
        so_far = ", ".join(f"{d:.4f} m to {car}" for car, d in least.items() if d is not None)
        words = "nothing wrong so far" if verdict.verdict == INCOMPLETE else verdict.reason
        yield Check("margins", None, f"so far {so_far}; the file claims none")
        yield Check("verdict", None, f"{verdict.verdict}: {words}; the file claims none")
        return
    claimed = found.summary
    groups: dict[str, tuple[str, ...]] = {
        "margins": _MARGINS,
        "contract": ("hypotheses",),
        "verdict": _VERDICT,
    }
    known = {key for keys in groups.values() for key in keys} | {"real_time_factor"}
    groups["summary"] = tuple(sorted((expected.keys() & claimed.keys()) - known))
    least = [
        f"d_{j} >= {d:.4f} m" for j, d in enumerate(expected["min_distance_m"].values(), 1) if d is not None
    ]
    broke = sum(at is not None for at in expected["hypotheses"].values())
    says = {
        "margins": ", ".join(least),
        "contract": f"{broke} of {len(expected['hypotheses'])} hypotheses broke, when it says",
        "verdict": f"{verdict.verdict}: {verdict.reason}",
        "summary": f"{len(groups['summary'])} more numbers",
    }
    for name, keys in groups.items():
        wrong = [w for key in keys for w in _differing(key, claimed.get(key), expected.get(key))]
        if name == "verdict" and found.verdict != verdict.verdict:
            wrong.insert(0, f"the file says {found.verdict!r}, its positions say {verdict.verdict!r}")
        yield Check(name, not wrong, _some(wrong) if wrong else says[name])
    yield _happened(found, trace, verdict)


def _differing(key: str, claimed: Any, expected: Any) -> Iterator[str]:
    """Where two summaries differ, key by key."""
    if isinstance(expected, Mapping) and isinstance(claimed, Mapping):
        for part in sorted(expected.keys() | claimed.keys()):
            yield from _differing(f"{key}.{part}", claimed.get(part), expected.get(part))
    elif isinstance(expected, float) and isinstance(claimed, int | float):
        if abs(claimed - expected) > _RELATIVE * max(1.0, abs(expected)):
            yield f"{key}: the file says {claimed:.6g}, its positions say {expected:.6g}"
    elif claimed != expected:
        yield f"{key}: the file says {claimed!r}, its positions say {expected!r}"


def _happened(found: Recorded, trace: Trace, verdict: Verdict) -> Check:
    """Events and phases are those of the trace."""

    def ns(time_s: float) -> int:
        return int(np.rint(time_s * 1e9))

    said = [(ns(e.time_s), e.level, f"{e.car}: {e.text}") for e in [*events(trace), *verdict.events()]]
    states = [(ns(p.time_s), p.subject, p.state) for p in phases(trace)]
    there = [e for e in found.said if e[2] != _NOTHING]
    wrong = []
    for name, ours, theirs in (("event", said, there), ("phase", states, found.states)):
        for word, some in (("missing", set(ours) - set(theirs)), ("not so", set(theirs) - set(ours))):
            wrong += [f"{name} {word}: {text!r} at {t / 1e9:.2f} s" for t, *_, text in sorted(some)]
    says = f"{len(there)} events and {len(found.states)} changes of phase"
    return Check("events", not wrong, _some(wrong) if wrong else says)


def _some(items: list[str]) -> str:
    """The first few of a list."""
    more = f", and {len(items) - _MOST_NAMED} more" if len(items) > _MOST_NAMED else ""
    return "; ".join(items[:_MOST_NAMED]) + more


def table(verified: Verified) -> Table:
    """The checks, for the terminal."""
    from rich.table import Table
    from rich.text import Text

    marks = {True: "[green]right[/]", False: "[bold red]WRONG[/]", None: "[yellow]note[/]"}
    grid = Table(show_header=False, box=None, pad_edge=False)
    grid.add_column(style="bold")
    grid.add_column()
    grid.add_column()
    for check in verified.checks:
        grid.add_row(check.name, marks[check.right], Text(check.says))
    return grid
