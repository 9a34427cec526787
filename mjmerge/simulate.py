"""The loop: observe, decide, actuate, record, step. One page, for one run or a thousand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mjmerge.actuation import BelievedCars, actuate, believed_sheets
from mjmerge.drivers import Along, Driver
from mjmerge.drivers.lane import keep_lane
from mjmerge.law import Decision, Sensed, advance, decide
from mjmerge.plant import make
from mjmerge.scenario import CARS, Scenario
from mjmerge.state import Array, Cars, Controls
from mjmerge.trace import Log, Sink, Stop, Trace
from mjmerge.world import World, build

_PROGRESS_TICKS = 20


def simulate(
    scenario: Scenario,
    plant: str = "double_integrator",
    *,
    runs: int = 1,
    seed: int = 0,
    threads: int = 0,
    world: World | None = None,
    sink: Sink | None = None,
    progress: Callable[[float], None] | None = None,
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
        progress: called now and then with the simulated time, s.

    Returns:
        The trace. A simulation that fails stops there, is named in ``trace.stops``, and is NaN from then on.

    Raises:
        UnknownNameError: there is no such plant.
        ModelError: a car model lacks what is needed of it.
    """
    if world is None and (plant == "mujoco" or sink is not None):
        world = build(scenario)
    law, h = scenario.law, scenario.control_step_s
    drivers = (scenario.drivers.vehicle_1, scenario.drivers.vehicle_2)
    seeds = np.arange(seed, seed + runs)
    drawn = [
        driver.draw([np.random.default_rng([s, j]) for s in seeds.tolist()], scenario.duration_s)
        for j, driver in enumerate(drivers)
    ]
    moving = make(plant, scenario, world, runs, threads)
    believed = BelievedCars.of(believed_sheets(scenario), limited=moving.limited)
    lanes_m = moving.observe().front_m[:, 1:, 1]
    z, mu = np.full(runs, scenario.initial.z), np.full(runs, scenario.initial.mu)
    running = np.ones(runs, dtype=bool)
    log = Log(scenario, plant, seeds, sink)

    for k, t in enumerate(log.time_s.tolist()):
        # observe
        for fault in moving.faults():
            if running[fault.run]:
                running[fault.run] = False
                log.stop(Stop(fault.run, t, CARS[fault.car], fault.reason))
        if not running.any():
            break
        cars = moving.observe()

        # decide: the neighbours first, then the ego, which knows what the leader intends
        u_j = _drive(drivers, drawn, cars, lanes_m, t)
        decision = decide(law, _sense(cars, u_j), z)

        # actuate
        u = np.concatenate([decision.u[:, None], u_j], axis=1)
        controls = actuate(cars, u, believed, law.eps_v_mps, h)

        # record
        log.write(_row(cars, controls, decision, z, mu), running, lambda: moving.qpos()[0])
        if progress is not None and k % _PROGRESS_TICKS == 0:
            progress(t)

        # step
        z, mu = advance(law, z, mu, decision.mu_input, h)
        moving.step(controls, running)
    return log.finish()


def _drive(
    drivers: tuple[Driver, ...], drawn: list[Array | None], cars: Cars, lanes_m: Array, time_s: float
) -> Array:
    """What the neighbours intend: their drivers decide along the road, lane keeping across it.

    Returns:
        u_j, m/s^2, (N, 2, 2), neighbour before component.
    """
    p, v = cars.front_m[:, 1:], cars.velocity_mps[:, 1:]
    u_j = np.zeros_like(p)
    leader = None
    for j, driver in enumerate(drivers):
        own = Along(p[:, j, 0], v[:, j, 0], u_j[:, j, 0])  # a view: holds the acceleration once decided
        u_j[:, j, 0] = driver.acceleration_mps2(time_s, own, leader or own, drawn[j])
        leader = own
    u_j[..., 1] = keep_lane(lanes_m, p[..., 1], v[..., 1])
    return u_j


def _sense(cars: Cars, u_j: Array) -> Sensed:
    """All that reaches the law."""
    return Sensed(
        p=cars.front_m[:, 0],
        v=cars.velocity_mps[:, 0],
        p_j=cars.front_m[:, 1:],
        v_j=cars.velocity_mps[:, 1:],
        u_1=u_j[:, 0],
    )


def _row(cars: Cars, controls: Controls, decision: Decision, z: Array, mu: Array) -> dict[str, Array]:
    """One tick, as the columns of the trace."""
    return {
        "opinion": z,
        "mu": mu,
        "weight": decision.w,
        "distance_m": decision.d,
        "distance_rate_mps": decision.d_dot,
        "gap_m": decision.dbar,
        "clearance_m": cars.clearance_m,
        "target_m": cars.front_m[:, 1] + decision.e_1_star,
        "u_n_mps2": decision.u_n,
        "u_c_mps2": decision.u_c,
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
