"""The result of a simulation: columns, float64, (simulation, tick, ...).

Every column is declared once, here, with its unit, its meaning and the names of its last axis; the loop
fills it, the recorders write it, and the documentation lists it from this declaration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, get_type_hints

import numpy as np
from numpy.typing import NDArray

from mjmerge.config.document import described
from mjmerge.errors import MjmergeError
from mjmerge.law.base import Signal
from mjmerge.law.choice import FOLLOWER, LEADER, records
from mjmerge.law.sensed import Places
from mjmerge.roster import PER_CAR, PER_NEIGHBOUR, PER_PAIR, PER_SENSED, WHEELS, XY, Axis, Roster, along
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.ramp import EDGE_DISTANCE, END_DISTANCE, END_RATE, Ramp
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.frame import frame
from mjmerge.simulation.look import html, line
from mjmerge.state import Array, Mask
from mjmerge.vehicle.datasheet import DataSheet

if TYPE_CHECKING:
    import pandas as pd


class Meaning:
    """Declares an attribute of :class:`Trace` as a column: its symbol, what it is, names along its axes."""

    told = False

    def __init__(self, symbol: str, doc: str, *axes: Axis) -> None:
        self.symbol, self.doc, self.axes = symbol, doc, axes


class Told(Meaning):
    """The same of a column that repeats the truth of another where the ego is told the truth."""

    told = True


@dataclass(frozen=True)
class Column:
    """How one column is declared.

    Attributes:
        name: attribute of :class:`Trace`, with the unit at its end.
        axes: each axis after (simulation, tick): one that is as long as the roster says, or its names; ``()``
            for a scalar.
        symbol: the paper's letter, or a short word.
        doc: what it is.
        told: whether it is what the ego is told, and repeats others where that is the truth.
    """

    name: str
    axes: tuple[Axis, ...]
    symbol: str
    doc: str
    told: bool

    def names(self, there: Roster) -> tuple[tuple[str, ...], ...]:
        """Names along each axis, for the cars that are there."""
        return along(self.axes, there)

    def shape(self, there: Roster) -> tuple[int, ...]:
        """Shape after (simulation, tick), likewise."""
        return tuple(len(names) for names in self.names(there))


@dataclass(frozen=True)
class Stop:
    """Why one simulation ended before its time.

    Attributes:
        run: which simulation.
        time_s: when.
        car: which car.
        reason: what happened, in words.
        touched: whether it ended because d_j reached 0, as far as can be told.
        crossing: whether it then closed in undiminished, so that it was to go through 0.
    """

    run: int
    time_s: float
    car: str
    reason: str
    touched: bool = False
    crossing: bool = False


@dataclass(frozen=True, repr=False)
class Trace:
    """What happened, N simulations times T ticks. After a simulation stopped, its rows are NaN.

    Commands of a tick hold from its time to the next tick's.
    """

    scenario: Scenario
    plant: str
    seeds: NDArray[np.int64]
    """Seed of each simulation, (N,): run i alone, with this seed, gives the same bits."""
    sheets: tuple[DataSheet, ...]
    """What is believed of each car, (C,): its data sheet at its size, with the scenario's ``belief``."""
    mismatch: tuple[Mismatch, ...]
    """How the truth of each simulation differs from what its law was told, N of them."""
    stops: tuple[Stop, ...]
    """Simulations that ended early."""
    continuous: bool
    """Whether law and plant were one differential equation; otherwise the command is held over a tick."""
    time_s: Array
    """Simulated time, s, (T,)."""

    opinion: Annotated[Array, Meaning("z", "opinion")]
    mu: Annotated[Array, Meaning("mu", "bifurcation parameter")]
    mu_input_per_s: Annotated[Array, Meaning("mu input", "what drives mu, k_s tanh(...)")]
    weight: Annotated[Array, Meaning("w", "weight of the merge in the target, tanh(k_w z)")]
    distance_m: Annotated[Array, Meaning("d_j", "distance of the front axles less r", PER_NEIGHBOUR)]
    distance_rate_mps: Annotated[Array, Meaning("d_j'", "rate of that distance", PER_NEIGHBOUR)]
    sensed_distance_m: Annotated[Array, Meaning("d_j seen", "the same as the ego is told", PER_NEIGHBOUR)]
    sensed_distance_rate_mps: Annotated[
        Array, Meaning("d_j' seen", "its rate as the ego is told", PER_NEIGHBOUR)
    ]
    sensed_front_m: Annotated[
        Array, Told("p seen", "front-axle centres as the ego is told them", PER_CAR, XY)
    ]
    sensed_velocity_mps: Annotated[Array, Told("v seen", "likewise their velocities", PER_CAR, XY)]
    sensed_heading_rad: Annotated[Array, Told("theta seen", "likewise its own heading")]
    sensed_speed_mps: Annotated[Array, Told("v_r seen", "likewise its own rear-axle speed")]
    sensed_steer_rad: Annotated[Array, Told("delta seen", "likewise its own steering angle")]
    sensed_leader_mps2: Annotated[
        Array, Told("u_1 seen", "likewise what the leader says that it intends", XY)
    ]
    gap_m: Annotated[Array, Meaning("dbar", "gap between leader and follower, |p_2 - p_1| - r")]
    gap_rate_mps: Annotated[Array, Meaning("dbar'", "rate of that gap")]
    clearance_m: Annotated[Array, Meaning("clearance", "distance between the bodies", PER_PAIR)]
    contact_impulse_n_s: Annotated[
        Array,
        Meaning("impulse", "of the contact between the bodies, over the tick that ends here", PER_PAIR),
    ]
    contact_speed_mps: Annotated[
        Array, Meaning("impact", "how fast they moved against each other as that tick began", PER_PAIR)
    ]
    target_m: Annotated[Array, Meaning("p_1 + e_1*", "where the nominal law wants the ego", XY)]
    u_n_mps2: Annotated[Array, Meaning("u_n", "nominal tracking command of the ego", XY)]
    u_c_mps2: Annotated[Array, Meaning("u_c", "barrier command of the ego", XY)]
    u_mps2: Annotated[Array, Meaning("u", "front-axle acceleration command", PER_CAR, XY)]
    front_m: Annotated[Array, Meaning("p", "front-axle centre", PER_CAR, XY)]
    velocity_mps: Annotated[Array, Meaning("v", "velocity of the front-axle centre", PER_CAR, XY)]
    heading_rad: Annotated[Array, Meaning("theta", "heading, from the road's direction to the left", PER_CAR)]
    speed_mps: Annotated[Array, Meaning("v_r", "rear-axle speed", PER_CAR)]
    steer_rad: Annotated[Array, Meaning("delta", "steering angle of the equivalent bicycle", PER_CAR)]
    a_mps2: Annotated[Array, Meaning("a", "rear-axle acceleration command, before limits", PER_CAR)]
    omega_radps: Annotated[Array, Meaning("omega", "steering rate command, before limits", PER_CAR)]
    steer_command_rad: Annotated[
        Array, Meaning("delta_cmd", "steering angle command, within limits", PER_CAR)
    ]
    torque_n_m: Annotated[Array, Meaning("tau", "wheel torque command, within limits", PER_CAR, WHEELS)]
    torque_clipped_n_m: Annotated[Array, Meaning("tau clipped", "torque asked for and not given", PER_CAR)]
    steer_clipped_rad: Annotated[Array, Meaning("delta clipped", "steering asked for and not given", PER_CAR)]

    signals: Mapping[str, Array] = field(default_factory=dict)
    """What there is only under some laws and on some roads, by name, each (N, T, ...): see :func:`own`."""

    def __repr__(self) -> str:
        return line(self)

    def _repr_html_(self) -> str:
        """What a notebook shows of it: least distances, and those of the worst run over time."""
        return html(self, worst_run(self))

    def frame(self, run: int = 0) -> pd.DataFrame:
        """One of the simulations as a table, a row per tick, over ``time_s``; needs pandas.

        Columns are named as in the files of ``mjmerge convert``: ``distance_m.vehicle_1``. After the
        simulation stopped, rows are NaN.

        Args:
            run: which.

        Raises:
            MjmergeError: there is no such simulation, or no pandas.
        """
        return frame(self, run)

    def alone(self, run: int, scenario: Scenario) -> Trace:
        """One of the simulations as a trace of its own: views of this one's columns.

        Args:
            run: which.
            scenario: what it was a run of.
        """
        row = slice(run, run + 1)
        return replace(
            self,
            scenario=scenario,
            seeds=self.seeds[row],
            mismatch=self.mismatch[row],
            stops=tuple(replace(stop, run=0) for stop in self.stops if stop.run == run),
            **{column.name: getattr(self, column.name)[row] for column in COLUMNS},
            signals={name: values[row] for name, values in self.signals.items()},
        )

    @property
    def columns(self) -> tuple[Column, ...]:
        """Every column of it, those that not every trace has last."""
        return (*COLUMNS, *own(self.scenario))

    def column(self, name: str) -> Array:
        """A column by its name, (N, T, ...)."""
        found: Array = self.signals[name] if name in self.signals else getattr(self, name)
        return found

    @property
    def roster(self) -> Roster:
        """Who is there."""
        return self.scenario.roster

    @property
    def runs(self) -> int:
        """Number of simulations N."""
        return len(self.seeds)

    @property
    def two(self) -> tuple[Places, Places]:
        """Where its law's leader and follower are along the axis of neighbours; chosen ones, each (N, T)."""
        law = self.scenario.law
        return place_of(self.signals, LEADER, law.j_1), place_of(self.signals, FOLLOWER, law.j_2)

    @property
    def leader_m(self) -> Array:
        """Front axle of the law's leader, m, (N, T, 2)."""
        return along_neighbours(self.front_m[:, :, 1:], self.two[0])

    @property
    def follower_m(self) -> Array:
        """Front axle of the law's follower, m, (N, T, 2)."""
        return along_neighbours(self.front_m[:, :, 1:], self.two[1])

    @property
    def min_distance_m(self) -> Array:
        """Smallest d_j of each simulation, m, (N, C-1); NaN rows where a run has no data at all."""
        return _least(self.distance_m)

    @property
    def edge_distance_m(self) -> Array | None:
        """The column of that name, (N, T); ``None`` where the ego's lane goes on."""
        return self.signals.get(EDGE_DISTANCE)

    @property
    def off_the_end(self) -> Mask:
        """Whether the ego's body is over that edge, (N, T); never where the lane goes on."""
        edge_m = self.edge_distance_m
        return np.zeros(self.distance_m.shape[:2], dtype=bool) if edge_m is None else edge_m <= 0

    @property
    def least_m(self) -> Array:
        """Smallest d_j, and where the ego's lane ends smallest distance from the edge, m, (N, C-1 or C)."""
        edge_m = self.edge_distance_m
        return _least(self.distance_m if edge_m is None else _beside(self.distance_m, edge_m))

    @property
    def guarded_m(self) -> Array:
        """d_j of everything that the law keeps clear of, m, (N, T, C-1 or C): of the end last, if told."""
        return self._guarded(self.distance_m, END_DISTANCE)

    @property
    def guarded_rate_mps(self) -> Array:
        """Its rate, m/s, likewise."""
        return self._guarded(self.distance_rate_mps, END_RATE)

    @property
    def guarded_points_m(self) -> Array:
        """Where that is, m, (N, T, C-1 or C, 2): the neighbours' front axles, and the end's nearest point."""
        points, ramp = self.front_m[:, :, 1:], self.ramp
        if ramp is None or not ramp.told:
            return points
        end, _ = ramp.nearest(self.front_m[:, :, 0], self.velocity_mps[:, :, 0])
        return np.concatenate([points, end[:, :, None]], axis=2)

    @property
    def ramp(self) -> Ramp | None:
        """The end of the ego's lane; ``None`` where it goes on."""
        return Ramp.of([self.scenario], self.plant)

    def _guarded(self, of_cars: Array, of_end: str) -> Array:
        told = of_end in self.signals and self.scenario.road.told == "obstacle"
        return _beside(of_cars, self.signals[of_end]) if told else of_cars

    @property
    def touching(self) -> Mask:
        """Whether two bodies touch at a tick or did since the last, (N, T, P); never where there are none."""
        return self.touching_in(slice(None))

    def touching_in(self, runs: int | slice) -> Mask:
        """The same of one simulation, (T, P), or of some."""
        return (self.clearance_m[runs] <= 0) | (self.contact_impulse_n_s[runs] > 0)

    @property
    def touching_ego(self) -> Mask:
        """The same of the ego and each neighbour, (N, T, C-1)."""
        return self.touching[..., : len(self.roster.neighbours)]

    @property
    def min_clearance_m(self) -> Array:
        """Smallest distance between bodies, pair by pair, m, (N, P); NaN where there are no bodies."""
        return _least(self.clearance_m)


