"""What may be different when somebody looks for failures: the section ``search`` of a scenario.

Three things span the space: keys of the scenario, mismatch above all, each with how it is distributed; what
the neighbours may do, within bounds that any road user keeps (Assumption 1 of the paper); and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import exp, isfinite, log
from statistics import NormalDist
from typing import Annotated, Any, Literal

from pydantic import Field

from mjmerge.config.frozen import Frozen, Further, NonNegative, PerCar, Positive

Values = Annotated[tuple[Any, ...], Field(strict=False, min_length=1)]
Pair = Annotated[tuple[float, float], Field(strict=False)]
Level = Literal["mild", "realistic", "severe"]
MOST_CHANGES = 16
"""Of one neighbour's mind."""
_NORMAL = NormalDist()
_TAIL = 1e-12  # of a distribution without an end: beyond it nothing is drawn
_FAR = -_NORMAL.inv_cdf(_TAIL)  # where that is, in standard deviations
_LARGEST = log(1e308)


class Distribution(Frozen):
    """How one key is drawn; one of the five."""

    uniform: Pair | None = None
    """From the first number to the second."""
    log_uniform: Pair | None = None
    """From the first number to the second, with a uniform logarithm; both positive."""
    normal: Pair | None = None
    """Mean and standard deviation."""
    lognormal: Pair | None = None
    """Median, and standard deviation of the logarithm."""
    choice: Values | None = None
    """One of these values, equally likely."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """What is wrong with it: key below it, and message."""
        ways = self.model_dump(exclude_none=True)
        if len(ways) != 1:
            yield "", f"must be one of {', '.join(type(self).model_fields)}"
        for name, pair in (("uniform", self.uniform), ("log_uniform", self.log_uniform)):
            if pair is None:
                continue
            low, high = pair
            if low > high:
                yield name, f"goes from {low} down to {high}; the smaller number comes first"
            elif not isfinite(high - low):
                yield name, f"{low} to {high} is wider than numbers can tell apart"
            if name == "log_uniform" and low <= 0:
                yield name, "both must be positive"
        for name, pair in (("normal", self.normal), ("lognormal", self.lognormal)):
            if pair is not None and pair[1] < 0:
                yield name, f"the standard deviation must not be negative, got {pair[1]}"
        if self.lognormal is not None and self.lognormal[0] <= 0:
            yield "lognormal", f"the median must be positive, got {self.lognormal[0]}"
        elif self.lognormal is not None and log(self.lognormal[0]) + _FAR * self.lognormal[1] > _LARGEST:
            yield "lognormal", "it reaches further than numbers do"
        if self.normal is not None and not isfinite(abs(self.normal[0]) + _FAR * self.normal[1]):
            yield "normal", "it reaches further than numbers do"

    def at(self, part: float) -> Any:
        """The value below which this part of all draws is: its quantile, 0 <= part <= 1."""
        if self.uniform is not None:
            low, high = self.uniform
            return low + part * (high - low)
        if self.log_uniform is not None:
            low, high = map(log, self.log_uniform)
            return exp(low + part * (high - low))
        if self.choice is not None:
            return self.choice[min(int(part * len(self.choice)), len(self.choice) - 1)]
        score = _NORMAL.inv_cdf(min(max(part, _TAIL), 1 - _TAIL))
        if self.normal is not None:
            return self.normal[0] + score * self.normal[1]
        assert self.lognormal is not None, "one of the five is given"
        return self.lognormal[0] * exp(score * self.lognormal[1])


class Behaviour(Frozen):
    """What a neighbour may do: changes of mind one after the other, each as hard as it is allowed to be."""

    changes: Annotated[int, Field(ge=0, le=MOST_CHANGES)] = 3
    """How many, at most: of the gap to the car ahead, or, with nobody ahead, of the speed."""
    acceleration_mps2: Positive
    """The hardest acceleration and braking of a change, m/s^2; the mildest is a tenth of it."""
    gap_m: Pair | None = None
    """Smallest and largest gap to the car ahead, front axle to front axle, m."""
    speed_mps: Pair | None = None
    """Lowest and highest speed of one that has nobody ahead, m/s."""
    from_s: NonNegative = 0.0
    """When the first change may begin, s."""


class Behaviours(PerCar):
    """What each neighbour may do; one that is not named does what the scenario says."""

    __pydantic_extra__: dict[Further, Behaviour]

    vehicle_1: Behaviour | None = None
    vehicle_2: Behaviour | None = None

    def of(self, car: str) -> Behaviour | None:
        """What a neighbour may do."""
        found: Behaviour | None = getattr(self, car, None)
        return found


class Space(Frozen):
    """Where failures are looked for."""

    level: Level | None = None
    """Every axis of mismatch that has this level, from nothing to it."""
    leave_out: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Axes that are not among them."""
    axes: dict[str, Distribution] = Field(default_factory=dict)
    """Keys of the scenario, and how each is distributed; they have the word over the level."""
    neighbours: Behaviours = Behaviours()
    """What the neighbours may do, within Assumption 1."""

    def __hash__(self) -> int:
        return hash(self.model_dump_json())
