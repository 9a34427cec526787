"""Metrics that a scenario brings: functions of a trace, found by name when it is read.

    def headway_s(trace: mjmerge.Trace) -> np.ndarray:
        ...  # a number for each simulation, (N,); NaN where it is not known

A metric is called as its function is, which ends with its unit. :mod:`mjmerge.verdict.own` runs them.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from mjmerge.config.document import described
from mjmerge.config.doors import Code, DoorError, code_of, from_outside, installed, located, resolve
from mjmerge.errors import UnknownNameError

GROUP = "mjmerge.metrics"
"""Of entry points."""


@dataclass(frozen=True)
class Metric:
    """A metric of somebody's own.

    Attributes:
        name: what it is called, with its unit at the end.
        description: the first line of its docstring; empty if it has none.
        code: the text that it was read from.
        function: trace to a number for each simulation, (N,).
    """

    name: str
    description: str
    code: Code
    function: Callable[[Any], Any]


def metric_name(reference: str) -> str:
    """What a metric is called that is named so: ``headway_s`` of ``mine.py:headway_s``."""
    return reference.rpartition(":")[2].rpartition(".")[2]


def find(reference: str, near: Path | None = None) -> Metric:
    """The metric of a name; its file is run.

    Args:
        reference: ``file.py:name``, ``package.module:name`` or an entry point's name.
        near: folder where a file is looked for first, before the current one.

    Raises:
        DoorError: it is not there, does not run, or is no metric.
        UnknownNameError: there is no entry point of that name.
    """
    if reference.endswith(".py"):
        raise DoorError(f"{reference[:200]} is a file and names no function in it: write file.py:headway_s")
    if not from_outside(reference) and reference not in installed(GROUP):
        raise UnknownNameError("metric", reference, installed(GROUP))
    where = located(reference, near, GROUP)
    function, code = resolve(where), code_of(where)
    if sha256(code.source.encode()).hexdigest() != code.sha256:
        raise DoorError(f"{where.rpartition(':')[0]} is not text in UTF-8")
    if not callable(function) or inspect.isclass(function):
        what = "a class" if inspect.isclass(function) else described(function)
        raise DoorError(f"{where} is {what}; a metric is a function of a trace")
    try:
        signature = inspect.signature(function)
    except (ValueError, TypeError):  # of what is not written in Python, nobody knows
        signature = None
    try:
        if signature is not None:
            signature.bind(None)
    except TypeError as error:
        must = f"must take one argument, the trace, as in `def {metric_name(where)}(trace):`"
        raise DoorError(f"{where}{signature} {must}: {error}") from error
    described_as = (inspect.getdoc(function) or "").strip().partition("\n")[0]
    return Metric(metric_name(where), described_as, code, function)
