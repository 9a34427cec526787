"""Numbers that follow from other numbers of the same recording, computed again.

The law, the drivers and the actuation are the run's own functions, asked again with what the recording says
that they saw. What moves the cars is asked again, too, where it is an equation; of physical cars, positions,
velocities, headings and steering angles must be each other's, to bounds from the physics.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from pydantic import PrivateAttr

from mjmerge.config.acts import LIMITS
from mjmerge.drivers import Absent, Along, Driver, Traffic
from mjmerge.law import AbsentLaw, Decision, Law, Memory, Sensed, remembered
from mjmerge.law import geometry as seen_geometry
from mjmerge.law.asked import slice_each
from mjmerge.law.choice import FOLLOWER, LEADER, Two, chosen, kept
from mjmerge.law.sensed import Places
from mjmerge.record.read import Recorded
from mjmerge.review.check import Check, checked, compared
from mjmerge.review.motion import motion
from mjmerge.scenario.cars import believed_sheets
from mjmerge.simulation.loop import recorded
from mjmerge.simulation.sensing import Sensing, foresight
from mjmerge.simulation.trace import Trace, along_neighbours, place_of, the_truth
from mjmerge.state import Array, Cars, Controls, Mask, dot, norm
from mjmerge.vehicle.actuation import BelievedCars, Feet, actuate

_DISTANCE_M = 1e-12
"""Distances follow from positions to the last bit on any processor; this much is allowed, or this part."""
_RELATIVE = 1e-9
"""Commands and opinion go through tanh and exp, whose last bits differ between processors."""


def derived(found: Recorded, trace: Trace) -> Iterator[Check]:
    """Every check of a number against others.

    Args:
        found: the file as read.
        trace: the run in it.
    """
    cars = cars_of(found, trace)
    with np.errstate(all="ignore"):
        yield _start(found, trace)
        yield _distances(found, trace)
        yield _sensing(found, trace, cars)
        yield _law(found, trace, cars)
        yield _opinion(found, trace)
        yield from motion(found, trace, cars)


def cars_of(found: Recorded, trace: Trace) -> Cars:
    """The recorded motion, tick by tick in place of simulation by simulation, (T, C)."""
    c = found.columns
    commanded = c["steer_rad"]
    if trace.plant in LIMITS:
        commanded = np.concatenate([np.zeros((1, c["front_m"].shape[1])), c["steer_command_rad"][:-1]])
    return Cars(
        front_m=c["front_m"],
        velocity_mps=c["velocity_mps"],
        heading_rad=c["heading_rad"],
        speed_mps=c["speed_mps"],
        steer_rad=c["steer_rad"],
        steer_command_rad=commanded,
        clearance_m=c["clearance_m"],
    )


def at(cars: Cars, row: int) -> Cars:
    """One tick as one simulation, (1, C)."""
    return Cars(**{name: values[row : row + 1] for name, values in vars(cars).items()})


def geometry(front_m: Array, velocity_mps: Array, r_m: float, two: tuple[Places, Places]) -> dict[str, Any]:
    """d_j, d_j' and the gap from positions and velocities, by column; (..., C, 2) -> (...).

    Args:
        front_m: front axles, m.
        velocity_mps: of them.
        r_m: the margin r, m.
        two: where leader and follower are along the axis of neighbours; chosen ones at every tick, (...).
    """

    def apart(p: Array, v: Array) -> tuple[Array, Array]:
        length = norm(p)
        unit = p / np.where(length == 0, 1.0, length)[..., None]
        return length - r_m, dot(unit, v)

    def between(a: int, b: int) -> tuple[Array, Array]:
        return apart(
            front_m[..., a, :] - front_m[..., b, :], velocity_mps[..., a, :] - velocity_mps[..., b, :]
        )

    def of(values: Array, j: Places) -> Array:
        return along_neighbours(values[..., 1:, :], j)

    apart_m, rates = zip(*(between(0, j) for j in range(1, front_m.shape[-2])), strict=True)
    gap, gap_rate = apart(*(of(values, two[1]) - of(values, two[0]) for values in (front_m, velocity_mps)))
    distance, rate = np.stack(apart_m, axis=-1), np.stack(rates, axis=-1)
    return {"distance_m": distance, "distance_rate_mps": rate, "gap_m": gap, "gap_rate_mps": gap_rate}


def end_of(trace: Trace) -> dict[str, Array]:
    """The columns about the end of the ego's lane from its motion, each (1, T); none where it goes on."""
    ramp = trace.ramp
    if ramp is None:
        return {}
    return ramp.columns(trace.front_m[:, :, 0], trace.velocity_mps[:, :, 0], trace.heading_rad[:, :, 0])


