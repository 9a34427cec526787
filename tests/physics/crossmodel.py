"""The same manoeuvres on a car of ours and on the published single-track model, with matched parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mjmerge.proving.ground import MotionLog, drive
from mjmerge.proving.manoeuvres import Scale, hold
from mjmerge.state import G_MPS2
from mjmerge.world.compose import single
from tests.physics.setups import set_up, turning_inertia_kg_m2
from tests.physics.single_track import SingleTrack

LOADED = "brake in turn, load transfer"
MANOEUVRES = ("step steer", "sine steer", "brake in turn", LOADED)
"""The last is the third against the model with its load transfer, which our tyres do not have."""


@dataclass(frozen=True)
class Comparison:
    """One manoeuvre on both, (T,) each.

    Attributes:
        time_s: from the start of the steering.
        steer_rad: of the car's wheels, which the model is given.
        speed_mps: of the car's centre of mass, which the model is given.
        yaw_rate_radps: of the car and of the model.
        lateral_mps2: of both centres of mass.
    """

    time_s: np.ndarray
    steer_rad: np.ndarray
    speed_mps: np.ndarray
    yaw_rate_radps: tuple[np.ndarray, np.ndarray]
    lateral_mps2: tuple[np.ndarray, np.ndarray]

    @staticmethod
    def off(pair):
        """Largest and root-mean-square difference, as parts of the model's largest value."""
        difference, size = pair[0] - pair[1], np.abs(pair[1]).max()
        return np.abs(difference).max() / size, np.sqrt(np.mean(difference**2)) / size


def compare(model):
    """All manoeuvres of a model, by name; braking in a turn also without the model's load transfer.

    Our tyres get stiffnesses in proportion to the axle loads, with the sum of the data sheet's: the published
    model has no other tyres.
    """
    sheet = single(model).sheets[0]
    given = sheet.cornering_stiffness_n_per_rad
    per_load = (given.front + given.rear) / (sheet.mass_kg * G_MPS2)
    behind = sheet.com_behind_front_axle_m / sheet.wheelbase_m
    loads = sheet.mass_kg * G_MPS2 * np.array([1 - behind, behind])
    world = set_up(model, *(per_load * loads))
    track = SingleTrack(
        mass_kg=sheet.mass_kg,
        yaw_inertia_kg_m2=turning_inertia_kg_m2(sheet),
        front_m=sheet.com_behind_front_axle_m,
        rear_m=sheet.wheelbase_m - sheet.com_behind_front_axle_m,
        height_m=0.0,
        stiffness_per_load=per_load,
    )
    log = _drive(world)
    rear_m = sheet.wheelbase_m - sheet.com_behind_front_axle_m
    speed = np.hypot(log.speed_mps, log.lateral_mps + rear_m * log.yaw_rate_radps)
    lateral = log.lateral_mps2(rear_m)
    tracks = (track, track, track, replace(track, height_m=sheet.com_height_m))
    found = {}
    for name, i, of in zip(MANOEUVRES, (0, 1, 2, 2), tracks, strict=True):
        yaw_rate, a = of.follow(log.time_s, log.steer_rad[i], speed[i])
        found[name] = Comparison(
            log.time_s, log.steer_rad[i], speed[i], (log.yaw_rate_radps[i], yaw_rate), (lateral[i], a)
        )
    return found


def _drive(world) -> MotionLog:
    sheet = world.sheets[0]
    scale = Scale.of(sheet)
    speed = 3 * scale.speed_mps
    angle = np.arctan(0.3 * G_MPS2 * sheet.wheelbase_m / speed**2)

    def driver(time_s, cars):
        t = time_s / scale.time_s - 1
        steer = angle * np.array([t > 0, (t > 0) * np.sin(0.8 * t), (t > 0) / 1.5])
        a = hold(world, cars, np.full(3, speed))
        a[2] = a[2] if t < 8 else -0.3 * G_MPS2
        return a, steer

    return drive(world, driver, 14 * scale.time_s, np.full(3, speed), tick_s=0.005)
