"""Workers on the nodes of a Ray cluster: the code goes with the work, and no node has other versions.

Ray itself tries nothing again: :mod:`mjmerge.sweep.workers` does, which knows what kills.
"""

from __future__ import annotations

import logging
import os
import shutil
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from mjmerge.config import shipped
from mjmerge.errors import MjmergeError
from mjmerge.sweep.elsewhere import unlike
from mjmerge.sweep.folder import computing
from mjmerge.sweep.processes import held
from mjmerge.sweep.workers import Workers

_ANSWERS_S = 10.0
_START_S = 120.0
"""A node has this long to say what it has installed."""


def cluster(address: str | None, most: int, cpus: int) -> Workers:
    """A team on a cluster, of which every node has been asked what it computes with.

    Args:
        address: of a cluster, as ``ray.init`` takes it; by default one of this machine alone is begun.
        most: tasks at a time, 0 for as many as there are processors.
        cpus: processors, and threads, of a task.

    Raises:
        MjmergeError: Ray is not installed, nothing answers, a node has other versions, or none has as many
            processors.
    """
    crew = Cluster(address, most, cpus)
    try:
        crew.check()
        room = crew.room
        return Workers(most or room, crew, cpus)
    except BaseException:
        crew.stop()
        raise


def needed() -> Any:
    """Ray, the package.

    Raises:
        MjmergeError: it is not installed.
    """
    os.environ.setdefault("RAY_DISABLE_FAILURE_SIGNAL_HANDLER", "1")  # it says a traceback of SIGTERM
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
        _reachable(address)
        self._ray, self._cpus = ray, cpus
        self._staged = Path(mkdtemp(prefix="mjmerge-"))
        # the thread that Ray lives in: in the main one it takes SIGTERM for itself
        self._thread = ThreadPoolExecutor(1)
        self._quiet = _no_standard_output()
        self._quiet.__enter__()
        own: dict[str, Any] = {"address": address}
        if address is None:
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # it would tell its makers
            new = {"address": "local", "include_dashboard": False}  # whatever else there is
            own = new | ({"num_cpus": most * cpus} if most else {})
        try:
            self._have(
                ray.init,
                **own,
                log_to_driver=False,
                logging_level=logging.ERROR,
                runtime_env={"py_modules": [str(_package(self._staged))]},
            )
        except BaseException as error:
            self.stop()
            if not isinstance(error, Exception):
                raise
            said = (str(error).strip().splitlines() or [type(error).__name__])[0]
            where = "no cluster of this machine" if address is None else f"no cluster at {address}"
            raise MjmergeError(f"{where}: {said}") from error
        self._task = ray.remote(num_cpus=cpus, max_retries=0)(_task)

    def _have(self, work: Callable[..., Any], **given: Any) -> None:
        """Has something of Ray begin or end, whole: a signal waits until it has."""
        with held(signal.SIGTERM), held(signal.SIGINT):
            self._thread.submit(work, **given).result()

    @property
    def room(self) -> int:
        """Tasks that there is room for at a time.

        Raises:
            MjmergeError: there is none for one.
        """
        found = [int(node["Resources"].get("CPU", 0)) for node in self._ray.nodes() if node["Alive"]]
        most = max(found, default=0)
        if self._cpus > most:
            raise MjmergeError(f"--cpus is {self._cpus}; the largest node has {most} processors")
        return sum(cpus // self._cpus for cpus in found)

    def check(self) -> None:
        """Asks every node what it computes with; one that leaves meanwhile has nothing to say.

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
            except ray.exceptions.TaskUnschedulableError:
                continue  # and nobody computes there
            except Exception as error:
                said = (str(error).strip().splitlines() or [""])[-1]
                problems.append(f"node {name} does not say what it computes with: {said}")
        if problems:
            raise MjmergeError("\n".join(problems))

    def submit(self, task: Callable[..., Any], *given: Any) -> Future[Any]:
        """See :class:`mjmerge.sweep.workers.Crew`."""
        found: Future[Any] = self._task.remote(task, *given).future()
        return found

    def part(self, future: Future[Any]) -> float:
        """Not known before it is done."""
        return float(future.done())

    def renew(self) -> None:
        """Ray does that itself."""

    def close(self) -> None:
        """Lets the cluster go; one that was begun here ends."""
        try:
            with suppress(Exception):
                self._have(self._ray.shutdown)
        finally:
            self._thread.shutdown()
            self._quiet.__exit__(None, None, None)
            shutil.rmtree(self._staged, ignore_errors=True)

    stop = close


def _computing() -> dict[str, Any]:
    return computing()


def _task(task: Callable[..., Any], *given: Any) -> Any:
    return task(*given)


def _package(place: Path) -> Path:
    """A copy of this package, with what is shipped in it, as a wheel has it."""
    package = Path(shipped.__file__).parents[1]
    copy = place / package.name
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))
    for kind in ("models", "scenarios"):
        if not (copy / "_share" / kind).is_dir():
            shutil.copytree(shipped.folder(kind), copy / "_share" / kind)
    return copy


def _reachable(address: str | None) -> None:
    """Refuses an address where nothing answers; Ray itself would look for a minute or more.

    Raises:
        MjmergeError: nothing does.
    """
    host, _, port = (address or "").rpartition(":")
    if host and "/" not in host and port.isdecimal():
        try:
            socket.create_connection((host.strip("[]"), int(port)), _ANSWERS_S).close()
        except (OSError, OverflowError) as error:
            raise MjmergeError(f"no cluster at {address}: {error}") from error


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
