"""Plants: what moves the cars. A ladder from the paper's own world to real physics, one interface.

``double_integrator`` takes u, ``bicycle`` takes (a, omega), ``bicycle_limited`` and ``mujoco`` take wheel
torques and steering angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from math import log
from typing import TYPE_CHECKING

from mjmerge.config import shipped
from mjmerge.errors import ModelError, UnknownNameError
from mjmerge.plant.base import Fault, Plant, Smooth
from mjmerge.roster import PLANTS
from mjmerge.scenario.cars import Misfit, data_sheet, misfits, on_plant
from mjmerge.scenario.schema import Scenario

if TYPE_CHECKING:
    from mjmerge.world.model import World

OFF = 1.15
"""A physical car may be off the length that is asked for by this factor, and off the width; it is told."""

__all__ = ["PLANTS", "Fault", "Plant", "Smooth", "check", "make"]


def check(name: str, scenario: Scenario) -> None:
    """Raises UnknownNameError if there is no such plant, ModelError if it has no cars of that size."""
    if name not in PLANTS:
        raise UnknownNameError("plant", name, PLANTS)
    if name == "mujoco" and scenario.models.size != 1:
        raise ModelError(
            f"models.size is {scenario.models.size:g}, but mujoco's cars come in their own size: "
            "choose models of that size, and set models.size=1"
        )
    if name == "mujoco":
        wrong = [
            one
            for one in misfits(on_plant(scenario, name))
            if one.key == "length_m" and not one.own_m / OFF <= one.asked_m <= one.own_m * OFF
        ]
        if wrong:
            raise ModelError("\n".join(map(_refused, wrong)))


def _refused(one: Misfit) -> str:
    """A car that is not nearly as long as is asked, and the model that is nearest to that."""
    sizes = {model: data_sheet(model).length_m for model in shipped.models()}
    nearest = min(sizes, key=lambda model: abs(log(sizes[model] / one.asked_m)))
    return (
        f"models.{one.key}.{one.car}: {one.sentence}, and mujoco's cars come as they are, to {OFF - 1:.0%}; "
        f"the nearest shipped model is {nearest}, {sizes[nearest]:g} m, and null takes it as it is"
    )


def make(name: str, scenarios: Sequence[Scenario], world: World | None, threads: int) -> Plant:
    """The plant of that name, at t = 0.

    Args:
        name: one of :data:`PLANTS`.
        scenarios: of each of the N simulations; they differ in initial state and mismatch at most.
        world: the compiled world; only ``mujoco`` needs it.
        threads: threads for the physics, 0 for all cores.

    Raises:
        UnknownNameError: there is no such plant.
        ModelError: it has no cars of that size.
    """
    check(name, scenarios[0])
    plant: Plant = import_module(f"mjmerge.plant.{name}").make(scenarios, world, threads)
    return plant