def worst_run(trace: Trace) -> int:
    """The simulation that came closest to a neighbour, or to the edge; without data it is worse than any."""
    least = trace.least_m.min(axis=1)
    return int(np.argmin(np.where(np.isnan(least), -np.inf, least)))


def check_trace(given: object) -> None:
    """Refuses what is no trace.

    Raises:
        MjmergeError: with what to pass.
    """
    if not isinstance(given, Trace):
        raise MjmergeError(
            f"expected a trace, got {described(given)}; pass what mjmerge.simulate(scenario) returned"
        )


COLUMNS: tuple[Column, ...] = tuple(
    Column(name, meaning.axes, meaning.symbol, meaning.doc, meaning.told)
    for name, hint in get_type_hints(Trace, include_extras=True).items()
    for meaning in getattr(hint, "__metadata__", ())
    if isinstance(meaning, Meaning)
)
"""The columns of every trace, in the order of their declaration. Those that its law does not fill are NaN."""


END_COLUMNS: tuple[Column, ...] = tuple(
    Column(name, (), symbol, doc, told=False)
    for name, symbol, doc in (
        (END_DISTANCE, "d_end", "distance of the ego's front axle from the end of its lane less r"),
        (END_RATE, "d_end'", "rate of that distance"),
        (
            EDGE_DISTANCE,
            "edge",
            "of the ego's body from the edge of the road where its lane ends; < 0: off it",
        ),
    )
)
"""The columns of a trace whose scenario has an end of the ego's lane."""


