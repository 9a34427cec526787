"""What a scenario stands on: the data sheets of its cars, on file and believed, and code from outside."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from mjmerge.config import shipped
from mjmerge.config.doors import Code, code_of, from_outside
from mjmerge.config.read import LARGEST_FILE_BYTES, raise_problems, read, validated
from mjmerge.vehicle.datasheet import DataSheet

if TYPE_CHECKING:  # a data sheet is read without a scenario, whose schema takes its time to make
    from mjmerge.scenario.schema import Models, Scenario


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
    """The data sheet of a car at the size that is asked of it."""
    sheet = data_sheet(models.of(car)).sized(models.size)
    return sheet.stretched(models.length_m.of(car), models.width_m.of(car))


def car_sheets(scenario: Scenario) -> list[DataSheet]:
    """The data sheet of each of a scenario's cars, at its size; as recorded, if it comes from a recording."""
    if scenario.sheets is not None:
        return list(scenario.sheets)
    return [sheet_of(scenario.models, car) for car in scenario.roster.cars]


def equipped(scenario: Scenario) -> Scenario:
    """The scenario with its data sheets settled, whatever becomes of the models."""
    return scenario.with_sheets(tuple(car_sheets(scenario)))


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
