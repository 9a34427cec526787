"""Cars with other tyres than their data sheet's."""

from __future__ import annotations

from dataclasses import replace

from mjmerge.vehicle.datasheet import Axles
from mjmerge.world.compose import single


def set_up(model, front, rear):
    """A car with other axle stiffnesses, in truth and in its data sheet."""
    world = single(model)
    world.model.numeric("ego/cornering_stiffness_n_per_rad").data[:] = front, rear
    axles = {"cornering_stiffness_n_per_rad": Axles(front=front, rear=rear)}
    return replace(world, sheets=(world.sheets[0].model_copy(update=axles),))


def turning_inertia_kg_m2(sheet):
    """What resists a change of yaw rate: the car's inertia, and its wheels that spin faster left than right.

    A wheel at half the track from the middle spins at -(T/2) r/r_w more: I_w/r_w^2 (T/2)^2 each.
    """
    return sheet.yaw_inertia_kg_m2 + sheet.rotating_mass_kg * sheet.track_m**2 / 4
