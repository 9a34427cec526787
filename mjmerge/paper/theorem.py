"""The theorem under load: random worlds in which every hypothesis holds, in continuous time.

Item 1 of the paper's lemma says: neighbours with bounded motion that keep their distance, a safe and bounded
start, z(0) > 0 and positive gains give d_1, d_2 > 0 for all time. Each draw here satisfies all of that:

- Vehicle 1's acceleration is known to the law (u_1), so in its frame it drops out, and that frame is used;
- Vehicle 2 changes the gap from one random width to another by bang-bang moves (acceleration switches between
  +a, -a and 0), never narrower than 2r and a margin, whether the ego is between or not;
- gains are within a factor of the paper's, log-uniformly, and the target lies inside the narrowest gap.

What it cannot settle: the theorem bounds d_j away from zero by no number. See ``RESOLVED_M``.

Draws that share their gains are integrated together: one stiff vector equation (the barrier's rate is
k_o/d_j), started anew wherever a neighbour switches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import BDF
from scipy.sparse import block_diag

from mjmerge.law import OpinionDynamics, Sensed
from mjmerge.law.opinion_dynamics.law import decide
from mjmerge.law.opinion_dynamics.opinion import rates
from mjmerge.state import Array, Mask, norm

RTOL, ATOL = 1e-7, 1e-10
RESOLVED_M = 1e-5
"""The barrier only damps: a steady pull towards a neighbour makes d_j fall exponentially, for as long as it
lasts (item 2 of the Appendix lemma). Below this, m, the theorem holds by a margin that nobody could measure;
such a world is unresolved, and is left there."""
TOGETHER = 50
"""Draws that share their gains and are integrated together."""

_SPREAD = {"k_p": 4.0, "k_v": 4.0, "k_o": 2.0, "k_w": 4.0, "k_mu": 4.0, "k": 4.0, "eps": 4.0}
"""Gains are within these factors of the paper's. d falls to about d exp(-v/k_o) for a closing speed v: with
much less k_o than this, theorem or not, nothing that computes in float64 can tell d from zero."""
_MARGIN_M = 0.05  # the gap stays this much wider than 2r
_WIDEST = 6.0  # widest gap, in r
_SLOT_S = 2.0  # a move of the gap starts at every multiple of this, and takes a part of it
_TAKES = np.array([0.25, 0.5, 0.75, 1.0])  # parts of it: few, so that worlds switch at the same times
_LIMIT_MPS2 = 3.0  # largest acceleration of Vehicle 2
_FASTEST_MPS = 1.5  # largest initial velocity of the ego relative to Vehicle 1, per component
_MOST_STEPS = 200_000


@dataclass(frozen=True)
class Draw:
    """N random worlds with one law, in Vehicle 1's frame.

    Attributes:
        law: gains.
        start: p, v of the ego, z, mu at t = 0, (N, 6).
        gaps_m: width of the gap, front axle to front axle, at each multiple of ``_SLOT_S``, m, (N, K).
        takes: part of its slot that each move takes, (N, K - 1).
    """

    law: OpinionDynamics
    start: Array
    gaps_m: Array
    takes: Array

    def one(self, i: int) -> Draw:
        """The i-th world alone."""
        row = slice(i, i + 1)
        return Draw(self.law, self.start[row], self.gaps_m[row], self.takes[row])

    def gap(self, slot: int, since_s: float) -> tuple[Array, Array]:
        """Gap and its rate, ``since_s`` after the start of a slot, m and m/s, each (N,)."""
        start, end = self.gaps_m[:, slot], self.gaps_m[:, slot + 1]
        T = _SLOT_S * self.takes[:, slot]  # noqa: N806
        s, a = np.minimum(since_s / T, 1.0), 4 * (end - start) / T**2
        first = s < 0.5
        gap = np.where(first, start + a * (s * T) ** 2 / 2, end - a * ((1 - s) * T) ** 2 / 2)
        return gap, np.where(first, a * s * T, a * (1 - s) * T)


@dataclass(frozen=True)
class WorldOutcome:
    """What came of N draws, each (N,).

    Attributes:
        least_m: smallest d_1 or d_2 at any step of the solver, m; <= 0 is a violation.
        close: whether d_j fell below r and below half of what it had been.
        unresolved: whether d_j fell below ``RESOLVED_M``; nothing is known after that.
        stuck: whether the solver could not reach the end; then nothing is known after that.
    """

    least_m: Array
    close: Mask
    unresolved: Mask
    stuck: Mask

    @property
    def thin(self) -> Mask:
        """Which draws the theorem holds in by less than can be told from 0, (N,)."""
        return self.unresolved & (self.least_m > 0)

    @property
    def violated(self) -> Mask:
        """Which draws contradict the theorem, (N,)."""
        return self.least_m <= 0


@dataclass(frozen=True)
class Tally:
    """What came of a campaign.

    Attributes:
        runs: how many worlds.
        violated: in how many d_j <= 0 at some time.
        unresolved: in how many some d_j fell below ``RESOLVED_M``, and the rest of the run is unknown.
        stuck: in how many the solver gave up, and the rest is unknown.
        close: in how many d_j fell below r and below half of what it had been.
        least_m: smallest d_j where it is resolved, m.
        counterexamples: seed, index in the batch, the simplest world that still violates, its duration, s.
    """

    runs: int
    violated: int
    unresolved: int
    stuck: int
    close: int
    least_m: float
    counterexamples: tuple[tuple[int, int, Draw, float], ...]


def tally(runs: int, seed: int, duration_s: float, progress: Callable[[int], None] | None = None) -> Tally:
    """Runs a campaign, counts, and shrinks every violation to the simplest one.

    Args:
        runs: how many worlds.
        seed: of the first batch.
        duration_s: simulated time of each, s.
        progress: called with the number of worlds done.
    """
    found, counterexamples = [], []
    for batch, outcome in campaign(runs, seed, duration_s, progress):
        found.append(outcome)
        for i in np.flatnonzero(outcome.violated).tolist():
            counterexamples.append((batch, i, *shrink(draw(batch, duration_s).one(i), duration_s)))
    least, close, unresolved, stuck = (
        np.concatenate([getattr(o, f.name) for o in found]) for f in fields(WorldOutcome)
    )
    return Tally(
        runs=len(least),
        violated=len(counterexamples),
        unresolved=int((unresolved & (least > 0)).sum()),
        stuck=int(stuck.sum()),
        close=int(close.sum()),
        least_m=float(least[~unresolved].min(initial=np.inf)),
        counterexamples=tuple(counterexamples),
    )


def draw(seed: int, duration_s: float, count: int = TOGETHER) -> Draw:
    """Worlds number ``seed * count`` to ``(seed + 1) * count - 1`` of the campaign.

    Args:
        seed: of gains and worlds.
        duration_s: simulated time, s.
        count: how many share the gains.
    """
    rng = np.random.default_rng(seed)
    paper = OpinionDynamics(r_rho_m=-1.0, r_eta_m=1.0)
    r = paper.r_m
    gains = {name: getattr(paper, name) * spread ** rng.uniform(-1, 1) for name, spread in _SPREAD.items()}
    slots = int(np.ceil(duration_s / _SLOT_S))
    narrowest = 2 * r + _MARGIN_M
    gaps = rng.uniform(narrowest, _WIDEST * r, (count, slots + 1))
    # a move over dg in a time T peaks at 4 |dg|/T^2: as short as that allows, or longer
    shortest = np.sqrt(4 * np.abs(np.diff(gaps, axis=1)) / _LIMIT_MPS2) / _SLOT_S
    takes = np.maximum(rng.choice(_TAKES, shortest.shape), _TAKES[np.searchsorted(_TAKES[:-1], shortest)])
    law = OpinionDynamics(
        r_rho_m=float(-rng.uniform(r, narrowest - r)),
        r_eta_m=float(rng.choice([-1, 1]) * rng.uniform(r, 3 * r)),
        **gains,
    )
    p = np.empty((count, 2))
    for i in range(count):  # anywhere near, but outside both margins
        while True:
            p[i] = rng.uniform((-_WIDEST * r - 2, -2.5), (2, 2.5))
            if min(np.hypot(*p[i]), np.hypot(p[i, 0] + gaps[i, 0], p[i, 1])) > r + 0.02:
                break
    v = rng.uniform(-_FASTEST_MPS, _FASTEST_MPS, (count, 2))
    z = 10 ** rng.uniform(-4, 0, count)
    mu = rng.uniform(-0.2, 0.2, count)
    return Draw(law, np.column_stack([p, v, z, mu]), gaps, takes)


def run(worlds: Draw, duration_s: float) -> WorldOutcome:
    """Integrates the worlds together; if the solver cannot, each by itself.

    Args:
        worlds: N of them.
        duration_s: simulated time, s.
    """
    n = len(worlds.start)
    outcome = _integrate(worlds, duration_s)
    if not outcome.stuck.any() or n == 1:
        return outcome
    alone = [_integrate(worlds.one(i), duration_s) for i in range(n)]
    return WorldOutcome(*(np.concatenate([getattr(o, f.name) for o in alone]) for f in fields(WorldOutcome)))


def campaign(
    runs: int, seed: int, duration_s: float, progress: Callable[[int], None] | None = None
) -> Iterator[tuple[int, WorldOutcome]]:
    """Yields the seed and the outcome of every batch of ``TOGETHER`` worlds, up to ``runs`` of them."""
    for batch in range(-(-runs // TOGETHER)):
        count = min(TOGETHER, runs - batch * TOGETHER)
        worlds = draw(seed + batch, duration_s)
        kept = Draw(worlds.law, worlds.start[:count], worlds.gaps_m[:count], worlds.takes[:count])
        yield seed + batch, run(kept, duration_s)
        if progress is not None:
            progress(batch * TOGETHER + count)


def shrink(world: Draw, duration_s: float) -> tuple[Draw, float]:
    """The simplest world that still violates the theorem: gains back to the paper's, moves undone, time cut.

    Args:
        world: one that does, N = 1.
        duration_s: how long it was run, s.
    """
    paper = OpinionDynamics(r_rho_m=world.law.r_rho_m, r_eta_m=world.law.r_eta_m)
    changed = True
    while changed:
        changed = False
        for simpler, shorter in _simpler(world, duration_s, paper):
            if run(simpler, shorter).violated.any():
                world, duration_s, changed = simpler, shorter, True
                break
    return world, duration_s


def _simpler(world: Draw, duration_s: float, paper: OpinionDynamics) -> Iterator[tuple[Draw, float]]:
    """Worlds one step simpler than this one."""
    for name in type(paper).model_fields:
        if getattr(world.law, name) != getattr(paper, name):
            law = world.law.model_copy(update={name: getattr(paper, name)})
            yield Draw(law, world.start, world.gaps_m, world.takes), duration_s
    for k in range(1, world.gaps_m.shape[1]):
        if np.any(world.gaps_m[:, k] != world.gaps_m[:, k - 1]):
            gaps = world.gaps_m.copy()
            gaps[:, k:] = gaps[:, k - 1 : k]
            yield Draw(world.law, world.start, gaps, world.takes), duration_s
    for i in range(2, world.start.shape[1]):
        simple = 0.1 if i == 4 else 0.0
        if np.any(world.start[:, i] != simple):
            start = world.start.copy()
            start[:, i] = simple
            yield Draw(world.law, start, world.gaps_m, world.takes), duration_s
    if duration_s > _SLOT_S:
        yield world, duration_s - _SLOT_S


@np.errstate(over="ignore", invalid="ignore")  # what a step that is not accepted computes does not matter
def _integrate(worlds: Draw, duration_s: float) -> WorldOutcome:
    """All worlds as one vector equation; the state is p, v, ln z, mu. An unresolved world then rests."""
    law, n = worlds.law, len(worlds.start)
    x = worlds.start.copy()
    x[:, 4] = np.log(x[:, 4])
    least, before = np.full(n, np.inf), np.zeros((n, 2))
    close, unresolved = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    blocks: Any = block_diag([np.ones((6, 6))] * n, format="csc")

    def rate(time_s: float, flat: Array, slot: int, moving: Array) -> Array:
        x = flat.reshape(n, 6)
        z = np.exp(x[:, 4])
        decision = decide(law, _sensed(worlds, slot, time_s, x), z)
        ln_z_rate, mu_rate = rates(law, z, x[:, 5], decision.mu_input)
        parts = [x[:, 2:4], decision.u, ln_z_rate[:, None], mu_rate[:, None]]
        return (moving * np.concatenate(parts, axis=1)).ravel()

    steps = 0
    for slot, t, stop in _stretches(worlds, duration_s):
        while t < stop:
            f = partial(rate, slot=slot, moving=~unresolved[:, None])
            solver = BDF(f, t, x.ravel(), stop, max_step=0.1, rtol=RTOL, atol=ATOL, jac_sparsity=blocks)
            touched = unresolved
            while solver.status == "running" and touched.sum() == unresolved.sum():
                steps += 1
                if not _step(solver) or steps > _MOST_STEPS:
                    return WorldOutcome(least, close, unresolved, ~unresolved)
                x = solver.y.reshape(n, 6)
                now = _sensed(worlds, slot, solver.t, x)
                d = norm(now.p[:, None] - now.p_j) - law.r_m
                before = np.maximum(before, d)
                least = np.where(unresolved, least, np.minimum(least, d.min(axis=1)))
                close |= np.any((d < law.r_m) & (d < before / 2), axis=1)
                touched = unresolved | (least < RESOLVED_M)
            t, unresolved = solver.t, touched
    return WorldOutcome(least, close, unresolved, np.zeros(n, dtype=bool))


def _step(solver: BDF) -> bool:
    """One step of the solver; whether it could."""
    try:
        return solver.step() is None
    except (RuntimeError, ValueError):  # its linear algebra met a singular matrix, or infinite numbers
        return False


def _sensed(worlds: Draw, slot: int, time_s: float, x: Array) -> Sensed:
    """What the law senses; Vehicle 1 rests at the origin."""
    gap, gap_rate = worlds.gap(slot, time_s - slot * _SLOT_S)
    p_j, v_j = np.zeros((2, len(x), 2, 2))
    p_j[:, 1, 0], v_j[:, 1, 0] = -gap, -gap_rate
    return Sensed(p=x[:, :2], v=x[:, 2:4], p_j=p_j, v_j=v_j, u_1=np.zeros((len(x), 2)))


def _stretches(worlds: Draw, duration_s: float) -> Iterator[tuple[int, float, float]]:
    """Slot, start and end of every stretch of time in which no acceleration switches in any world, s."""
    for slot in range(worlds.gaps_m.shape[1] - 1):
        begin = slot * _SLOT_S
        takes = _SLOT_S * worlds.takes[:, slot]
        marks = np.unique(np.concatenate([[0.0, _SLOT_S], takes / 2, takes])) + begin
        marks = marks[marks <= duration_s]
        for start, stop in pairwise(marks.tolist()):
            if stop - start > 1e-9:
                yield slot, start, stop
