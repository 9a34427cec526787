"""Our cars against someone else's model: the single-track model of `commonroad-vehicle-models`."""

from __future__ import annotations

import numpy as np
import pytest

from mjmerge.state import G_MPS2
from tests.physics.crossmodel import LOADED, MANOEUVRES, compare


@pytest.fixture(scope="module")
def compared(car):
    return compare(car)


@pytest.mark.parametrize("manoeuvre", MANOEUVRES[:3])
def test_it_agrees_with_the_published_single_track_model(compared, manoeuvre):
    """Up to 0.3 g, root mean square and largest, in parts of the largest value.

    The largest is a moment after the step: the car's body rolls, the model's does not.
    """
    found = compared[manoeuvre]
    assert np.abs(found.lateral_mps2[1]).max() > 0.19 * G_MPS2
    for pair in (found.yaw_rate_radps, found.lateral_mps2):
        largest, mean = found.off(pair)
        assert mean < 0.03
        assert largest < 0.07


def test_load_transfer_is_what_our_tyres_lack_when_braking_in_a_turn(compared):
    """The published model's stiffness follows the load, so braking turns it in; ours does not."""
    ours, theirs = compared[LOADED].yaw_rate_radps
    braking = compared[LOADED].time_s > 10 * compared[LOADED].time_s[-1] / 14
    assert compared[LOADED].off((ours, theirs))[0] > 0.1
    assert (theirs[braking] > ours[braking]).all()
