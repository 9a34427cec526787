"""What can be derived from the paper with a pencil, seen in the package."""

from math import exp, pi

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from mjmerge import load, simulate
from mjmerge.law import OpinionDynamics, Sensed
from mjmerge.law.opinion_dynamics.barrier import barrier
from mjmerge.law.opinion_dynamics.law import decide
from mjmerge.law.opinion_dynamics.opinion import rates
from mjmerge.scenario.cars import data_sheet

LAW = OpinionDynamics(r_rho_m=-1.206, r_eta_m=1.457)


# One dimension, no PD: d'' = -k_o d'/d, so d' + k_o ln d keeps its value.


def head_on(v_0, k_o=1.0, d_0=0.6):
    """The ego runs at a resting Vehicle 1 from d_0; Vehicle 2 is nowhere near. Smallest d_1, largest u."""
    nowhere = 1e9
    scenario = load(
        "paper",
        [
            f"initial={{ego: {{front_m: [{-(d_0 + 0.6)}, 0.0], speed_mps: {v_0}}},"
            f" vehicle_1: {{front_m: [0.0, 0.0], speed_mps: 0.0}},"
            f" vehicle_2: {{front_m: [{-nowhere}, 0.0], speed_mps: 0.0}}}}",
            "drivers.vehicle_1.speed_mps=0",
            f"drivers.vehicle_2={{kind: gap, gap_m: {nowhere}}}",
            f"law={{k_p: 0, k_v: 0, k_o: {k_o}, r_rho_m: -1.2, r_eta_m: 0.0}}",
            "duration_s=6",
            "control_step_s=0.002",
        ],
    )
    trace = simulate(scenario, "double_integrator", continuous=True)
    assert not trace.stops
    return trace.min_distance_m[0, 0], np.abs(trace.u_mps2[0, :, 0]).max()


@pytest.mark.parametrize(("v_0", "k_o"), [(0.5, 1.0), (1.5, 1.0), (3.0, 1.0), (1.5, 2.0)])
def test_head_on_the_ego_stops_at_d_0_exp_of_minus_v_0_over_k_o_and_asks_no_more_than_its_peak(v_0, k_o):
    d_0 = 0.6
    least, most = head_on(v_0, k_o, d_0)
    assert least == pytest.approx(d_0 * exp(-v_0 / k_o), rel=1e-6)
    peak = k_o**2 / d_0 * exp(v_0 / k_o - 1) if v_0 > k_o else k_o * v_0 / d_0
    assert most == pytest.approx(peak, rel=1e-3)


def test_the_published_peak_demand_at_3_metres_a_second():
    assert head_on(3.0)[1] == pytest.approx(12.3, abs=0.05)


def test_the_lemma_of_the_appendix_holds_whatever_bounded_force_pushes():
    """d'' = -k_o d'/d - alpha(t): d > 0 for ever, and d' + k_o ln d + int alpha keeps its value."""
    rng = np.random.default_rng(0)
    g, away = np.array([[[1.0, 0.0], [0.0, 1.0]]]), np.array([1.0, 0.0])
    for _ in range(10):
        law = LAW.model_copy(update={"k_o": rng.uniform(0.3, 3)})
        a, w, f = rng.uniform(-1.5, 1.5, 4), rng.uniform(0.2, 6, 4), rng.uniform(0, 2 * pi, 4)
        bias, end = rng.uniform(-0.2, 0.6), 6.0

        def alpha(t, a=a, w=w, f=f, bias=bias):
            return bias + np.sum(a * np.sin(w * t + f))

        def work(t, a=a, w=w, f=f, bias=bias):
            return bias * t - np.sum(a / w * (np.cos(w * t + f) - np.cos(f)))

        def rate(t, x, law=law, alpha=alpha):
            u_c = barrier(law, g, np.array([[x[0], 1.0]]), np.array([[x[1], 0.0]]))[0]
            return [x[1], u_c @ away - alpha(t)]

        d_0, v_0 = rng.uniform(0.2, 1.5), rng.uniform(-1.5, 1.5)
        solved = solve_ivp(rate, (0, end), [d_0, v_0], method="Radau", rtol=1e-8, atol=1e-11)
        d, v = solved.y
        assert solved.success
        assert (d > 0).all()
        kept = v + law.k_o * np.log(d) + [work(t) for t in solved.t]
        assert kept == pytest.approx(v_0 + law.k_o * np.log(d_0), abs=1e-5)
        assert np.abs(v / d).max() < 1e4  # phi stays bounded


