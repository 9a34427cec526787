"""The result of a simulation: columns, float64, (simulation, tick, ...).

Every column is declared once, here, with its unit, its meaning and the names of its last axis; the loop
fills it, the recorders write it, and the documentation lists it from this declaration.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmerge.scenario import CARS, Scenario

Array = NDArray[np.float64]
XY = ("x", "y")
NEIGHBOURS = CARS[1:]
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
PAIR_NAMES = ("ego_vehicle_1", "ego_vehicle_2", "vehicle_1_vehicle_2")


@dataclass(frozen=True)
class Column:
    """How one column is declared.

    Attributes:
        name: attribute of :class:`Trace`, with the unit at its end.
        axes: names along each axis after (simulation, tick); ``()`` for a scalar.
        symbol: the paper's letter, or a short word.
        doc: what it is.
    """

    name: str
    axes: tuple[tuple[str, ...], ...]
    symbol: str
    doc: str

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape after (simulation, tick)."""
        return tuple(len(a) for a in self.axes)


def _column(symbol: str, doc: str, *axes: tuple[str, ...]) -> Any:
    return field(metadata={"symbol": symbol, "doc": doc, "axes": axes})


@dataclass(frozen=True)
class Stop:
    """Why one simulation ended before its time.

    Attributes:
        run: which simulation.
        time_s: when.
        car: which car.
        reason: what happened, in words.
    """

    run: int
    time_s: float
    car: str
    reason: str


@dataclass(frozen=True)
class Trace:
    """What happened, N simulations times T ticks. After a simulation stopped, its rows are NaN.

    Commands of a tick hold from its time to the next tick's.
    """

    scenario: Scenario
    plant: str
    seeds: NDArray[np.int64]
    """Seed of each simulation, (N,): run i alone, with this seed, gives the same bits."""
    stops: tuple[Stop, ...]
    """Simulations that ended early."""
    time_s: Array
    """Simulated time, s, (T,)."""

    opinion: Array = _column("z", "opinion")
    mu: Array = _column("mu", "bifurcation parameter")
    weight: Array = _column("w", "weight of the merge in the target, tanh(k_w z)")
    distance_m: Array = _column("d_j", "distance of the front axles less r", NEIGHBOURS)
    distance_rate_mps: Array = _column("d_j'", "rate of that distance", NEIGHBOURS)
    gap_m: Array = _column("dbar", "gap between the neighbours, |p_2 - p_1| - r")
    clearance_m: Array = _column("clearance", "distance between the bodies", PAIR_NAMES)
    target_m: Array = _column("p_1 + e_1*", "where the nominal law wants the ego", XY)
    u_n_mps2: Array = _column("u_n", "nominal tracking command of the ego", XY)
    u_c_mps2: Array = _column("u_c", "barrier command of the ego", XY)
    u_mps2: Array = _column("u", "front-axle acceleration command", CARS, XY)
    front_m: Array = _column("p", "front-axle centre", CARS, XY)
    velocity_mps: Array = _column("v", "velocity of the front-axle centre", CARS, XY)
    heading_rad: Array = _column("theta", "heading, from the road's direction to the left", CARS)
    speed_mps: Array = _column("v_r", "rear-axle speed", CARS)
    steer_rad: Array = _column("delta", "steering angle of the equivalent bicycle", CARS)
    a_mps2: Array = _column("a", "rear-axle acceleration command, before limits", CARS)
    omega_radps: Array = _column("omega", "steering rate command, before limits", CARS)
    steer_command_rad: Array = _column("delta_cmd", "steering angle command, within limits", CARS)
    torque_n_m: Array = _column("tau", "wheel torque command, within limits", CARS, WHEELS)
    torque_clipped_n_m: Array = _column("tau clipped", "torque asked for and not given", CARS)
    steer_clipped_rad: Array = _column("delta clipped", "steering asked for and not given", CARS)

    qpos: Array | None = None
    """Generalised positions of the composed MuJoCo world, (N, T, nq), when poses were asked for."""

    @property
    def runs(self) -> int:
        """Number of simulations N."""
        return len(self.seeds)

    @property
    def min_distance_m(self) -> Array:
        """Smallest d_1 and d_2 of each simulation, m, (N, 2); NaN rows where a run has no data at all."""
        return _least(self.distance_m)

    @property
    def min_clearance_m(self) -> Array:
        """Smallest distance between bodies, pair by pair, m, (N, 3); NaN where there are no bodies."""
        return _least(self.clearance_m)


COLUMNS: tuple[Column, ...] = tuple(
    Column(f.name, f.metadata["axes"], f.metadata["symbol"], f.metadata["doc"])
    for f in fields(Trace)
    if "axes" in f.metadata
)


def _least(values: Array) -> Array:
    """Minimum over the tick axis that ignores NaN, and is NaN where there is nothing else."""
    least: Array = np.where(np.isnan(values), np.inf, values).min(axis=1)
    return np.where(np.isinf(least), np.nan, least)


@dataclass(frozen=True)
class Block:
    """Some consecutive ticks of one simulation, as recorders get them.

    Attributes:
        ticks: index of each tick in the run, (B,).
        time_s: simulated time, s, (B,).
        columns: each column of ``COLUMNS`` by name, (B, ...); views, not to be written to.
        qpos: generalised positions of the composed world, (B, nq).
    """

    ticks: NDArray[np.int64]
    time_s: Array
    columns: dict[str, Array]
    qpos: Array


def blocks(trace: Trace, run: int, size: int = 500) -> Iterator[Block]:
    """A simulation of a finished trace, cut into blocks of ``size`` ticks, up to where it stopped."""
    assert trace.qpos is not None, "simulate(..., poses=True) keeps what the recorders need"
    alive = np.flatnonzero(~np.isnan(trace.front_m[run, :, 0, 0]))
    end = int(alive[-1]) + 1 if alive.size else 0
    for start in range(0, end, size):
        part = slice(start, min(start + size, end))
        yield Block(
            ticks=np.arange(part.start, part.stop),
            time_s=trace.time_s[part],
            columns={c.name: getattr(trace, c.name)[run, part] for c in COLUMNS},
            qpos=trace.qpos[run, part],
        )
