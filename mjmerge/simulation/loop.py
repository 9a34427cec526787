"""The loop: observe, decide, actuate, record, step. One page, for one run or a thousand."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mjmerge.config.acts import WHEELS
from mjmerge.config.bounds import check_runs
from mjmerge.drivers import Traffic
from mjmerge.law import Decision, Geometry, Law, Laws, Memory, Sensed, geometry
from mjmerge.law.base import OWN_DISTANCES
from mjmerge.law.sensed import of_each
from mjmerge.plant import Plant, check, make
from mjmerge.scenario.cars import believed_sheets, equipped
from mjmerge.scenario.effect import check as check_effect
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.ramp import Ramp
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.arguments import check_run
from mjmerge.simulation.log import Log, Sink
from mjmerge.simulation.sensing import Sensing, foresight
from mjmerge.simulation.trace import Stop, Trace
from mjmerge.state import Array, Cars, Controls, Mask
from mjmerge.vehicle.actuation import BelievedCars, Feet, actuate, of_points

if TYPE_CHECKING:
    from mjmerge.world.model import World

Case = tuple[int, Mismatch]
"""Seed and mismatch of one simulation."""

_PROGRESS_TICKS = 20


def simulate(
    scenario: Scenario,
    plant: str = "mujoco",
    *,
    runs: int = 1,
    seed: int = 0,
    threads: int = 0,
    world: World | None = None,
    sink: Sink | None = None,
    live: Sink | None = None,
    progress: Callable[[float], None] | None = None,
    continuous: bool = False,
    cases: Sequence[Case] | None = None,
) -> Trace:
    """Runs a scenario N times; run i has the seed ``seed + i`` and the same bits alone or among others.

    Args:
        scenario: what to run.
        plant: what moves the cars, one of ``mjmerge.plant.PLANTS``.
        runs: number of simulations N.
        seed: seed of the first one.
        threads: threads for the physics, 0 for all cores; does not change the result.
        world: the scenario's world, where it is built already.
        sink: gets simulation 0 in blocks while it runs.
        live: likewise, in smaller blocks.
        progress: called now and then with the simulated time, s.
        continuous: in continuous time, to the accuracy of ``mjmerge.simulation.continuous``: no command is
            held. For the two ideal plants.
        cases: seed and mismatch of each simulation, in place of ``runs``, ``seed`` and the scenario's
            mismatch. In continuous time there is no mismatch.

    Returns:
        The trace. A simulation that fails stops there, is named in ``trace.stops``, and is NaN from then on.

    Raises:
        UnknownNameError: there is no such plant.
        ModelError: a car model lacks what is needed of it.
        ScenarioError: a key that was given beside the scenario's file, or a case, is without effect here.
        MjmergeError: an argument is not what it must be, the plant has no continuous time, or the first
            neighbour's driver nobody to follow.
    """
    check_run(scenario, plant, runs, seed, threads, cases, continuous=continuous, world=world)
    check(plant, scenario)
    check_effect(scenario, plant, continuous=continuous, mismatches=[m for _, m in cases or ()])
    changes, scenario = scenario.changes, equipped(scenario.settled())
    if cases is None:
        check_runs(scenario, runs, (seed, seed + runs - 1), [scenario.mismatch])
        cases = [(seed + i, scenario.mismatch) for i in range(runs)]
    seeds, mismatch = zip(*cases, strict=True)
    check_runs(scenario, len(cases), (min(seeds), max(seeds)), mismatch)
    each = [scenario.model_copy(update={"mismatch": truth}) for truth in mismatch]
    going = ticks(
        scenario.recalling(changes), each, seeds, plant,
        threads=threads, world=world, sink=sink, live=live, progress=progress, continuous=continuous,
    )  # fmt: skip
    return run(going).finish()


class Turn(NamedTuple):
    """A moment at which somebody decides: in each tick the neighbours, then the ego.

    Attributes:
        time_s: simulated time, s.
        running: which simulations still run, (N,); the loop's own: where it is made false, one ends here.
        plant: what moves the cars.
        cars: their motion, as it truly is.
        log: what is written.
        sensed: what the law sees; ``None`` as long as it is the neighbours' turn.
        ahead: the cars as the law and the inverse are shown them, likewise.
    """

    time_s: float
    running: Mask
    plant: Plant
    cars: Cars
    log: Log
    sensed: Sensed | None = None
    ahead: Cars | None = None


Ticks = Generator[Turn, Array | None, Log]
"""Simulations that go on turn by turn. The ego's takes a command, m/s^2, (N, 2); ``None`` for the law's."""


@np.errstate(over="ignore", invalid="ignore")  # what stopped may hold anything, unrecorded
def run(going: Ticks) -> Log:
    """Runs simulations to their end, the ego as its law decides."""
    while True:
        try:
            next(going)
        except StopIteration as end:
            log: Log = end.value
            return log


def ticks(
    scenario: Scenario,
    each: Sequence[Scenario],
    seeds: Sequence[int],
    plant: str,
    *,
    threads: int = 0,
    world: World | None = None,
    sink: Sink | None = None,
    live: Sink | None = None,
    progress: Callable[[float], None] | None = None,
    continuous: bool = False,
    kept: Collection[str] | None = None,
) -> Ticks:
    """N simulations, turn by turn, which may differ in what :func:`alike` leaves open.

    Args:
        scenario: what they have in common.
        each: the scenario of each, N of them.
        seeds: of each.
        plant: see :func:`simulate`, as the others.
        threads: for the physics.
        world: of all.
        sink: gets simulation 0.
        live: likewise.
        progress: called with the simulated time, s.
        continuous: in continuous time.
        kept: columns of the trace that are kept, all by default; the others are NaN, and take no room.
    """
    runs, mismatch = len(each), tuple(one.mismatch for one in each)
    if world is None and (plant == "mujoco" or sink is not None or live is not None):
        from mjmerge.world.compose import build  # physics takes its time to import

        world = build(scenario, mismatch)
    laws, h = Laws.of([one.law for one in each], len(each[0].roster.neighbours)), scenario.control_step_s
    law, names = laws.first, scenario.roster.cars
    moving = make(plant, each, world, threads)
    sense = Sensing(() if continuous else mismatch, seeds, h, len(names) - 1)
    sheets = tuple(believed_sheets(scenario))
    starts_m, hold_s = moving.observe().front_m[:, 1:], 0.0 if continuous else h
    traffic = Traffic.of(
        [one.neighbours for one in each], seeds, scenario.duration_s, starts_m, sheets[1:], hold_s,
        (law.j_1, law.j_2),
    )  # fmt: skip
    believed, feet = BelievedCars.of(sheets, limited=moving.limited), Feet(h)
    foresee = foresight(scenario, plant, continuous=continuous)
    ramp = Ramp.of(each, plant)
    end = None if ramp is None else ramp.obstacle
    began = Sensed.of(moving.observe(), np.zeros((runs, 2)))
    memory = laws.start([one.initial.opinion for one in each], began)
    made_own = set(OWN_DISTANCES) <= set(law.gives)
    running = np.ones(runs, dtype=bool)
    log = Log(
        scenario, plant, np.array(seeds, dtype=np.int64), sheets, mismatch, sink, live,
        continuous=continuous, told_truth=sense.exact, kept=kept,
    )  # fmt: skip
    if continuous:
        from mjmerge.simulation.continuous import solve  # scipy takes its time to import

        moving = flow = solve(scenario, plant, moving, traffic, believed, log.time_s, progress, ramp)
        progress = None

    for k, t in enumerate(log.time_s.tolist()):
        # observe
        for fault in moving.faults():
            if running[fault.run]:
                running[fault.run] = False
                log.stop(Stop(fault.run, t, names[fault.car], fault.reason, fault.touched, fault.crossing))
        if not running.any():
            break
        cars = moving.observe()

        # decide: the neighbours first, then the ego, which knows what the leader intends
        yield Turn(t, running, moving, cars, log)
        u_j = traffic.intend(cars, t)
        two = laws.two(memory)
        seen, u_1 = sense(cars, of_each(u_j, two.j_1))
        ahead = foresee(seen)
        sensed = Sensed.of(ahead, u_1, end)
        decision = laws.decide(sensed, memory, 0.0 if continuous else h)
        for one, why in decision.failed.items():
            if running[one]:
                running[one] = False
                log.stop(Stop(one, t, names[0], why))
        given = yield Turn(t, running, moving, cars, log, sensed, ahead)

        # actuate
        u = np.concatenate([(decision.u if given is None else given)[:, None], u_j], axis=1)
        if plant in WHEELS:
            stands = traffic.stands(cars, t, u_j)
            controls = actuate(ahead, u, believed, law.eps_v_mps, h, feet, stands)
            foresee.told(controls)
        else:
            controls = of_points(u)

        # record
        row = _row(cars, controls, moving.contacts()) | _of_law(law, memory, decision, len(names) - 1)
        if ramp is not None:
            row |= ramp.columns(cars.front_m[:, 0], cars.velocity_mps[:, 0], cars.heading_rad[:, 0])
        if foresee.looks_ahead or not made_own:  # the law's distances are those of later, or it gives none
            row |= _distances(geometry(two, Sensed.of(seen, u_1)))
        if not sense.exact:
            row |= _told(seen, u_1)
        elif law.choice != "named":
            row["sensed_leader_mps2"] = u_1
        log.write(row, running, lambda: moving.qpos()[0])
        if progress is not None and k % _PROGRESS_TICKS == 0:
            progress(t)

        # step
        memory = flow.memory() if continuous else laws.remembered(memory, decision, h)
        moving.step(controls, running)
    return log


def _told(seen: Cars, u_1: Array) -> dict[str, Array]:
    """What the ego was told in one tick, as the columns of the trace."""
    return {
        "sensed_front_m": seen.front_m,
        "sensed_velocity_mps": seen.velocity_mps,
        "sensed_heading_rad": seen.heading_rad[:, 0],
        "sensed_speed_mps": seen.speed_mps[:, 0],
        "sensed_steer_rad": seen.steer_rad[:, 0],
        "sensed_leader_mps2": u_1,
    }


def _distances(told: Geometry) -> dict[str, Array]:
    """Distances of one tick as the ego is told them, as the columns of the trace."""
    return {"sensed_distance_m": told.d, "sensed_distance_rate_mps": told.d_dot}


def _of_law(law: Law, memory: Memory, decision: Decision, neighbours: int) -> dict[str, Array]:
    """What the law remembers and made of one tick, as far as it is recorded."""
    return {name: memory[name] for name in law.remembers} | recorded(law, decision.signals, neighbours)


def recorded(law: Law, signals: Mapping[str, Array], neighbours: int) -> dict[str, Array]:
    """What a law decided as it is recorded: its distances, and what it asks of others, of cars alone."""
    asks = [s.name for s in law.signals if s.asks and s.axes]
    return {n: v[:, :neighbours] if n in OWN_DISTANCES or n in asks else v for n, v in signals.items()}


def _row(cars: Cars, controls: Controls, contacts: tuple[Array, Array]) -> dict[str, Array]:
    """One tick, as the columns of the trace; the distances follow from it."""
    return {
        "clearance_m": cars.clearance_m,
        "contact_impulse_n_s": contacts[0],
        "contact_speed_mps": contacts[1],
        "u_mps2": controls.u_mps2,
        "front_m": cars.front_m,
        "velocity_mps": cars.velocity_mps,
        "heading_rad": cars.heading_rad,
        "speed_mps": cars.speed_mps,
        "steer_rad": cars.steer_rad,
        "a_mps2": controls.a_mps2,
        "omega_radps": controls.omega_radps,
        "steer_command_rad": controls.steer_rad,
        "torque_n_m": controls.torque_n_m,
        "torque_clipped_n_m": controls.torque_clipped_n_m,
        "steer_clipped_rad": controls.steer_clipped_rad,
    }
