"""Who is there: the cars of a scenario, what moves them, and the axes of arrays about them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

EGO = "ego"
"""The car that the law drives."""
MOST_CARS = 32
"""In a scenario: pairs, and with them columns, grow with the square."""
_NEIGHBOUR = re.compile(r"vehicle_([1-9][0-9]{0,3})")

PLANTS = {
    "double_integrator": "front axles are point masses: the paper's proof",
    "bicycle": "kinematic bicycles without limits: the paper's vehicle model",
    "bicycle_limited": "kinematic bicycles with the mass and the limits of their cars",
    "mujoco": "physical cars with mass, tyres, suspension, servos and limits",
}
"""What moves the cars, by the name of its module, from the proof to physics: each has more of a car."""
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
"""The wheels of a car, in the order of every array's axis of wheels."""
XY = ("x", "y")
"""The components of a vector in the road frame."""


@dataclass(frozen=True)
class Roster:
    """The cars of one scenario, the ego first, in the order of every array's car axis."""

    cars: tuple[str, ...]

    @property
    def neighbours(self) -> tuple[str, ...]:
        """All but the ego, in the order of every array's axis of neighbours."""
        return self.cars[1:]

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Who stands to whom, by index, in the order of every array's axis of pairs: the ego's come first."""
        return tuple(combinations(range(len(self.cars)), 2))

    @property
    def pair_names(self) -> tuple[str, ...]:
        """Names of the pairs: ``ego_vehicle_1``."""
        return tuple(f"{self.cars[a]}_{self.cars[b]}" for a, b in self.pairs)

    @property
    def others(self) -> slice:
        """Where along the axis of pairs those without the ego are, after the ego's, one per neighbour."""
        return slice(len(self.neighbours), None)


@lru_cache(maxsize=64)
def roster(neighbours: int = 2) -> Roster:
    """So many neighbours, called ``vehicle_1`` and so on, around an ego."""
    return Roster((EGO, *(neighbour(j) for j in range(neighbours))))


def neighbour(j: int) -> str:
    """What the neighbour at this place of the axis of neighbours is called: 0 is ``vehicle_1``."""
    return f"vehicle_{j + 1}"


@lru_cache(maxsize=1024)  # the law asks at every tick
def slot(name: str) -> int | None:
    """Where along the axis of neighbours one of this name is; ``None`` for what is no neighbour's name."""
    found = _NEIGHBOUR.fullmatch(name)
    return int(found[1]) - 1 if found else None


def in_order(names: Iterable[str]) -> tuple[str, ...]:
    """Those of some names that are a car's: the ego, then the neighbours by their numbers."""
    slots = {name: j for name in names if (j := slot(name)) is not None}
    return (EGO, *sorted(slots, key=slots.__getitem__))


PER_CAR, PER_NEIGHBOUR, PER_PAIR, PER_SENSED = "cars", "neighbours", "pairs", "sensed"
"""Axes that are as long as the roster says; the last has the neighbours, then the end of the ego's lane."""
END = "end"
"""What the end of the ego's lane is called among those that a law keeps clear of."""
Axis = str | tuple[str, ...]
"""One of these, or the names along an axis that is the same for every roster."""


def along(axes: tuple[Axis, ...], there: Roster) -> tuple[tuple[str, ...], ...]:
    """The names along some axes, for the cars that are there."""
    named = {PER_CAR: there.cars, PER_NEIGHBOUR: there.neighbours, PER_PAIR: there.pair_names}
    named[PER_SENSED] = (*there.neighbours, END)
    return tuple(named[axis] if isinstance(axis, str) else axis for axis in axes)


PAINT = {
    EGO: (0.16, 0.62, 0.33),
    neighbour(0): (0.17, 0.38, 0.75),
    neighbour(1): (0.85, 0.45, 0.13),
}
"""Colour of each car, red, green and blue, 0 to 1; the paper draws the ego green and its neighbours blue."""
_FURTHER = (
    (0.52, 0.32, 0.68),
    (0.10, 0.60, 0.66),
    (0.72, 0.62, 0.10),
    (0.80, 0.30, 0.48),
    (0.45, 0.36, 0.28),
    (0.35, 0.55, 0.80),
)


def paint(car: str) -> tuple[float, float, float]:
    """Colour of any car; from the ninth neighbour on they come round again."""
    if car in PAINT:
        return PAINT[car]
    return _FURTHER[((slot(car) or 0) - len(PAINT) + 1) % len(_FURTHER)]


def colour(car: str) -> str:
    """The same as figures and pages want it."""
    return "#" + "".join(f"{round(255 * c):02x}" for c in paint(car))
