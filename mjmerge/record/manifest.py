"""Where a recording comes from, and how its numbers are to be read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mjmerge.record.recording import Header

SCHEMA_VERSION = 2
"""Of topics, entity names and messages; goes up when a reader of the old ones would go wrong. From 2 on the
manifest says who is there; before, it was an ego and two neighbours."""
SCHEMA_VERSIONS = (1, SCHEMA_VERSION)
"""Those that are read."""
DRAWING = 2
"""Of how numbers are drawn; goes up when the same ones look otherwise. Who checks a drawing asks for it."""

EXPLANATION = "explanation.json"
"""Why a run fails: an attachment, a file of the run folder, and a text with a fingerprint."""

CONVENTIONS = {
    "units": "SI; every name ends in its unit, names without one are plain numbers",
    "frame": "road frame: x along the road, y to its left, z up; origin on the road's surface",
    "quaternions": "x y z w in the files",
    "time": "simulated, from 0 at the start of the run",
    "commands": "those of a tick hold until the next tick",
    "missing": "NaN",
}


def canonical(of: Mapping[str, Any]) -> str:
    """A manifest, or an explanation, as the text that its fingerprint is of."""
    return json.dumps(of, sort_keys=True)


def manifest(header: Header) -> dict[str, Any]:
    """All of it as one JSON-able mapping, with nothing that changes from run to run."""
    there = header.scenario.roster
    columns = [
        {"name": c.name, "symbol": c.symbol, "doc": c.doc, "axes": c.names(there)} for c in header.columns
    ]
    asks = {s.name: s.asks for s in header.scenario.law.signals if s.asks}
    return {
        "schema_version": SCHEMA_VERSION,
        "drawing": DRAWING,
        "cars": list(there.cars),
        "scenario": header.scenario.name,
        "description": header.scenario.description,
        "plant": header.plant,
        "seed": header.seed,
        "control_step_s": header.control_step_s,
        "continuous": header.continuous,
        "sensing": "recorded" if header.told else "exact",
        "versions": dict(header.versions),
        "acceptance": dict(header.acceptance),
        "sheets": {car: sheet.model_dump() for car, sheet in zip(there.cars, header.sheets, strict=True)},
        "conventions": CONVENTIONS,
        "columns": columns,
        **({"code": {name: dict(of) for name, of in header.code.items()}} if header.code else {}),
        **({"asks": asks} if asks else {}),
        **({"set": list(header.scenario.changes)} if header.scenario.changes else {}),
        **({"metrics": [dict(metric) for metric in header.metrics]} if header.metrics else {}),
    }
