"""The probability of something rare: subset simulation, and plain Monte Carlo beside it.

S.-K. Au, J. L. Beck, Estimation of small failure probabilities in high dimensions by subset simulation,
Probabilistic Engineering Mechanics 16 (2001) 263. A rare event is reached over levels, each as likely as
``PART`` under the one before it; within a level, samples are moved by a chain that leaves it alone: u' =
sqrt(1 - s^2) u + s xi in a space of standard normals (conditional sampling: I. Papaioannou et al., MCMC
algorithms for subset simulation, ibid. 41 (2015) 89), with s adapted so that ``ACCEPTED`` of the moves are.

The seed of a run is part of a sample. A move keeps it, or draws another one: otherwise a chain would accept
by the luck of new noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjmerge.errors import MjmergeError
from mjmerge.state import Array
from mjmerge.sweep.statistics import clopper_pearson

Seeds = NDArray[np.int64]
Function = Callable[[Array, Seeds], Array]
"""What samples come to: standard normals, (M, D), and seeds, (M,), to numbers, (M,); small ones are rare."""

PART = 0.1
"""Part of a level's samples that the next one starts from."""
ACCEPTED = 0.44
"""Part of the moves that a chain is to accept."""
MOST_LEVELS = 12
CONFIDENCE = 0.95
"""Of the intervals."""
CALIBRATION = 1.2
"""The levels' own coefficient of variation is too small by about this: chains forget their start slowly. It
is measured, by repeats on functions with known answers."""
FEW_CHAINS = 4.0
"""And by one and this over the number of chains, measured likewise: a few chains see little."""
LEAST_EACH = 100
"""Samples of a level, at least: with fewer, intervals were not measured to hold."""
_SCORE = 1.959963984540054  # of the normal distribution, for 95 %
_SEEDS = 2**31


@dataclass(frozen=True)
class Samples:
    """Samples, and what they came to.

    Attributes:
        u: standard normals, (M, D).
        seeds: of the runs, (M,).
        values: of the function, (M,).
    """

    u: Array
    seeds: Seeds
    values: Array

    def __len__(self) -> int:
        """How many, M."""
        return len(self.values)

    def differing(self) -> Samples:
        """Each once, the least value first: a chain whose move was not taken stays where it is."""
        rows = {(int(self.seeds[i]), self.u[i].tobytes()): i for i in range(len(self))}
        first = np.array(list(rows.values()), dtype=np.intp)
        return self.at(first[np.argsort(self.values[first], kind="stable")])

    def at(self, which: NDArray[Any]) -> Samples:
        """Some of them: indices, or which are meant, (M,)."""
        return Samples(self.u[which], self.seeds[which], self.values[which])

    @classmethod
    def drawn(cls, function: Function, size: int, count: int, rng: np.random.Generator) -> Samples:
        """Independent ones."""
        u, seeds = rng.standard_normal((count, size)), rng.integers(_SEEDS, size=count)
        return cls(u, seeds, function(u, seeds))

    @classmethod
    def joined(cls, parts: Sequence[Samples]) -> Samples:
        """One after the other."""
        return cls(*(np.concatenate([getattr(one, name) for one in parts]) for name in _COLUMNS))


_COLUMNS = ("u", "seeds", "values")


@dataclass(frozen=True)
class Level:
    """One level of a subset simulation.

    Attributes:
        bound: below it are the samples that the next level starts from; at the last one, the event's.
        part: of its samples that are below.
        variation: coefficient of variation of that part, by the chains' own correlation.
        accepted: part of the moves that were accepted; 1 on the first level, which has none.
        samples: all of it; of chains, the first sample of each, then the second of each, and so on.
    """

    bound: float
    part: float
    variation: float
    accepted: float
    samples: Samples


@dataclass(frozen=True)
class Estimate:
    """A probability, and how well it is known.

    Attributes:
        probability: of the event.
        low: lower end of the interval.
        high: its upper end.
        runs: how many samples were run.
        levels: from the first to the last; independent samples alone are one.
        chains: how many chains each level after the first has; 0 without any.
        length: samples of a chain, the one that it starts from included.
        below: samples of the event.
    """

    probability: float
    low: float
    high: float
    runs: int
    levels: tuple[Level, ...]
    chains: int
    length: int
    below: Samples


def monte_carlo(function: Function, size: int, bound: float, runs: int, seed: int) -> Estimate:
    """By independent samples, with the interval of Clopper and Pearson.

    Args:
        function: what a sample comes to.
        size: its coordinates, D.
        bound: the event is that it is at most this.
        runs: how many samples.
        seed: of the samples.
    """
    return _independent(Samples.drawn(function, size, runs, np.random.default_rng(seed)), bound)


def _independent(samples: Samples, bound: float) -> Estimate:
    hit, runs = samples.values <= bound, len(samples)
    rate = clopper_pearson(int(hit.sum()), runs)
    level = Level(bound, rate.count / runs, _variation(hit[:, None]), 1.0, samples)
    return Estimate(level.part, rate.low, rate.high, runs, (level,), 0, 1, samples.at(hit))


