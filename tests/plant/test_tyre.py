"""The tyre's closed form: what the contact parameters mean, put back into MuJoCo's own formulas."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.config import shipped
from mjmerge.plant.truth import Truth
from mjmerge.plant.tyre import ADDED_MASS, FASTEST_PER_S, OUT_OF_REACH, front_stiffness
from mjmerge.world.compose import single
from mjmerge.world.model import HARDEST, IMPRATIO

NAMES = sorted(shipped.models())
TYRES = {name: Truth.of(single(name), None).tyres for name in NAMES}
IDEAL = {name: Truth.of(single(name, tyres="ideal"), None).tyres for name in NAMES}
MU = 0.7
names = st.sampled_from(NAMES)
speeds = st.floats(0, 60)


def contact(tyres, speed, slip=0.0):
    """Regularisation R and damping b that MuJoCo makes of the parameters, each (1, 1, 4)."""
    speed, slip, mu = (np.full((1, 1, 4), value) for value in (speed, slip, MU))
    d, damping = tyres.contact(speed, slip, mu)
    assert (d > 0).all()
    assert (d <= HARDEST * (1 + 1e-12)).all()
    return (1 - d) / d * tyres.invweight_per_kg / IMPRATIO, damping / d


@pytest.mark.parametrize("name", NAMES)
def test_a_steady_turn_sees_the_stiffness_that_was_asked_for(name):
    """F = (b v_s - a)/R with a = F/m gives F (R + 1/m) = b v_s, so that C = v F/v_s = v b/(R + 1/m)."""
    tyres = TYRES[name]
    for speed in (1.0, 2.0, 5.0) if name == "rc" else (5.0, 15.0, 30.0):
        r, b = contact(tyres, speed)
        stiffness = speed * b / (r + 1 / tyres.wheel_mass_kg)
        assert stiffness == pytest.approx(tyres.stiffness_n_per_rad, rel=1e-9)
        assert (1 / r <= 1.2 * ADDED_MASS * tyres.wheel_mass_kg).all()


@given(names, speeds, st.booleans())
def test_slip_never_decays_faster_than_a_step_can_follow(name, speed, ideal):
    tyres = (IDEAL if ideal else TYRES)[name]
    r, b = contact(tyres, speed)
    assert (b / r / (tyres.spin_mass_kg + 1 / r)).max() <= FASTEST_PER_S * (1 + 1e-6)


@given(names, speeds)
def test_a_tyre_that_slides_asks_for_no_more_than_is_out_of_reach(name, speed):
    tyres = TYRES[name]
    slip = 1.0 + speed
    r, b = contact(tyres, speed, slip)
    assert (slip * b / (r + 1 / tyres.wheel_mass_kg) <= OUT_OF_REACH * MU * tyres.load_n * (1 + 1e-9)).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_ideal_tyre_is_the_same_at_any_speed_and_that_of_a_car_that_stands(name):
    standing = np.array(contact(TYRES[name], 0.0))
    for speed in (0.0, 1.0, 30.0):
        assert np.array(contact(IDEAL[name], speed)) == pytest.approx(standing, rel=1e-9)


@given(names, st.lists(speeds, min_size=2, max_size=6))
def test_every_simulation_has_the_bits_that_it_has_alone(name, many):
    tyres = TYRES[name]
    speed = np.repeat(np.array(many), 4).reshape(-1, 1, 4)
    together = tyres.contact(speed, speed / 10, np.full_like(speed, MU))
    for i in range(len(many)):
        alone = tyres.contact(speed[i : i + 1], speed[i : i + 1] / 10, np.full((1, 1, 4), MU))
        assert all(np.array_equal(a[i : i + 1], b) for a, b in zip(together, alone, strict=True))


@given(st.floats(-0.02, 0.2), st.floats(5e4, 2e5), st.floats(5e3, 2e4), st.floats(5e3, 2e4))
def test_the_front_stiffness_gives_the_understeer_gradient_that_was_asked_for(k, c_r, w_f, w_r):
    c_f = front_stiffness(k, c_r, w_f, w_r)
    assert w_f / c_f - w_r / c_r == pytest.approx(k, abs=1e-12)


def test_an_understeer_gradient_out_of_reach_is_refused():
    with pytest.raises(ValueError, match="out of reach"):
        front_stiffness(-0.2, 1e5, 1e4, 1e4)
