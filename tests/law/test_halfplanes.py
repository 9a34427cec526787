"""The nearest point of many half-planes: exact fractions, an independent solver, and what optimal means."""

from fractions import Fraction
from itertools import combinations

import daqp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog, nnls

from mjmerge.law.halfplanes import nearest

MARGIN = 1e-7  # nearer to the edge of feasibility, two solvers may differ
TRIPLES = [(1, 0, 1), (0, 1, 1), (3, 4, 5), (4, 3, 5), (5, 12, 13), (20, 21, 29), (119, 120, 169)]


def alone(u_n, a, b):
    u, met = nearest(np.array([u_n], float), np.array([a], float).reshape(1, -1, 2), np.array([b], float))
    return u[0], bool(met[0])


def random_programmes(seed, n, m, tightness=0.4):
    """u_n, a, b; some constraints are parallel, opposite or the same, and many programmes infeasible."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, (n, m))
    likewise = rng.random((n, m)) < 0.1
    angle = np.where(likewise, angle[:, :1] + np.pi * rng.integers(0, 2, (n, m)), angle)
    a = np.stack([np.cos(angle), np.sin(angle)], -1) * np.exp(rng.normal(size=(n, m, 1)))
    inner = rng.normal(size=(n, 1, 2))
    tight = tightness * rng.integers(0, 3, (n, 1)) * rng.exponential(size=(n, m))
    h = tight - rng.exponential(size=(n, m))
    return 3 * rng.normal(size=(n, 2)), a, (a * inner).sum(-1) + h * np.linalg.norm(a, axis=-1)


def violation(u, a, b):
    """The largest (b_i - a_i . u) / |a_i|, for u of (..., 2)."""
    return ((b - (a * u[..., None, :]).sum(-1)) / np.linalg.norm(a, axis=-1)).max(-1)


def cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def exact(u, n, h):
    """The solution in fractions, if there is one; unit normals."""
    points = [u]
    for (x, y), b in zip(n, h, strict=True):
        short = b - x * u[0] - y * u[1]
        points.append((u[0] + short * x, u[1] + short * y))
    for i, j in combinations(range(len(n)), 2):
        if sin := cross(n[i], n[j]):
            points.append(
                ((h[i] * n[j][1] - h[j] * n[i][1]) / sin, (n[i][0] * h[j] - n[j][0] * h[i]) / sin),
            )
    fit = [p for p in points if all(x * p[0] + y * p[1] >= b for (x, y), b in zip(n, h, strict=True))]
    return min(fit, key=lambda p: (p[0] - u[0]) ** 2 + (p[1] - u[1]) ** 2, default=None)


def exact_deficit(n, h):
    """The smallest t for which n . u >= h - t can be met, if that is positive, in fractions."""
    t = Fraction(0)
    for i, j in combinations(range(len(n)), 2):
        if n[i] == (-n[j][0], -n[j][1]):
            t = max(t, (h[i] + h[j]) / 2)
    for i, j, k in combinations(range(len(n)), 3):
        weights = cross(n[j], n[k]), cross(n[k], n[i]), cross(n[i], n[j])
        if min(weights) >= 0 < max(weights) or max(weights) <= 0 > min(weights):
            t = max(t, sum(w * h[q] for w, q in zip(weights, (i, j, k), strict=True)) / sum(weights))
    return t


@st.composite
def rational_programmes(draw):
    """u_n, unit normals, bounds, and the lengths |a_i|; many touch, are parallel, or have no inside."""
    scale = draw(st.sampled_from([1, 1000, 10**12]))
    coarse = st.builds(lambda k, d: Fraction(scale * k, d), st.integers(-4, 4), st.integers(1, 3))
    sign = st.sampled_from([-1, 1])
    u, common = draw(st.tuples(coarse, coarse)), draw(st.tuples(coarse, coarse))
    n, h, length = [], [], []
    for _ in range(draw(st.integers(1, 6))):
        x, y, z = draw(st.sampled_from(TRIPLES))
        n.append((Fraction(draw(sign) * x, z), Fraction(draw(sign) * y, z)))
        through = n[-1][0] * common[0] + n[-1][1] * common[1]
        h.append(through if draw(st.booleans()) else draw(coarse))
        length.append(Fraction(draw(st.integers(1, 99)), draw(st.integers(1, 99))))
    return u, n, h, length


@given(rational_programmes())
def test_it_is_the_exact_solution_and_else_the_exact_least_violation_nearest_to_the_wish(programme):
    u_n, n, h, length = programme
    a = [[float(c * size) for c in row] for row, size in zip(n, length, strict=True)]
    u, met = alone([float(c) for c in u_n], a, [float(b * size) for b, size in zip(h, length, strict=True)])
    solution = exact(u_n, n, h)
    assert met == (solution is not None)
    t = exact_deficit(n, h)
    expected = solution or exact(u_n, n, [b - t for b in h])
    size = float(max(1, *map(abs, u_n), *map(abs, h)))
    assert u == pytest.approx([float(c) for c in expected], abs=1e-11 * size)


def by_daqp(u_n, n, h):
    m = len(h)
    u, _, flag, _ = daqp.solve(
        np.eye(2), -u_n, n, np.full(m, 1e30), h, np.zeros(m, np.int32), primal_tol=1e-12
    )
    assert flag in (1, -1)
    return u, flag == 1


def test_an_independent_solver_finds_the_same_point_and_tells_infeasible_programmes_alike(long):
    kinds, each = (range(1, 35), 295) if long else ((1, 2, 3, 4, 6, 8, 14, 34), 125)
    compared, infeasible, on_the_edge = 0, 0, 0
    for m in kinds:
        u_n, a, b = random_programmes(m, each, m)
        length = np.linalg.norm(a, axis=-1)
        n, h = a / length[..., None], b / length
        for k, (u, met) in enumerate(zip(*nearest(u_n, a, b), strict=True)):
            if by_daqp(u_n[k], n[k], h[k] - MARGIN)[1] != by_daqp(u_n[k], n[k], h[k] + MARGIN)[1]:
                on_the_edge += 1
                continue
            expected, can_be_met = by_daqp(u_n[k], n[k], h[k])
            assert met == can_be_met
            compared += 1
            infeasible += not met
            if met:
                assert u == pytest.approx(expected, abs=1e-9)
    print(f"{compared} compared, {infeasible} of them infeasible; {on_the_edge} within {MARGIN} of the edge")
    assert on_the_edge <= 0.001 * compared
    assert 0.2 * compared < infeasible < 0.8 * compared


@pytest.mark.parametrize("m", [3, 8, 34])
def test_where_nothing_fits_the_largest_violation_is_that_of_a_linear_programme(m, long):
    u_n, a, b = random_programmes(m, 200 if long else 30, m, tightness=1.0)
    u, met = nearest(u_n, a, b)
    assert not met.all()
    for k in np.flatnonzero(~met):
        length = np.linalg.norm(a[k], axis=-1)
        rows = np.column_stack([-a[k] / length[:, None], -np.ones(m)])
        least = linprog([0, 0, 1], A_ub=rows, b_ub=-b[k] / length, bounds=[(None, None)] * 3)
        assert violation(u[k], a[k], b[k]) == pytest.approx(least.fun, abs=1e-9)


seeds = st.integers(0, 2**32 - 1)
counts = st.integers(1, 34)


@given(seeds, counts)
def test_what_moves_the_wish_are_the_constraints_it_ends_on_each_pushing_inwards(seed, m):
    u_n, a, b = random_programmes(seed, 4, m, tightness=0.1)
    u, met = nearest(u_n, a, b)
    for k in np.flatnonzero(met):
        n = a[k] / np.linalg.norm(a[k], axis=-1, keepdims=True)
        slack = n @ u[k] - b[k] / np.linalg.norm(a[k], axis=-1)
        assert slack.min() > -1e-12
        pushing = n[slack < 1e-9]
        off = nnls(pushing.T, u[k] - u_n[k])[1] if len(pushing) else np.abs(u[k] - u_n[k]).max()
        assert off < 1e-9


@given(seeds, counts)
def test_no_point_that_fits_is_nearer_and_where_one_fits_that_is_told(seed, m):
    u_n, a, b = random_programmes(seed, 4, m, tightness=0.1)
    u, met = nearest(u_n, a, b)
    tries = np.random.default_rng(seed).normal(size=(200, 1, 2)) * 2
    fits = violation(tries, a, b) <= 0
    assert met[fits.any(0)].all()
    nearer = np.linalg.norm(tries - u_n, axis=-1) < np.linalg.norm(u - u_n, axis=-1) - 1e-12
    assert not (fits & nearer).any()


@given(seeds, counts, st.sampled_from([1e-12, 1.0, 1e12]))
def test_a_simulation_has_the_same_bits_alone_as_in_company(seed, m, scale):
    u_n, a, b = random_programmes(seed, 9, m, tightness=0.2)
    b *= scale
    a[0, 0], b[0, 0], a[1, 0], u_n[2] = 0, 1, np.nan, np.inf
    u, met = nearest(u_n, a, b)
    for k in range(len(u)):
        u_k, met_k = nearest(u_n[k : k + 1], a[k : k + 1], b[k : k + 1])
        assert (u_k.tobytes(), met_k[0]) == (u[k].tobytes(), met[k])


@given(seeds, counts)
def test_a_wish_that_fits_is_granted_to_the_bit(seed, m):
    u_n, a, b = random_programmes(seed, 4, m)
    b = np.minimum(b, (a * u_n[:, None]).sum(-1) - 1e-9)
    u, met = nearest(u_n, a, b)
    assert met.all()
    assert u.tobytes() == u_n.tobytes()


def test_no_constraints_grant_every_wish():
    u, met = nearest(np.ones((2, 2)), np.zeros((2, 0, 2)), np.zeros((2, 0)))
    assert (u == 1).all()
    assert met.all()
    assert nearest(np.zeros((0, 2)), np.zeros((0, 3, 2)), np.zeros((0, 3)))[0].shape == (0, 2)


@pytest.mark.parametrize("past", [1e-7, 1e-9, 1e-11, 1e-13])
def test_a_corner_next_to_the_foot_on_one_of_its_sides_is_not_taken_for_it(past):
    u, met = alone([0, 0], [[1, 0], [0.6, 0.8]], [1, 0.6 + 0.8 * past])
    assert met
    assert u == pytest.approx([1, past], abs=1e-15)


@pytest.mark.parametrize("m", [2, 3, 4, 5, 9])
def test_lines_through_one_point_are_met_however_nearly_parallel(m):
    rng = np.random.default_rng(m)
    spread = rng.choice([0, 1e-12, 1e-9, 1e-8, 1e-6, 1e-5, 1e-3, 1], (4000, m))
    angle = rng.uniform(0, 2 * np.pi, (4000, 1)) + spread * rng.normal(size=(4000, m))
    a = np.stack([np.cos(angle), np.sin(angle)], -1) * rng.choice([-1, 1], (4000, m, 1))
    b = (a * rng.normal(size=(4000, 1, 2))).sum(-1)
    u_n = rng.normal(size=(4000, 2))
    u, met = nearest(u_n, a, b)
    assert met.all()
    assert (violation(u, a, b) <= 2e-14 * (1 + np.abs(u_n).max(-1) + np.abs(u).max(-1))).all()


@pytest.mark.parametrize("turn", [1e-14, 1e-12, 1e-10, 1e-8])
def test_nearly_the_same_constraint_twice_is_nearly_that_constraint(turn):
    angle = np.random.default_rng(0).uniform(0, 2 * np.pi, (1000, 1)) + np.array([0, turn])
    n = np.stack([np.cos(angle), np.sin(angle)], -1)
    u, met = nearest(np.zeros((1000, 2)), n, np.ones((1000, 2)))
    assert met.all()
    assert np.abs(u - n[:, 0]).max() < 2 * turn


@pytest.mark.parametrize("far", [1.0, 3.7, 1e6, 1e12])
def test_the_sides_of_a_box_are_kept_to_the_bit(far):
    rng = np.random.default_rng(0)
    low, high = -rng.exponential(size=(1000, 2)), rng.exponential(size=(1000, 2))
    a = np.broadcast_to([[1.0, 0], [0, 1], [-1, 0], [0, -1]], (1000, 4, 2))
    u_n = far * rng.normal(size=(1000, 2))
    u, met = nearest(u_n, a, np.column_stack([low, -high]))
    assert met.all()
    assert (u == np.clip(u_n, low, high)).all()


BOX, SIDES = [[1, 0], [-1, 0], [0, 1], [0, -1]], [-0.1, -0.3, -0.7, -1.1]  # -0.1..0.3 by -0.7..1.1


def test_a_constraint_without_a_normal_is_void_or_cannot_be_met_and_the_others_decide():
    assert alone([2, 0.2], [*BOX, [0, 0]], [*SIDES, -1])[1]
    assert alone([2, 0.2], [*BOX, [0, 0]], [*SIDES, 0])[1]
    u, met = alone([2, 0.2], [*BOX, [0, 0]], [*SIDES, 1e-9])
    assert (u.tolist(), met) == ([0.3, 0.2], False)


def test_of_points_equally_bad_it_is_the_nearest_that_fits_best():
    u, met = alone([7, -3], [[2, 0], [-1, 0]], [2, 0])  # x >= 1 and x <= 0
    assert (u.tolist(), met) == (pytest.approx([0.5, -3]), False)
    u, met = alone([7, -3], [[2, 0], [-1, 0], [0, 1]], [2, 0, -1])  # y >= -1 gives way as well
    assert (u.tolist(), met) == (pytest.approx([0.5, -1.5]), False)


@pytest.mark.parametrize("length", [1e-12, 1.0, 1e12])
def test_a_strip_without_width_is_met_and_one_that_is_too_narrow_is_not(length):
    a = length * np.array([[0.6, 0.8], [-0.3, -0.4], [0.8, -0.6]])
    u, met = alone([5, 5], a, length * np.array([1, -0.5, 2]))
    assert (u.tolist(), met) == (pytest.approx([2.2, -0.4]), True)
    assert not alone([5, 5], a, length * np.array([1, -0.5 + 1e-12, 2]))[1]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_keeps_the_wish_and_is_told(bad):
    u_n, a, b = random_programmes(0, 4, 5)
    sound = nearest(u_n, a, b)
    a[0, 1, 0] = bad
    b[1, 3] = bad
    u_n[2, 1] = bad
    u, met = nearest(u_n, a, b)
    assert u[:3].tobytes() == u_n[:3].tobytes()
    assert met.tolist() == [False, False, False, sound[1][3]]
    assert u[3].tobytes() == sound[0][3].tobytes()
