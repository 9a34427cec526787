"""Every folder under models/ is a car that these tests drive; a new one is tested by being there."""

from __future__ import annotations

from pathlib import Path

import pytest

from mjmerge.config import shipped
from mjmerge.world.compose import single


def pytest_generate_tests(metafunc):
    """Every shipped model, or those that ``pytest tests/physics --car ./mine`` names."""
    if "car" in metafunc.fixturenames:
        cars = [str(Path(car).resolve()) for car in metafunc.config.getoption("--car")]
        metafunc.parametrize("car", cars or sorted(shipped.models()), scope="module")


@pytest.fixture(scope="module")
def world(car):
    """It alone on dry road, with the tyres of its data sheet."""
    return single(car)


@pytest.fixture(scope="module")
def sheet(world):
    """Its data sheet."""
    return world.sheets[0]


@pytest.fixture(scope="module")
def ideal(car):
    """It on tyres that do not slip."""
    return single(car, tyres="ideal")
