"""The law put together: its equilibria and its symmetries."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mjmerge.law import OpinionDynamics, Sensed
from mjmerge.law.opinion_dynamics.law import decide

LAW = OpinionDynamics(r_rho_m=-1.2, r_eta_m=1.4)
MIRRORED = LAW.model_copy(update={"r_eta_m": -1.4})

position, velocity = st.floats(-5, 5), st.floats(-3, 3)


def point(of):
    return st.tuples(of, of).map(np.array)


@st.composite
def situations(draw):
    """What one ego senses, with everybody away from the singularities of the law."""
    p, p_1, p_2 = (draw(point(position)) for _ in range(3))
    v, v_1, v_2, u_1 = (draw(point(velocity)) for _ in range(4))
    for a, b in ((p, p_1), (p, p_2), (p_1, p_2)):
        apart = np.hypot(*(a - b))
        assume(apart > 0.05)
        assume(abs(apart - LAW.r_m) > 0.05)
    return Sensed(p[None], v[None], np.stack([p_1, p_2])[None], np.stack([v_1, v_2])[None], u_1[None])


def changed(s, p=lambda x: x, v=lambda x: x, u=lambda x: x):
    """The situation with every position, velocity and acceleration mapped."""
    return Sensed(p(s.p), v(s.v), p(s.p_j), v(s.v_j), u(s.u_1))


opinion = st.floats(0, 0.3).map(lambda z: np.array([z]))


@pytest.mark.parametrize(("z", "lateral"), [(0.0, LAW.r_eta_m), (1.0, 0.0)])
def test_both_branches_rest_at_their_target_beside_still_neighbours(z, lateral):
    still = np.zeros((1, 2))
    sensed = Sensed(
        p=np.array([[3.0 + LAW.r_rho_m, 0.5 + lateral]]),
        v=still,
        p_j=np.array([[[3.0, 0.5], [3.0 - 2.5, 0.5]]]),
        v_j=np.zeros((1, 2, 2)),
        u_1=still,
    )
    made = decide(LAW, sensed, np.array([z]))
    assert (made.geometry.d > 0).all()
    assert made.u == pytest.approx(0, abs=1e-15)


@given(situations(), opinion)
def test_a_mirrored_road_gets_the_mirrored_command_to_the_last_bit(s, z):
    def mirror(a):
        return a * np.array([1.0, -1.0])

    made, other = decide(LAW, s, z), decide(MIRRORED, changed(s, mirror, mirror, mirror), z)
    assert np.array_equal(other.u, mirror(made.u))
    assert np.array_equal(other.e_1_star, mirror(made.e_1_star))
    for name in ("w", "mu_input"):
        assert np.array_equal(getattr(made, name), getattr(other, name)), name
    for name in ("d", "d_dot", "dbar", "dbar_dot"):
        assert np.array_equal(getattr(made.geometry, name), getattr(other.geometry, name)), name


@given(situations(), opinion, point(st.floats(-100, 100)))
def test_it_does_not_matter_where_on_earth_it_happens(s, z, shift):
    made, other = decide(LAW, s, z), decide(LAW, changed(s, p=lambda x: x + shift), z)
    assert other.u == pytest.approx(made.u, rel=1e-9, abs=1e-9)
    assert other.mu_input == pytest.approx(made.mu_input, abs=1e-8)


@given(situations(), opinion, point(st.floats(-30, 30)))
def test_a_common_velocity_changes_nothing(s, z, common):
    made, other = decide(LAW, s, z), decide(LAW, changed(s, v=lambda x: x + common), z)
    assert other.u == pytest.approx(made.u, rel=1e-9, abs=1e-9)
    assert other.mu_input == pytest.approx(made.mu_input, abs=1e-8)


@given(situations(), opinion)
def test_the_leaders_acceleration_is_passed_on(s, z):
    at_rest = changed(s, u=lambda x: 0 * x)
    assert decide(LAW, s, z).u - decide(LAW, at_rest, z).u == pytest.approx(s.u_1, abs=1e-9)


@given(situations(), opinion)
def test_rates_are_the_derivatives_of_the_distances(s, z):
    h = 1e-6
    ahead, behind = (
        decide(LAW, Sensed(s.p + k * s.v, s.v, s.p_j + k * s.v_j, s.v_j, s.u_1), z) for k in (h, -h)
    )
    made = decide(LAW, s, z)
    assert made.geometry.d_dot == pytest.approx((ahead.geometry.d - behind.geometry.d) / (2 * h), abs=1e-6)


@given(situations(), opinion)
def test_a_car_that_closes_in_pushes_the_ego_away_from_itself(s, z):
    """g_j points from the neighbour to the ego."""
    for j in (0, 1):
        towards = (s.p - s.p_j[:, j])[0]
        closing = Sensed(s.p, s.p * 0, s.p_j, s.v_j * 0, s.u_1 * 0)
        closing.v_j[0, j] = 2 * towards / np.hypot(*towards)
        made = decide(LAW, closing, z)
        assert made.geometry.d_dot[0, j] == pytest.approx(-2.0)
        assert made.geometry.d_dot[0, 1 - j] == 0
        if made.geometry.d[0, j] > 0:
            assert made.u_c[0] @ towards > 0


def numbers(decision):
    """All arrays of a decision, by name."""
    return {k: v for k, v in vars(decision).items() if k != "geometry"} | vars(decision.geometry)


def test_rows_of_a_batch_are_what_each_is_alone():
    rng = np.random.default_rng(3)
    s = Sensed(*(rng.uniform(-3, 3, (5, *shape)) for shape in ((2,), (2,), (2, 2), (2, 2), (2,))))
    z = rng.uniform(0, 0.2, 5)
    together = decide(LAW, s, z)
    for i in range(5):
        row = slice(i, i + 1)
        alone = decide(LAW, Sensed(s.p[row], s.v[row], s.p_j[row], s.v_j[row], s.u_1[row]), z[row])
        for name, value in numbers(alone).items():
            assert value.tobytes() == numbers(together)[name][row].tobytes(), name


def test_cars_in_one_place_give_numbers():
    one_place = Sensed(
        np.zeros((1, 2)), np.ones((1, 2)), np.zeros((1, 2, 2)), np.zeros((1, 2, 2)), np.zeros((1, 2))
    )
    for value in numbers(decide(LAW, one_place, np.array([0.1]))).values():
        assert np.isfinite(value).all()
