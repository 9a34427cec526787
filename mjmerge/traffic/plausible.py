"""Whether the numbers of a file of traffic fit one another: sizes, speeds and accelerations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjmerge.errors import Problem
from mjmerge.traffic.tracks import Track

_MEDIAN_LENGTH_M = ((0.2, 0.9), (2.0, 12.0))  # of cars at 1/10 scale or so, and of cars
_MEDIAN_OFF = (0.6, 1.6)
_UNITS = {"feet": 1 / 0.3048, "metres where feet are meant": 0.3048, "km/h": 3.6, "mph": 2.237}


def doubts_of_units(tracks: Sequence[Track], step_s: float) -> list[Problem]:
    """Where sizes or speeds cannot be in metres and seconds, as a whole: each car alone may be odd."""
    found = []
    vehicles = [one for one in tracks if one.kind not in ("pedestrian", "bicycle", "motorcycle")]
    if vehicles:
        length = float(np.median([one.length_m for one in vehicles]))
        if not any(low <= length <= high for low, high in _MEDIAN_LENGTH_M):
            found.append(
                Problem(f"half of all vehicles are {length:.3g} m long: are lengths in metres?", "length")
            )
    given, moved = [], []
    for one in tracks:
        speed = np.hypot(*np.gradient(one.centre_m, step_s, axis=0).T)
        rolls = (speed > 2) & ~np.isnan(one.speed_mps)
        given.append(np.abs(one.speed_mps[rolls]))
        moved.append(speed[rolls])
    if given and sum(map(len, given)):
        ratio = float(np.median(np.concatenate(given) / np.concatenate(moved)))
        if not _MEDIAN_OFF[0] <= ratio <= _MEDIAN_OFF[1]:
            near = min(_UNITS, key=lambda word: abs(np.log(ratio / _UNITS[word])))
            guess = f", as if in {near}" if abs(ratio / _UNITS[near] - 1) < 0.05 else ""
            found.append(
                Problem(
                    f"speeds are {ratio:.3g} times what the positions say{guess}: are units and the time "
                    "step right?",
                    "velocity",
                )
            )
    return found


def biased(tracks: Sequence[Track], step_s: float) -> list[str]:
    """What the file says of speeds and accelerations that its positions do not: told, and not used."""
    off, clipped, states, missing = [], 0, 0, 0
    for one in tracks:
        speed = np.hypot(*np.gradient(one.centre_m, step_s, axis=0).T)
        off.append((one.speed_mps - speed)[~np.isnan(one.speed_mps)])
        a = np.abs(one.acceleration_mps2)
        missing += int(np.isnan(a).all())
        states += len(a)
    if not tracks:
        return []
    every = np.abs(np.concatenate([one.acceleration_mps2 for one in tracks]))
    every = every[~np.isnan(every)]
    if len(every) and every.max() > 0:
        clipped = int(np.count_nonzero(every >= every.max() * (1 - 1e-6)))
    found = []
    speeds = np.concatenate(off)
    if len(speeds):
        found.append(
            f"speeds in the file, less those of its positions: median {np.median(speeds):+.2f} m/s, 95 % "
            f"within {np.quantile(np.abs(speeds), 0.95):.2f} m/s; positions are used"
        )
    if clipped > max(0.01 * states, 10) and every.max() > 1:
        found.append(
            f"accelerations in the file are clipped at {every.max():.2f} m/s^2 ({clipped} of {states} "
            "states); positions are used"
        )
    if missing:
        found.append(f"{missing} of {len(tracks)} tracks have no accelerations; positions are used")
    return found
