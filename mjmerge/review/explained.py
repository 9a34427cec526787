"""What a recording says of why its run fails, against its numbers: it must be about this run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from mjmerge.record.manifest import EXPLANATION
from mjmerge.record.read import Recorded
from mjmerge.review.check import Check, checked, differing
from mjmerge.search.margin import margin
from mjmerge.simulation.trace import Trace

_RELATIVE = 1e-9


def explained(found: Recorded, trace: Trace) -> Iterator[Check]:
    """The run that an explanation is of is this one; nothing where there is none.

    Args:
        found: the file as read.
        trace: the run in it, with its distances from its positions.
    """
    if found.explanation is None:
        return
    if found.verdict is None:
        yield Check("explanation", False, "there is one of a run that has not finished")
        return
    expected = _run(found, trace)
    wrong = [
        text
        for key, value in expected.items()
        for text in differing(key, found.explanation[key], value, _RELATIVE)
    ]
    rows = [one["taken_back"] for one in found.explanation["table"] if one["safe"]]
    wrong += differing("needs", found.explanation["needs"], rows, _RELATIVE, "its table says")
    says = f"of this run; the {found.explanation['runs']} runs it rests on are not made again"
    yield checked("explanation", [f"{EXPLANATION}: {text}" for text in wrong], says)


def _run(found: Recorded, trace: Trace) -> dict[str, Any]:
    """What an explanation of this run must say of it."""
    there = margin(trace)
    return {
        **{key: found.manifest[key] for key in ("scenario", "plant", "seed", "continuous")},
        "unsafe": there.kind is not None,
        "kind": there.kind,
        "margin_m": float(there.least_m) if np.isfinite(there.least_m) else None,
        "unsafe_at_s": there.unsafe_at_s,
        "broken": [{"hypothesis": one.hypothesis, "time_s": one.time_s} for one in there.broken],
    }
