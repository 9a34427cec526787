"""Options that several commands share."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mjmerge.config.bounds import MOST_RUNS, MOST_SEED, most_threads, most_workers
from mjmerge.errors import MjmergeError
from mjmerge.roster import PLANTS

if TYPE_CHECKING:
    from mjmerge.sweep.workers import Workers


def unsaid(metavar: str) -> Any:
    """An option that is nothing unless it is given: what it is by default stands in its own words."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


ANY_PLANT = "|".join(PLANTS)
PlantName = Annotated[str, tyro.conf.arg(metavar=ANY_PLANT)]
"""One of the plants; another is told with the nearest."""
ScenarioName = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")]
"""Name of a shipped scenario, or the path of a YAML file."""
RunPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
"""A recorded run: its folder, or a .mcap or .rrd file."""
Overrides = Annotated[
    tuple[str, ...],
    tyro.conf.arg(name="set", metavar="KEY=VALUE", help_behavior_hint=""),
    tyro.conf.UseAppendAction,
]
"""Scenario keys with other values, ``--set KEY=VALUE``, repeatable."""
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")]
"""Off unless it is given."""
Count = Annotated[int, tyro.conf.arg(metavar="N")]
"""A whole number."""


_MOST: dict[str, Callable[[], int]] = {
    "runs": lambda: MOST_RUNS,
    "budget": lambda: MOST_RUNS,
    "findings": lambda: MOST_FINDINGS,
    "seeds": lambda: MOST_SEEDS,
    "seed": lambda: MOST_SEED,
    "threads": most_threads,
    "workers": most_workers,
    "cpus": most_threads,
}
MOST_FINDINGS = 100
"""Failures that a search shrinks."""
MOST_SEEDS = 1000
"""Seeds of each point, with --break."""


def processes(workers: int) -> int:
    """How many processes are meant by a number of workers: with 0 one per core that there is for us."""
    return workers or len(os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else [0])


@dataclass(frozen=True)
class Machines:
    """What does the work of a command; none of it changes the result."""

    engine: Literal["processes", "ray"] = "processes"
    """Processes of this machine, or the nodes of a Ray cluster (extra `ray`)."""
    address: Annotated[str | None, unsaid("ADDRESS")] = None
    """With --engine ray, of the cluster, such as auto or HOST:6379; by default one begins on this machine."""
    cpus: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """With --engine ray, processors that each task takes, and as many threads."""

    def check(self) -> None:
        """Refuses what does not go together, or is not installed.

        Raises:
            MjmergeError: something does not.
        """
        at_least(1, cpus=self.cpus)
        if self.engine != "ray" and (self.address is not None or self.cpus != 1):
            raise MjmergeError("--address and --cpus are for --engine ray")
        if self.engine == "ray":
            from mjmerge.sweep.ray import needed

            needed()


@contextmanager
def team(workers: int, machines: Machines) -> Iterator[Workers]:
    """Who does the work of a command; what was done again, as somebody died, it says on standard error.

    Args:
        workers: how many, 0 for one per core.
        machines: where.
    """
    from mjmerge.sweep.workers import Workers, at_work

    if machines.engine == "ray":
        from mjmerge.sweep.ray import cluster

        who = cluster(machines.address, workers, machines.cpus)
    else:
        who = Workers(processes(workers))
    with at_work(who) as found:
        yield found
    if found.losses:
        print(f"mjmerge: work was lost with a worker {found.losses} times, and done again", file=sys.stderr)


def at_least(least: int, **given: int) -> None:
    """Refuses options below a bound, or above the most that there is of it.

    Args:
        least: the lower bound.
        given: options by name.

    Raises:
        MjmergeError: with the first that is out of bounds.
    """
    for name, value in given.items():
        most = _MOST[name]()
        if value < least:
            raise MjmergeError(f"--{name} is {value}; it must be at least {least}")
        if value > most:
            raise MjmergeError(f"--{name} is {value}; it must be at most {most}")
