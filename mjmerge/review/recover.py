"""``mjmerge recover``: what is left of a run that was killed, rewritten as a whole file.

Every number stays as it was. Added is what a run gets at its end: events, phases, summary and verdict, which
of a run that was cut off is ``incomplete``, unless it had become unsafe before.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mjmerge.errors import MjmergeError
from mjmerge.outputs import whole
from mjmerge.record import FORMATS
from mjmerge.record.read import Recorded, read
from mjmerge.record.scene import Scene
from mjmerge.review.poses import header, outcome, posed
from mjmerge.simulation.trace import Stop

CUT_OFF = "the recording was cut off here, and recovered"
"""Why a recovered run ended."""


def recovered_name(path: Path) -> Path:
    """Where a recovered file goes: ``run.recovered.mcap`` beside ``run.mcap.partial``."""
    stem = path.with_suffix("") if path.suffix == ".partial" else path
    return stem.with_name(f"{stem.stem}.recovered{stem.suffix}")


def recover(path: Path, out: Path) -> Recorded:
    """Rewrites an unfinished recording.

    Args:
        path: the file.
        out: the file to write, of the same format.

    Returns:
        What was in the old file.

    Raises:
        UnreadableError: there is no whole tick in it.
        MjmergeError: nothing is missing from it.
        OutputError: the new file is there already, or cannot be written.
    """
    found = read(path)
    if found.finished and found.verdict is not None and not found.fault:
        raise MjmergeError(f"{path} is whole: there is nothing to recover")
    about = header(found)
    scene = Scene(about.model, about.scenario.r_m)
    block = posed(found, about, scene)
    trace = found.run()
    missing = np.flatnonzero(np.isnan(trace.front_m[0, :, 0, 0]))
    if missing.size and not trace.stops:
        trace = replace(trace, stops=(Stop(0, float(trace.time_s[missing[0]]), "ego", CUT_OFF),))
    end = outcome(found, trace)

    def write(partial: Path) -> None:
        recorder = FORMATS[f"run.{found.kind}"](partial, about, scene)
        try:
            recorder.write(block)
            recorder.close(end)
        except BaseException:
            recorder.abort()
            raise

    whole(out, write)
    return found
