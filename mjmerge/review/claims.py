"""What a recording claims of its run, against what follows from its numbers: margins, verdict, events."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mjmerge.drivers import Absent
from mjmerge.law import AbsentLaw
from mjmerge.record.read import Recorded
from mjmerge.review.check import Check, checked, differing, some
from mjmerge.simulation.trace import Trace
from mjmerge.state import NS_PER_S, Array
from mjmerge.verdict import own
from mjmerge.verdict.judge import HELD, INCOMPLETE, VACUOUS, Verdict
from mjmerge.verdict.metrics import events
from mjmerge.verdict.phases import phases
from mjmerge.verdict.summary import ground, summary

_RELATIVE = 1e-9
_MARGINS = ("min_distance_m", "t_min_distance_s", "min_clearance_m", "floor_m", "floor_held")
_VERDICT = ("verdict", "reason", "verdicts")
_OF_THE_IDEAL: dict[str, Any] = {"reason": str, "needed": bool, "without_barrier_m": float}
"""What a summary says of the run on the ideal plant, and of which type."""
_NOTHING = "nothing to report"


def claims(found: Recorded, trace: Trace, verdict: Verdict) -> Iterator[Check]:
    """Margins, contract, verdict and every other number of the summary, and what happened.

    Args:
        found: the file as read.
        trace: the run in it, with its distances from its positions.
        verdict: of that.
    """
    expected = what_follows(found, trace, verdict)
    if found.verdict is None:
        least = expected["min_distance_m"]
        so_far = ", ".join(f"{d:.4f} m to {car}" for car, d in least.items() if d is not None)
        words = "nothing wrong so far" if verdict.verdict == INCOMPLETE else verdict.reason
        yield Check("margins", None, f"so far {so_far}; the file claims none")
        yield Check("verdict", None, f"{verdict.verdict}: {words}; the file claims none")
        return
    claimed = found.summary or {}
    groups: dict[str, tuple[str, ...]] = {
        "margins": _MARGINS,
        "contract": ("hypotheses",),
        "verdict": _VERDICT,
    }
    grouped = {key for keys in groups.values() for key in keys}
    groups["summary"] = tuple(sorted((expected.keys() | claimed.keys()) - grouped))
    least = [
        f"d_{j} >= {d:.4f} m" for j, d in enumerate(expected["min_distance_m"].values(), 1) if d is not None
    ]
    broke = sum(at is not None for at in expected["hypotheses"].values())
    says = {
        "margins": ", ".join(least),
        "contract": f"{broke} of {len(expected['hypotheses'])} hypotheses broke, when it says",
        "verdict": f"{verdict.verdict}: {verdict.reason}",
        "summary": f"{len(groups['summary'])} more entries",
    }
    absent = unknown(trace)
    if absent:
        allow(found, claimed, expected)
    for name, keys in groups.items():
        wrong = [
            text for key in keys for text in differing(key, claimed.get(key), expected.get(key), _RELATIVE)
        ]
        wrong += [f"{key}: nobody records that" for key in keys if key not in expected and key in claimed]
        wrong += [f"{key}: not in the file" for key in keys if key in expected and key not in claimed]
        if "metrics" in keys and claimed.get("metrics", {}).keys() != expected.get("metrics", {}).keys():
            wrong.append("metrics: not those of the scenario")
        if name == "verdict" and found.verdict != expected["verdict"]:
            wrong.insert(0, f"the file says {found.verdict!r}, its numbers say {verdict.verdict!r}")
        if name == "verdict" and absent and not wrong:
            yield Check(
                name, None, f"{found.verdict}: not derived, as the code of {some(absent)} is not let in"
            )
            continue
        yield checked(name, list(dict.fromkeys(wrong)), says[name])
    yield _happened(found, trace, verdict)


def unknown(trace: Trace) -> list[str]:
    """Drivers and law whose code is not here, so that what the barrier was worth cannot be asked."""
    found = [driver.kind for driver in trace.scenario.neighbours if isinstance(driver, Absent)]
    return found + [trace.scenario.law.kind] * isinstance(trace.scenario.law, AbsentLaw)


def allow(found: Recorded, claimed: Mapping[str, Any], expected: dict[str, Any]) -> None:
    """Lets a safe run claim, without its drivers' and law's code, that the barrier was needed or not."""
    if expected["verdict"] != VACUOUS or found.verdict not in (HELD, VACUOUS):
        return
    expected["verdict"], expected["verdicts"] = found.verdict, {found.verdict: 1}
    for key, kinds in _OF_THE_IDEAL.items():
        if isinstance(claimed.get(key), kinds):
            expected[key] = claimed[key]


def claimed_metrics(found: Recorded, trace: Trace) -> dict[str, Array]:
    """What a recording says that the metrics of its scenario came to, by name, (1,); NaN where it does not.

    That cannot be derived from it: it takes their code, which nobody runs who only has a file.
    """
    said = (found.summary or {}).get("metrics", {})
    known = {name: said.get(name) for name in own.names(trace.scenario)}
    return {name: np.array([np.nan if v is None else float(v)]) for name, v in known.items()}


def what_follows(
    found: Recorded, trace: Trace, verdict: Verdict, metrics: Mapping[str, Array] | None = None
) -> dict[str, Any]:
    """The summary that a recording must have, from its trace.

    Args:
        found: the file as read.
        trace: the run.
        verdict: on it.
        metrics: what the scenario's own metrics came to, where somebody ran them; what the file says of the
            others is taken as it is.
    """
    values = claimed_metrics(found, trace) | dict(metrics or {})
    expected = summary(trace, [verdict], values)
    accepted = found.manifest["acceptance"]
    stands = ground(trace.scenario, trace.plant, accepted, expected, continuous=trace.continuous)
    return expected | stands | {"distinct_runs": 1}


def _happened(found: Recorded, trace: Trace, verdict: Verdict) -> Check:
    """Events and phases are those of the trace."""

    def ns(time_s: float) -> int:
        return int(np.rint(time_s * NS_PER_S))

    said = [(ns(e.time_s), e.level, f"{e.car}: {e.text}") for e in [*events(trace), *verdict.events()]]
    states = [(ns(p.time_s), p.subject, p.state) for p in phases(trace)]
    there = [e for e in found.said if e[2] != _NOTHING]
    wrong = []
    for name, ours, theirs in (("event", said, there), ("phase", states, found.states)):
        for word, odd in (("missing", set(ours) - set(theirs)), ("not so", set(theirs) - set(ours))):
            wrong += [f"{name} {word}: {text!r} at {t / NS_PER_S:.2f} s" for t, *_, text in sorted(odd)]
        if not wrong and len(ours) != len(theirs):
            wrong.append(f"{len(theirs)} {name}s, not {len(ours)}")
    return checked("events", wrong, f"{len(there)} events and {len(found.states)} changes of phase")
