"""What a recording holds, as arrays: ``mjmerge run charge``, then ``python examples/read_a_recording.py``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from mjmerge.record.read import read, recording


def main(place: str = "runs/charge-mujoco-0") -> None:
    """Prints how close the ego came to each neighbour, when, and what the law asked for then."""
    trace = read(recording(Path(place))).trace()
    for j, car in enumerate(trace.roster.neighbours):
        d = trace.distance_m[0, :, j]
        tick = int(np.nanargmin(d))
        u_c = np.hypot(*trace.u_c_mps2[0, tick])
        print(f"{car}: d = {d[tick]:.3f} m at {trace.time_s[tick]:.2f} s, barrier {u_c:.2f} m/s^2")


if __name__ == "__main__":
    main(*sys.argv[1:])
