"""Where a key of a scenario acts: on which plants, whether in continuous time, and with what else.

Each key says it once, where it is declared: ``friction: Annotated[float, Acts(on=BODIES)]``. A key that says
nothing acts everywhere. "Acts" means that it can change how the cars move or what the ego is told of them.
:mod:`mjmerge.scenario.effect` asks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mjmerge.roster import PLANTS

EVERY = tuple(PLANTS)
"""All plants, from the proof to the cars; each of the following has more of a car than the one before."""
WHEELS, LIMITS, BODIES = EVERY[1:], EVERY[2:], EVERY[3:]
"""Plants with wheels that steer; with the limits and the mass of a car; with bodies, tyres and a road."""


def _always(scenario: Any) -> bool:
    del scenario
    return True


@dataclass(frozen=True)
class Acts:
    """Where a key acts.

    Attributes:
        on: plants that have it.
        continuous: whether these have it in continuous time too, those that have one.
        when: whether the rest of a scenario, its mismatch in place, lets it act.
        only: that condition in words, after "acts only"; empty where there is none.
        random: whether it makes another seed another run.
        beside: a key that cannot always have another value unless this one has: then it may have one too.
    """

    on: tuple[str, ...] = EVERY
    continuous: bool = False
    when: Callable[[Any], bool] = _always
    only: str = ""
    random: bool = False
    beside: str = ""

    @property
    def plants(self) -> str:
        """The plants that have it, in words."""
        return "every plant" if self.on == EVERY else listed(self.on) if self.on else "no plant"

    @property
    def where(self) -> str:
        """Where it acts and with what else, in words."""
        found = f"{self.plants}, {self.only}" if self.only else self.plants
        return found + "; in continuous time too" * self.continuous

    def why_not(self, scenario: Any, plant: str, *, continuous: bool) -> str | None:
        """Why it does not act there, in words that follow the key; ``None`` if it does."""
        if plant not in self.on:
            there = f"{listed(self.on)} only, not on {plant}" if self.on else "no plant"
            return f"acts on {there}{f': {self.only}' if not self.on else ''}"
        if continuous and not self.continuous:
            return f"acts on {self.plants}, but not in continuous time"
        return None if self.when(scenario) else f"acts only {self.only}"


def listed(names: tuple[str, ...]) -> str:
    """Names in a sentence: ``a, b and c``."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