def _start(found: Recorded, trace: Trace) -> Check:
    """The first tick is the scenario's beginning."""
    if found.ticks[0] != 0:
        return Check("start", False, f"it begins at {found.ticks[0] * found.step_s:.2f} s")
    c = found.columns
    starts = trace.scenario.starts
    speed = np.array([start.speed_mps for start in starts])
    none = np.zeros(len(starts))
    expected = {
        "front_m": np.array([start.front_m for start in starts]),
        "velocity_mps": np.stack([speed, none], axis=-1),
        "heading_rad": none,
        "speed_mps": speed,
        "steer_rad": none,
        **{name: value[0] for name, value in _memory(trace.scenario.law, trace).items()},
    }
    if trace.plant == "double_integrator":  # a point turns with its velocity, and has no wheels
        expected |= {
            "heading_rad": np.arctan2(none, speed),
            "speed_mps": np.abs(speed),
            "steer_rad": np.full(len(starts), np.nan),
        }
    first = {name: value[None] for name, value in expected.items()}
    here = {name: c[name][:1] for name in expected}
    wrong, _ = compared(here, first, np.zeros(1), _RELATIVE, 1e-6)
    return checked("start", wrong, "positions, speeds, z and mu as the scenario begins")


def _memory(law: Law, trace: Trace) -> Memory:
    """What the law begins with, as far as it is recorded, each (1,)."""
    return law.start(1, trace.scenario.initial.opinion) if law.remembers else {}


def _distances(found: Recorded, trace: Trace) -> Check:
    """d_j, d_j' and the gap follow from the positions and velocities."""
    c = found.columns
    expected = geometry(c["front_m"], c["velocity_mps"], trace.scenario.r_m, _two(c, trace.scenario.law))
    says, ramp = "d_j, d_j' and the gap, from positions and velocities", trace.ramp
    if ramp is not None:
        expected |= ramp.columns(c["front_m"][:, 0], c["velocity_mps"][:, 0], c["heading_rad"][:, 0])
        says = "d_j, d_j', the gap and the end of the lane, from positions, velocities and headings"
    return _check("distances", says, found, expected, _DISTANCE_M, _DISTANCE_M)


def _two(columns: Mapping[str, Array], law: Law) -> tuple[Places, Places]:
    """Where leader and follower are along the axis of neighbours, of those that are there."""
    last = columns["front_m"].shape[-2] - 2
    one, two = place_of(columns, LEADER, law.j_1), place_of(columns, FOLLOWER, law.j_2)
    return tuple(j if isinstance(j, int) else np.clip(j, 0, last) for j in (one, two))  # type: ignore[return-value]


def _sensing(found: Recorded, trace: Trace, cars: Cars) -> Check:
    """What the ego was told follows from the truth, the scenario's mismatch and the seed."""
    there, (leader, _) = found.roster, _two(found.columns, trace.scenario.law)
    if found.manifest["sensing"] == "exact":
        sense = Sensing((trace.scenario.mismatch,), [0], found.step_s, len(there.neighbours))
        if not (trace.continuous or sense.exact):
            return Check("sensing", False, "the manifest says exact, and the scenario does not")
        return Check("sensing", True, "the ego was told the truth")
    sense = Sensing((trace.scenario.mismatch,), [int(trace.seeds[0])], found.step_s, len(there.neighbours))
    rows = []
    for k, j_1 in enumerate(np.broadcast_to(leader, len(found.ticks)).tolist()):
        seen, u_1 = sense(at(cars, k), found.columns["u_mps2"][k : k + 1, 1 + j_1])
        told = {"front_m": seen.front_m, "velocity_mps": seen.velocity_mps, "heading_rad": seen.heading_rad}
        told |= {"speed_mps": seen.speed_mps, "steer_rad": seen.steer_rad}
        u = np.zeros((1, len(there.cars), 2))
        u[:, 1 + j_1] = u_1
        rows.append(the_truth(told | {"u_mps2": u}, j_1))
    expected = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
    says = "what the ego was told, from the truth, the mismatch and the seed"
    return _check("sensing", says, found, expected, _RELATIVE, _RELATIVE)


def _law(found: Recorded, trace: Trace, cars: Cars) -> Check:
    """Drivers, law, inverse and limits say what the cars are told, from what they saw and the opinion."""
    says = "drivers, target, u_n, u_c, u, a, omega, steering and torques, from what was seen and the opinion"
    return _check("law", says, found, commands(found, trace, cars), _RELATIVE, _RELATIVE)


