"""What a scenario stands on: the data sheets of its cars, on file and believed, and code from outside."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from mjmerge.config import shipped
from mjmerge.config.acts import BODIES
from mjmerge.config.doors import Code, code_of, from_outside
from mjmerge.config.read import LARGEST_FILE_BYTES, raise_problems, read, validated
from mjmerge.scenario.schema import Models, Scenario
from mjmerge.vehicle.datasheet import DataSheet


def data_sheet(model: str) -> DataSheet:
    """Read a car model's data sheet.

    Args:
        model: a shipped model's name, or the path of its folder.

    Raises:
        ScenarioError: with every problem found in it.
        UnknownNameError: there is no such model.
    """
    path = shipped.model_folder(model) / "datasheet.yaml"
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE_BYTES + 1)
    except OSError:
        content = b""
    return _data_sheet(path, content)


@lru_cache(maxsize=32)  # a few cars, and the loader, the world, the belief and the judge ask for each
def _data_sheet(path: Path, content: bytes) -> DataSheet:
    """What the file says; by its content, so that a file that has changed is read again."""
    del content
    document = read(path)
    sheet = validated(DataSheet, document)
    raise_problems(path, document)
    assert sheet is not None, "what is not valid has problems"
    return sheet


def sheet_of(models: Models, car: str) -> DataSheet:
    """The data sheet of a car at the size that is asked of it, as ideal plants have it."""
    sheet = data_sheet(models.of(car)).sized(models.size)
    return sheet.stretched(models.length_m.of(car), models.width_m.of(car))


def car_sheets(scenario: Scenario) -> list[DataSheet]:
    """The data sheet of each of a scenario's cars, at its size; as recorded, if it comes from a recording."""
    if scenario.sheets is not None:
        return list(scenario.sheets)
    return [sheet_of(scenario.models, car) for car in scenario.roster.cars]


def on_plant(scenario: Scenario, plant: str) -> Scenario:
    """The scenario with its data sheets settled, whatever becomes of the models: mujoco's as its cars are."""
    stretched = scenario.sheets is None or (scenario.models.resized and not any(misfits(scenario)))
    if stretched and plant in BODIES:
        return scenario.with_sheets(tuple(map(data_sheet, scenario.car_models)))
    return scenario.with_sheets(tuple(car_sheets(scenario)))


@dataclass(frozen=True)
class Misfit:
    """A car whose body is not of the size that its scenario asks for.

    Attributes:
        car: which.
        key: of its data sheet, ``length_m`` or ``width_m``.
        own_m: what it is, m.
        asked_m: what it should be, m.
    """

    car: str
    key: str
    own_m: float
    asked_m: float

    @property
    def sentence(self) -> str:
        """It in words."""
        side = "long" if self.key == "length_m" else "wide"
        return f"{self.car} is {self.own_m:g} m {side}, not {self.asked_m:g} m as it should be"


def misfits(scenario: Scenario) -> Iterator[Misfit]:
    """Where cars are not of the size that is asked for: where their sheets are those of physical cars."""
    sheets = dict(zip(scenario.roster.cars, car_sheets(scenario), strict=True))
    for key in ("length_m", "width_m"):
        for car, asked_m in getattr(scenario.models, key).said.items():
            own_m = getattr(sheets[car], key)
            if own_m != asked_m:
                yield Misfit(car, key, own_m, asked_m)


def believed_sheets(scenario: Scenario) -> list[DataSheet]:
    """Data sheet of each car, the ego's with what the scenario's ``belief`` says otherwise."""
    sheets = car_sheets(scenario)
    sheets[0] = sheets[0].model_copy(update=scenario.belief.model_dump(exclude_none=True))
    return sheets


def codes(scenario: Scenario) -> tuple[Code, ...]:
    """The code from outside that a scenario runs, each once."""
    kinds = dict.fromkeys((scenario.law.kind, *(driver.kind for driver in scenario.neighbours)))
    found = [code_of(kind) for kind in kinds if from_outside(kind)]
    return (*found, *(code for code in scenario.metric_codes if code not in found))
