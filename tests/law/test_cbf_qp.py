"""The CBF-QP keeps every d_j positive wherever its own hypotheses hold."""

from __future__ import annotations

import numpy as np
import pytest

from mjmerge import judge, load, simulate
from mjmerge.law import Sensed, geometry
from mjmerge.law.cbf_qp import CbfQp
from mjmerge.law.nominal import Nominal
from mjmerge.verdict.metrics import merged_at_s

LAW = CbfQp(r_rho_m=-1.2)


def seen(runs: int, neighbours: int = 2, seed: int = 0) -> Sensed:
    """Some metres and metres per second around an ego."""
    rng = np.random.default_rng(seed)
    p, v, u = (rng.uniform(-2, 2, (runs, 2)) for _ in range(3))
    p_j, v_j = (rng.uniform(-3, 3, (runs, neighbours, 2)) for _ in range(2))
    return Sensed(p, v, p_j, v_j, u)


@pytest.mark.parametrize("neighbours", [2, 5])
def test_its_constraints_are_the_second_derivatives_of_the_distances(neighbours):
    """By differences of d_j along the motion that u gives, all neighbours unaccelerated but the leader."""
    s, h = seen(50, neighbours), 1e-4
    law = LAW.model_copy(update={"a_j_mps2": 0.0})
    u = np.random.default_rng(1).uniform(-3, 3, s.p.shape)
    u_j = np.zeros(s.v_j.shape)
    u_j[:, 0] = s.u_1

    def d(t: float) -> np.ndarray:
        moved = Sensed(s.p + t * s.v + t * t / 2 * u, s.v, s.p_j + t * s.v_j + t * t / 2 * u_j, s.v_j, s.u_1)
        return geometry(law, moved).d

    now = geometry(law, s)
    second = (d(h) - 2 * d(0.0) + d(-h)) / h**2
    normals, bounds = law.constraints(s)
    slack = np.sum(normals * u[:, None], axis=-1) - bounds
    expected = second + 4.0 * now.d_dot + 4.0 * now.d
    assert np.allclose(slack, expected, rtol=1e-4, atol=1e-4)


def test_it_leaves_the_tracking_alone_where_that_is_safe_and_meets_every_constraint_elsewhere():
    s = seen(500, neighbours=5)
    made = LAW.decide(s, {}, 0.01)
    normals, bounds = LAW.constraints(s)
    u_n, _ = LAW.nominal(s)
    fits = np.all(np.sum(normals * u_n[:, None], axis=-1) >= bounds, axis=1)
    assert 0 < fits.sum() < 500
    assert np.array_equal(made.u[fits], u_n[fits])
    feasible = made.signals["qp_feasible"] == 1
    assert 0.3 < feasible.mean() < 1
    left = np.sum(normals * made.u[:, None], axis=-1) - bounds
    assert left[feasible].min() > -1e-9
    assert left[~feasible].min(axis=1).max() < 0


def test_without_its_filter_it_is_the_nominal_law():
    off = LAW.unguarded()
    assert off.unguarded() is off
    s = seen(20)
    nominal = Nominal(r_rho_m=-1.2).decide(s, {}, 0.01)
    assert np.array_equal(off.decide(s, {}, 0.01).u, nominal.u)


@pytest.mark.parametrize("name", ["paper", "charge", "highway"])
def test_it_merges_on_the_ideal_plant_because_of_its_filter(name):
    trace = simulate(load(name, ["law.kind=cbf_qp", "control_step_s=0.02"]), "double_integrator")
    (verdict,) = judge(trace)
    assert (verdict.verdict, verdict.needed) == ("held", True)
    harder = ["neighbours accelerate as assumed"] * (name == "charge")  # than 1 m/s^2: it charges
    assert [breach.hypothesis for breach in verdict.breaches] == harder
    assert np.isfinite(merged_at_s(trace)).all()
    assert trace.min_distance_m.min() > 0


def test_it_is_the_same_at_another_size():
    small = simulate(load("paper", ["law.kind=cbf_qp", "duration_s=8"]), "double_integrator")
    large = simulate(small.scenario.scaled(9.0), "double_integrator")
    assert np.allclose(large.front_m, 9.0 * small.front_m, rtol=0, atol=1e-9)
    assert np.array_equal(large.signals["qp_feasible"], small.signals["qp_feasible"])


