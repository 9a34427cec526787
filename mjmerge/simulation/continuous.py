"""Continuous time, the paper's own: law, its memory, drivers and an ideal plant as one ODE.

The state x is the plant's, then the coordinates of the law's memory: of the paper's, ln z and mu.
Positions are in a frame that moves at the leader's first
speed, so that the solver's accuracy is relative to the distances between the cars and not to the way they
have come.

Each simulation is integrated by itself with DOP853, anew from every time at which a driver's intention may
jump. Where the equation is stiff (the barrier's rate is k_o/d_j) and its steps become tiny, Radau takes over
for a while. The solution is sampled on the trace's grid and played back as a plant, so that the same loop
fills every column of the trace.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np
from scipy.integrate import DOP853, OdeSolver, Radau
from scipy.optimize import brentq

from mjmerge.config.acts import listed
from mjmerge.drivers import Traffic
from mjmerge.errors import MjmergeError
from mjmerge.law import Flow, Law, Memory, Sensed, decided
from mjmerge.law.sensed import End
from mjmerge.plant import Fault, Plant, Smooth, make
from mjmerge.scenario.ramp import Ramp
from mjmerge.scenario.schema import Scenario
from mjmerge.state import Array, Cars, Controls, Mask, norm
from mjmerge.vehicle.actuation import BelievedCars
from mjmerge.vehicle.bicycle import inverse

RTOL, ATOL = 1e-10, 1e-12
"""Relative and absolute error of one step of the solver, in SI units."""

_LONGEST_STEP_S = 0.2  # between the ends of a longer one, the interpolant is far worse than the step
_TINY_STEP_S = 2e-3  # an average step of less is stiffness
_LOOK_STEPS = 50  # how many steps that average is over
_IMPLICIT_S = 1.0  # how long the implicit method then has the word
_MOST_STEPS = 2_000  # it may take in that time before it gives up
_TOLERANCES = 300  # a distance of so many of the solver's tolerances is the least it can tell from 0
_DECADE = 10.0
_BESIDE_S = 1e-11  # drivers are asked this far inside the stretch between two switches: no side to choose

Rates = Callable[[float, Array], Array]


def resolution_m(law: Law) -> float:
    """The least d_j that the solver can tell from 0, m: some hundreds of its tolerances for a few r."""
    return _TOLERANCES * (ATOL + RTOL * 10 * law.r_m)


def _u(cars: Cars, u: Array, believed: BelievedCars, law: Law) -> Array:
    del cars, believed, law
    return u


def _a_omega(cars: Cars, u: Array, believed: BelievedCars, law: Law) -> Array:
    pose = cars.heading_rad, cars.speed_mps, cars.steer_rad
    return np.stack(inverse(u, *pose, believed.wheelbase_m, law.eps_v_mps), axis=-1)


_COMMANDS = {"double_integrator": _u, "bicycle": _a_omega}
"""What each plant that has a continuous time is told, from the front-axle accelerations u."""


class Equation:
    """One simulation as x' = f(t, x)."""

    def __init__(
        self,
        scenario: Scenario,
        plant: str,
        traffic: Traffic,
        believed: BelievedCars,
        end: End | None = None,
    ) -> None:
        self._law, self._initial, self._end = scenario.law, scenario.initial.opinion, end
        numbers = range(1, len(scenario.roster.cars))
        self.names = (*(f"d_{j}" for j in numbers), *(["d_end"] if end is not None else []))
        self._memory = _flow(scenario.law)
        self._traffic, self._believed, self._command = traffic, believed, _COMMANDS[plant]
        self._plant = cast("Smooth", make(plant, [scenario], None, threads=0))
        self._frame_mps = np.zeros(self._plant.state().shape[1:])
        leader = scenario.starts[1 + scenario.law.j_1]
        self._frame_mps[:, 0] = leader.speed_mps  # every plant's state begins with its x

    def start(self) -> Array:
        """x(0), (K,)."""
        return np.array([*self._plant.state().flat, *self._memory.start(self._initial)])

    def memory(self, x: Array) -> Memory:
        """What the law remembers in x, (T, K) -> each (T, ...)."""
        return self._memory.memory(x[:, self._frame_mps.size :])

    def motion(self, time_s: Array, x: Array) -> Array:
        """The plant's state in x, (T,) and (T, K) -> (T, C, K')."""
        own = x[:, : self._frame_mps.size]
        return own.reshape(-1, *self._frame_mps.shape) + time_s[:, None, None] * self._frame_mps

    def distance_m(self, x: Array) -> Array:
        """Every d_j in x, m, (K,) -> (C-1,); of the end of the lane last, where the law is told of it."""
        seen = self._seen(x)
        d: Array = norm(seen.p - seen.p_j[0]) - self._law.r_m
        return d

    def distance_rate_mps(self, x: Array) -> Array:
        """Their rates in x, m/s, (K,) -> likewise."""
        seen = self._seen(x)
        e, nu = seen.p - seen.p_j[0], seen.v - seen.v_j[0]
        rate: Array = np.sum(e * nu, axis=-1) / norm(e)
        return rate

    def _seen(self, x: Array) -> Sensed:
        """Positions and velocities in x, of one simulation."""
        return Sensed.of(self._cars(0.0, x), np.zeros((1, 2)), self._end)

    def between(self, start_s: float, end_s: float) -> Rates:
        """f, with every driver's intention as it is between these times."""
        law, first, last = self._law, start_s + _BESIDE_S, end_s - _BESIDE_S

        def f(time_s: float, x: Array) -> Array:
            cars = self._cars(time_s, x)
            u_j = self._traffic.intend(cars, min(max(time_s, first), last))
            seen = Sensed.of(cars, u_j[:, law.j_1], self._end)
            decision = decided(law, seen, self.memory(x[None]), 0.0)
            if decision.failed:
                raise _StuckError(decision.failed[0])
            u = np.concatenate([decision.u[:, None], u_j], axis=1)
            motion = self._plant.rate(self._command(cars, u, self._believed, law)) - self._frame_mps
            return np.concatenate([motion.ravel(), self._memory.rates(x[motion.size :], decision)])

        return f

    def _cars(self, time_s: float, x: Array) -> Cars:
        self._plant.put(self.motion(np.array([time_s]), x[None]))
        return self._plant.observe()