def commands(found: Recorded, trace: Trace, cars: Cars) -> dict[str, Array]:
    """What drivers, law, inverse and limits tell the cars, by column, (T, ...).

    Args:
        found: the file as read.
        trace: the run in it.
        cars: its motion, (T, C).
    """
    c, law = found.columns, trace.scenario.law
    u_j, stand = _neighbours(found, trace, cars)
    heading, speed, steer = c["heading_rad"].copy(), c["speed_mps"].copy(), c["steer_rad"].copy()
    heading[:, 0], speed[:, 0] = c["sensed_heading_rad"], c["sensed_speed_mps"]
    steer[:, 0] = c["sensed_steer_rad"]
    seen = replace(
        cars,
        front_m=c["sensed_front_m"],
        velocity_mps=c["sensed_velocity_mps"],
        heading_rad=heading,
        speed_mps=speed,
        steer_rad=steer,
    )
    two = Two(law.r_m, *_two(c, law))
    seen_as = seen_geometry(two, Sensed.of(seen, c["sensed_leader_mps2"]))
    ahead, later = _foreseen(seen, found, trace)
    ramp = trace.ramp
    sensed = Sensed.of(ahead, c["sensed_leader_mps2"], None if ramp is None else ramp.obstacle)
    u_0, signals = c["u_mps2"][:, 0], {}  # a law whose code is not let in decided what it did
    if not isinstance(law, AbsentLaw):
        decision = _decided(found, trace, sensed, two)
        u_0, signals = decision.u, recorded(law, decision.signals, len(found.roster.neighbours))
        signals |= _chosen(found, law, sensed, two, cars)
    own = {"sensed_distance_m": seen_as.d, "sensed_distance_rate_mps": seen_as.d_dot}
    own |= {} if later else {name: signals[name] for name in own if name in signals}
    u = np.concatenate([u_0[:, None], u_j], axis=1)
    actuated = _actuated(ahead, u, stand, found, trace)
    for k, driver in enumerate(trace.scenario.neighbours, 1):
        if isinstance(driver, Absent):  # when it means to stand is its own
            for name in ("torque_n_m", "torque_clipped_n_m"):
                actuated[name][:, k] = c[name][:, k]
    return {
        **signals,
        **own,
        "u_mps2": u,
        **actuated,
    }


def _chosen(found: Recorded, law: Law, sensed: Sensed, two: Two, cars: Cars) -> dict[str, Array]:
    """Whom the law chose at every tick, by what it saw and had chosen at the one before."""
    c = found.columns
    if law.choice == "named" or isinstance(two.j_1, int) or isinstance(two.j_2, int):
        return {}
    after = kept(chosen(law, sensed, two, len(found.roster.neighbours)))
    knows = np.diff(found.ticks, prepend=found.ticks[0]) == 1  # what went before is there
    expected = {name: np.where(knows, np.roll(after[name], 1), c[name]) for name in after}
    if found.ticks[0] == 0:
        start = Sensed.of(at(cars, 0), np.zeros((1, 2)))
        for name, number in kept(chosen(law, start)).items():
            expected[name][0] = number[0]
    return expected


def _decided(found: Recorded, trace: Trace, sensed: Sensed, two: Two) -> Decision:
    """What the law makes of what it saw, between whom it had chosen.

    Of all ticks at once, or of one after the other where it remembers more than is recorded; after a gap
    nobody knows what, and it decided what it did.
    """
    law, step_s, c = trace.scenario.law, 0.0 if trace.continuous else found.step_s, found.columns
    memory = law.start(1, trace.scenario.initial.opinion)
    if memory.keys() <= {*law.remembers}:
        memory = {name: c[name] for name in law.remembers}
        return two.put_back(law, law.decide(two.arranged(law, sensed), memory, step_s))
    whole = int(np.argmin([*(found.ticks == np.arange(len(found.ticks))), False]))
    made = []
    for _, (now, _) in zip(range(whole), slice_each(two.arranged(law, sensed), {}), strict=False):
        made.append(law.decide(now, memory, step_s))
        memory = remembered(law, memory, made[-1], step_s)
    names = [*law.gives, *(s.name for s in law.signals)]
    told = [recorded(law, one.signals, len(found.roster.neighbours)) for one in made]
    signals = {name: np.concatenate([c[name][:0], *(one[name] for one in told)]) for name in names}
    first = two.of(slice(whole)).put_back(law, Decision(c["u_mps2"][:0, 0], signals)).signals
    return Decision(
        np.concatenate([*(one.u for one in made), c["u_mps2"][whole:, 0]]),
        {name: np.concatenate([first[name], c[name][whole:]]) for name in names},
    )


def _neighbours(found: Recorded, trace: Trace, cars: Cars) -> tuple[Array, Mask]:
    """What the neighbours' drivers intend, (T, C-1, 2), and which of the cars mean to stand, (T, C)."""
    scenario = trace.scenario
    drivers = tuple(
        _AsRecorded.of(found, j) if isinstance(driver, Absent) else driver
        for j, driver in enumerate(scenario.neighbours)
    )
    starts_m = np.array([[start.front_m for start in scenario.starts[1:]]])
    hold_s = 0.0 if trace.continuous else found.step_s
    seeds = [int(trace.seeds[0])]
    two = scenario.law.j_1, scenario.law.j_2
    traffic = Traffic.of([drivers], seeds, scenario.duration_s, starts_m, trace.sheets[1:], hold_s, two)
    intended, stand = [], []
    for k, tick in enumerate(found.ticks):
        now, time_s = at(cars, k), float(tick * found.step_s)
        intended.append(traffic.intend(now, time_s))
        stand.append(traffic.stands(now, time_s, intended[-1]))
    return np.concatenate(intended), np.concatenate(stand)