def test_a_neighbour_that_accelerates_harder_than_assumed_breaks_its_hypothesis():
    charge = simulate(load("charge", ["law.kind=cbf_qp", "law.a_j_mps2=0.1"]), "double_integrator")
    (verdict,) = judge(charge)
    assert "neighbours accelerate as assumed" in [breach.hypothesis for breach in verdict.breaches]


def test_constraints_that_contradict_each_other_are_a_hypothesis_that_breaks():
    s = Sensed(
        p=np.zeros((1, 2)),
        v=np.zeros((1, 2)),
        p_j=np.array([[[0.65, 0.0], [-0.65, 0.0]]]),
        v_j=np.array([[[-2.0, 0.0], [2.0, 0.0]]]),
        u_1=np.zeros((1, 2)),
    )
    made = LAW.decide(s, {}, 0.01)
    assert made.signals["qp_feasible"] == 0
    assert made.u[0, 0] == pytest.approx(
        0.5
    )  # half of what it wants from the follower, whom nobody tells it of


class Neighbours:
    """Random ones whose accelerations are sums of waves, within a_j together, and whose motion is known."""

    def __init__(self, worlds: int, count: int, a_j_mps2: float) -> None:
        rng = np.random.default_rng(0)
        shape = (worlds, count, 2, 3)
        self.rate = rng.uniform(0.3, 3.0, shape)
        self.phase = rng.uniform(0, 2 * np.pi, shape)
        size = rng.uniform(0, 1, shape)
        self.size = a_j_mps2 / np.sqrt(2) * size / size.sum(axis=-1, keepdims=True)
        self.p = rng.uniform(-4, 4, shape[:-1])
        self.v = rng.uniform(-0.5, 0.5, shape[:-1])

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, velocities and accelerations, each (N, C-1, 2)."""
        w, f, a = self.rate, self.phase, self.size
        u = np.sum(a * np.sin(w * t + f), axis=-1)
        v = self.v + np.sum(a / w * (np.cos(f) - np.cos(w * t + f)), axis=-1)
        p = (
            self.p
            + self.v * t
            + np.sum(a / w * (t * np.cos(f) - (np.sin(w * t + f) - np.sin(f)) / w), axis=-1)
        )
        return p, v, u


def test_in_continuous_time_no_distance_falls_below_0_wherever_its_own_hypotheses_hold(long):
    """Double integrators, steps of a Runge-Kutta method that is exact to some 1e-7 m."""
    worlds, h, end_s = (2_000, 0.0025, 10.0) if long else (150, 0.005, 6.0)
    law, around = LAW, Neighbours(worlds, 2, LAW.a_j_mps2)

    def seen(t: float, x: np.ndarray) -> Sensed:
        p_j, v_j, u_j = around.at(t)
        return Sensed(x[:, :2], x[:, 2:], p_j, v_j, u_j[:, 0])

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[:, 2:], law.decide(seen(t, x), {}, 0.0).u], axis=1)

    x, t = np.zeros((worlds, 4)), 0.0
    first = law.decide(seen(t, x), {}, 0.0).signals["psi_mps"]
    start = np.all(first >= 0, axis=1) & np.all(geometry(law, seen(t, x)).d > 0, axis=1)
    holds, least = start, np.full(worlds, np.inf)
    while t < end_s:
        now = seen(t, x)
        least = np.minimum(least, geometry(law, now).d.min(axis=1))
        holds = holds & (law.decide(now, {}, 0.0).signals["qp_feasible"] == 1)
        k_1 = rate(t, x)
        k_2 = rate(t + h / 2, x + h / 2 * k_1)
        k_3 = rate(t + h / 2, x + h / 2 * k_2)
        k_4 = rate(t + h, x + h * k_3)
        x, t = x + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4), t + h
    assert holds.sum() > (1_000 if long else 50)
    assert np.mean(least[holds] < 0.3) > 0.1
    assert least[holds].min() > 0
    assert least[~start].min() < 0
