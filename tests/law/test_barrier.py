"""The barrier: what its equation says in closed form, which way it points, and what it does at d = 0."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mjmerge.law import OpinionDynamics, Sensed
from mjmerge.law.opinion_dynamics.barrier import barrier
from mjmerge.law.opinion_dynamics.law import decide
from mjmerge.plant.double_integrator import DoubleIntegrator
from mjmerge.plant.kinematic import Arrivals
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.state import Controls

ALONE = OpinionDynamics(k_p=0, k_v=0, r_rho_m=-1.2, r_eta_m=0.0)
D_0 = 0.6
FAR = 1e9


def head_on(v_0, step_s, law=ALONE, duration_s=5.0):
    """The ego runs at a resting Vehicle 1 from d = D_0; smallest d and largest demand, for each speed."""
    runs = len(v_0)
    front = np.zeros((runs, 3, 2))
    front[:, 0, 0], front[:, 2, 1] = -(D_0 + law.r_m), FAR
    velocity = np.zeros((runs, 3, 2))
    velocity[:, 0, 0] = v_0
    plant = DoubleIntegrator(front, velocity, Arrivals([Mismatch()], step_s), None)
    nothing, running = np.zeros((runs, 3)), np.ones(runs, dtype=bool)
    least, most = np.full(runs, np.inf), np.zeros(runs)
    for _ in range(round(duration_s / step_s)):
        cars = plant.observe()
        p, v = cars.front_m, cars.velocity_mps
        made = decide(law, Sensed(p[:, 0], v[:, 0], p[:, 1:], v[:, 1:], np.zeros((runs, 2))), np.zeros(runs))
        least = np.minimum(least, made.geometry.d[:, 0])
        most = np.maximum(most, np.abs(made.u[:, 0]))
        u = np.zeros((runs, 3, 2))
        u[:, 0] = made.u
        plant.step(Controls(u, *[nothing] * 7), running)
    return least, most


@pytest.fixture(scope="module")
def fine_and_coarse():
    v_0 = np.array([0.3, 0.9, 1.5, 2.5])
    return v_0, head_on(v_0, 5e-4), head_on(v_0, 1e-3)


def test_head_on_the_ego_stops_at_d_0_times_exp_of_minus_v_0_over_k_o(fine_and_coarse):
    v_0, (fine, _), (coarse, _) = fine_and_coarse
    oracle = D_0 * np.exp(-v_0 / ALONE.k_o)
    assert fine == pytest.approx(oracle, rel=0.03)
    assert (np.abs(fine - oracle) < 0.6 * np.abs(coarse - oracle)).all()  # first order in the hold
    assert 2 * fine - coarse == pytest.approx(oracle, rel=1e-3)  # what is left without it


def test_head_on_the_peak_demand_is_the_closed_form(fine_and_coarse):
    v_0, (_, fine), (_, coarse) = fine_and_coarse
    k_o = ALONE.k_o
    oracle = np.where(v_0 > k_o, k_o**2 / D_0 * np.exp(v_0 / k_o - 1), k_o * v_0 / D_0)
    assert fine == pytest.approx(oracle, rel=0.02)
    assert 2 * fine - coarse == pytest.approx(oracle, rel=1e-3)


def test_a_stronger_barrier_stops_earlier_by_the_same_formula():
    strong = ALONE.model_copy(update={"k_o": 2.0})
    least, _ = head_on(np.array([2.0]), 1e-3, strong, 3.0)
    assert least == pytest.approx(D_0 * np.exp(-1), rel=0.01)


angle, distance, rate = st.floats(-np.pi, np.pi), st.floats(1e-3, 10), st.floats(-5, 5)


def unit(*angles):
    """Unit vectors at angles, (1, 2, 2)."""
    return np.array([[[np.cos(a), np.sin(a)] for a in angles]])


def single(g, d, d_dot):
    """Barrier against the first of two neighbours, the second keeping its distance."""
    return barrier(ALONE, g, np.array([[d, 1.0]]), np.array([[d_dot, 0.0]]))[0]


@given(angle, distance, rate)
def test_it_pushes_away_while_closing_and_drags_after_a_car_that_leaves(a, d, d_dot):
    assume(abs(d_dot) > 1e-6)
    g = unit(a, 0.0)
    along = single(g, d, d_dot) @ g[0, 0]
    assert np.sign(along) == -np.sign(d_dot)
    assert abs(along) == pytest.approx(ALONE.k_o * abs(d_dot) / d, rel=1e-9)


@given(angle, distance, st.floats(-5, -1e-3))
def test_inside_the_margin_it_pulls_inward_as_printed(a, d, d_dot):
    g = unit(a, 0.0)
    assert single(g, -d, d_dot) @ g[0, 0] < 0


@given(angle, angle, distance, distance, rate, rate)
def test_it_is_the_sum_over_the_neighbours(a, b, d_1, d_2, rate_1, rate_2):
    both = barrier(ALONE, unit(a, b), np.array([[d_1, d_2]]), np.array([[rate_1, rate_2]]))[0]
    parts = single(unit(a, 0), d_1, rate_1) + single(unit(b, 0), d_2, rate_2)
    assert both == pytest.approx(parts, rel=1e-12, abs=1e-9)


@pytest.mark.parametrize("d", [0.0, 1e-320, -1e-320])
@pytest.mark.parametrize("d_dot", [-100.0, -1.0, 0.0, 1.0, 100.0])
def test_on_the_margin_it_is_a_number_and_points_as_just_beside_it(d, d_dot):
    for k_o in (0.0, 1.0, 50.0):
        law = ALONE.model_copy(update={"k_o": k_o})
        u_c = barrier(law, unit(0.0, np.pi / 2), np.array([[d, 1.0]]), np.array([[d_dot, 0.0]]))[0]
        assert np.isfinite(u_c).all()
        assert u_c[1] == 0
        assert np.sign(u_c[0]) == -np.sign(d_dot * k_o) * (1 if d >= 0 else -1)


def test_without_gain_there_is_no_barrier():
    off = ALONE.model_copy(update={"k_o": 0.0})
    assert not barrier(off, unit(0.3, 2.0), np.array([[0.01, -0.2]]), np.array([[-3.0, 2.0]])).any()
