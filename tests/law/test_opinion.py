"""Opinion and bifurcation parameter: exact where they claim to be, and never negative."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.law import OpinionDynamics
from mjmerge.law.opinion_dynamics.opinion import advance, bifurcation_input

LAW = OpinionDynamics(r_rho_m=-1.2, r_eta_m=1.4)
MU_MAX = LAW.k_s / LAW.k_mu  # where mu goes while its input is largest


def step(z, mu, mu_input, h, law=LAW):
    """One step of a single simulation, as floats."""
    z, mu = advance(law, np.array([z]), np.array([mu]), np.array([mu_input]), h)
    return float(z[0]), float(mu[0])


def steps(z, mu, mu_input, h, n):
    """n steps of h/n with the input held throughout."""
    for _ in range(n):
        z, mu = step(z, mu, mu_input, h / n)
    return z, mu


def reference(z, mu, mu_input, h, n=4000):
    """Both equations as printed, by classical Runge-Kutta with n steps."""

    def rate(x):
        return np.array([(x[1] * x[0] - x[0] ** 2) / LAW.eps, -LAW.k_mu * x[1] + mu_input])

    x, dt = np.array([z, mu]), h / n
    for _ in range(n):
        k_1 = rate(x)
        k_2 = rate(x + dt / 2 * k_1)
        k_3 = rate(x + dt / 2 * k_2)
        k_4 = rate(x + dt * k_3)
        x = x + dt / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
    return float(x[0]), float(x[1])


@given(
    mu=st.floats(-10, 10),
    mu_input=st.floats(-10, 10),
    h=st.floats(1e-4, 10),
)
def test_mu_is_the_closed_form_of_a_first_order_lag(mu, mu_input, h):
    decay = np.exp(-LAW.k_mu * h)
    assert step(0.1, mu, mu_input, h)[1] == pytest.approx(
        mu * decay + mu_input / LAW.k_mu * (1 - decay), rel=1e-12, abs=1e-14
    )


def test_mu_solves_its_differential_equation():
    assert step(0.1, -0.1, 0.7, 0.3)[1] == pytest.approx(reference(0.1, -0.1, 0.7, 0.3)[1], abs=1e-13)


def test_mu_integrates_its_input_where_it_hardly_decays():
    slow = LAW.model_copy(update={"k_mu": 1e-9})
    assert step(0.1, 0.05, 0.3, 0.01, slow)[1] == pytest.approx(0.05 + 0.3 * 0.01, rel=1e-10)


@given(
    z=st.floats(1e-6, 2),
    mu=st.one_of(st.floats(-1, -1e-3), st.floats(1e-3, 1)),
    h=st.floats(1e-4, 0.5),
)
def test_z_is_the_logistic_curve_while_mu_rests(z, mu, h):
    growth = np.exp(mu * h / LAW.eps)
    logistic = mu * z * growth / (mu + z * (growth - 1))
    assert step(z, mu, mu * LAW.k_mu, h)[0] == pytest.approx(logistic, rel=1e-11)


@given(
    z=st.one_of(st.just(0.0), st.floats(1e-300, 1e6)),
    mu=st.floats(-1e6, 1e6),
    mu_input=st.floats(-1e6, 1e6),
    h=st.floats(1e-9, 1e3),
)
def test_z_is_never_negative_and_always_finite(z, mu, mu_input, h):
    later, mu_later = step(z, mu, mu_input, h)
    assert later >= 0
    assert np.isfinite(later)
    assert np.isfinite(mu_later)


@given(z=st.floats(0, 3), inputs=st.lists(st.floats(-1, 1), min_size=1, max_size=30), h=st.floats(1e-3, 1))
def test_z_never_exceeds_what_it_was_or_the_largest_mu(z, inputs, h):
    bound, mu = max(z, MU_MAX), 0.0
    for mu_input in inputs:
        z, mu = step(z, mu, mu_input, h)
        assert z <= bound * (1 + 1e-12)


@pytest.mark.parametrize("mu", [0.2, 5.0, 1e3, 1e5])
@pytest.mark.parametrize("h", [0.01, 1.0, 100.0])
def test_z_settles_at_mu_however_strong_and_long_the_step(mu, h):
    z = 0.1
    for _ in range(1 + int(200 * LAW.eps / (mu * h))):
        z, _ = step(z, mu, mu * LAW.k_mu, h)
    assert z == pytest.approx(mu, rel=1e-9)


def test_indifference_is_not_a_special_case():
    h, z = 0.01, 0.15
    at_zero = step(z, 0.0, 0.0, h)[0]
    assert at_zero == pytest.approx(z / (1 + z * h / LAW.eps), rel=1e-15)
    for exponent, sign in itertools.product(range(2, 20), (-1, 1)):
        mu = sign * 10.0**-exponent
        change = step(z, mu, mu * LAW.k_mu, h)[0] - at_zero
        assert abs(change) <= abs(mu) * z * h / LAW.eps * 1.1 + 1e-15
    assert step(z, 1e-2, 1e-2 * LAW.k_mu, h)[0] != at_zero


def test_an_opinion_of_zero_stays_zero():
    for mu, h in itertools.product((-1e3, -0.2, 0.0, 0.2, 1e3), (1e-6, 0.01, 1.0)):
        assert step(0.0, mu, 1.0, h)[0] == 0.0


@pytest.mark.parametrize(
    ("z", "mu", "mu_input"), [(0.15, 0.0, 1.0), (0.15, 0.2, -1.0), (1e-3, -0.2, 1.0), (0.2, 0.2, -0.5)]
)
def test_the_step_size_does_not_decide_z(z, mu, mu_input):
    """The mean of mu stands in for its curve: third order in h, 1e-6 of z at the usual 10 ms."""
    exact = reference(z, mu, mu_input, 0.1)[0]
    errors = [abs(steps(z, mu, mu_input, 0.1, n)[0] / exact - 1) for n in (1, 10, 100)]
    assert errors[0] < 2e-2
    assert errors[1] < errors[0] / 50
    assert errors[2] < errors[1] / 50
    assert steps(z, mu, mu_input, 0.01, 1)[0] == pytest.approx(reference(z, mu, mu_input, 0.01)[0], rel=1e-5)


def test_simulations_do_not_mix():
    z, mu, mu_input = np.array([0.0, 0.1, 0.2]), np.array([0.1, -0.1, 0.2]), np.array([1.0, 0.5, -1.0])
    together = np.stack(advance(LAW, z, mu, mu_input, 0.01))
    alone = np.array([step(*row, 0.01) for row in zip(z, mu, mu_input, strict=True)]).T
    assert np.array_equal(together, alone)


def mu_input(beside, room, open_, law=LAW):
    """The input with each of the three conditions at a margin of 0.3, either way."""
    dbar = 2 * law.r_m + 0.3 * room
    dbar_dot = (0.3 * open_ - law.eps_1) * dbar
    return float(
        bifurcation_input(law, np.array([[0.6, -0.6 * beside]]), np.array([dbar]), np.array([dbar_dot]))[0]
    )


@pytest.mark.parametrize(("beside", "room", "open_"), list(itertools.product((1, -1), repeat=3)))
def test_mu_follows_the_sign_of_the_product_of_the_three_conditions(beside, room, open_):
    """As printed: all true asks for the merge, one false refuses it, and two false make a true one again."""
    assert np.sign(mu_input(beside, room, open_)) == beside * room * open_


def test_two_false_conditions_ask_for_a_merge_that_neither_would_allow():
    too_small_and_closing = mu_input(1, -1, -1)
    ahead_and_too_small = mu_input(-1, -1, 1)
    assert too_small_and_closing > 0.2
    assert ahead_and_too_small > 0.2


def test_the_input_is_symmetric_in_the_neighbours_and_bounded():
    rng = np.random.default_rng(0)
    rho_g, dbar, dbar_dot = rng.uniform(-1, 1, (200, 2)), rng.uniform(-1, 5, 200), rng.uniform(-5, 5, 200)
    found = bifurcation_input(LAW, rho_g, dbar, dbar_dot)
    assert np.array_equal(found, bifurcation_input(LAW, rho_g[:, ::-1], dbar, dbar_dot))
    assert np.array_equal(found, bifurcation_input(LAW, -rho_g, dbar, dbar_dot))
    assert np.abs(found).max() <= LAW.k_s
    stronger = LAW.model_copy(update={"k_s": 3.0})
    assert bifurcation_input(stronger, rho_g, dbar, dbar_dot) == pytest.approx(3 * found)


@pytest.mark.parametrize("dbar_dot", [-100.0, -0.1, 0.0, 0.1, 100.0])
@pytest.mark.parametrize("rho_g", [(0.7, -0.7), (0.0, 0.5)])
def test_a_gap_of_exactly_r_gives_a_number(dbar_dot, rho_g):
    found = bifurcation_input(LAW, np.array([rho_g]), np.zeros(1), np.array([dbar_dot]))
    assert np.abs(found) <= LAW.k_s