def subset(function: Function, size: int, bound: float, each: int, seed: int) -> Estimate:
    """By subset simulation.

    Args:
        function: what a sample comes to.
        size: its coordinates, D.
        bound: the event is that it is at most this.
        each: samples of a level; a multiple of 1/``PART`` is used.
        seed: of the samples and of the chains.

    Raises:
        MjmergeError: a level has fewer than ``LEAST_EACH`` samples.
    """
    if each < LEAST_EACH:
        raise MjmergeError(f"a level of {each} samples is too small; it must have at least {LEAST_EACH}")
    rng = np.random.default_rng(seed)
    chains, length = round(each * PART), round(1 / PART)
    each = chains * length
    samples, moved, step = Samples.drawn(function, size, each, rng), 1.0, 0.8
    if (samples.values <= bound).mean() >= PART:
        return replace(_independent(samples, bound), chains=chains, length=length)
    levels: list[Level] = []
    stuck = False
    while True:
        order = np.argsort(samples.values, kind="stable")
        reached = float(samples.values[order[chains - 1]])
        last = reached <= bound or len(levels) + 1 == MOST_LEVELS
        here = bound if last else reached
        below = samples.values <= here
        part = float(below.mean())
        inside = below.reshape(length, -1).T if levels else below[:, None]
        levels.append(Level(here, part, _variation(inside), moved, samples))
        if last:
            break
        stuck = part == 1.0 or (len(levels) > 1 and reached >= levels[-2].bound)
        if stuck:  # nothing is lower: as far as anybody can see the event never happens
            break
        start = order[:chains] if part <= PART + 1e-12 else np.flatnonzero(below)[:chains]
        samples, moved, step = chained(function, samples.at(start), here, length, step, rng)
    runs = each + (len(levels) - 1) * chains * (length - 1)
    below_it = samples.at(samples.values <= bound)
    probability = float(np.prod([level.part for level in levels]))
    if stuck or probability == 0:
        most = float(np.prod([level.part for level in levels[:-1]])) * spread(levels[:-1], chains)
        high = min(1.0, most * clopper_pearson(0, chains if len(levels) > 1 else each).high)
        return Estimate(0.0, 0.0, high, runs, tuple(levels), chains, length, below_it)
    by = spread(levels, chains)
    low, high = probability / by, min(1.0, probability * by)
    return Estimate(probability, low, high, runs, tuple(levels), chains, length, below_it)


def widened(variation: float, chains: int) -> float:
    """A coefficient of variation that chains claim, as large as it was measured to be."""
    return CALIBRATION * (1 + FEW_CHAINS / chains) * variation


def spread(levels: Sequence[Level], chains: int) -> float:
    """Factor from the product of some levels' parts to either end of its interval, lognormal."""
    variation = widened(float(np.sqrt(sum(level.variation**2 for level in levels))), chains)
    return float(np.exp(_SCORE * np.sqrt(np.log1p(variation**2))))


def chained(
    function: Function, start: Samples, bound: float, length: int, step: float, rng: np.random.Generator
) -> tuple[Samples, float, float]:
    """Chains that do not leave a level, all at once.

    Args:
        function: what a sample comes to.
        start: where each begins, (chains,); all of the level.
        bound: none of their samples is above it.
        length: samples of each, the first included.
        step: how far a move goes at first, 0 to 1.
        rng: of the moves.

    Returns:
        Every sample, (chains * length,), the first of each before the second of each; the part of the moves
        that was accepted; and how far the last ones went.
    """
    now, samples, took = start, [start], []
    for _ in range(length - 1):
        proposed = np.sqrt(1 - step**2) * now.u + step * rng.standard_normal(now.u.shape)
        other = rng.random(len(now)) < step
        drawn = np.where(other, rng.integers(_SEEDS, size=len(now)), now.seeds)
        found = function(proposed, drawn)
        fine = found <= bound
        now = Samples(
            np.where(fine[:, None], proposed, now.u),
            np.where(fine, drawn, now.seeds),
            np.where(fine, found, now.values),
        )
        samples.append(now)
        took.append(float(fine.mean()))
        step = float(np.clip(np.exp(np.log(step) + (took[-1] - ACCEPTED) / np.sqrt(len(took))), 0.05, 1.0))
    return Samples.joined(samples), float(np.mean(took)), step


def _variation(inside: NDArray[np.bool_]) -> float:
    """Coefficient of variation of the part that is inside, (chains, length), by the chains' correlation."""
    chains, length = inside.shape
    part = float(inside.mean())
    if part in (0.0, 1.0):
        return 0.0
    whole = part * (1 - part)
    off = inside - part
    gamma = 0.0
    for lag in range(1, length):
        together = float((off[:, :-lag] * off[:, lag:]).mean())
        gamma += 2 * (1 - lag / length) * together / whole
    return float(np.sqrt((1 - part) / (part * chains * length) * max(1 + gamma, 1.0)))
