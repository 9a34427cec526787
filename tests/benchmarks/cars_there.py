"""What a car more costs: ``python tests/benchmarks/cars_there.py``. Ratios in one process, no test.

Time of a control step, on the ideal plant and on MuJoCo, by how many cars there are, and how far each is from
the straight line through all of them; at most 15 %. With the gap as named and as the law chooses it.
"""

from __future__ import annotations

import statistics
import time

import numpy as np
import quiet
from rich.console import Console
from rich.table import Table

import mjmerge
from mjmerge.world.compose import build

COUNTS = (3, 4, 6, 9)
RUNS, REPEATS = 64, 5
AT_M = ((2.0, 1.2), (2.0, 0.0), (-5.0, 1.2), (-5.5, 0.0), (4.0, 0.0), (4.0, 1.2))


def scenario(cars: int, duration_s: float, choice: str):
    """Two that a merge is between, and others around them."""
    spread = {f"vehicle_{j}": at for j, at in enumerate(AT_M[: cars - 3], 3)}
    places = {"ego": (-1.75, 1.2), "vehicle_1": (0.0, 0.0), "vehicle_2": (-3.5, 0.0)} | spread
    return mjmerge.load(
        {
            "duration_s": duration_s,
            "initial": {car: {"front_m": list(at), "speed_mps": 1.0} for car, at in places.items()},
            "law": {"r_rho_m": -1.5, "r_eta_m": 1.2} | ({"choice": choice} if cars > 3 else {}),
            "drivers": {car: {"kind": "steady", "speed_mps": 1.0} for car in places if car != "ego"},
        }
    )


def step_s(cars: int, plant: str, runs: int, choice: str) -> float:
    """Time of a control step of all runs, s."""
    of = scenario(cars, 1.0, choice)
    world = build(of) if plant == "mujoco" else None
    taken = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        trace = mjmerge.simulate(of, plant, runs=runs, threads=1, world=world)
        taken.append((time.perf_counter() - began) / len(trace.time_s))
    return statistics.median(taken)


def main() -> None:
    """Prints the table."""
    quiet.look()
    table = Table("plant", "runs", "choice", "cars", "a step (us)", "over the first", "off the line")
    for plant, runs, choice in (
        ("double_integrator", RUNS, "named"),
        ("double_integrator", RUNS, "largest"),
        ("mujoco", 1, "named"),
        ("mujoco", 16, "named"),
        ("mujoco", 16, "largest"),
    ):
        counts = COUNTS if choice == "named" else COUNTS[1:]  # among two there is nothing to choose
        taken = np.array([step_s(cars, plant, runs, choice) for cars in counts])
        line = np.polyval(np.polyfit(counts, taken, 1), counts)
        for cars, t, fit in zip(counts, taken, line, strict=True):
            table.add_row(
                plant,
                str(runs),
                choice,
                str(cars),
                f"{1e6 * t:.0f}",
                f"{t / taken[0]:.2f}",
                f"{t / fit - 1:+.1%}",
            )
    Console().print(table)


if __name__ == "__main__":
    main()
