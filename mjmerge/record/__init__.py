"""Recordings of one simulation: ``run.rrd`` to look at (Rerun), ``run.mcap`` to keep (Foxglove, MCAP).

    header = Header(...)
    with Recording(folder, header, FORMATS) as recording:
        for block in blocks(trace, run=0):
            recording.write(block)
        recording.close(Outcome(events, verdict, summary))
    recording.failures  # what went wrong, format by format; the run itself never stops for it

A file is called ``*.partial`` until it is complete. Nothing here imports Rerun or Foxglove before it is used.
"""

from __future__ import annotations

from pathlib import Path

from mjmerge.outputs import ENDINGS
from mjmerge.record.posed import PosedBlock
from mjmerge.record.recording import Factory, Header, Keep, Outcome, Recorder, Recording
from mjmerge.record.scene import Scene
from mjmerge.verdict.metrics import Event
from mjmerge.versions import git_revision, versions

__all__ = [
    "ENDINGS",
    "FORMATS",
    "Event",
    "Factory",
    "Header",
    "Keep",
    "Outcome",
    "PosedBlock",
    "Recorder",
    "Recording",
    "git_revision",
    "open_mcap",
    "open_rrd",
    "versions",
]


def open_rrd(path: Path, header: Header, scene: Scene) -> Recorder:
    """Starts a Rerun recording."""
    if not header.code:  # which may use pandas
        from mjmerge.record.rerun import without_pandas

        without_pandas.skip()
    from mjmerge.record.rerun.recorder import RerunRecorder

    return RerunRecorder(path, header, scene)


def open_mcap(path: Path, header: Header, scene: Scene) -> Recorder:
    """Starts an MCAP recording."""
    from mjmerge.record.mcap.recorder import McapRecorder

    return McapRecorder(path, header, scene)


FORMATS: dict[str, Factory] = {"run.rrd": open_rrd, "run.mcap": open_mcap}
"""File name in the run folder, and what writes it."""
