"""The scenario: what one YAML file says, frozen once loaded.

Units are in the key names. Positions are **front-axle centres in the road frame**: x along the road
(the paper's rho), y to the left of it (eta). Every number the paper leaves open is a key here, with the
default we chose and why.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, sqrt
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, PrivateAttr, ValidationError, ValidationInfo, field_validator

from mjmerge import drivers as _drivers
from mjmerge import law as _laws
from mjmerge.config.acts import BODIES, LIMITS, WHEELS, Acts
from mjmerge.config.bounds import LONGEST_S, MOST_SEED
from mjmerge.config.doors import Code
from mjmerge.config.frozen import Frozen, Further, NonNegative, PerCar, Positive
from mjmerge.config.units import Unit, rescaled
from mjmerge.errors import MjmergeError, Problem, ScenarioError
from mjmerge.roster import EGO, Roster, in_order
from mjmerge.scenario.look import html, line
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.space import Space
from mjmerge.vehicle.datasheet import DataSheet

if TYPE_CHECKING:
    DriverSpec = _drivers.Driver
    LawSpec = _laws.Law
else:
    DriverSpec = _drivers.union()
    LawSpec = _laws.union()

Need = Literal["barrier", "grip"]
_TWO = ("vehicle_1", "vehicle_2")
"""The neighbours that every scenario has: the paper's."""
Place = Annotated[float, Field(ge=-1e9, le=1e9)]
Point = Annotated[tuple[Place, Place], Field(strict=False)]


class CarStart(Frozen):
    """Where a car is at t = 0; it points along the road with straight wheels."""

    front_m: Point
    """Front-axle centre [x, y] in the road frame, m."""
    speed_mps: Annotated[float, Field(ge=-1000, le=1000)]
    """Speed along the road, m/s."""


class Initial(PerCar):
    """State at t = 0; who stands here is there: ``vehicle_3`` and so on may follow."""

    __pydantic_extra__: dict[Further, CarStart]

    ego: CarStart
    vehicle_1: CarStart
    vehicle_2: CarStart
    z: NonNegative = 0.15
    """Opinion z(0); the paper asks for a small positive number."""
    mu: float = 0.0
    """Bifurcation parameter mu(0), 1."""

    @property
    def opinion(self) -> dict[str, float]:
        """What a law may begin with: z(0) and mu(0)."""
        return {"z": self.z, "mu": self.mu}

    @property
    def roster(self) -> Roster:
        """Who is there."""
        return Roster(in_order([*_TWO, *self.further]))


class Drivers(PerCar):
    """Who drives the neighbours; ``mjmerge list drivers`` shows the kinds."""

    __pydantic_extra__: dict[Further, DriverSpec]

    vehicle_1: DriverSpec
    vehicle_2: DriverSpec


Length = Annotated[float, Field(gt=0, le=1000)]
_OF_CAR = Unit(1, 0)


class Lengths(PerCar):
    """A length of each car's body where it is not that of its model's data sheet, m; null = data sheet."""

    __pydantic_extra__: dict[Further, Length]

    ego: Annotated[Length | None, _OF_CAR] = None
    vehicle_1: Annotated[Length | None, _OF_CAR] = None
    vehicle_2: Annotated[Length | None, _OF_CAR] = None

    def of(self, car: str) -> float | None:
        """That of a car, m; ``None`` where nothing is said."""
        found: float | None = getattr(self, car, None)
        return found

    @property
    def said(self) -> dict[str, float]:
        """Those that are said, by car, m."""
        every = {car: self.of(car) for car in (*type(self).model_fields, *self.further)}
        return {car: length_m for car, length_m in every.items() if length_m is not None}