class _AsRecorded(Driver):
    """Stands for a driver whose code is not let in: intends what is recorded of it."""

    can_lead: ClassVar[bool] = True
    kind: str
    _wanted: dict[float, float] = PrivateAttr(default_factory=dict)

    @classmethod
    def of(cls, found: Recorded, neighbour: int) -> _AsRecorded:
        """The stand-in of a neighbour, by its place along their axis."""
        own = cls(kind="as recorded")
        wanted = found.columns["u_mps2"][:, 1 + neighbour, 0].tolist()
        own._wanted = dict(zip((found.ticks * found.step_s).tolist(), wanted, strict=True))
        return own

    def acceleration_mps2(
        self, time_s: float, own: Along, leader: Along | None, drawn: Array | None, hold_s: float = 0.0
    ) -> Array:
        """What is recorded at that time."""
        del own, leader, drawn, hold_s
        return np.array([self._wanted[time_s]])


def _actuated(seen: Cars, u: Array, stand: Mask, found: Recorded, trace: Trace) -> dict[str, Array]:
    """What the cars are told, by column, tick after tick: feet remember."""
    believed = BelievedCars.of(believed_sheets(trace.scenario), limited=trace.plant in LIMITS)
    eps_v_mps, feet = trace.scenario.law.eps_v_mps, Feet(found.step_s)
    told = [
        actuate(at(seen, k), u[k : k + 1], believed, eps_v_mps, found.step_s, feet, stand[k : k + 1])
        for k in range(len(found.ticks))
    ]
    names = {
        "a_mps2": "a_mps2",
        "omega_radps": "omega_radps",
        "steer_command_rad": "steer_rad",
        "torque_n_m": "torque_n_m",
        "torque_clipped_n_m": "torque_clipped_n_m",
        "steer_clipped_rad": "steer_clipped_rad",
    }
    return {column: np.concatenate([getattr(one, name) for one in told]) for column, name in names.items()}


def _foreseen(seen: Cars, found: Recorded, trace: Trace) -> tuple[Cars, bool]:
    """What law and inverse were shown by what was commanded before, and whether it is of later."""
    c, foresee = found.columns, foresight(trace.scenario, trace.plant, continuous=trace.continuous)
    shown = []
    for k in range(len(found.ticks)):
        shown.append(foresee(at(seen, k)))
        row = {name: c[column][k : k + 1] for name, column in _TOLD.items()}
        foresee.told(Controls(**row, wheel_steer_rad=np.zeros(0)))
    whole = {name: np.concatenate([getattr(one, name) for one in shown]) for name in vars(seen)}
    return Cars(**whole), foresee.looks_ahead


_TOLD = {
    "u_mps2": "u_mps2",
    "a_mps2": "a_mps2",
    "omega_radps": "omega_radps",
    "steer_rad": "steer_command_rad",
    "torque_n_m": "torque_n_m",
    "torque_clipped_n_m": "torque_clipped_n_m",
    "steer_clipped_rad": "steer_clipped_rad",
}
"""Controls, and the columns that hold them."""


def _opinion(found: Recorded, trace: Trace) -> Check:
    """Opinion z and mu follow from one tick to the next."""
    if trace.continuous:
        return Check("opinion", None, "not checked: in continuous time it has no steps")
    c, law, step_s = found.columns, trace.scenario.law, trace.scenario.control_step_s
    if not law.remembers:
        return Check("opinion", None, "not checked: the law records nothing that it remembers")
    before = np.flatnonzero(np.diff(found.ticks) == 1)
    told = Decision(c["u_mps2"][before, 0], {name: c[name][before] for name in law.gives})
    expected = law.advance({name: c[name][before] for name in law.remembers}, told, step_s)
    return _check(
        "opinion", "z and mu, each from the tick before", found, expected, _RELATIVE, 1e-12, before + 1
    )


def _check(
    name: str,
    says: str,
    found: Recorded,
    expected: Mapping[str, Array],
    relative: float,
    absolute: float,
    rows: Any = slice(None),
) -> Check:
    """Recorded columns against what they should be."""
    columns = {column: found.columns[column][rows] for column in expected}
    time_s = found.ticks[rows] * found.step_s
    wrong, most = compared(columns, expected, time_s, relative, absolute)
    return checked(name, wrong, f"{says}: off by at most {most:.1g}")
