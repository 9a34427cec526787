"""What a command left, opened again in Python: a recording as a trace, a sweep as its table."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from mjmerge.config.document import described
from mjmerge.errors import MjmergeError, UnreadableError
from mjmerge.record.read import Recorded, recording
from mjmerge.record.read import read as read_recording
from mjmerge.simulation.trace import Trace
from mjmerge.sweep.folder import PLAN, TABLE
from mjmerge.verdict.judge import Verdict, judge

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True, repr=False)
class RecordedTrace(Trace):
    """A recorded run as a trace of one simulation, NaN where nothing was recorded.

    Whatever takes a trace takes it. Code from outside that it ran is not run again: the law and drivers of
    :attr:`scenario` are then :class:`~mjmerge.law.AbsentLaw` and :class:`~mjmerge.drivers.Absent`.
    """

    recorded: Recorded = field(kw_only=True)
    """The file: what it claims (``verdict``, ``summary``, ``manifest``), its events and states."""

    @cached_property
    def verdict(self) -> Verdict:
        """What the recorded numbers say, judged anew; whether they are true, ``mjmerge verify`` says."""
        (verdict,) = judge(self)
        return verdict


def read(path: str | os.PathLike[str]) -> RecordedTrace | pa.Table:
    """What is in a run folder, a recording or the folder of a sweep.

    Args:
        path: a run folder (also by its name in ``runs/``), a ``.mcap`` or ``.rrd`` file, finished or not, or
            the folder of a sweep.

    Returns:
        The recorded run, of several simulations the one in ``run.mcap``: the worst. Of a sweep its table, a
        row per run; ``table.to_pandas()`` makes a data frame of it.

    Raises:
        MjmergeError: the path is none.
        UnreadableError: there is nothing of that name, it is none of these, or it is not finished.
    """
    if not isinstance(path, str | os.PathLike) or isinstance(os.fspath(path), bytes):
        raise MjmergeError(f"expected the path of a run folder, recording or sweep, got {described(path)}")
    place = Path(path)
    if _is_file(place / TABLE) or _is_file(place / PLAN):
        return _table(place)
    found = read_recording(recording(place))
    trace = found.run()
    return RecordedTrace(**{f.name: getattr(trace, f.name) for f in fields(trace)}, recorded=found)


def _is_file(path: Path) -> bool:
    return os.path.isfile(path)  # noqa: PTH113 (a name may be too long)


def _table(folder: Path) -> pa.Table:
    """The table of a sweep."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not _is_file(folder / TABLE):
        raise UnreadableError(folder, "the sweep is not finished: run it again, and it goes on")
    try:
        return pq.read_table(folder / TABLE, page_checksum_verification=True)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise UnreadableError(folder / TABLE, str(error)) from error
