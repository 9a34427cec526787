"""How much dead time does a merge stand? A simulation for each: ``python examples/dead_time.py``."""

from __future__ import annotations

import numpy as np

import mjmerge
from mjmerge.scenario.mismatch import Mismatch

DELAYS_S = np.arange(0.0, 0.24, 0.04)


def main() -> None:
    """Prints a row per delay."""
    scenario = mjmerge.load("charge")
    cases = [(0, Mismatch(command_delay_s=float(delay_s))) for delay_s in DELAYS_S]
    trace = mjmerge.simulate(scenario, "mujoco", cases=cases)
    for delay_s, (d_1, d_2), verdict in zip(
        DELAYS_S, trace.min_distance_m, mjmerge.judge(trace), strict=True
    ):
        print(f"{delay_s:.2f} s   d_1 >= {d_1:6.3f} m   d_2 >= {d_2:6.3f} m   {verdict.verdict}")


if __name__ == "__main__":
    main()
