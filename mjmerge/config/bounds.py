"""The most there may be of anything that takes memory or time: what is too much is refused at once."""

from __future__ import annotations

import operator
import os
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

from mjmerge.config.document import described
from mjmerge.errors import MjmergeError

if TYPE_CHECKING:
    from mjmerge.scenario.mismatch import Mismatch
    from mjmerge.scenario.schema import Scenario

MOST_RUNS = 1_000_000
"""Runs of a command or a campaign."""
LONGEST_S = 3600.0
"""Simulated time of a run, s."""
MOST_TICKS = 4_000_000
"""Control ticks of one run: an hour at 1 kHz, and some."""
MOST_SEED = 2**63 - 1
"""The largest seed: recordings and tables keep them in 64 bits."""
MOST_THREADS, MOST_WORKERS = 256, 64
"""Threads for the physics, and processes; or as many as there are cores, where that is more."""
MOST_ROWS = 1_000
"""Rows of a scenario's gate."""
MOST_METRICS = 100
"""Metrics of a scenario's own."""
MOST_DASHES = 1_000
"""Dashes between two lanes; on a longer road they are further apart."""

_TICK_BYTES, _RUN_BYTES, _PAST_BYTES, _STEP_BYTES = 1_000, 50_000, 300, 200
"""Of memory, about, that a control tick, a run, a tick of its past and a physics step of that take."""
_MOST_BYTES = 64 * 10**9
_REMEMBERED = (
    "command_delay_s",
    "sensing_delay_s",
    "neighbour_velocity_window_s",
    "leader_acceleration_delay_s",
)


@cache
def memory_bytes() -> int:
    """Memory that the runs of one command may take together: half of this machine's, and at most 64 GB."""
    try:
        there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        there = 16 * 10**9
    return min(there // 2, _MOST_BYTES)


def check_runs(scenario: Scenario, runs: int, seeds: tuple[int, int], mismatches: Sequence[Mismatch]) -> None:
    """Refuses runs that would take more memory together than they may, or have seeds that are none.

    Args:
        scenario: of all.
        runs: how many.
        seeds: the smallest and the largest.
        mismatches: of each, or of all of them.

    Raises:
        MjmergeError: with what they need, and the bound.
    """
    if not 1 <= runs <= MOST_RUNS:
        raise MjmergeError(f"runs is {runs}; it must be at least 1 and at most {MOST_RUNS}")
    for seed in seeds:
        if not 0 <= seed <= MOST_SEED:
            raise MjmergeError(f"a run has the seed {seed}; it must be at least 0 and at most {MOST_SEED}")
    ticks = scenario.ticks
    longest_s = max(getattr(m, name) for m in mismatches for name in _REMEMBERED)
    past_ticks = longest_s / scenario.control_step_s
    past_steps = longest_s / scenario.physics_step_s + scenario.substeps
    each = _RUN_BYTES + ticks * _TICK_BYTES + past_ticks * _PAST_BYTES + past_steps * _STEP_BYTES
    if runs * each > memory_bytes():
        raise MjmergeError(
            f"{runs} x {ticks} ticks need about {runs * each / 1e9:.3g} GB of memory; the most is "
            f"{memory_bytes() / 1e9:.3g} GB: ask for fewer runs, shorter ones or a longer control step, or "
            "make them a campaign, which keeps a row of each (mjmerge sweep)"
        )


def patience_s(quiet_s: float) -> float:
    """How long to wait for a process that takes so long at most on a quiet machine, s.

    Longer where others want the processors too, up to ten times: what is slow then is not broken.
    """
    busy = os.getloadavg()[0] / (os.cpu_count() or 1) if hasattr(os, "getloadavg") else 1.0
    return quiet_s * min(max(busy, 1.0), 10.0)


def most_threads() -> int:
    """The most threads that may be asked for on this machine."""
    return max(MOST_THREADS, os.cpu_count() or 1)


def most_workers() -> int:
    """The most processes that may be asked for on this machine."""
    return max(MOST_WORKERS, os.cpu_count() or 1)


def whole(name: str, given: object, least: int, most: int) -> int:
    """A whole number of any kind.

    Args:
        name: of the argument.
        given: what it is.
        least: its lower bound.
        most: its upper bound.

    Raises:
        MjmergeError: it is none, or out of bounds.
    """
    try:
        if isinstance(given, bool):
            raise TypeError
        value = operator.index(given)  # type: ignore[arg-type]
    except TypeError:
        raise MjmergeError(f"{name} must be a whole number, got {described(given)}") from None
    if not least <= value <= most:
        raise MjmergeError(f"{name} is {value}; it must be at least {least} and at most {most}")
    return value