def test_delay_makes_the_barrier_oscillate_below_2_k_o_tau_over_pi():
    """At distance d from a car, a nudge seen tau late grows if d is below the bound, and decays above it.

    The nudge is so small that d stays; v' = -k_o v(t - tau)/d.
    """
    tau, n = 0.1, 400
    critical = 2 * LAW.k_o * tau / pi
    d = np.array([[0.9 * critical, 9.0], [1.1 * critical, 9.0]])  # two runs, each beside one car
    g = np.tile([[[1.0, 0.0], [0.0, 1.0]]], (2, 1, 1))
    past = [np.full(2, 1e-9)] * (n + 1)
    for _ in range(40 * n):
        seen = np.stack([past[-n - 1], np.zeros(2)], axis=1)
        halfway = (seen + np.stack([past[-n], np.zeros(2)], axis=1)) / 2
        past.append(past[-1] + tau / n * barrier(LAW, g, d, halfway)[:, 0])
    v = np.array(past)
    periods = 8 * n  # two periods of 4 tau
    early, late = (np.abs(part).max(axis=0) for part in (v[2 * periods : 3 * periods], v[-periods:]))
    assert late[0] > 1.5 * early[0]
    assert late[1] < early[1] / 1.5
    assert np.count_nonzero(np.diff(np.sign(v[-periods:, 0]))) == 4  # at the bound the period is 4 tau


def dead_time_limit_s(scenario):
    """The dead time at which a kinematic bicycle behind its inverse starts to weave, without a barrier.

    Across the road, for small angles and a = v/L, the front axle obeys v delta' = y'' - a v delta, and a
    command that is tau late makes delta'(t) = (u/v - a delta)(t - tau), u = -k_p y - k_v y'. So
    s^3 + e^(-tau s) (a s^2 + (s + a)(k_v s + k_p)) = 0, whose first root on the imaginary axis is looked for.
    """
    law, v = scenario.law, scenario.initial.ego.speed_mps
    a = v / data_sheet(scenario.models.ego).wheelbase_m

    def late(s):
        return a * s * s + (s + a) * (law.k_v * s + law.k_p)

    w = brentq(lambda w: abs(late(1j * w)) - w**3, a, 4 * a)
    return (-np.angle(-((1j * w) ** 3) / late(1j * w))) % (2 * pi) / w


@pytest.mark.parametrize(("name", "duration_s"), [("paper", 12), ("highway", 30)])
def test_a_late_bicycle_inverse_weaves_from_where_its_characteristic_equation_says(name, duration_s):
    scenario = load(name)
    limit_s = dead_time_limit_s(scenario) - scenario.control_step_s / 2  # a held command is late by that
    early, end = {}, {}
    for part in (0.95, 1.0, 1.05):
        late = [f"mismatch.command_delay_s={part * limit_s}", "law.k_o=0", f"duration_s={duration_s}"]
        trace = simulate(load(name, late), "bicycle")
        steer = trace.steer_rad[0, :, 0]
        early[part], end[part] = (np.ptp(steer[int(at * len(steer)) :][:150]) for at in (0.5, 0.85))
    assert end[1.0] == pytest.approx(early[1.0], rel=0.2)
    assert end[0.95] < end[1.0] / 10
    assert np.isnan(end[1.05])  # it ran away


# The closed loop beside neighbours at rest, in the leader's frame: x = p, v, z, mu.


def closed_loop(law, gap_m, x):
    """x' of the whole loop, (6,)."""
    still = np.zeros((1, 2))
    sensed = Sensed(
        x[None, :2], x[None, 2:4], np.array([[[0.0, 0.0], [-gap_m, 0.0]]]), np.zeros((1, 2, 2)), still
    )
    z, mu = x[4:5], x[5:6]
    made = decide(law, sensed, z)
    growth, mu_rate = rates(law, z, mu, made.mu_input)
    return np.concatenate([x[2:4], made.u[0], z * growth, mu_rate])