def own(scenario: Scenario) -> tuple[Column, ...]:
    """The columns that not every trace has: the signals of its law, then those of the end of the lane."""
    ends = END_COLUMNS if scenario.road.ends_m is not None else ()
    return (*signals_of(scenario), *ends)


def signals_of(scenario: Scenario) -> tuple[Column, ...]:
    """The columns of its law's own signals; those of neighbours have one of the end, too, if it is told.

    But for what the law asks of neighbours: the end does nothing.
    """
    told = scenario.road.ends_m is not None and scenario.road.told == "obstacle"
    as_told: dict[Axis, Axis] = {PER_NEIGHBOUR: PER_SENSED} if told else {}
    return tuple(
        Column(s.name, axes, s.symbol or s.name, s.doc, told=False)
        for s in records(scenario.law)
        for axes in [s.axes if s.asks else tuple(as_told.get(a, a) for a in s.axes)]
    )


def the_truth(columns: Mapping[str, Array], leader: Places) -> dict[str, Array]:
    """The columns of what the ego is told where that is the truth: views of others, but for a chosen leader.

    Args:
        columns: the others by name, (..., shape of the column).
        leader: where it is along the axis of neighbours; a chosen one at every tick, (...).
    """
    return {
        "sensed_front_m": columns["front_m"],
        "sensed_velocity_mps": columns["velocity_mps"],
        "sensed_heading_rad": columns["heading_rad"][..., 0],
        "sensed_speed_mps": columns["speed_mps"][..., 0],
        "sensed_steer_rad": columns["steer_rad"][..., 0],
        "sensed_leader_mps2": along_neighbours(columns["u_mps2"][..., 1:, :], leader),
    }


