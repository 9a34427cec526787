"""The metrics that a scenario brings, run on a trace, and whether their numbers are within bounds.

It is the user's code: whatever it does wrong is told with its name and its file. Nothing here is done to a
trace that was read from a recording: what that names is not ours to run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from mjmerge.config.document import described
from mjmerge.config.doors import Code, DoorError, told
from mjmerge.scenario.metrics import Metric, find, metric_name
from mjmerge.scenario.schema import Bound, Scenario
from mjmerge.simulation.trace import COLUMNS, Trace
from mjmerge.state import Array


def names(scenario: Scenario) -> tuple[str, ...]:
    """What a scenario's own metrics are called, in its order."""
    return tuple(metric_name(reference) for reference in scenario.metrics)


def metrics(scenario: Scenario) -> tuple[Metric, ...]:
    """A scenario's own metrics, ready to be run: those that were found when it was read.

    Raises:
        DoorError: one is not there any more, or another by now; or they were not read with the scenario: of
            a recording they never are.
    """
    if scenario.metrics and not scenario.metric_codes:
        raise DoorError(
            f"the metrics of {scenario.name} were not found when it was read: those of a recording are not "
            "run; to set others, load it with them: load(name, ['metrics=[mine.py:headway_s]'])"
        )
    return tuple(map(_unchanged, scenario.metric_codes))


def _unchanged(code: Code) -> Metric:
    metric = find(code.name)
    if metric.code.sha256 != code.sha256:
        raise DoorError(f"{_whose(metric)} was edited since its scenario was read: run it again")
    return metric


def measured(trace: Trace) -> dict[str, Array]:
    """What a scenario's own metrics come to, by name, each (N,); NaN where they do not know.

    Raises:
        DoorError: one fails, or gives something else; with its name, its file and the line.
    """
    return {metric.name: run(metric, trace) for metric in metrics(trace.scenario)}


def run(metric: Metric, trace: Trace) -> Array:
    """What one metric comes to, (N,); it cannot alter the trace.

    Raises:
        DoorError: it fails, or gives something else than a number for each simulation.
    """
    file = getattr(getattr(metric.function, "__code__", None), "co_filename", _place(metric))
    with told(Path(file), f"{_whose(metric)} fails: "):
        given = metric.function(_frozen(trace))
        values = np.asarray(given)
    if values.dtype.kind not in "fiu":
        what = described(given) if values.dtype.kind == "O" else f"values of type {values.dtype}"
        raise DoorError(
            f"{_whose(metric)} must give {trace.runs} numbers, one for each simulation, got {what}"
        )
    if values.shape != (trace.runs,):
        raise DoorError(
            f"{_whose(metric)} must give a number for each simulation, an array of shape ({trace.runs},), "
            f"got one of shape {values.shape}"
        )
    numbers: Array = values.astype(np.float64)
    if np.isinf(numbers).any():
        seed = trace.seeds[np.argmax(np.isinf(numbers))]
        raise DoorError(f"{_whose(metric)} is infinite with seed {seed}: give NaN where it is not known")
    return numbers


def _frozen(trace: Trace) -> Trace:
    """The same trace, whose arrays cannot be written to."""
    views = {name: getattr(trace, name).view() for name in ("seeds", "time_s", *(c.name for c in COLUMNS))}
    signals = {name: values.view() for name, values in trace.signals.items()}
    for view in (*views.values(), *signals.values()):
        view.flags.writeable = False
    return replace(trace, **views, signals=signals)


def _whose(metric: Metric) -> str:
    return f"the metric {metric.name} of {_place(metric)}"


def _place(metric: Metric) -> str:
    """Its file, or its module."""
    return metric.code.name.rpartition(":")[0]


def within(bound: Bound, value: float) -> bool:
    """Whether a number is within its bounds; what is not known (NaN) never is."""
    low = bound.at_least is None or value >= bound.at_least
    high = bound.at_most is None or value <= bound.at_most
    return bool(low and high and not np.isnan(value))


def broken(bounds: Mapping[str, Bound], values: Mapping[str, float]) -> Iterator[str]:
    """What of one simulation is out of bounds, in words."""
    for name, bound in bounds.items():
        value = values[name]
        if within(bound, value):
            continue
        if np.isnan(value):
            yield f"{name} is not known, and must be {in_words(bound)}"
        elif bound.at_least is not None and value < bound.at_least:
            yield f"{name} is {value:.6g}, below its bound of {bound.at_least:g}"
        else:
            yield f"{name} is {value:.6g}, above its bound of {bound.at_most:g}"


def in_words(bound: Bound) -> str:
    """``at least 0.5 and at most 3``."""
    return " and ".join(f"at {side} {value:g}" for side, value in _sides(bound) if value is not None)


def _sides(bound: Bound) -> tuple[tuple[str, float | None], ...]:
    return ("least", bound.at_least), ("most", bound.at_most)


def one(values: Mapping[str, Array], run: int) -> dict[str, float]:
    """The numbers of one simulation, by name."""
    return {name: float(of[run]) for name, of in values.items()}


def held(bounds: Mapping[str, Bound], values: Mapping[str, Array], run: int) -> bool:
    """Whether all numbers of one simulation are within bounds."""
    return not any(broken(bounds, one(values, run)))


def carried(scenario: Scenario) -> tuple[dict[str, str], ...]:
    """What a recording says of each metric beside its code: name, reference and description."""
    return tuple(
        {"name": metric.name, "reference": metric.code.name, "description": metric.description}
        for metric in metrics(scenario)
    )