@dataclass(frozen=True)
class Solution:
    """One simulation on the trace's grid; NaN from where it ended.

    Attributes:
        motion: the plant's state, (T, C, K).
        memory: what the law remembers, each (T, ...).
        ticks: how many ticks it reached.
        end: why no more, in words; ``None`` if all.
        touched: whether that is d_j reaching 0, as far as the solver can tell.
        crossing: whether it then closed in undiminished.
    """

    motion: Array
    memory: Memory
    ticks: int
    end: str | None
    touched: bool
    crossing: bool


def integrate(
    equation: Equation, law: Law, time_s: Array, switches_s: Array, progress: Callable[[float], None]
) -> Solution:
    """Solves an equation up to the last tick, to d_j = 0 if the barrier is singular there, or until stuck.

    Short of d_j = 0 there is a distance that the solver cannot tell from it, and there it ends. A barrier
    that works takes k_o ln 10 out of the closing speed over the last decade before that; where none of it is
    taken, d_j was to go through 0.

    Args:
        equation: what to solve.
        law: its law.
        time_s: the trace's grid, s, (T,).
        switches_s: where to start anew, s, (S,), increasing.
        progress: called after every step with the simulated time, s.
    """
    start = equation.start()
    samples = np.full((len(time_s), len(start)), np.nan)
    ticks, end, touched, crossing, d = 0, None, False, False, equation.distance_m(start)
    least_m = resolution_m(law)
    rate_before = np.full(len(d), -np.inf)  # of each d_j, a decade before that
    inside = switches_s[(switches_s > 0) & (switches_s < time_s[-1])]
    try:
        for solver in _steps(equation, start, [0.0, *inside.tolist(), float(time_s[-1])]):
            d_before, d, upto = d, equation.distance_m(solver.y), solver.t
            near_m = _DECADE * least_m
            for j in np.flatnonzero((d_before > near_m) & (d <= near_m)).tolist():
                rate_before[j] = equation.distance_rate_mps(_when(equation, solver, j, near_m)[1])[j]
            reached = np.flatnonzero((d_before > least_m) & (d <= least_m)).tolist()
            if law.singular and reached:
                touched = True
                upto, x, j = min(
                    ((*_when(equation, solver, j, least_m), j) for j in reached), key=lambda found: found[0]
                )
                crossing = bool(equation.distance_rate_mps(x)[j] <= rate_before[j])
                end = (
                    f"{equation.names[j]} goes through 0 at {upto:.6g} s"
                    if crossing
                    else f"{equation.names[j]} is below {least_m:.2g} m at {upto:.6g} s, too little to tell "
                    "from 0"
                )
            now = int(np.searchsorted(time_s, upto, side="right"))
            if now > ticks:
                samples[ticks:now] = solver.dense_output()(time_s[ticks:now]).T
                ticks = now
            progress(upto)
            if end is not None:
                break
    except _StuckError as stuck:
        each = (f"{name} = {d_j:.3g} m" for name, d_j in zip(equation.names, d, strict=True))
        end = f"{stuck}, with {listed(tuple(each))}"
    return Solution(equation.motion(time_s, samples), equation.memory(samples), ticks, end, touched, crossing)


class _StuckError(Exception):
    """The solver cannot go on."""


def _steps(equation: Equation, x: Array, marks_s: list[float]) -> Iterator[OdeSolver]:
    """The solver after each of its steps, whatever method it takes, started anew at every mark."""
    for start, stop in pairwise(marks_s):
        f, t, explicit = equation.between(start, stop), start, True
        while t < stop:
            solver: OdeSolver
            if explicit:
                solver = DOP853(f, t, x, stop, max_step=_LONGEST_STEP_S, rtol=RTOL, atol=ATOL)
            else:
                solver = Radau(f, t, x, min(t + _IMPLICIT_S, stop), rtol=RTOL, atol=ATOL)
            yield from _stretch(solver, explicit)
            t, x, explicit = solver.t, solver.y, not explicit