class Models(PerCar):
    """The car model of each car; ``mjmerge list models`` shows them."""

    __pydantic_extra__: dict[Further, str]

    ego: str = "rc"
    vehicle_1: str = "rc"
    vehicle_2: str = "rc"
    size: Annotated[float, Field(gt=0), Unit(1, 0)] = 1.0
    """Lengths of the cars over those of their data sheets. Only ideal plants have cars of any size: mujoco's
    come as they are."""

    length_m: Lengths = Lengths()
    """How long each car is, nose to tail, m: its data sheet is stretched to that, and on mujoco the car,
    by a factor of 1.6 at most."""
    width_m: Lengths = Lengths()
    """How wide each car is, m; likewise."""

    def of(self, car: str) -> str:
        """The model of a car: ``rc`` where nothing is said."""
        name: str = getattr(self, car, type(self).model_fields[EGO].default)
        return name


class Road(Frozen):
    """The road as it is drawn; it is flat and straight, and its grip is a mismatch, not a design value."""

    lane_width_m: Annotated[float, Field(ge=0.01, le=1000)] = 1.2
    """Width of a lane as drawn, m; the paper gives none."""
    ends_m: Place | None = None
    """Where the lane that the ego starts in ends, x in the road frame, m; null: nowhere."""
    taper_m: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """Length over which it narrows before that, from its outer side, m."""
    told: Literal["obstacle", "nothing"] = "obstacle"
    """What the law is told of the end: a standing obstacle, by its nearest point, or nothing."""


class Belief(Frozen):
    """What the ego believes of itself where it differs from its model's data sheet; null = data sheet."""

    wheelbase_m: Annotated[Positive | None, Acts(on=WHEELS, continuous=True)] = None
    """Wheelbase L, m."""
    mass_kg: Annotated[Positive | None, Acts(on=LIMITS)] = None
    """Mass, m, kg."""
    wheel_radius_m: Annotated[Positive | None, Acts(on=LIMITS)] = None
    """Rolling radius, m."""


def _foresees(scenario: Any) -> bool:
    return bool(scenario.actuation.inverse == "predicted")


_FORESEEN = Acts(on=WHEELS, when=_foresees, only="under actuation.inverse predicted")


class Actuation(Frozen):
    """From the acceleration that the law asks for to what the ego's car is told."""

    inverse: Annotated[Literal["measured", "commanded", "predicted"], Acts(on=WHEELS)] = "measured"
    """Which steering angle the bicycle inverse takes for delta: the one that is measured, as printed, or the
    one that was last commanded, with which a dead time does not make it weave; predicted also takes the ego
    and all others as they will be after dead_time_s."""
    dead_time_s: Annotated[float, Field(ge=0, le=2), _FORESEEN] = 0.0
    """Dead time that the inverse predicted reckons with, of measurements and commands together, s."""


class Floor(Frozen):
    """A one-sided bound."""

    at_least: float = 0.0
    """The run fails below this."""


class Bound(Frozen):
    """Bounds of a metric, in its unit: at least, at most, or both. What is not known is within none."""

    at_least: float | None = None
    """The run fails below this."""
    at_most: float | None = None
    """The run fails above this."""


class Expect(Frozen):
    """What must come out for exit code 0."""

    min_distance_m: Floor = Floor()
    """Safety floor on min over t of every d_j, m. Whatever it says, d_j <= 0 and touching bodies fail."""
    min_edge_distance_m: Floor = Floor()
    """The same on the distance of the ego's body from the edge of the road where its lane ends, m; only with
    road.ends_m. Whatever it says, running off the end fails."""
    metrics: dict[str, Bound] = Field(default_factory=dict)
    """Bounds of the scenario's own metrics, by name."""

    def __hash__(self) -> int:
        return hash(self.model_dump_json())


def _on_a_line(name: str) -> str:
    """A name that tables, CSV, JUnit and pytest can all show."""
    if not name.isprintable() or name != name.strip() or "::" in name:
        raise ValueError("must be printable text on a line, without '::' or spaces around it")
    return name


