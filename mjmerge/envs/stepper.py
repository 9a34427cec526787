"""The loop of :mod:`mjmerge.simulation.loop`, a tick at a time: somebody else drives one of the cars.

It is that loop, and no copy: fed with what the law decides, it writes the bits of :func:`mjmerge.simulate`.
The law looks on where another drives the ego: it decides at every tick, and its columns are recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from pydantic import PrivateAttr

from mjmerge.config.bounds import check_runs
from mjmerge.drivers import Along, Driver
from mjmerge.errors import MjmergeError, UnknownNameError
from mjmerge.plant import check
from mjmerge.roster import EGO
from mjmerge.scenario.cars import equipped
from mjmerge.scenario.effect import check as check_effect
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.ramp import Ramp
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.arguments import check_run
from mjmerge.simulation.log import Log
from mjmerge.simulation.loop import Ticks, Turn, ticks
from mjmerge.simulation.trace import Trace
from mjmerge.state import Array


class Hand(Driver):
    """A neighbour's driver that intends what it is told to, tick by tick; one for all N simulations."""

    can_lead: ClassVar[bool] = True

    kind: Literal["hand"] = "hand"

    _asked_mps2: Array = PrivateAttr(default_factory=lambda: np.zeros(1))

    def ask(self, a_mps2: Array) -> None:
        """Takes what it is to intend from now on, m/s^2, (N,)."""
        self._asked_mps2 = a_mps2

    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """See :meth:`Driver.acceleration_mps2`."""
        del time_s, own, leader, drawn, hold_s
        return self._asked_mps2


class Stepper:
    """N simulations of a scenario, a tick at a time.

    Attributes:
        scenario: what runs.
        plant: what moves the cars.
        ramp: the end of the ego's lane in the simulations; ``None`` where it goes on.
        log: what is written of them.
    """

    ramp: Ramp | None
    log: Log

    def __init__(
        self, scenario: Scenario, plant: str = "mujoco", *, drives: str = EGO, threads: int = 0
    ) -> None:
        """Checks all that there is to check before anything runs.

        Args:
            scenario: what to run.
            plant: what moves the cars, one of ``mjmerge.plant.PLANTS``.
            drives: the car that is driven from outside; the ego, or a neighbour along its lane.
            threads: threads for the physics, 0 for all cores; does not change the result.

        Raises:
            MjmergeError: as of :func:`mjmerge.simulate`, or there is no such car.
        """
        check_run(scenario, plant, 1, 0, threads, None)
        check(plant, scenario)
        check_effect(scenario, plant)
        if drives not in scenario.roster.cars:
            raise UnknownNameError("car", drives, scenario.roster.cars)
        self.scenario, self.plant = equipped(scenario.settled()), plant
        self._drives, self._threads, self._hand = drives, threads, Hand()
        self._going: Ticks | None = None

    def reset(self, seeds: Sequence[int], cases: Sequence[Mismatch] | None = None) -> Turn:
        """Starts N simulations anew.

        Args:
            seeds: of each, N of them.
            cases: mismatch of each; the scenario's where nothing is said.

        Returns:
            The moment at which the first command is asked for.

        Raises:
            MjmergeError: a seed is none, there is not a case for each, or they need too much memory.
        """
        cases = [self.scenario.mismatch] * len(seeds) if cases is None else list(cases)
        if len(cases) != len(seeds):
            raise MjmergeError(f"{len(seeds)} seeds, and {len(cases)} cases: there must be a case for each")
        check_run(
            self.scenario, self.plant, 1, 0, self._threads, list(zip(seeds, cases, strict=True)),
        )  # fmt: skip
        check_effect(self.scenario, self.plant, mismatches=cases)
        check_runs(self.scenario, len(seeds), (min(seeds), max(seeds)), cases)
        each = [self.scenario.model_copy(update={"mismatch": truth}) for truth in cases]
        if self._drives != EGO:
            self._hand.ask(np.zeros(len(seeds)))
            drivers = self.scenario.drivers.model_copy(update={self._drives: self._hand})
            each = [one.model_copy(update={"drivers": drivers}) for one in each]
        self.ramp = Ramp.of(each, self.plant)
        self._going = ticks(self.scenario, each, list(seeds), self.plant, threads=self._threads)
        turn = self._next(None)
        if turn is None:
            raise MjmergeError(f"scenario {self.scenario.name!r}: no simulation can begin")
        self.log = turn.log
        return turn

    def step(self, asked: Array | None) -> Turn | None:
        """One tick further.

        Args:
            asked: of the ego, acceleration u of its front axle, m/s^2, (N, 2), or ``None`` for what its law
                decides; of a neighbour, acceleration along its lane, m/s^2, (N,).

        Returns:
            The next moment at which a command is asked for; ``None`` when this was the last.

        Raises:
            MjmergeError: there is nothing to step.
        """
        if self._going is None:
            raise MjmergeError("nothing runs: reset comes first, and again after the last tick")
        if self._drives == EGO:
            return self._next(asked)
        assert asked is not None, "no law drives a neighbour"
        self._hand.ask(asked)
        return self._next(None)

    @property
    def over(self) -> bool:
        """Whether there is nothing more to step."""
        return self._going is None

    @property
    def trace(self) -> Trace:
        """What happened so far; what is yet to come is NaN."""
        return self.log.finish()

    @np.errstate(over="ignore", invalid="ignore")  # what stopped may hold anything, unrecorded
    def _next(self, given: Array | None) -> Turn | None:
        """Goes on to the next turn of whoever is driven from outside."""
        assert self._going is not None
        try:
            turn = self._going.send(given)
            while (turn.sensed is not None) != (self._drives == EGO):
                turn = next(self._going)
        except StopIteration:
            self._going = None
            return None
        return turn
