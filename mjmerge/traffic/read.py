"""A file of recorded traffic, whichever it is."""

from __future__ import annotations

from pathlib import Path

from mjmerge.errors import MjmergeError
from mjmerge.traffic.columns import read_columns
from mjmerge.traffic.commonroad import read_commonroad
from mjmerge.traffic.tracks import Tracks

XML, CSV = (".xml",), (".csv", ".txt")


def read(path: Path, columns: str = "") -> Tracks:
    """Recorded traffic.

    Args:
        path: CommonRoad (.xml), or a table (.csv).
        columns: of a table, the name or path of the map of its columns; by default the shipped one that fits.

    Raises:
        ScenarioError: with everything that is wrong with it.
        MjmergeError: it is neither, or a map was given for what is no table.
    """
    ending = path.suffix.lower()
    if ending in XML:
        if columns:
            raise MjmergeError(f"{path} is no table: it takes no map of columns")
        return read_commonroad(path)
    if ending in CSV:
        return read_columns(path, columns)
    raise MjmergeError(
        f"{path}: traffic is read from CommonRoad {' or '.join(XML)} and from tables {' or '.join(CSV)}"
    )
