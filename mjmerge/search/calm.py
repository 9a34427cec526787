"""What neighbours do, taken from them: drivers that only go on as they begin.

Of a driver with a plan, each part of it can be taken back: a move, a change of speed, the swaying, the way to
the gap or speed that it begins with. Of any other its doing can, as a whole: it keeps its gap to the car
ahead, or its speed where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isclose
from pathlib import Path
from typing import Any

from mjmerge.config.doors import from_outside
from mjmerge.drivers import Driver, ahead
from mjmerge.drivers.flips import Flips
from mjmerge.drivers.gap import Gap, Move, Sway
from mjmerge.drivers.recorded import Recorded
from mjmerge.drivers.speeds import Change, Speeds
from mjmerge.drivers.steady import Steady
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.schema import Scenario

SAME = 0.01
"""A gap or a speed that differs from the first by less than this part of it is kept, not gone to."""
WHOLE = ""
"""Stands for all that a driver does, in place of one of its keys."""


@dataclass(frozen=True)
class Doing:
    """What a driver does that one who only goes on would not.

    Attributes:
        calm: the one who only goes on.
        moves: changes of mind, in order of time.
        keys: keys with values of their own; ``WHOLE`` with the driver itself where it cannot be taken apart.
    """

    calm: Driver
    moves: tuple[Move | Change, ...]
    keys: dict[str, Any]


def doing(scenario: Scenario, car: str) -> Doing:
    """What a neighbour does, apart from going on as it begins."""
    own: Driver = getattr(scenario.drivers, car)
    gap_m, speed_mps = _first_gap_m(scenario, car), getattr(scenario.initial, car).speed_mps
    if isinstance(own, Gap) and gap_m is not None:
        start = {} if isclose(own.gap_m, gap_m, rel_tol=SAME) else {"gap_m": own.gap_m}
        sway = {"sway": own.sway} if own.sway is not None and own.sway.amplitude_m != 0 else {}
        calm = own.model_copy(update={"moves": (), "sway": None, "gap_m": gap_m if start else own.gap_m})
        return Doing(calm, own.moves, {**start, **sway})
    if isinstance(own, Speeds | Steady):
        same = isclose(own.speed_mps, speed_mps, rel_tol=SAME)
        start = {} if same else {"speed_mps": own.speed_mps}
        update: dict[str, Any] = {"speed_mps": speed_mps} if start else {}
        if isinstance(own, Steady):
            return Doing(own.model_copy(update=update), (), start)
        return Doing(own.model_copy(update=update | {"changes": ()}), own.changes, start)
    if isinstance(own, Flips):
        calm_ = own.model_copy(update={"open_gap_m": own.closed_gap_m})
        return Doing(calm_, (), {} if calm_ == own else {WHOLE: own})
    goes_on = Steady(speed_mps=speed_mps) if gap_m is None else Gap(gap_m=gap_m)
    return Doing(goes_on, (), {WHOLE: own})


def _first_gap_m(scenario: Scenario, car: str) -> float | None:
    """The gap to the car ahead at t = 0, front axle to front axle, m; ``None`` where there is none."""
    law, starts_m = scenario.law, [start.front_m for start in scenario.starts[1:]]
    j = scenario.roster.neighbours.index(car)
    leader = ahead(starts_m, car_sheets(scenario)[1:], (law.j_1, law.j_2))[j]
    return None if leader is None else float(starts_m[leader][0] - starts_m[j][0])


def said(who: str, key: str, value: Any) -> str:
    """A key of a driver that is a part of its own, in words."""
    if isinstance(value, Sway):
        return f"{who} sways by {value.amplitude_m:g} m, every {value.period_s:g} s"
    if isinstance(value, Flips):
        return f"{who} flips between gaps of {value.closed_gap_m:g} m and {value.open_gap_m:g} m"
    if isinstance(value, Recorded):
        return f"{who} drives as recorded"
    if isinstance(value, Driver):
        place, _, name = str(value.kind).rpartition(":")
        kind = f"{Path(place).name}:{name}" if from_outside(value.kind) else value.kind
        return f"{who} drives as {kind} does"
    unit = "a gap of {:g} m" if key == "gap_m" else "{:g} m/s"
    return f"{who} goes to {unit.format(value)} at the start"