class GateRow(Frozen):
    """A row of the regression gate: this scenario under a mismatch, and what must hold then."""

    name: Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_on_a_line)]
    """What the row is called."""
    plant: str = "mujoco"
    """What moves the cars."""
    seed: Annotated[int, Field(ge=0, le=MOST_SEED)] = 0
    """Of the run: of its noise, and of what a neighbour decides by chance."""
    set: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Keys that are different in this row, as on the command line: mismatch.friction=0.3."""
    at_least_m: float
    """Safety floor on every d_j, m: one-sided, set by hand."""
    metrics: dict[str, Bound] = Field(default_factory=dict)
    """Bounds of the scenario's own metrics in this row, by name."""
    needs: Annotated[tuple[Need, ...], Field(strict=False)] = ("barrier",)
    """What must be put to the test, or the row is vacuous: barrier (it is safe because of it), grip (some
    car was asked for more than the road gives)."""

    def __hash__(self) -> int:
        return hash(self.model_dump_json())


class Scenario(Frozen):
    """One run, described completely: with a seed, a plant and the versions it gives the same bits again."""

    description: str = ""
    """One line for ``mjmerge list``."""
    duration_s: Annotated[float, Field(gt=0, le=LONGEST_S)] = 35.0
    """Simulated time, s."""
    control_step_s: Annotated[float, Field(gt=0, le=1)] = 0.01
    """Time the law's command is held, s; the paper has none (continuous time)."""
    physics_step_s: Annotated[float, Field(ge=1e-5, le=0.02), Acts(on=BODIES, beside="control_step_s")] = (
        0.001
    )
    """Time step of the physics, s; the control step is a whole multiple of it."""
    initial: Initial
    law: LawSpec
    drivers: Drivers
    models: Models = Models()
    road: Road = Road()
    actuation: Actuation = Actuation()
    belief: Belief = Belief()
    mismatch: Mismatch = Mismatch()
    metrics: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Metrics of one's own, functions of a trace: `file.py:name` (beside this file, or in the current
    folder), `package.module:name`, or the name of an entry point of the group mjmerge.metrics."""
    expect: Expect = Expect()
    gate: Annotated[
        tuple[GateRow, ...],
        Field(strict=False),
        Acts(on=(), only="it is read by `mjmerge check` alone"),
    ] = ()
    """Rows of the regression gate, see ``mjmerge check``."""
    search: Annotated[
        Space | None, Acts(on=(), only="it is read by `mjmerge falsify`, `probability` and `harden` alone")
    ] = None
    """Where failures are looked for, see ``mjmerge falsify``."""

    _name: str = PrivateAttr(default="scenario")
    _recorded: tuple[Models, tuple[DataSheet, ...]] | None = PrivateAttr(default=None)
    _given: dict[str, str] = PrivateAttr(default_factory=dict)
    _changes: tuple[str, ...] = PrivateAttr(default=())
    _metric_codes: tuple[Code, ...] = PrivateAttr(default=())

    @property
    def name(self) -> str:
        """What the run is called: the stem of the file it came from. Not a key, and not compared."""
        return self._name

    def named(self, name: str) -> Scenario:
        """The same scenario under another name."""
        copy = self.model_copy()
        copy._name = name
        return copy

    @property
    def r_m(self) -> float:
        """The margin r, m: every law is judged by the same one."""
        return self.law.r_m

    @property
    def roster(self) -> Roster:
        """Who is there: the cars that stand somewhere at t = 0."""
        return self.initial.roster

    @property
    def starts(self) -> tuple[CarStart, ...]:
        """Where each car is at t = 0, (C,)."""
        return tuple(getattr(self.initial, car) for car in self.roster.cars)

    @property
    def neighbours(self) -> tuple[DriverSpec, ...]:
        """Who drives each neighbour, (C - 1,)."""
        return tuple(getattr(self.drivers, car) for car in self.roster.neighbours)

    @property
    def car_models(self) -> tuple[str, ...]:
        """The model of each car, (C,)."""
        return tuple(self.models.of(car) for car in self.roster.cars)

    @property
    def given(self) -> Mapping[str, str]:
        """Keys that were given beside the file, as in ``--set``, and the text of each. Not compared.

        Where such a key is without effect on a plant, the run is refused, see :mod:`mjmerge.scenario.effect`.
        """
        return self._given

    def giving(self, given: Mapping[str, str]) -> Scenario:
        """The same scenario with the memory that these keys were given beside its file."""
        copy = self.model_copy()
        copy._given = dict(given)
        copy._changes = tuple(dict.fromkeys(text.removeprefix("--set ") for text in given.values()))
        return copy

    def settled(self) -> Scenario:
        """The same scenario as if all of it stood in its file: to be run on another plant for comparison.

        It still tells what was given beside it.
        """
        return self.giving({}).recalling(self.changes)

    def recalling(self, changes: tuple[str, ...]) -> Scenario:
        """The same scenario with the memory of what was given beside its file, to be told of what ran."""
        copy = self.model_copy()
        copy._changes = changes
        return copy

    @property
    def changes(self) -> tuple[str, ...]:
        """What was given beside its file, such as ``law.k_o=0``: what a figure says of it."""
        return self._changes

    @property
    def sheets(self) -> tuple[DataSheet, ...] | None:
        """Data sheet of each car where they are settled, (C,); ``None`` where the models are to be asked."""
        if self._recorded is None or self._recorded[0] != self.models:
            return None
        return self._recorded[1]

    def with_sheets(self, sheets: tuple[DataSheet, ...] | None) -> Scenario:
        """The same scenario with data sheets of its own, (C,): whatever has become of the models' files.

        With ``None`` the models are to be asked again.
        """
        copy = self.model_copy()
        copy._recorded = None if sheets is None else (self.models, sheets)
        return copy

    @property
    def metric_codes(self) -> tuple[Code, ...]:
        """The code of each of ``metrics`` as it was when they were found; none where nobody looked for it."""
        return self._metric_codes if tuple(code.name for code in self._metric_codes) == self.metrics else ()

    def with_metric_codes(self, codes: tuple[Code, ...]) -> Scenario:
        """The same scenario with the memory of its metrics' code. Not compared."""
        copy = self.model_copy()
        copy._metric_codes = codes
        return copy

    def scaled(self, length: float) -> Scenario:
        """The same scenario at another size, by similarity: lengths times s, times and speeds times sqrt(s).

        Accelerations stay, so that gravity and friction keep their meaning; everything else follows from its
        unit (k_o is a velocity, k_p is 1/s^2, ...). On the ideal plants the run is the same run at the other
        scale, with cars of that size (``models.size``). Physical cars come in their own size: for ``mujoco``,
        choose models of the new one. The regression gate and the search are left behind, and how the
        neighbours keep their lane is not scaled. Bounds of metrics are, where their names end with a unit of
        lengths and times.

        Args:
            length: s, the factor of lengths.

        Raises:
            MjmergeError: it is no size.
            ScenarioError: a key leaves its bounds.
        """
        if isinstance(length, bool) or not isinstance(length, int | float) or not 0 < length < inf:
            raise MjmergeError(f"the scale must be a positive number, got {length!r}")
        alone = self.model_copy(update={"gate": (), "search": None})
        other = rescaled(alone, length, sqrt(length))
        try:
            type(self).model_validate(other.model_dump())
        except ValidationError as invalid:
            problems = [Problem(e["msg"], ".".join(map(str, e["loc"]))) for e in invalid.errors()]
            raise ScenarioError(f"{self.name}, scaled by {length:g}", problems) from invalid
        return other

    def __repr__(self) -> str:
        return line(self)

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        return html(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scenario) and self.model_dump() == other.model_dump()

    @field_validator("*", mode="after")
    @classmethod
    def _hand_over(cls, value: object, info: ValidationInfo) -> object:
        """Put every valid section into the context, so that an invalid scenario's can be checked too."""
        if info.context is not None:
            info.context[info.field_name] = value
        return value

    @property
    def ticks(self) -> int:
        """Number of control ticks in the trace, both ends included."""
        return round(self.duration_s / self.control_step_s) + 1

    @property
    def substeps(self) -> int:
        """Physics steps per control step."""
        return round(self.control_step_s / self.physics_step_s)
