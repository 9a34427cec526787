"""``mjmerge convert``: a recording as one table, a row per tick, for pandas, polars and spreadsheets.

Columns are named as in :mod:`mjmerge.simulation.frame`. Numbers are as recorded, to the last bit; NaN stays
NaN.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from mjmerge.errors import UnreadableError
from mjmerge.figures.style import save_columns
from mjmerge.outputs import whole
from mjmerge.record import content
from mjmerge.record.read import Recorded
from mjmerge.simulation.frame import spread
from mjmerge.simulation.trace import COLUMNS
from mjmerge.state import Array


def flat(found: Recorded) -> dict[str, Array]:
    """Every component of every column by name, each (T,); ``time_s`` first.

    Raises:
        UnreadableError: there is no tick in it, or it is of another schema.
    """
    if not found.columns or not len(found.ticks):
        raise UnreadableError(
            found.path, f"no columns that this mjmerge knows (schema {found.schema_version})"
        )
    every = (*COLUMNS, *content.own_columns(found.manifest))
    time_s = np.ascontiguousarray(found.columns["time_s"])
    return {"time_s": time_s} | spread(every, found.roster, found.columns)


def to_csv(found: Recorded, path: Path) -> None:
    """Writes a CSV file, a header and a row per tick.

    Raises:
        OutputError: the file is there already, or cannot be written.
    """
    columns = flat(found)
    whole(path, lambda partial: save_columns(columns, partial))


def to_parquet(found: Recorded, path: Path) -> None:
    """Writes a Parquet file; manifest, scenario, summary, verdict and why it fails are in its metadata.

    Raises:
        OutputError: the file is there already, or cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    about = {
        "manifest": json.dumps(found.manifest),
        "scenario.yaml": found.scenario_yaml,
        "summary": json.dumps(found.summary),
        "verdict": found.verdict or "",
        **({} if found.explanation is None else {"explanation": json.dumps(found.explanation)}),
    }
    made = pa.table(flat(found)).replace_schema_metadata({f"mjmerge.{k}": v for k, v in about.items()})
    whole(path, lambda partial: pq.write_table(made, partial, compression="zstd"))
