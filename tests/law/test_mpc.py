"""The plan of the MPC is the best one, by other means; what it cannot meet is on record."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize, nnls

from mjmerge import judge, load, simulate
from mjmerge.errors import MjmergeError, ScenarioError
from mjmerge.law import Sensed, mpc
from mjmerge.law.mpc import Mpc
from mjmerge.law.nominal import Nominal
from mjmerge.verdict.metrics import merged_at_s

LAW = Mpc(r_rho_m=-1.2)
SOFTNESS = 1e-4


def seen(runs: int, neighbours: int = 2, seed: int = 0, wild_mps: float = 0.7) -> Sensed:
    """An ego somewhere beside or in a gap."""
    rng = np.random.default_rng(seed)
    p = rng.uniform([-2.2, -0.3], [0.2, 1.6], (runs, 2))
    p_j = rng.uniform(-0.2, 0.2, (runs, neighbours, 2)) - np.arange(neighbours)[:, None] * [2.2, 0.0]
    v, v_j = (
        np.array([2.0, 0.0]) + rng.uniform(-wild_mps, wild_mps, (runs, *of, 2)) for of in ((), (neighbours,))
    )
    return Sensed(p, v, p_j, v_j, rng.uniform(-2, 2, (runs, 2)))


def row(s: Sensed, k: int) -> Sensed:
    return Sensed(**{name: values[k : k + 1] for name, values in vars(s).items()})


class Rolled:
    """The plan of one simulation in the road frame, in SI units, step by step as the page has it."""

    def __init__(self, law: Mpc, s: Sensed) -> None:
        self.law, self.s, self.dt = law, s, law.horizon_s / law.steps

    def u_1(self, k: int) -> np.ndarray:
        return self.s.u_1[0] * min(max(self.law.told_s / self.dt - k, 0.0), 1.0)

    def states(self, u):
        """After each step: p, v of the ego and p_j, v_j of all."""
        h, p, v, p_j, v_j = self.dt, self.s.p[0], self.s.v[0], self.s.p_j[0].copy(), self.s.v_j[0].copy()
        for k in range(self.law.steps):
            a_j = np.zeros(p_j.shape)
            a_j[0] = self.u_1(k)
            p, v = p + h * v + h * h / 2 * u[k], v + h * u[k]
            p_j, v_j = p_j + h * v_j + h * h / 2 * a_j, v_j + h * a_j
            yield p, v, p_j, v_j

    def cost(self, x: np.ndarray) -> float:
        law, u = self.law, x.reshape(-1, 2)
        q_p, q_v = law.k_p**2, law.k_v**2 - 2 * law.k_p
        w = np.array([u[k] - self.u_1(k) for k in range(law.steps)])
        total = np.sum(w**2) + law.q_c * np.sum((w[1:] - w[:-1]) ** 2) / self.dt**2
        for p, v, p_j, v_j in self.states(u):
            e, nu = p - p_j[0] - [law.r_rho_m, 0.0], v - v_j[0]
            total += q_p * e @ e + q_v * nu @ nu
        return total + (law.k_p * law.k_v * e @ e + 2 * law.k_p * e @ nu + law.k_v * nu @ nu) / self.dt

    def room(self, x: np.ndarray) -> np.ndarray:
        """What is left of every half-plane, m."""
        away = self.s.p[0] - self.s.p_j[0]
        g = away / np.linalg.norm(away, axis=1)[:, None]
        found = [np.sum(g * (p - p_j), axis=1) for p, _, p_j, _ in self.states(x.reshape(-1, 2))]
        return np.concatenate(found) - self.law.r_m - self.law.margin_m


def test_its_first_step_is_that_of_the_best_plan_as_another_solver_and_another_model_find_it():
    law = LAW.model_copy(update={"horizon_s": 1.2, "steps": 4, "u_max_mps2": 4.0})
    s = seen(60, seed=3, wild_mps=3)
    made = law.decide(s, {}, 0.01)
    bound = np.flatnonzero(made.signals["qp_status"] == mpc.OPTIMAL)
    assert len(bound) > 10
    for k in bound[:8]:
        alone = Rolled(law, row(s, k))
        rows = np.stack([alone.room(x) - alone.room(np.zeros(8)) for x in np.eye(8)], axis=1)
        found = minimize(
            alone.cost,
            np.zeros(8),
            jac="3-point",
            method="SLSQP",
            bounds=[(-4.0, 4.0)] * 8,
            constraints={"type": "ineq", "fun": alone.room, "jac": lambda _, rows=rows: rows},
            options={"ftol": 1e-13, "maxiter": 200},
        )
        assert made.u[k] == pytest.approx(found.x[:2], abs=5e-6)
    past = law.unguarded().decide(s, {}, 0.01)
    assert np.array_equal(past.u, made.signals["u_n_mps2"])
    assert (past.signals["free_status"] == mpc.OPTIMAL).any()
    for k in range(4):
        cost, within = Rolled(law, row(s, k)).cost, [(-4.0, 4.0)] * 8
        free = minimize(cost, np.zeros(8), jac="3-point", method="SLSQP", bounds=within, tol=1e-13)
        assert past.u[k] == pytest.approx(free.x[:2], abs=5e-6)


def plans(law: Mpc, s: Sensed, *, soft: bool):
    """Programmes and plans of the simulations whose plan is asked with hard or with soft half-planes."""
    flags = law.decide(s, {}, 0.01).signals["soft_status" if soft else "qp_status"]
    programme = law.programme(s)
    for k in np.flatnonzero(flags == (mpc.SOFT_OPTIMAL if soft else mpc.OPTIMAL)):
        one = programme.alone(k)
        w, _ = one.solve(half_planes=True, soft=soft)
        e_nu = np.stack([one.e, one.nu])
        pull = (one.model.pull @ e_nu).T.ravel()
        yield one, w, one.model.hessian @ w.T.ravel() + pull


@pytest.mark.parametrize("neighbours", [2, 4])
def test_plans_meet_all_constraints_and_multipliers_prove_them_best(neighbours):
    found = 0
    for one, w, gradient in plans(LAW, seen(120, neighbours, seed=1), soft=False):
        x, lower, upper = w.T.ravel(), one.lower.T.ravel(), one.upper.T.ravel()
        left = one.normals() @ x - one.b.ravel()
        assert left.min() > -1e-6
        assert (x - lower).min() > -1e-7
        assert (upper - x).min() > -1e-7
        box = np.eye(len(x))
        tight = [one.normals()[left < 1e-6], box[x - lower < 1e-6], -box[upper - x < 1e-6]]
        _, rest = nnls(np.concatenate(tight).T, gradient)
        assert rest < 1e-6 * np.linalg.norm(gradient)
        found += 1
    assert found > 30


def test_what_is_soft_is_paid_for_by_what_it_costs_w_to_undo_it():
    """A violation of sigma in that measure pulls with sigma / SOFTNESS, and nothing else does."""
    law, found = LAW.model_copy(update={"u_max_mps2": None, "told_s": 0.0}), 0
    for one, w, gradient in plans(law, seen(1000, 4, seed=2, wild_mps=3), soft=True):
        a, x = one.normals(), w.T.ravel()
        size = np.sqrt(np.sum(a * np.linalg.solve(one.model.hessian, a.T).T, axis=1))
        sigma = np.maximum(one.b.ravel() - a @ x, 0.0) / size
        pull = a.T @ (sigma / size / SOFTNESS)
        assert np.linalg.norm(gradient - pull) < 1e-4 * np.linalg.norm(gradient)
        found += 1
    assert found > 10


def squeezed() -> Sensed:
    """A follower that comes at 3 m/s from 1.4 m behind, the leader 1.4 m ahead."""
    return Sensed(
        p=np.zeros((1, 2)),
        v=np.zeros((1, 2)),
        p_j=np.array([[[1.4, 0.0], [-1.4, 0.0]]]),
        v_j=np.array([[[0.0, 0.0], [3.0, 0.0]]]),
        u_1=np.zeros((1, 2)),
    )


def test_half_planes_that_leave_no_plan_are_told_and_the_near_ones_kept():
    made = LAW.decide(squeezed(), {}, 0.01)
    one = LAW.programme(squeezed()).alone(0)
    assert made.signals["qp_feasible"] == 0
    assert (made.signals["qp_status"], made.signals["soft_status"]) == (-1, mpc.SOFT_OPTIMAL)
    w, _ = one.solve(half_planes=True, soft=True)
    late = (one.b - np.sum(one.g[:, None] * (one.model.reach @ w), axis=-1)) * one.model.dt**2
    assert late[:, :3].max() < 1e-3  # of the next 0.3 s, within which it is not yet there
    assert late.max() == pytest.approx(made.signals["slack_m"][0])
    assert made.signals["slack_m"] > 1.0
    (signal,) = (one for one in LAW.signals if one.asks)
    assert signal.name == "qp_feasible"


def test_it_brakes_where_daqp_gives_up_and_says_so(monkeypatch):
    given_up = SimpleNamespace(solve=lambda *_, **__: (np.zeros(40), 0.0, -2, {}))
    monkeypatch.setattr(mpc, "import_module", lambda _: given_up)
    s = seen(60, seed=4)
    made = LAW.decide(s, {}, 0.01)
    failed = made.signals["qp_status"] == -2
    assert 0 < failed.sum() < 60
    assert np.array_equal(failed, made.signals["soft_status"] == -2)
    assert np.array_equal(failed, np.isnan(made.signals["slack_m"]))
    assert np.array_equal(made.signals["qp_feasible"] == 0, failed)
    brake = s.u_1 - LAW.k_v * (s.v - s.v_j[:, 0])
    assert np.allclose(made.u[failed], brake[failed], rtol=0, atol=1e-12)


def test_a_simulation_has_its_bits_alone_in_a_batch_and_after_others():
    s = seen(60, neighbours=3, seed=5)
    law = LAW.model_copy(update={"u_max_mps2": 2.0})
    together = law.decide(s, {}, 0.01)
    asked = {
        name: set(together.signals[name].tolist()) for name in ("qp_status", "soft_status", "free_status")
    }
    assert asked == {"qp_status": {-1, 0, 1}, "soft_status": {0, 2}, "free_status": {0, 1}}
    for k in reversed(range(60)):
        alone = law.decide(row(s, k), {}, 0.0)
        assert alone.u.tobytes() == together.u[k : k + 1].tobytes()
        for name, values in alone.signals.items():
            assert values.tobytes() == together.signals[name][k : k + 1].tobytes()


def test_in_small_steps_and_with_nothing_in_the_way_it_is_the_tracking():
    s = seen(50, seed=6)
    for horizon_s in (0.2, 1.0):
        keys = {"horizon_s": horizon_s, "steps": 100, "q_c": 0.0, "guarded": False, "u_max_mps2": None}
        u = LAW.model_copy(update=keys).decide(s, {}, 0.01).u
        assert np.abs(u - Nominal(r_rho_m=-1.2).decide(s, {}, 0.01).u).max() < 0.04
    with pytest.raises(ScenarioError, match=r"law.k_v: must be at least sqrt\(2 k_p\) = 1.183"):
        load("paper", ["law.kind=mpc", "law.k_v=1.1"])
    weighted = load("paper", ["law.kind=mpc", "law.k_v=1.1", "law.q_p=0.49", "law.q_v=2.6"]).law
    assert np.allclose(weighted.model.plan, LAW.model.plan)


@pytest.mark.parametrize(("name", "duration_s"), [("paper", 12), ("charge", 16), ("highway", 45)])
def test_it_merges_on_the_ideal_plant_because_of_its_half_planes(name, duration_s):
    """``charge`` it leaves, as Vehicle 2 comes at a speed that it believes in, and merges after its end."""
    keys = ["law.kind=mpc", "control_step_s=0.04", f"duration_s={duration_s}"]
    trace = simulate(load(name, keys), "double_integrator")
    (verdict,) = judge(trace)
    assert (verdict.verdict, verdict.needed) == ("held", True)
    assert np.isfinite(merged_at_s(trace)).all()
    assert trace.min_distance_m.min() > 0
    assert trace.signals["qp_feasible"].all()
    assert "without collision avoidance the ideal comes to d_2 = -" in verdict.reason


def test_it_is_the_same_at_another_size():
    keys = ["law.kind=mpc", "duration_s=9", "control_step_s=0.02"]
    small = simulate(load("paper", keys), "double_integrator")
    large = simulate(small.scenario.scaled(9.0), "double_integrator")
    assert (small.signals["qp_status"] == mpc.OPTIMAL).any()
    assert np.allclose(large.front_m, 9.0 * small.front_m, rtol=0, atol=1e-8)
    assert np.array_equal(large.signals["qp_status"], small.signals["qp_status"])


def test_without_daqp_a_line_says_what_to_install_before_anything_runs(monkeypatch):
    scenario = load("paper", ["law.kind=mpc"])
    monkeypatch.setitem(sys.modules, "daqp", None)
    install = r"the law needs daqp: pip install 'mjmerge\[laws\]'$"
    with pytest.raises(ScenarioError, match=f"law.kind: {install}"):
        load("paper", ["law.kind=mpc"])
    with pytest.raises(MjmergeError, match=install):
        simulate(scenario, "double_integrator")
    with pytest.raises(MjmergeError, match=install):
        scenario.law.decide(squeezed(), {}, 0.01)
    assert load("paper", ["law.kind=mpc"], code=False).law == scenario.law  # as where a recording is read
    assert load("paper").law.kind == "opinion_dynamics"
