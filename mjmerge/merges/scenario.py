"""An event as a scenario file: the law where the human was, between cars that drive as they were recorded."""

from __future__ import annotations

import json
from math import floor, sqrt
from typing import Any

import numpy as np

from mjmerge.config.units import rescaled
from mjmerge.drivers.recorded import curve
from mjmerge.merges.event import LIKE, Event
from mjmerge.scenario.load import load
from mjmerge.traffic.tracks import Tracks

CARS = ("ego", "vehicle_1", "vehicle_2")
_ROOM = 1.02  # the target is further from both neighbours than r by this factor
_LAW = ("k_p", "k_v", "k_o", "k_mu", "k", "k_s", "eps", "eps_1", "r_m", "r_rho_m", "r_eta_m", "eps_v_mps")


def scenario(event: Event, traffic: Tracks) -> dict[str, Any]:
    """The keys of the scenario of an event, as they are written.

    Gains are those of the shipped scenario by similarity: lengths times s, times times sqrt(s), where s is
    the margin r at these cars' size over its own. They are about motion relative to the leader: the speed of
    the road enters by the start alone.

    Args:
        event: what happened.
        traffic: the file that it is from.
    """
    own = load(LIKE)
    step_s = own.control_step_s
    duration_s = round(floor(event.time_s[-1] / step_s + 1e-6) * step_s, 6)
    time_s = [round(float(t), 6) for t in event.time_s]
    drivers, speeds = {}, [_first_mps(event.time_s, event.front_m[:, 0, 0])]
    for j, car in enumerate(CARS[1:], 1):
        travelled_m = [round(float(x), 5) for x in event.front_m[:, j, 0] - event.front_m[0, j, 0]]
        drivers[car] = {
            "kind": "recorded",
            "time_s": time_s,
            "travelled_m": travelled_m,
            "source": source(event, traffic, j),
        }
        speeds.append(curve(tuple(time_s), tuple(travelled_m)).at(0.0)[1])
    across_m = (float(event.front_m[0, 0, 1]), 0.0, 0.0)  # the others in the middle of their lane
    return {
        "description": described(event, traffic),
        "duration_s": duration_s,
        "control_step_s": step_s,
        "physics_step_s": own.physics_step_s,
        "models": dict(zip(CARS, event.models, strict=True)) | _sizes(event),
        "road": {"lane_width_m": round(event.lane_m, 2)},
        "initial": {
            car: {
                "front_m": [round(float(event.front_m[0, i, 0]), 4), round(across_m[i], 4)],
                "speed_mps": round(speeds[i], 6),
            }
            for i, car in enumerate(CARS)
        }
        | {"z": own.initial.z, "mu": own.initial.mu},
        "law": law(event),
        "drivers": drivers,
    }


def _sizes(event: Event) -> dict[str, dict[str, float]]:
    """The keys of the cars' sizes."""
    return {
        key: {car: getattr(body, key) for car, body in zip(CARS, event.bodies, strict=True)}
        for key in ("length_m", "width_m")
    }


def law(event: Event) -> dict[str, float]:
    """The law's keys at the size of the cars; its target is between the two of the event."""
    own = load(LIKE).law
    length = event.r_m / own.r_m
    sized = rescaled(own, length, sqrt(length))
    keys = {name: float(f"{getattr(sized, name):.5g}") for name in _LAW}
    gap_m = float(np.hypot(event.gap_m[0], 0.0))
    if -keys["r_rho_m"] + _ROOM * event.r_m > gap_m:  # too near to the follower: in the middle
        keys["r_rho_m"] = round(-gap_m / 2, 4)
    return keys | {"r_eta_m": round(abs(float(event.front_m[0, 0, 1])), 4)}


def source(event: Event, traffic: Tracks, j: int) -> str:
    """Where a car's motion comes from, and what was done to it."""
    one = event.smoothing[j]
    how = (
        f"smoothed over {one.period_s:.2g} s, moved by {one.most_m:.2f} m at most"
        if one.period_s
        else "as it stands there"
    )
    also = f"; {event.tightened}" if j == 2 and event.tightened else ""
    return f"{traffic.path.name}, car {event.change.three[j]}, from {event.from_s:.2f} s; {how}{also}"


def described(event: Event, traffic: Tracks) -> str:
    """In a line."""
    change = event.change
    also = f"; {event.tightened}" if event.tightened else ""
    return (
        f"Car {change.car} of {traffic.path.name} changes lanes behind {change.leader} and ahead of "
        f"{change.follower}, from {event.from_s:.1f} s; the law in its place{also}."
    )


def written(keys: dict[str, Any]) -> str:
    """A scenario's keys as YAML: a line for each key of a section."""
    lines = []
    for name, value in keys.items():
        if isinstance(value, dict) and name != "road":
            lines += ["", f"{name}:"]
            for key, inner in value.items():
                if name == "drivers":
                    lines.append(f"  {key}:")
                    lines += [f"    {k}: {_flow(v)}" for k, v in inner.items()]
                else:
                    lines.append(f"  {key}: {_flow(inner)}")
        else:
            lines.append(f"{name}: {_flow(value)}")
    return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    """A value on a line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str) and value.isidentifier():
        return value
    return json.dumps(value, ensure_ascii=True) if isinstance(value, str) else repr(value)


def _first_mps(time_s: Any, along_m: Any) -> float:
    """Speed at the first of some times, not below 0."""
    travelled = np.maximum.accumulate(along_m - along_m[0])
    return float(curve(tuple(map(float, time_s)), tuple(map(float, travelled))).at(0.0)[1])
