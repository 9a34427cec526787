"""Every folder under models/ is a car that these tests drive; a new one is tested by being there."""

from __future__ import annotations

import pytest

from mjmerge.config import shipped
from mjmerge.world.compose import single


@pytest.fixture(scope="module", params=sorted(shipped.models()))
def car(request):
    """Name of a model."""
    return request.param


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
