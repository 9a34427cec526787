"""Does the merge that a paper proves safe survive real cars?

>>> import mjmerge
>>> trace = mjmerge.simulate(mjmerge.load("paper"))
>>> [verdict.verdict for verdict in mjmerge.judge(trace)]
['held']
"""

import mjmerge.interrupts  # noqa: F401  (first: the rest takes its time)

# isort: split
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mjmerge.errors import MjmergeError
    from mjmerge.review.opened import read
    from mjmerge.scenario.load import load
    from mjmerge.scenario.schema import Scenario
    from mjmerge.simulation.loop import simulate
    from mjmerge.simulation.trace import Trace
    from mjmerge.verdict.judge import Verdict, judge
    from mjmerge.verdict.metrics import events

__all__ = ["MjmergeError", "Scenario", "Trace", "Verdict", "events", "judge", "load", "read", "simulate"]

_PLACES = {
    "MjmergeError": "errors",
    "Scenario": "scenario.schema",
    "Trace": "simulation.trace",
    "Verdict": "verdict.judge",
    "events": "verdict.metrics",
    "judge": "verdict.judge",
    "load": "scenario.load",
    "read": "review.opened",
    "simulate": "simulation.loop",
}
"""Where each name is, which is imported when it is asked for: importing takes its time."""


def __getattr__(name: str) -> Any:
    """One of the names of the face, see PEP 562."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """What there is, asked for or not."""
    return sorted({*globals(), *__all__})
