"""Model predictive control: at every tick the best plan over a horizon, by a quadratic programme.

The front axle is a double integrator in the leader's frame. With e = p - p_1 - rho r^rho, nu = v - v_1 and
w = u - u_1, which is constant over each of K steps of dt, the plan

    minimises   sum_k q_p |e_k|^2 + q_v |nu_k|^2 + |w_k|^2 + q_c |w_k - w_(k-1)|^2 / dt^2 + the rest after K
    subject to  g_j . (p_k - p_jk) >= r + margin for all j and k = 1..K, and u_k within u_max in x and in y;

its first u is the command.

Published: predictive control of a point mass in traffic, with linear constraints that keep it clear of the
others (Nilsson, Gao, Carvalho and Borrelli, IFAC World Congress 2014). Of double integrators, by a quadratic
programme in the accelerations alone, with costs of the way that is left, of w and of its change, and with
|p - p_j| >= r linearised to half-planes, relaxed where need be: Luis and Schoellig (RA-L 2019, p. 375).

Ours:

* g_j is the present direction from the neighbour to the ego, at all k. They linearise about the last plan,
  which would have to be remembered. The half-plane lies outside the disc: a plan that keeps to it keeps
  d_j >= margin at its steps if the others move as predicted. Nothing is asked between steps or after K.
* Neighbours keep their velocity; the leader first keeps the acceleration that it tells, for ``told_s``.
* The rest after K is the least there is in continuous time, forever and past nobody. q_p and q_v are by
  default k_p^2 and k_v^2 - 2 k_p, for which -k_p e - k_v nu is the best w: where nothing is in the way the
  law is the tracking of the others, but for q_c and the length of a step.
* dt does not follow the control step: the law is the same in continuous time.
* Half-planes are hard (theirs are soft). Only where nothing meets all constraints they may be violated, at a
  cost of the square, each in daqp's measure: what it costs w to undo it. So the near ones are kept best.
  Where there is no plan even then, it brakes relative to the leader, w = -k_v nu.

It promises nothing: nothing says that there is a plan at the next tick where there is one now, nor that the
others keep their velocity. Whether there was one is recorded, and so is every exit flag of daqp.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from importlib import import_module
from math import sqrt
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field

from mjmerge.config.frozen import NonNegative, Positive
from mjmerge.config.units import Unit
from mjmerge.errors import MjmergeError
from mjmerge.law.base import Decision, Memory, Signal, lacking
from mjmerge.law.nominal import Tracking
from mjmerge.law.sensed import Sensed, geometry
from mjmerge.state import Array, Mask, dot

NOT_ASKED, OPTIMAL, SOFT_OPTIMAL = 0, 1, 2
"""Exit flags: where daqp was not asked, and its own of success; those of failure are negative."""
_TOLERANCE = 1e-9  # of constraints, in daqp's measure
_SOFT, _CHEAP = 8, 1e-4  # daqp: a constraint that may be violated; what undoing costs, against bearing it
_LARGEST = 1e100  # magnitudes from here on are not finite to us


class Mpc(Tracking):
    """Model predictive control: the best plan past half-planes around the neighbours, anew at every tick."""

    guard: ClassVar[str] = "collision avoidance"
    gives: ClassVar[tuple[str, ...]] = ("target_m", "u_n_mps2", "u_c_mps2")
    needs: ClassVar[Mapping[str, str]] = {"daqp": "laws"}

    kind: Literal["mpc"] = "mpc"
    horizon_s: Positive = 2.0
    """How far the plan goes, s."""
    steps: Annotated[int, Field(ge=2, le=100)] = 20
    """Steps K of the plan, equally long."""
    q_p: Annotated[NonNegative | None, Unit(0, -4)] = None
    """Weight of the squared deviation from the target, 1/s^4, that of u being 1; null: k_p^2."""
    q_v: Annotated[NonNegative | None, Unit(0, -2)] = None
    """Weight of the squared velocity relative to the leader, 1/s^2; null: k_v^2 - 2 k_p."""
    q_c: Annotated[NonNegative, Unit(0, 2)] = 0.01
    """Weight of the squared rate of u along the plan, s^2."""
    u_max_mps2: Positive | None = 8.0
    """Most of each component of u, m/s^2; null: no bound."""
    margin_m: NonNegative = 0.05
    """Least d_j along the plan, m."""
    told_s: NonNegative = 0.5
    """How long the leader is taken to go on with the acceleration that it tells, s."""
    guarded: bool = True
    """Whether the half-planes are there; without, it plans as if alone with the leader's lane."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Gains that are the best for no weights."""
        if self.q_v is None and self.k_v**2 < 2 * self.k_p:
            least = sqrt(2 * self.k_p)
            yield (
                "k_v",
                f"must be at least sqrt(2 k_p) = {least:.4g}, or q_v = k_v^2 - 2 k_p is no weight; give q_v",
            )

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Whether there was a plan, how far it comes into the margin, and every exit flag."""
        flag = "daqp's exit flag: 1 optimal, negative none, 0 not asked"
        return (
            Signal("qp_feasible", "1 where a plan meets all constraints", asks="a plan meets all of it"),
            Signal("qp_status", f"{flag}, because the plan past nobody is clear"),
            Signal("soft_status", f"{flag}; of soft half-planes, 2 where one is violated"),
            Signal("free_status", f"{flag}, because no bound is reached; of the plan past nobody"),
            Signal("slack_m", "how far the plan comes into the margins; NaN where there is none", "s"),
        )

    @property
    def model(self) -> Model:
        """What of the programme follows from the keys."""
        q_p = self.k_p**2 if self.q_p is None else self.q_p
        q_v = max(self.k_v**2 - 2 * self.k_p, 0.0) if self.q_v is None else self.q_v
        return _model(self.horizon_s / self.steps, self.steps, q_p, q_v, self.q_c, self.told_s)

    def programme(self, seen: Sensed) -> Programme:
        """The programmes of all simulations."""
        one, near = self.model, geometry(self, seen)
        e = (seen.p - self._target(seen)) / one.dt**2
        nu = (seen.v - seen.v_j[:, self.j_1]) / one.dt
        told, most = one.told[:, None] * seen.u_1[:, None], self.u_max_mps2 or np.inf
        pushed = dot(near.g, seen.u_1[:, None])
        pushed[:, self.j_1] = 0.0  # the leader's frame moves with it
        short, closing = (self.margin_m - near.d) / one.dt**2, near.d_dot / one.dt
        k = np.arange(1.0, self.steps + 1)
        b = short[..., None] - k * closing[..., None] - one.carried * pushed[..., None]
        return Programme(one, e, nu, lower=-most - told, upper=most - told, g=near.g, b=b)

    def _target(self, seen: Sensed) -> Array:
        """Where the ego is to be, m, (N, 2)."""
        target: Array = seen.p_j[:, self.j_1] + np.array([self.r_rho_m, 0.0])
        return target

    def decide(self, seen: Sensed, memory: Memory, step_s: float) -> Decision:
        """The first step of the best plan."""
        del memory, step_s
        runs, programme = len(seen.p), self.programme(seen)
        free, within, clear, sound = programme.free()
        w_n, w, met = free[:, 0].copy(), free[:, 0].copy(), sound.copy()
        slack_m, flags = np.where(sound, 0.0, np.nan), np.full((3, runs), float(NOT_ASKED))
        easy = within & clear if self.guarded else within
        for i in np.flatnonzero(sound & ~easy).tolist():
            alone = programme.alone(i)
            found = alone.first(free[i] if within[i] else None, guarded=self.guarded)
            w_n[i] = alone.brake() if found.w_n is None else found.w_n
            w[i] = alone.brake() if found.w is None else found.w
            slack_m[i], flags[:, i], met[i] = found.slack * self.model.dt**2, found.flags, found.met
        most, told = self.u_max_mps2 or np.inf, self.model.told[0] * seen.u_1
        u_n, u = (np.clip(first + told, -most, most) for first in (w_n, w))
        return Decision(
            u,
            {
                "target_m": self._target(seen),
                "u_n_mps2": u_n,
                "u_c_mps2": u - u_n,
                "qp_feasible": met.astype(np.float64),
                "qp_status": flags[0],
                "soft_status": flags[1],
                "free_status": flags[2],
                "slack_m": slack_m,
            },
        )

    def unguarded(self) -> Self:
        """Without the half-planes."""
        return self.model_copy(update={"guarded": False}) if self.guarded else self


class Model(NamedTuple):
    """The programme in steps of dt: e in dt^2, nu in dt, and so everything in m/s^2; x and y alike.

    With w_0..w_(K-1) of an axis, e_k = e + k nu + (reach w)_k and the cost is w' H w / 2 + (pull (e, nu))' w.

    Attributes:
        dt: length of a step, s.
        k_v: what the tracking that it is without constraints has, 1/s.
        hessian: H of both axes, (2K, 2K).
        pull: (K, 2).
        plan: the best w without constraints, by e and nu, (K, 2).
        reach: how far w takes e at the end of each step, (K, K).
        reached: that by the plan, (K, 2).
        told: how much of each step the leader's acceleration lasts, (K,).
        carried: how far that takes the leader, (K,).
    """

    dt: float
    k_v: float
    hessian: Array
    pull: Array
    plan: Array
    reach: Array
    reached: Array
    told: Array
    carried: Array


@lru_cache(maxsize=64)
def _model(dt: float, steps: int, q_p: float, q_v: float, q_c: float, told_s: float) -> Model:
    k, i = np.arange(1, steps + 1)[:, None], np.arange(steps)
    reach, speed = np.where(i < k, k - i - 0.5, 0.0), np.where(i < k, 1.0, 0.0)
    free_e, free_nu = np.hstack([np.ones_like(k), k]), np.hstack([np.zeros_like(k), np.ones_like(k)])
    k_p = sqrt(q_p)
    k_v = sqrt(q_v + 2 * k_p)
    q_e, q_nu, q_both = np.full(steps, q_p * dt**4), np.full(steps, q_v * dt**2), np.zeros(steps)
    q_e[-1] += k_p * k_v * dt**3
    q_nu[-1] += k_v * dt
    q_both[-1] += k_p * dt**2
    by_e = reach.T * q_e + speed.T * q_both
    by_nu = speed.T * q_nu + reach.T * q_both
    change = np.diff(np.eye(steps), axis=0)
    axis = 2 * (by_e @ reach + by_nu @ speed + np.eye(steps) + q_c / dt**2 * change.T @ change)
    axis = (axis + axis.T) / 2
    pull = 2 * (by_e @ free_e + by_nu @ free_nu)
    plan = -np.linalg.solve(axis, pull)
    told = np.clip(told_s / dt - i, 0.0, 1.0)
    none = np.zeros_like(axis)
    hessian = np.block([[axis, none], [none, axis]])
    return Model(dt, k_v, hessian, pull, plan, reach, reach @ plan, told, reach @ told)


def _linear(by: Array, e: Array, nu: Array) -> Array:
    """What is linear in e and nu, (N, 2) each, by their coefficients (K, 2): (N, K, 2)."""
    return by[:, :1] * e[:, None] + by[:, 1:] * nu[:, None]


class First(NamedTuple):
    """What comes of a programme.

    Attributes:
        w_n: first w of the plan past nobody, (2,); ``None`` where there is none.
        w: first w of the plan, (2,); ``None`` where there is none.
        flags: exit flags with half-planes, with soft ones, and past nobody.
        slack: how far the plan comes into a margin, m/s^2.
        met: whether the plan meets all constraints.
    """

    w_n: Array | None
    w: Array | None
    flags: tuple[int, int, int]
    slack: float
    met: bool


class Programme(NamedTuple):
    """Minimise w' H w / 2 + (pull (e, nu))' w within bounds, with g_j . (reach w)_k >= b_jk; all in m/s^2.

    Attributes:
        model: what of it follows from the keys.
        e: deviation from the target, (N, 2).
        nu: velocity relative to the leader, (N, 2).
        lower: least w, (N, K, 2).
        upper: most w, (N, K, 2).
        g: normals g_j, (N, C-1, 2).
        b: bounds b_jk, (N, C-1, K).
    """

    model: Model
    e: Array
    nu: Array
    lower: Array
    upper: Array
    g: Array
    b: Array

    def free(self) -> tuple[Array, Mask, Mask, Mask]:
        """The plans without constraints, (N, K, 2); if within bounds, past half-planes, finite, (N,) each."""
        w, way = _linear(self.model.plan, self.e, self.nu), _linear(self.model.reached, self.e, self.nu)
        within = np.all((w >= self.lower) & (w <= self.upper), axis=(1, 2))
        clear = np.all(dot(self.g[:, :, None], way[:, None]) >= self.b, axis=(1, 2))
        sound = np.all(np.isfinite(self.b), axis=(1, 2)) & np.all(np.abs(w) < _LARGEST, axis=(1, 2))
        return w, within, clear, sound

    def alone(self, run: int) -> Programme:
        """That of one simulation, without the axis N."""
        return Programme(self.model, *(values[run] for values in self[1:]))

    def brake(self) -> Array:
        """W that slows down relative to the leader, (2,), of one simulation."""
        return np.clip(-self.model.k_v * self.model.dt * self.nu, self.lower[0], self.upper[0])

    def first(self, free: Array | None, *, guarded: bool) -> First:
        """Solves what has to be, of one simulation.

        Args:
            free: the plan without constraints where it is within its bounds, (K, 2).
            guarded: whether the half-planes are there.
        """
        hard = soft = past = NOT_ASKED
        w, slack = free, 0.0
        if w is None:
            w, past = self.solve()
        w_n = None if w is None else w[0]
        if guarded and self.short(w) > 0:
            w, hard = self.solve(half_planes=True)
            if w is None:
                w, soft = self.solve(half_planes=True, soft=True)
                slack = max(self.short(w), 0.0)
        if w is None:
            return First(w_n, None, (hard, soft, past), np.nan, met=False)
        return First(w_n, w[0], (hard, soft, past), slack, met=soft == NOT_ASKED)

    def short(self, w: Array | None) -> float:
        """How much a plan, (K, 2), lacks of its half-planes at most, m/s^2; all, if there is none."""
        if w is None:
            return np.inf
        return float((self.b - dot(self.g[:, None], (self.model.reach @ w)[None])).max())

    def normals(self) -> Array:
        """The half-planes' as rows of all w, first x, then y: ((C-1) K, 2K), of one simulation."""
        rows = self.g[:, None, :, None] * self.model.reach[:, None]
        return rows.reshape(self.b.size, 2 * len(self.lower))

    def solve(self, *, half_planes: bool = False, soft: bool = False) -> tuple[Array | None, int]:
        """The plan of one simulation, (K, 2), ``None`` where there is none, and daqp's exit flag."""
        steps = len(self.lower)
        bounds = 2 * steps if np.isfinite(self.lower).all() else 0
        rows = self.b.size if half_planes else 0
        x, _, flag, _ = _daqp().solve(
            self.model.hessian,
            _linear(self.model.pull, self.e[None], self.nu[None])[0].T.ravel(),
            self.normals()[:rows],
            np.concatenate([self.upper.T.ravel()[:bounds], np.full(rows, np.inf)]),
            np.concatenate([self.lower.T.ravel()[:bounds], self.b.ravel()[:rows]]),
            np.repeat(np.array([0, _SOFT * soft], dtype=np.intc), [bounds, rows]),
            primal_tol=_TOLERANCE,
            rho_soft=_CHEAP,
        )
        found = flag in (OPTIMAL, SOFT_OPTIMAL) and bool(np.isfinite(x).all())
        return np.asarray(x).reshape(2, steps).T if found else None, int(flag)


def _daqp() -> Any:
    """The solver, which is only there with an extra.

    Raises:
        MjmergeError: it is not.
    """
    for message in lacking(Mpc):
        raise MjmergeError(message)
    return import_module("daqp")
