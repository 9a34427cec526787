"""What is written while a run goes on: whole columns in the end, and blocks of them for whoever watches."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mjmerge.law.choice import FOLLOWER, LEADER, Two
from mjmerge.law.sensed import Sensed, geometry
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.trace import COLUMNS, Stop, Trace, own, place_of, the_truth
from mjmerge.state import Array, Mask
from mjmerge.vehicle.datasheet import DataSheet

BLOCK_S = 0.5
"""Simulated time that reaches the recorders at once: what a crash can lose, at most, s."""


GLIMPSE_S = 0.1
"""Simulated time that reaches whoever watches a run live at once, s."""


@dataclass(frozen=True)
class TickBlock:
    """Some consecutive ticks of one simulation, as recorders get them.

    Attributes:
        ticks: index of each tick in the run, (B,).
        time_s: simulated time, s, (B,).
        columns: each column of the trace by name, (B, ...); views, not to be written to.
        qpos: generalised positions of the composed world, (B, nq).
    """

    ticks: NDArray[np.int64]
    time_s: Array
    columns: Mapping[str, Array]
    qpos: Array


class Sink(Protocol):
    """Where the blocks of a running simulation go."""

    def write(self, block: TickBlock) -> None:
        """Takes the next ticks of simulation 0."""


class _Feed:
    """Hands simulation 0 to a sink, some ticks at a time."""

    def __init__(self, sink: Sink, ticks: int) -> None:
        self._sink, self._ticks = sink, ticks
        self._qpos: list[Array] = []

    def add(self, qpos: Array) -> bool:
        """Takes the next tick's positions; says whether it is time to flush."""
        self._qpos.append(qpos)
        return len(self._qpos) >= self._ticks

    def flush(self, time_s: Array, columns: Mapping[str, Array], end: int) -> None:
        """Hands over what the sink has not had yet, up to tick ``end``."""
        if not self._qpos:
            return
        part = slice(end - len(self._qpos), end)
        qpos = np.stack(self._qpos)
        self._qpos.clear()
        self._sink.write(
            TickBlock(
                ticks=np.arange(part.start, part.stop),
                time_s=time_s[part],
                columns={name: values[0, part] for name, values in columns.items()},
                qpos=qpos,
            )
        )


class Log:
    """The trace while it is being written; hands simulation 0 to its sinks, block by block."""

    def __init__(
        self,
        scenario: Scenario,
        plant: str,
        seeds: NDArray[np.int64],
        sheets: tuple[DataSheet, ...],
        mismatch: tuple[Mismatch, ...],
        sink: Sink | None = None,
        live: Sink | None = None,
        *,
        continuous: bool = False,
        told_truth: bool = False,
        kept: Collection[str] | None = None,
    ) -> None:
        self._scenario, self._plant, self._seeds = scenario, plant, seeds
        self._sheets, self._mismatch, self._continuous = sheets, mismatch, continuous
        self.time_s: Array = np.arange(scenario.ticks, dtype=np.float64) * scenario.control_step_s
        self._kept = kept

        def empty(name: str, shape: tuple[int, ...]) -> Array:
            return np.full(shape, np.nan) if self._keeps(name) else np.broadcast_to(np.nan, shape)

        self.columns = {
            c.name: empty(c.name, (len(seeds), scenario.ticks, *c.shape(scenario.roster)))
            for c in (*COLUMNS, *own(scenario))
            if not (c.told and told_truth)
        }
        if told_truth:  # nothing is kept twice
            told = the_truth(self.columns, scenario.law.j_1)
            if scenario.law.choice != "named":
                told["sensed_leader_mps2"] = told["sensed_leader_mps2"] * np.nan  # as it is chosen
            self.columns |= told
        self._block_ticks = block_ticks(scenario.control_step_s)
        self._stops: list[Stop] = []
        sinks = ((sink, BLOCK_S), (live, GLIMPSE_S))
        self._feeds = [
            _Feed(to, block_ticks(scenario.control_step_s, s)) for to, s in sinks if to is not None
        ]
        self._ticks = self._followed = 0

    def _keeps(self, name: str) -> bool:
        return self._kept is None or name in self._kept

    def write(self, row: Mapping[str, Array], running: Mask, qpos: Callable[[], Array]) -> None:
        """One tick of all simulations; those not running stay NaN.

        Args:
            row: value of every column that does not follow from others, (N, ...).
            running: which simulations still run, (N,).
            qpos: gives the generalised positions of simulation 0 now, (nq,), if they are needed.
        """
        k, everyone = self._ticks, running.all()
        for name, value in row.items():
            if not self._keeps(name):
                continue
            if everyone:
                self.columns[name][:, k] = value
            else:
                self.columns[name][running, k] = value[running]
        self._ticks = k + 1
        if self._feeds and running[0]:
            now = qpos().copy()
            for feed in [feed for feed in self._feeds if feed.add(now)]:
                self._follow()
                feed.flush(self.time_s, self.columns, self._ticks)
        elif self._ticks - self._followed >= self._block_ticks:
            self._follow()

    def _follow(self) -> None:
        """The true distances and the gap of the ticks since the last time, from how the cars moved."""
        ticks = slice(self._followed, self._ticks)
        self._followed = self._ticks
        cars = self.columns["front_m"].shape[2:]
        front_m, velocity_mps = (
            self.columns[name][:, ticks].reshape(-1, *cars) for name in ("front_m", "velocity_mps")
        )
        law = self._scenario.law
        chosen = {
            s.name: self.columns[s.name][:, ticks].ravel()
            for s in (LEADER, FOLLOWER)
            if s.name in self.columns
        }
        two = Two(law.r_m, place_of(chosen, LEADER, law.j_1), place_of(chosen, FOLLOWER, law.j_2))
        p, p_j = front_m[:, 0], front_m[:, 1:]
        v, v_j = velocity_mps[:, 0], velocity_mps[:, 1:]
        truth = geometry(two, Sensed(p, v, p_j, v_j, u_1=np.full_like(p, np.nan)))
        for name, values in (
            ("distance_m", truth.d),
            ("distance_rate_mps", truth.d_dot),
            ("gap_m", truth.dbar),
            ("gap_rate_mps", truth.dbar_dot),
        ):
            column = self.columns[name][:, ticks]
            column[:] = values.reshape(column.shape)

    def flush(self) -> None:
        """Hands the sinks what they have not had yet."""
        self._follow()
        for feed in self._feeds:
            feed.flush(self.time_s, self.columns, self._ticks)

    def stop(self, stop: Stop) -> None:
        """A simulation ends here, before its time."""
        if stop.run == 0:
            self.flush()
        self._stops.append(stop)

    def finish(self) -> Trace:
        """The trace, complete."""
        self.flush()
        beside = tuple(c.name for c in own(self._scenario))
        return Trace(
            scenario=self._scenario,
            plant=self._plant,
            seeds=self._seeds,
            sheets=self._sheets,
            mismatch=self._mismatch,
            stops=tuple(self._stops),
            continuous=self._continuous,
            time_s=self.time_s,
            **{name: values for name, values in self.columns.items() if name not in beside},
            signals={name: self.columns[name] for name in beside},
        )

    def each(self, scenarios: Sequence[Scenario]) -> list[Trace]:
        """Each simulation's trace, with a scenario of its own."""
        whole = self.finish()
        return [whole.alone(run, scenario) for run, scenario in enumerate(scenarios)]


def block_ticks(control_step_s: float, block_s: float = BLOCK_S) -> int:
    """Ticks in a block: as many as span no more than its time, at least one."""
    return max(1, int(block_s / control_step_s + 1e-9))
