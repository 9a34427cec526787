"""Does the merge that a paper proves safe survive real cars?

>>> import mjmerge
>>> trace = mjmerge.simulate(mjmerge.load("paper"))
>>> [verdict.verdict for verdict in mjmerge.judge(trace)]
['held']
"""

import mjmerge.interrupts  # noqa: F401  (first: the rest takes its time)
from mjmerge.errors import MjmergeError
from mjmerge.scenario.load import load
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Trace
from mjmerge.verdict.judge import Verdict, judge
from mjmerge.verdict.metrics import events

__all__ = ["MjmergeError", "Scenario", "Trace", "Verdict", "events", "judge", "load", "simulate"]
