"""What tyres cost: ``python tests/benchmarks/cars.py``. Ratios in one process, in processor time on one
thread, so that other work on the machine does not count; no test.

- the tyre update over the batch step it precedes; at most 0.05.
- three cars with slip-angle tyres over the same cars on MuJoCo's own contact, per step; at most 25/20.
"""

from __future__ import annotations

import statistics
import time

import numpy as np
import quiet
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

import mjmerge
from mjmerge.plant.mujoco import MuJoCo
from mjmerge.vehicle.actuation import BelievedCars, command
from mjmerge.world.compose import build

REPEATS, RUNS, TICKS = 7, 128, 10
OWN_IMPRATIO, OWN_SOLIMP, OWN_SOLREF = 10.0, (0.9, 0.95, 0.001, 0.5, 2.0), (0.0, 0.0)
"""What a wheeled car on MuJoCo is usually given: a stiff contact, and nothing to update."""


def spent_s(owner, name, do) -> tuple[float, float]:
    """Time inside one method while something is done, and the time of all of it, s."""
    inside, method = [0.0], getattr(owner, name)

    def timed(*args, **kwargs):
        began = time.process_time()
        result = method(*args, **kwargs)
        inside[0] += time.process_time() - began
        return result

    setattr(owner, name, timed)
    try:
        began = time.process_time()
        do()
        return inside[0], time.process_time() - began
    finally:
        setattr(owner, name, method)


def driven(scenario):
    """A plant of many runs, rolling in a gentle turn, and a function that drives it on."""
    world = build(scenario)
    cars = [getattr(scenario.initial, car) for car in world.cars]
    front_m = np.tile([c.front_m for c in cars], (RUNS, 1, 1))
    speed_mps = np.tile([c.speed_mps for c in cars], (RUNS, 1))
    plant = MuJoCo(world, front_m, speed_mps, substeps=scenario.substeps, threads=1)
    believed = BelievedCars.of(world.sheets, limited=True)
    steer, running = np.full(speed_mps.shape, 0.02), np.ones(RUNS, bool)

    def drive():
        for _ in range(TICKS):
            now = plant.observe()
            plant.step(command(now, speed_mps - now.speed_mps, steer, believed), running)

    return plant, drive


def bare_s(scenario, plant) -> float:
    """Time of stepping the same cars from the same state on MuJoCo's own contact, s."""
    model = plant.batch.get_model(0)
    model.opt.impratio = OWN_IMPRATIO
    model.pair_solimp[:], model.pair_solreffriction[:] = OWN_SOLIMP, OWN_SOLREF
    batch = Batch(model, nsim=RUNS, nthread=1)
    batch.state[:] = plant.batch.state
    began = time.process_time()
    for _ in range(TICKS):
        batch.step(nstep=scenario.substeps)
    return time.process_time() - began


def main() -> None:
    """Prints the table."""
    quiet.look()
    table = Table("scenario", "what", "median", "min", "max", "target")
    for name in ("paper", "highway", "van_behind"):
        scenario = mjmerge.load(name, ["control_step_s=0.02", "physics_step_s=0.002"])
        plant, drive = driven(scenario)
        drive()
        updates, ratios, steps = [], [], []
        for _ in range(REPEATS):
            update, _ = spent_s(plant, "_grip", drive)
            step, _ = spent_s(plant.batch, "step", drive)
            updates.append(update / step)
            ratios.append((update + step) / bare_s(scenario, plant))
            steps.append(1e6 * (update + step) / (RUNS * TICKS * scenario.substeps))
        for what, values, target in (
            ("tyre update / batch step", updates, "<= 0.05"),
            ("with tyres / MuJoCo's own contact", ratios, "<= 1.25"),
            ("us per step, three cars", steps, "-"),
        ):
            median, least, most = (f(values) for f in (statistics.median, min, max))
            table.add_row(name, what, f"{median:.3f}", f"{least:.3f}", f"{most:.3f}", target)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
