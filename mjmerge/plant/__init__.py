"""Plants: what moves the cars. A ladder from the paper's own world to real physics, one interface.

``double_integrator`` takes u, ``bicycle`` takes (a, omega), ``bicycle_limited`` and ``mujoco`` take wheel
torques and steering angles.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from math import log
from typing import TYPE_CHECKING

from mjmerge.config import shipped
from mjmerge.errors import ModelError, UnknownNameError
from mjmerge.plant.base import Fault, Plant, Smooth
from mjmerge.roster import PLANTS
from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.schema import Scenario

if TYPE_CHECKING:
    from mjmerge.world.model import World

STRETCH = 1.6
"""A physical car may be longer or shorter than its model by this factor; so its width and proportions."""

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
    if name == "mujoco" and (wrong := list(_beyond(scenario))):
        raise ModelError("\n".join(wrong))


def _beyond(scenario: Scenario) -> Iterator[str]:
    """Cars that their model cannot be stretched to, in words, with the model that is nearest to that.

    One whose model is gone, as of a recording that has its sheet, was when it ran.
    """
    models, sheets = scenario.models, {model: data_sheet(model) for model in shipped.models()}
    for car in {**models.length_m.said, **models.width_m.said}:
        try:
            own, by = data_sheet(models.of(car)), {"length_m": 1.0, "width_m": 1.0}
        except UnknownNameError:
            if scenario.sheets is None:
                raise
            continue
        for key, side in (("length_m", "long"), ("width_m", "wide")):
            own_m, asked_m = getattr(own, key), getattr(models, key).of(car)
            if asked_m is None:
                continue
            by[key] = asked_m / own_m
            if not 1 / STRETCH <= by[key] <= STRETCH:
                nearest = min(sheets, key=lambda model: abs(log(getattr(sheets[model], key) / asked_m)))
                size = f"; the nearest shipped model is {nearest}, {getattr(sheets[nearest], key):g} m"
                yield (
                    f"models.{key}.{car}: {models.of(car)} is {own_m:g} m {side}, and mujoco's cars are "
                    f"stretched by a factor of {STRETCH:g} at most, so not to {asked_m:g} m"
                    + (size if nearest != models.of(car) else "")
                )
        each = all(1 / STRETCH <= one <= STRETCH for one in by.values())
        if each and not 1 / STRETCH <= by["width_m"] / by["length_m"] <= STRETCH:
            yield (
                f"models.width_m.{car}: {models.of(car)} would be {by['length_m']:.3g} times as long and "
                f"{by['width_m']:.3g} times as wide; on mujoco these differ by {STRETCH:g} times at most"
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
