"""The probability of something rare on a plant that is dear, by a cheap one that is not quite like it.

The cheap plant divides all draws into strata: subset simulation takes it down to the event that its own
margin is below a bound, somewhat above the one that is meant, and each level on the way leaves a stratum that
the cheap plant says is safe. Some samples of every stratum are run on the plant itself. Its probability is
the sum, over the strata, of how likely the stratum is times the part of its samples that fail: stratified
sampling (W. G. Cochran, Sampling Techniques, 3rd ed., 1977, ch. 5). So what the cheap plant finds in vain is
taken off, and what it misses is added, as well as so many runs can tell.

The parts' intervals are put together by melding (M. P. Fay, M. A. Proschan, E. Brittain, Combining one-sample
confidence procedures for inference in the two-sample case, Biometrics 71 (2015) 146): each end of the sum is
a quantile over draws of the same ends of its parts, those of Clopper and Pearson for what was run. A stratum
of which nothing was seen to fail still counts with what so few runs would not have seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjmerge.errors import MjmergeError
from mjmerge.search.rare import (
    CONFIDENCE,
    Estimate,
    Function,
    Level,
    Samples,
    chained,
    subset,
    widened,
)
from mjmerge.state import Array

LEAST_RUNS = 100
"""On the plant itself, at least."""
PILOT = 0.08
"""Part of those that first show how far the two margins are apart."""
INSIDE = 0.4
"""Part of the others that are run where the cheap plant shows the event; the rest is run elsewhere."""
_SETTLE = 15  # moves of a chain between two samples that are run on the plant
_MOST_ROUNDS = 12  # of such samples, for a stratum that few of them are in
_DRAWS = 8_000


@dataclass(frozen=True)
class Stratum:
    """Where the cheap margin lies between two bounds, and what becomes of it on the plant.

    Attributes:
        above: the cheap margin is more than this; ``-inf`` in the innermost, where the event is.
        up_to: and at most this; ``inf`` in the outermost.
        weight: how likely that is.
        runs: samples that were run on the plant.
        failing: how many of them failed there.
    """

    above: float
    up_to: float
    weight: float
    runs: int
    failing: int

    @property
    def inside(self) -> bool:
        """Whether the cheap plant shows the event there."""
        return self.above == -np.inf


@dataclass(frozen=True)
class Within:
    """A probability, and its interval."""

    probability: float
    low: float
    high: float


@dataclass(frozen=True)
class Screened:
    """A probability on the plant, by way of a cheap one.

    Attributes:
        offset: what was added to the bound for the cheap plant.
        cheap: how likely its margin is below that.
        strata: from the outermost to the innermost.
        whole: how likely the event is on the plant.
        found: the part of it where the cheap plant shows its own event.
        missed: the part of it where the cheap plant shows none.
        runs: on the plant.
        cheap_runs: on the cheap one.
        below: samples that fail on the plant.
    """

    offset: float
    cheap: Estimate
    strata: tuple[Stratum, ...]
    whole: Within
    found: Within
    missed: Within
    runs: int
    cheap_runs: int
    below: Samples


def screened(
    cheap: Function, real: Function, size: int, bound: float, each: int, runs: int, seed: int
) -> Screened:
    """By a cheap function, corrected by runs of the real one.

    Args:
        cheap: what a sample comes to there, of which many are taken.
        real: what it comes to in earnest.
        size: coordinates of a sample, D.
        bound: the event is that the real one is at most this.
        each: samples of a level of the cheap one.
        runs: samples of the real one, at most.
        seed: of all samples.

    Raises:
        MjmergeError: that is too few.
    """
    if runs < LEAST_RUNS:
        raise MjmergeError(f"{runs} runs are too few to correct a screening; it takes {LEAST_RUNS}")
    rng = np.random.default_rng([seed, 1])
    cheap_runs = 0

    def counted(u: Array, seeds: np.ndarray) -> Array:
        nonlocal cheap_runs
        cheap_runs += len(u)
        return cheap(u, seeds)

    pilot = Samples.drawn(counted, size, round(PILOT * runs), rng)
    in_earnest = [Samples(pilot.u, pilot.seeds, real(pilot.u, pilot.seeds))]
    offset = _offset(pilot.values, in_earnest[0].values)
    estimate = subset(counted, size, bound + offset, each, seed)
    strata: list[Stratum] = []
    wanted = _shared(estimate, runs - len(pilot))
    for k, many in enumerate(wanted):
        above, up_to = _between(estimate, k)
        taken = _taken(counted, estimate, k, many, rng)
        values = real(taken.u, taken.seeds)
        in_earnest.append(Samples(taken.u, taken.seeds, values))
        failing = int((values <= bound).sum())
        strata.append(Stratum(above, up_to, _weight(estimate, k), len(taken), failing))
    everything = Samples.joined(in_earnest)
    weights = _weights_drawn(estimate.levels, estimate.chains, rng)
    low, high = _parts_drawn(strata, rng)
    inside = np.array([one.inside for one in strata])
    return Screened(
        offset=offset,
        cheap=estimate,
        strata=tuple(strata),
        whole=_melded(strata, weights, low, high, np.ones_like(inside)),
        found=_melded(strata, weights, low, high, inside),
        missed=_melded(strata, weights, low, high, ~inside),
        runs=len(everything),
        cheap_runs=cheap_runs,
        below=everything.at(everything.values <= bound),
    )


def _offset(cheap: Array, real: Array) -> float:
    """How much further down the real one goes, but for a tenth of a few samples; 0 if it does not.

    Not the most that it ever does: where it fails in a way of its own, no offset brings that in.
    """
    known = np.isfinite(cheap) & np.isfinite(real)
    return float(max(0.0, np.quantile(cheap[known] - real[known], 0.9))) if known.any() else 0.0


def _between(estimate: Estimate, k: int) -> tuple[float, float]:
    """The bounds of a stratum: of each level what is above the next one, and of the last one the rest."""
    bounds = [np.inf, *(level.bound for level in estimate.levels)]
    return (float(bounds[k + 1]) if k < len(estimate.levels) else -np.inf), float(bounds[k])


def _weight(estimate: Estimate, k: int) -> float:
    parts = [level.part for level in estimate.levels]
    return float(np.prod(parts[:k])) * (1 - parts[k] if k < len(parts) else 1.0)


def _shared(estimate: Estimate, runs: int) -> list[int]:
    """Runs of each stratum: outside half of them evenly, half as what is not seen there weighs."""
    weights = np.array([_weight(estimate, k) for k in range(len(estimate.levels) + 1)])
    there = weights > 0
    outside = there.copy()
    outside[-1] = False
    inside = 0 if not there[-1] else runs if not outside.any() else round(INSIDE * runs)
    share = np.zeros(len(weights))
    if outside.any():
        root = np.sqrt(np.where(outside, weights, 0.0))
        share = (runs - inside) * (0.5 * outside / outside.sum() + 0.5 * root / root.sum())
    return [*np.floor(share[:-1]).astype(int).tolist(), inside]


def _taken(cheap: Function, estimate: Estimate, k: int, many: int, rng: np.random.Generator) -> Samples:
    """Samples of a stratum that know little of each other, up to so many."""
    above, up_to = _between(estimate, k)
    size = estimate.levels[0].samples.u.shape[1]
    nothing = Samples(np.empty((0, size)), np.empty(0, dtype=np.int64), np.empty(0))
    found, there = nothing, nothing
    if k and many:
        before = estimate.levels[k - 1].samples
        inside = before.at(np.flatnonzero(before.values <= up_to))
        there = inside.at(rng.permutation(len(inside))[: estimate.chains])
    for _ in range(_MOST_ROUNDS):
        if len(found) >= many:
            break
        if k:
            moved, _, _ = chained(cheap, there, up_to, _SETTLE + 1, 0.5, rng)
            there = moved.at(np.arange(len(moved) - len(there), len(moved)))
        else:
            there = Samples.drawn(cheap, size, many, rng)
        found = Samples.joined([found, there.at(there.values > above)])
    return found.at(np.arange(min(many, len(found))))


def _weights_drawn(levels: Sequence[Level], chains: int, rng: np.random.Generator) -> Array:
    """How likely each stratum may be, (draws, strata)."""
    drawn = np.ones((_DRAWS, len(levels)))
    for k, level in enumerate(levels):
        many = len(level.samples)
        inside = round(level.part * many)
        if k == 0:
            drawn[:, k] = rng.beta(inside + 0.5, many - inside + 0.5, _DRAWS)
        else:
            sigma = np.sqrt(np.log1p(widened(level.variation, chains) ** 2))
            drawn[:, k] = np.minimum(level.part * np.exp(sigma * rng.standard_normal(_DRAWS)), 1.0)
    before = np.concatenate([np.ones((_DRAWS, 1)), np.cumprod(drawn, axis=1)], axis=1)
    found: Array = before * np.concatenate([1 - drawn, np.ones((_DRAWS, 1))], axis=1)
    return found


def _parts_drawn(strata: Sequence[Stratum], rng: np.random.Generator) -> tuple[Array, Array]:
    """What part of each may fail, from below and from above, (draws, strata)."""
    low, high = np.zeros((_DRAWS, len(strata))), np.ones((_DRAWS, len(strata)))
    for k, one in enumerate(strata):
        safe = one.runs - one.failing
        if one.failing:
            low[:, k] = rng.beta(one.failing, safe + 1, _DRAWS)
        if safe:
            high[:, k] = rng.beta(one.failing + 1, safe, _DRAWS)
    return low, high


def _melded(strata: Sequence[Stratum], weights: Array, low: Array, high: Array, which: Array) -> Within:
    """The sum over some strata."""
    tail = (1 - CONFIDENCE) / 2
    value = sum(
        one.weight * one.failing / one.runs
        for one, meant in zip(strata, which, strict=True)
        if meant and one.runs
    )
    least = float(np.quantile((weights * low * which).sum(axis=1), tail))
    most = float(np.quantile((weights * high * which).sum(axis=1), 1 - tail))
    return Within(float(value), min(least, float(value)), max(min(most, 1.0), float(value)))