def equilibrium(law, gap_m, branch):
    """Where the loop rests: z* = 0 (branch a) or z* = mu* (branch b), found from e_1*(z*) and mu*(e_1*)."""
    x = np.array([law.r_rho_m, law.r_eta_m if branch == "a" else 0.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(50):
        x[5] += closed_loop(law, gap_m, x)[5] / law.k_mu
        x[4] = x[5] if branch == "b" else 0.0
        x[1] = (1 - np.tanh(law.k_w * x[4])) * law.r_eta_m
    return x


def jacobian(f, x, h=1e-6):
    return np.stack([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(len(x))], axis=1)


def gains(seed):
    """The paper's gains, then random ones: k_w large and eps small, as the lemma asks."""
    if seed == 0:
        return LAW
    rng = np.random.default_rng(seed)
    return LAW.model_copy(
        update={
            "k_p": rng.uniform(0.1, 5),
            "k_v": rng.uniform(0.2, 5),
            "k_o": rng.uniform(0.05, 5),
            "k_w": rng.uniform(20, 200),
            "k_mu": rng.uniform(0.5, 10),
            "k": rng.uniform(5, 50),
            "eps": 10 ** rng.uniform(-3, -1),
            "eps_1": rng.uniform(0.2, 2),
            "r_eta_m": rng.uniform(1, 3),
        }
    )


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize(("branch", "gap_m"), [("a", 1.7), ("b", 2.412)])
def test_both_branches_rest_at_their_target_and_are_stable(seed, branch, gap_m):
    law = gains(seed)
    x = equilibrium(law, gap_m, branch)

    def f(state):
        return closed_loop(law, gap_m, state)

    assert f(x) == pytest.approx(0, abs=1e-9)
    assert (x[5] > 0) == (branch == "b")
    eigenvalues = np.linalg.eigvals(jacobian(f, x))
    assert eigenvalues.real.max() < -1e-3


@pytest.mark.parametrize("gap_m", [1.7, 2.412])
def test_the_other_branch_is_unstable(gap_m):
    x = equilibrium(LAW, gap_m, "a")
    x[4] = min(x[5], 0.0)  # z = mu < 0, or z = 0 < mu
    growth = jacobian(lambda state: closed_loop(LAW, gap_m, state), x)[4, 4]
    assert growth > 0


# The proof's Lyapunov function L = k_p/2 |e_1 - e_1*|^2 + |nu_1|^2/2, with v_21 = 0 and z frozen on a branch.


def unforced(law, gap_m, z, x):
    """(e_1, nu_1)' with z frozen, L, and what the law made of it."""
    sensed = Sensed(
        x[None, :2],
        x[None, 2:],
        np.array([[[0.0, 0.0], [-gap_m, 0.0]]]),
        np.zeros((1, 2, 2)),
        np.zeros((1, 2)),
    )
    made = decide(law, sensed, np.array([z]))
    off = x[:2] - made.e_1_star[0]
    return np.concatenate([x[2:], made.u[0]]), law.k_p / 2 * off @ off + x[2:] @ x[2:] / 2, made


@given(st.integers(0, 10_000), st.sampled_from([0.0, 1.0]), st.tuples(*(st.floats(-2, 2),) * 4))
def test_the_lyapunov_function_falls_at_the_rate_of_the_proof(seed, z, x):
    law, x = gains(seed), np.array(x)
    assume(min(np.hypot(x[0], x[1]), np.hypot(x[0] + 2.4, x[1])) > law.r_m + 1e-3)
    rate, _, made = unforced(law, 2.4, z, x)
    fall = law.k_p * (x[:2] - made.e_1_star[0]) @ rate[:2] + x[2:] @ rate[2:]
    proof = -law.k_v * x[2:] @ x[2:] - law.k_o * np.sum(made.geometry.d_dot**2 / made.geometry.d)
    assert fall == pytest.approx(proof, rel=1e-9, abs=1e-9)
    assert fall <= 1e-12


@pytest.mark.parametrize("z", [0.0, 1.0])
def test_it_never_rises_along_a_run(z):
    rng = np.random.default_rng(1)
    for seed in range(8):
        law = gains(seed)
        start = np.array([rng.uniform(-3, 1), rng.uniform(0.8, 2), rng.uniform(-1, 1), rng.uniform(-1, 1)])

        def rate(t, x, law=law):
            return unforced(law, 2.412, z, x)[0]

        solved = solve_ivp(rate, (0, 8), start, method="LSODA", rtol=1e-9, atol=1e-11)
        L = np.array([unforced(law, 2.412, z, x)[1] for x in solved.y.T])
        assert solved.success
        assert (np.diff(L) <= 1e-9).all()
        assert L[-1] < L[0]


@pytest.mark.parametrize("z_0", [0.0, 1e-300, 1e-3, 0.15, 3.0])
def test_an_opinion_that_is_not_negative_stays_so(z_0):
    scenario = load("flips", [f"initial.z={z_0}", "duration_s=4", "initial.mu=-1"])
    for continuous in (False, True):
        z = simulate(scenario, "double_integrator", seed=3, continuous=continuous).opinion
        assert (z >= 0).all()
        assert (z[0, -1] > 0) == (z_0 > 0)


@pytest.mark.parametrize("plant", ["double_integrator", "bicycle"])
def test_the_discrete_plants_converge_to_the_continuous_ones_at_first_order(plant):
    steps_s = [0.02, 0.01, 0.005]
    exact = simulate(load("charge", ["duration_s=6", "control_step_s=0.02"]), plant, continuous=True)
    errors = []
    for h in steps_s:
        trace = simulate(load("charge", ["duration_s=6", f"control_step_s={h}"]), plant)
        every = round(0.02 / h)
        errors.append(
            [
                np.abs(getattr(trace, name)[0, ::every] - getattr(exact, name)[0]).max()
                for name in ("front_m", "velocity_mps", "opinion", "mu")
            ]
        )
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx(1.0, abs=0.15)
