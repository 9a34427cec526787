"""Workers on the nodes of a Ray cluster: the code goes with the work, and no node has other versions.

Ray itself tries nothing again: :mod:`mjmerge.sweep.workers` does, which knows what kills.
"""

from __future__ import annotations

import logging
import os
import pickle
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from mjmerge.config import doors, shipped
from mjmerge.errors import MjmergeError
from mjmerge.sweep.folder import computing
from mjmerge.sweep.workers import Raised, Workers

_START_S = 120.0
"""A node has this long to say what it has installed."""


def cluster(address: str | None, most: int, cpus: int) -> Workers:
    """A team on a cluster, of which every node has been asked what it computes with.

    Args:
        address: of a cluster, as ``ray.init`` takes it; by default one of this machine alone is begun.
        most: tasks at a time, 0 for as many as there are processors.
        cpus: processors, and threads, of a task.

    Raises:
        MjmergeError: Ray is not installed, nothing answers, or a node has other versions.
    """
    crew = Cluster(address, most, cpus)
    try:
        crew.check()
        return Workers(most or crew.room, crew, cpus)
    except BaseException:
        crew.stop()
        raise


def needed() -> Any:
    """Ray, the package.

    Raises:
        MjmergeError: it is not installed.
    """
    try:
        import ray
    except ImportError:
        raise MjmergeError("the engine ray needs Ray: pip install 'mjmerge[ray]'") from None
    return ray


class Cluster:
    """The workers of a Ray cluster, for as long as this process is connected to it.

    Standard output belongs to the command: meanwhile nothing that Ray starts has it.
    """

    def __init__(self, address: str | None, most: int, cpus: int) -> None:
        """Connects; see :func:`cluster`."""
        ray = needed()
        self._ray, self._cpus = ray, cpus
        self._staged = Path(mkdtemp(prefix="mjmerge-"))
        self._quiet = _no_standard_output()
        self._quiet.__enter__()
        own: dict[str, Any] = {"address": address}
        if address is None:
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would tell its makers
            own = {"include_dashboard": False, **({"num_cpus": most * cpus} if most else {})}
        try:
            ray.init(
                **own,
                log_to_driver=False,
                logging_level=logging.ERROR,
                runtime_env={"py_modules": [str(_package(self._staged))]},
            )
        except Exception as error:
            self.stop()
            said = (str(error).strip().splitlines() or [type(error).__name__])[0]
            where = "no cluster of this machine" if address is None else f"no cluster at {address}"
            raise MjmergeError(f"{where}: {said}") from error
        self._do = ray.remote(num_cpus=cpus, max_retries=0)(_do)

    @property
    def room(self) -> int:
        """Tasks that there is room for at a time."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)) // self._cpus)

    def check(self) -> None:
        """Asks every node what it computes with.

        Raises:
            MjmergeError: with every node that computes with something else, and what.
        """
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        ray = self._ray
        asked = {}
        for node in ray.nodes():
            if node["Alive"]:
                there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
                options = {"num_cpus": 0, "max_retries": 3, "scheduling_strategy": there}
                asked[node["NodeManagerAddress"], node["NodeID"]] = ray.remote(**options)(_computing).remote()
        problems = []
        for (name, _), answer in asked.items():
            try:
                problems += unlike(name, computing(), ray.get(answer, timeout=_START_S))
            except Exception as error:
                said = (str(error).strip().splitlines() or [""])[-1]
                problems.append(f"node {name} does not say what it computes with: {said}")
        if problems:
            raise MjmergeError("\n".join(problems))

    def submit(self, task: Callable[..., Any], *given: Any) -> Future[Any]:
        """See :class:`mjmerge.sweep.workers.Crew`."""
        found: Future[Any] = self._do.remote(
            computing(), doors.let_in(), pickle.dumps((task, given))
        ).future()
        return found

    def part(self, future: Future[Any]) -> float:
        """Not known before it is done."""
        return float(future.done())

    def renew(self) -> None:
        """Ray does that itself."""

    def close(self) -> None:
        """Lets the cluster go; one that was begun here ends."""
        with suppress(Exception):
            self._ray.shutdown()
        self._quiet.__exit__(None, None, None)
        shutil.rmtree(self._staged, ignore_errors=True)

    stop = close


def unlike(node: str, here: Mapping[str, Any], there: Mapping[str, Any]) -> list[str]:
    """In what a node computes with something else, as a line; an empty list if in nothing.

    Args:
        node: its name.
        here: what this process computes with, see :func:`mjmerge.sweep.folder.computing`.
        there: what the node does.
    """
    mine, theirs = here["versions"], there["versions"]
    found = [
        f"{name} {theirs.get(name, 'is missing')} (here {mine.get(name, 'missing')})"
        for name in {**mine, **theirs}
        if mine.get(name) != theirs.get(name)
    ]
    found += [f"another {name}" for name in here if name != "versions" and here[name] != there.get(name)]
    return [f"node {node} would compute other rows: {', '.join(found)}"] if found else []


def _computing() -> dict[str, Any]:
    return computing()


def _do(here: Mapping[str, Any], code: Mapping[str, str], payload: bytes) -> Any:
    """On a node: a task, unless the node computes with something else, such as one that came later."""
    other = unlike("that came later", here, computing())
    if other:
        return Raised(MjmergeError(other[0]))
    try:
        doors.carry(code)
        task, given = pickle.loads(payload)
    except Exception as error:
        return Raised(MjmergeError(f"a node cannot read its task: {type(error).__name__}: {error}"))
    return task(*given)


def _package(place: Path) -> Path:
    """A copy of this package, with what is shipped in it, as a wheel has it."""
    package = Path(doors.__file__).parents[1]
    copy = place / package.name
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))
    for kind in ("models", "scenarios"):
        if not (copy / "_share" / kind).is_dir():
            shutil.copytree(shipped.folder(kind), copy / "_share" / kind)
    return copy


@contextmanager
def _no_standard_output() -> Iterator[None]:
    """Meanwhile standard output, of this process and those that it starts, goes nowhere."""
    sys.stdout.flush()
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
