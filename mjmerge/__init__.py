"""Does the merge that a paper proves safe survive real cars?

>>> import mjmerge
>>> trace = mjmerge.simulate(mjmerge.load("paper"))
>>> [verdict.verdict for verdict in mjmerge.judge(trace)]
['held']
"""

import mjmerge.interrupts  # noqa: F401  (first: the rest takes its time)
from mjmerge.contract import Verdict, judge
from mjmerge.errors import MjmergeError
from mjmerge.loader import load
from mjmerge.metrics import events
from mjmerge.scenario import Scenario
from mjmerge.simulate import simulate
from mjmerge.trace import Trace

__all__ = ["MjmergeError", "Scenario", "Trace", "Verdict", "events", "judge", "load", "simulate"]
