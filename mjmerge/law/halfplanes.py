"""The point nearest to a wish in an intersection of half-planes, of many simulations at once.

minimise |u - u_n|^2 over u in R^2    subject to a_i . u >= b_i,    i = 1..M

Solved by enumeration: u_n itself, its foot on every line, and every crossing of two lines. Those that solve
the programme of their own one or two constraints are no farther from u_n than the solution, which is one of
them: the farthest. Where rounding makes two equally far, all are held against every constraint. The smallest
violation that has to be put up with is that of two or three constraints (Helly).

Only +, -, *, / and square roots of single elements: a simulation has the same bits in any company.

With n_i = a_i / |a_i| and h_i = b_i / |a_i|: a constraint holds where n_i . u >= h_i but for ``TOLERANCE``
(|h_i| + |u_n| + |u|), and lines are parallel where |n_i x n_j| is no more than ``PARALLEL``.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from mjmerge.state import Array, Mask, dot, norm

TOLERANCE = 1e-14
"""Relative to the magnitudes in a constraint: some ten times the rounding."""
PARALLEL = 8 * float(np.finfo(float).eps)
"""Largest sine between lines that count as parallel: what rounding makes of lines that are."""
LARGEST = 1e100
"""Magnitudes |h_i| and |u_n| from here on are not finite to us."""
BLOCK = 1 << 17
"""Elements of the arrays worked on at a time."""


def nearest(u_n: Array, a: Array, b: Array) -> tuple[Array, Mask]:
    """u, (N, 2), and where the constraints can be met, (N,).

    u is u_n to the bit where that meets them. Where nothing does, u is the point whose largest violation,
    max_i (b_i - a_i . u) / |a_i|, is smallest, and of several such points the nearest to u_n.
    A constraint with a_i = 0 has no say in u: it is void where b_i <= 0, and cannot be met where b_i > 0.
    A simulation with a number that is not finite keeps its u_n, and counts as one that cannot be met.

    Args:
        u_n: the wish, any unit, (N, 2).
        a: normals, into the half-planes, any unit and length, (N, M, 2).
        b: bounds, in the product of the units, (N, M).
    """
    n, h = _normalised(a, b)
    sound = np.isfinite(a).all((-1, -2)) & (np.abs(h) < LARGEST).all(-1) & (np.abs(u_n) < LARGEST).all(-1)
    u, met = u_n.copy(), sound & ((a != 0).any(-1) | (b <= 0)).all(-1)
    rows = np.flatnonzero(sound)
    rows = rows[(h[rows] > dot(n[rows], u[rows, None])).any(-1)]
    for block in _blocks(len(rows), _candidates_n(h.shape[1])):
        some = rows[block]
        u[some], found = _solve(u_n[some], n[some], h[some])
        met[some] &= found
    return u, met


def _normalised(a: Array, b: Array) -> tuple[Array, Array]:
    """n, (N, M, 2), and h, (N, M); both are 0 where a_i is."""
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.maximum(np.abs(a[..., 0]), np.abs(a[..., 1]))
        there = size != 0
        size = np.where(there, size, 1.0)
        n = a / size[..., None]
        length = np.where(there, norm(n), 1.0)
        return n / length[..., None], np.where(there, b / size / length, np.where(np.isfinite(b), 0.0, b))


def _solve(u_n: Array, n: Array, h: Array) -> tuple[Array, Mask]:
    """u, (N, 2), and whether it meets all constraints, (N,)."""
    u = _farthest(u_n, n, h)
    met = _excess(u, u_n, n, h) <= 0
    rows = np.flatnonzero(~met)
    if len(rows):
        u_n, n, h = u_n[rows], n[rows], h[rows]
        eased = h - _deficit(n, h)[:, None]
        room = TOLERANCE / 4 * (np.abs(h) + norm(u_n)[:, None])  # where there is less of it than rounding
        found = _farthest(u_n, n, eased)
        for bounds in (eased, eased - room):
            off = np.flatnonzero(_excess(found, u_n, n, eased) > 0)
            for block in _blocks(len(off), _candidates_n(h.shape[1]) * h.shape[1]):
                some = off[block]
                found[some] = _held_against_all(u_n[some], n[some], bounds[some])
        u[rows], met[rows] = found, _excess(found, u_n, n, h) <= 0
    return u, met


def _candidates_n(m: int) -> int:
    """How many points are to choose from with m constraints."""
    return 1 + m + m * (m - 1) // 2


def _candidates(u_n: Array, n: Array, h: Array) -> tuple[Array, Array]:
    """u_n, its feet and all crossings, (N, K, 2), and their squared distances to u_n, (N, K).

    The distance is -inf where the point does not solve the programme of its own one or two constraints.
    """
    c = h - dot(n, u_n[:, None])
    t = np.stack([-n[..., 1], n[..., 0]], axis=-1)
    tau = dot(t, u_n[:, None])
    feet = h[..., None] * n + tau[..., None] * t
    i, j = np.triu_indices(h.shape[1], 1)
    h_i, h_j = h[:, i], h[:, j]
    cos, sin = dot(n[:, i], n[:, j]), _cross(n[:, i], n[:, j])
    apart = np.abs(sin) > PARALLEL
    sin = np.where(apart, sin, 1.0)
    sign, near = np.copysign(1.0, cos), np.abs(cos) > 0.5
    versine = sin * sin / (1 + np.abs(cos))  # 1 - |cos|, also where that cancels
    along_i = np.where(near, (h_j - sign * h_i) + sign * h_i * versine, h_j - h_i * cos) / sin
    along_j = np.where(near, (h_i - sign * h_j) + sign * h_j * versine, h_i - h_j * cos) / -sin
    s_i, s_j = along_i - tau[:, i], along_j - tau[:, j]
    crossings = h_i[..., None] * n[:, i] + along_i[..., None] * t[:, i]
    foot = np.where(c > 0, c * c, -np.inf)
    own = apart & (s_i * sin > 0) & (s_j * sin < 0)  # both constraints pull
    crossing = np.where(own, c[:, i] * c[:, i] + s_i * s_i, -np.inf)
    points = np.concatenate([u_n[:, None], feet, crossings], axis=1)
    return points, np.concatenate([np.zeros((len(h), 1)), foot, crossing], axis=1)


def _farthest(u_n: Array, n: Array, h: Array) -> Array:
    """The candidate that is the solution if there is one, but for ties, (N, 2)."""
    points, far = _candidates(u_n, n, h)
    best: Array = points[np.arange(len(h)), far.argmax(axis=1)]
    return best


def _held_against_all(u_n: Array, n: Array, h: Array) -> Array:
    """The candidate that meets all constraints, or else does so most nearly, (N, 2)."""
    points, far = _candidates(u_n, n, h)
    excess = np.where(far >= 0, _excess(points, u_n[:, None], n[:, None], h[:, None]), np.inf)
    met = excess <= 0
    pick = np.where(met.any(axis=1), np.where(met, far, -np.inf).argmax(axis=1), excess.argmin(axis=1))
    best: Array = points[np.arange(len(h)), pick]
    return best


def _excess(u: Array, u_n: Array, n: Array, h: Array) -> Array:
    """By how much the worst constraint is violated beyond its tolerance, (...) for u of (..., 2)."""
    allowed = TOLERANCE * (np.abs(h) + (norm(u_n) + norm(u))[..., None])
    worst: Array = (h - dot(n, u[..., None, :]) - allowed).max(axis=-1)
    return worst


def _deficit(n: Array, h: Array) -> Array:
    """The smallest t >= 0 such that n_i . u >= h_i - t can be met, (N,).

    It is the largest sum l_i h_i of two or three constraints with l_i >= 0, sum l_i = 1 and sum l_i n_i = 0.
    """
    m = h.shape[1]
    i, j = np.triu_indices(m, 1)
    three: NDArray[np.intp] = np.array([*combinations(range(m), 3)], dtype=np.intp).reshape(-1, 3)
    most = np.zeros(len(h))
    for block in _blocks(len(h), max(len(i), len(three))):
        some, b = n[block], h[block]
        sin = np.zeros((len(b), m, m))
        sin[:, i, j] = _cross(some[:, i], some[:, j])
        opposite = (np.abs(sin[:, i, j]) <= PARALLEL) & (dot(some[:, i], some[:, j]) < 0)
        two = np.where(opposite, (b[:, i] + b[:, j]) / 2, 0.0)
        p, q, r = three.T
        l_p, l_q, l_r = sin[:, q, r], -sin[:, p, r], sin[:, p, q]
        total = l_p + l_q + l_r
        bounded = ((l_p >= 0) & (l_q >= 0) & (l_r >= 0)) | ((l_p <= 0) & (l_q <= 0) & (l_r <= 0))
        bounded &= np.abs(total) > PARALLEL
        t = (l_p * b[:, p] + l_q * b[:, q] + l_r * b[:, r]) / np.where(bounded, total, 1.0)
        worst = np.concatenate([two, np.where(bounded, t, 0.0)], axis=1).max(axis=1, initial=0.0)
        most[block] = np.where(worst > 0, worst, 0.0)
    return most


def _cross(a: Array, b: Array) -> Array:
    """Cross product of unit vectors over the last axis, to full relative precision also near zero."""
    a_1, b_1 = a.astype(np.float32).astype(float), b.astype(np.float32).astype(float)
    a_2, b_2 = a - a_1, b - b_1
    whole = a_1[..., 0] * b_1[..., 1] - a_1[..., 1] * b_1[..., 0]
    part = (a_1[..., 0] * b_2[..., 1] - a_1[..., 1] * b_2[..., 0]) + (
        a_2[..., 0] * b_1[..., 1] - a_2[..., 1] * b_1[..., 0]
    )
    rest = a_2[..., 0] * b_2[..., 1] - a_2[..., 1] * b_2[..., 0]
    product: Array = whole + (part + rest)
    return product


def _blocks(rows: int, width: int) -> Iterator[slice]:
    """Slices of the rows, each of ``BLOCK`` elements at most where a row has ``width``, or of one row."""
    step = max(1, BLOCK // max(1, width))
    for start in range(0, rows, step):
        yield slice(start, start + step)
