"""Screening on a cheap function that is not the real one: the interval covers, whatever it gets wrong."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest

from mjmerge.errors import MjmergeError
from mjmerge.search.screen import Screened, screened

NORMAL = NormalDist()
SIZE = 4


def plane(u, _):
    return -u.sum(axis=1) / np.sqrt(SIZE)


def tilted(u, _):
    """What the cheap plant shows, but half of it is something else: 0.9 of the plane's direction."""
    return 0.9 * plane(u, _) - np.sqrt(1 - 0.81) * (u[:, 0] - u[:, 1]) / np.sqrt(2)


def other_side(u, _):
    """As the plane, and a failure of its own that the cheap plant knows nothing of."""
    return np.minimum(plane(u, _), -(u[:, 0] - u[:, 1]) / np.sqrt(2) - 0.5)


def union(bound: float) -> float:
    """How likely ``other_side`` is at most a bound: two directions at right angles."""
    return 1 - (1 - NORMAL.cdf(bound)) * (1 - NORMAL.cdf(bound + 0.5))


DEEP, SHALLOW = NORMAL.inv_cdf(1e-3), NORMAL.inv_cdf(1e-2)
CASES = {
    "the same": (plane, plane, DEEP, 1e-3),
    "too careful": (lambda u, s: plane(u, s) - 0.5, plane, DEEP, 1e-3),
    "too bold": (lambda u, s: plane(u, s) + 0.5, plane, DEEP, 1e-3),
    "tilted": (plane, tilted, DEEP, 1e-3),
    "misses much": (plane, other_side, SHALLOW, union(SHALLOW)),
    "misses little": (plane, other_side, DEEP, union(DEEP)),
    "knows nothing": (lambda u, _: u[:, 0] - u[:, 1], plane, SHALLOW, 1e-2),
    "flat": (lambda u, _: np.ones(len(u)), plane, SHALLOW, 1e-2),
}
"""Cheap, real, the bound, and how likely the real one is at most that."""


def repeated(name: str, repeats: int, runs: int = 600) -> list[Screened]:
    cheap, real, bound, _ = CASES[name]
    return [screened(cheap, real, SIZE, bound, 300, runs, seed) for seed in range(repeats)]


@pytest.mark.parametrize("name", CASES)
def test_the_interval_covers_whatever_the_cheap_one_gets_wrong(name, long):
    found = repeated(name, 400 if long else 50)
    p = CASES[name][3]
    assert np.mean([one.whole.low <= p <= one.whole.high for one in found]) >= 0.9
    assert all(one.runs <= 600 for one in found)
    assert np.mean([one.whole.probability for one in found]) == pytest.approx(p, rel=0.25)
    for one in found:
        assert one.found.probability + one.missed.probability == pytest.approx(one.whole.probability)
        assert sum(stratum.weight for stratum in one.strata) == pytest.approx(1.0)
        assert one.whole.low <= one.whole.probability <= one.whole.high


def test_where_nothing_was_seen_to_fail_the_interval_is_as_wide_as_few_runs_leave_it():
    (one,) = repeated("the same", 1)
    outermost = one.strata[0]
    assert (outermost.failing, outermost.up_to) == (0, np.inf)
    assert one.whole.high > outermost.weight / outermost.runs
    assert one.found.high < 0.5 * one.whole.high
    (more,) = repeated("the same", 1, runs=6000)
    assert more.whole.high < 0.5 * one.whole.high


def test_samples_of_the_event_are_real_ones_and_the_same_seed_gives_the_same_bits():
    one, other = (repeated("tilted", 1)[0] for _ in range(2))
    assert one.whole == other.whole
    assert one.below.u.tobytes() == other.below.u.tobytes()
    assert len(one.below) > 10
    assert (tilted(one.below.u, one.below.seeds) <= DEEP).all()


def test_too_few_runs_to_correct_it_are_refused():
    with pytest.raises(MjmergeError, match="it takes 100"):
        screened(plane, plane, SIZE, DEEP, 300, 50, 0)