def _stretch(solver: OdeSolver, explicit: bool) -> Iterator[OdeSolver]:
    """Steps to the end; the explicit method stops where its steps become tiny, the implicit one must not."""
    looked, steps = solver.t, 0
    while solver.status == "running":
        try:
            trouble = solver.step()
        except ValueError:  # the implicit method's linear algebra refuses infinite numbers
            trouble = "its numbers are not finite"
        if trouble is None:
            yield solver
            steps += 1
        if explicit:
            tiny = steps % _LOOK_STEPS == 0 and solver.t - looked < _LOOK_STEPS * _TINY_STEP_S
            if trouble is not None or tiny:
                return
            if steps % _LOOK_STEPS == 0:
                looked = solver.t
        elif trouble is not None or steps > _MOST_STEPS:
            trouble = trouble or "too many steps"
            raise _StuckError(f"the solver gives up at {solver.t:.6g} s ({trouble})")


def _when(equation: Equation, solver: OdeSolver, j: int, distance_m: float) -> tuple[float, Array]:
    """When d_j fell to a distance within the last step, s, and x then, (K,)."""
    curve = solver.dense_output()
    at_s = float(brentq(lambda t: equation.distance_m(curve(t))[j] - distance_m, solver.t_old, solver.t))
    return at_s, curve(at_s)


class Played:
    """The solutions of N simulations, played back as a plant and as the course of the law's memory."""

    limited = False

    def __init__(self, plant: Smooth, solutions: Sequence[Solution]) -> None:
        self._plant, self._solutions, self._tick = plant, solutions, 0
        self._motion = np.stack([s.motion for s in solutions], axis=1)
        names = solutions[0].memory
        self._memory = {name: np.stack([s.memory[name] for s in solutions], axis=1) for name in names}

    def memory(self) -> Memory:
        """In place of :meth:`Law.advance`: the memory at the next tick, as solved, each (N, ...)."""
        tick = min(self._tick + 1, len(self._motion) - 1)
        return {name: values[tick] for name, values in self._memory.items()}

    def observe(self) -> Cars:
        """See :meth:`Plant.observe`."""
        return self._plant.observe()

    def step(self, controls: Controls, running: Mask) -> None:
        """See :meth:`Plant.step`; the controls are in the solution already."""
        del controls, running
        self._tick = min(self._tick + 1, len(self._motion) - 1)
        self._plant.put(self._motion[self._tick])

    def contacts(self) -> tuple[Array, Array]:
        """See :meth:`Plant.contacts`."""
        return self._plant.contacts()

    def faults(self) -> list[Fault]:
        """See :meth:`Plant.faults`."""
        return [
            Fault(run, 0, solution.end, solution.touched, solution.crossing)
            for run, solution in enumerate(self._solutions)
            if solution.end is not None and solution.ticks <= self._tick
        ]

    def qpos(self) -> Array:
        """See :meth:`Plant.qpos`."""
        return self._plant.qpos()


def check(plant: str, law: Law) -> None:
    """Raises MjmergeError unless plant and law are a differential equation."""
    if plant not in _COMMANDS:
        raise MjmergeError(f"{plant} has no continuous time; {' and '.join(_COMMANDS)} have")
    if law.choice != "named":
        why = "law.choice must be 'named' in continuous time: a choice is made from tick to tick"
        raise MjmergeError(f"{why}, and is {law.choice!r}")
    _flow(law)


def _flow(law: Law) -> Flow:
    """The law's memory as part of the equation.

    Raises:
        MjmergeError: it has one, and says not how that changes.
    """
    flow = law.flow()
    if flow is None:
        raise MjmergeError(
            f"the law {law.kind} has no continuous time: it may remember something, and nothing says at "
            "which rate that changes (a class derived from mjmerge.law.Law can, with flow)"
        )
    return flow


def solve(
    scenario: Scenario,
    plant: str,
    moving: Plant,
    traffic: Traffic,
    believed: BelievedCars,
    time_s: Array,
    progress: Callable[[float], None] | None,
    ramp: Ramp | None = None,
) -> Played:
    """Integrates every simulation, each by itself.

    Args:
        scenario: what to run.
        plant: name of the plant.
        moving: that plant with all N simulations, which plays the solutions back.
        traffic: the neighbours of all N.
        believed: what the cars are believed to be.
        time_s: the trace's grid, s, (T,).
        progress: called with the simulated time averaged over all N, s.
        ramp: the end of the ego's lane in all N.

    Raises:
        MjmergeError: the plant is no differential equation.
    """
    check(plant, scenario.law)
    solutions: list[Solution] = []
    runs = len(traffic.starts_m)

    def report(t: float) -> None:
        if progress is not None:
            progress((len(solutions) * time_s[-1] + t) / runs)

    with np.errstate(all="ignore"):  # what a step that is not accepted computes does not matter
        for run in range(runs):
            alone = traffic.alone(run)
            end = None if ramp is None else ramp.alone(run).obstacle
            equation = Equation(scenario, plant, alone, believed, end)
            solutions.append(integrate(equation, scenario.law, time_s, alone.switches(), report))
    return Played(cast("Smooth", moving), solutions)
