"""A merge among more and more cars, built in Python: ``python examples/many_neighbours.py``."""

from __future__ import annotations

import mjmerge

LEADER, FOLLOWER = {"front_m": [0.0, 0.0], "speed_mps": 1.2}, {"front_m": [-3.6, 0.0], "speed_mps": 1.2}
AROUND_M = ([0.4, 1.2], [-5.0, 0.0], [2.0, 0.0], [-4.4, 1.2])
"""Where more start: ahead of the ego, behind the follower, ahead of the leader, behind the ego."""


def merge(neighbours: int) -> mjmerge.Scenario:
    """The ego between two cars, with others around them."""
    steady = {"kind": "steady", "speed_mps": 1.2}
    initial = {"ego": {"front_m": [-1.8, 1.2], "speed_mps": 1.2}, "vehicle_1": LEADER, "vehicle_2": FOLLOWER}
    drivers = {"vehicle_1": steady, "vehicle_2": {"kind": "gap", "gap_m": 3.6}}
    for j, front_m in enumerate(AROUND_M[: neighbours - 2], start=3):
        initial[f"vehicle_{j}"] = {"front_m": front_m, "speed_mps": 1.2}
        drivers[f"vehicle_{j}"] = steady | {"speed_mps": 1.0} if j == 3 else steady
    law = {"r_rho_m": -1.5, "r_eta_m": 1.2}
    return mjmerge.load({"duration_s": 10, "initial": initial, "law": law, "drivers": drivers})


def main() -> None:
    """Prints a row per number of neighbours."""
    for neighbours in range(2, 7):
        trace = mjmerge.simulate(merge(neighbours), "bicycle")
        (verdict,) = mjmerge.judge(trace)
        least = ", ".join(f"{d:.2f}" for d in trace.min_distance_m[0])
        print(f"{neighbours} neighbours: least d_j {least} m; {verdict.reason}")


if __name__ == "__main__":
    main()