def place_of(columns: Mapping[str, Array], signal: Signal, named: int) -> Places:
    """Where leader or follower is along the axis of neighbours: as named, or as chosen, (...).

    Where nothing is known of a choice, as after a run's end, it is the named one.

    Args:
        columns: by name.
        signal: whose number is meant, ``LEADER`` or ``FOLLOWER``.
        named: where the one is that the law names.
    """
    if signal.name not in columns:
        return named
    number: Places = np.nan_to_num(columns[signal.name], nan=named + 1).astype(np.intp) - 1
    return number


def along_neighbours(values: Array, at: Places) -> Array:
    """Of one neighbour each, (..., M), from all of them, (..., C-1, M)."""
    if isinstance(at, int):
        one: Array = values[..., at, :]
        return one
    return np.take_along_axis(values, at[..., None, None], axis=-2)[..., 0, :]


def _beside(of_cars: Array, of_end: Array) -> Array:
    """Numbers of each neighbour, (N, T, C-1), and one more, (N, T)."""
    return np.concatenate([of_cars, of_end[..., None]], axis=-1)


def _least(values: Array) -> Array:
    """Minimum over the tick axis that ignores NaN, and is NaN where there is nothing else."""
    least: Array = np.where(np.isnan(values), np.inf, values).min(axis=1)
    return np.where(np.isinf(least), np.nan, least)


OF_LEAST = (
    "front_m", "velocity_mps", "distance_m", "distance_rate_mps", "gap_m", "gap_rate_mps",
    EDGE_DISTANCE, LEADER.name, FOLLOWER.name,
)  # fmt: skip
"""The columns that :attr:`Trace.least_m` is made of."""
