"""Rare events with known answers: what subset simulation says of them, and how sure it is."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest

from mjmerge.errors import MjmergeError
from mjmerge.search.rare import Estimate, monte_carlo, subset

NORMAL = NormalDist()
EVENTS = {
    "plane": (lambda u, _: -u.sum(axis=1) / np.sqrt(u.shape[1]), lambda p: NORMAL.inv_cdf(p)),
    "two sides": (lambda u, _: -np.abs(u[:, 0]), lambda p: NORMAL.inv_cdf(p / 2)),
    "corner": (lambda u, _: -np.minimum(u[:, 0], u[:, 1]), lambda p: NORMAL.inv_cdf(np.sqrt(p))),
}
"""Functions of 8 standard normals, and the bound below which they are with a probability p."""


def repeated(name: str, p: float, repeats: int, each: int = 1300) -> list[Estimate]:
    function, bound = EVENTS[name]
    return [subset(function, 8, bound(p), each, seed) for seed in range(repeats)]


@pytest.mark.parametrize("name", EVENTS)
def test_one_in_ten_thousand_is_found_with_6000_runs_and_its_interval_covers_it(name, long):
    repeats = 400 if long else 100
    found = repeated(name, 1e-4, repeats)
    p = np.array([one.probability for one in found])
    assert p.mean() == pytest.approx(1e-4, rel=0.1)
    assert p.std() / 1e-4 < 0.3 * (1 if long else 1.1)  # of 100 repeats it is known to within 7 %
    assert np.mean([one.runs for one in found]) <= 6000
    assert np.mean([one.low <= 1e-4 <= one.high for one in found]) >= 0.9


@pytest.mark.parametrize("p", [0.5, 0.05, 1e-2, 1e-6])
def test_what_is_likelier_takes_fewer_runs_and_what_is_rarer_more(p):
    found = repeated("plane", p, 40)
    assert np.mean([one.probability for one in found]) == pytest.approx(p, rel=0.25)
    assert np.mean([one.low <= p <= one.high for one in found]) >= 0.85
    assert found[0].runs == pytest.approx(1300 + (len(found[0].levels) - 1) * 1170)


def test_independent_samples_agree_with_the_levels():
    function, bound = EVENTS["corner"]
    plain = monte_carlo(function, 8, bound(1e-3), 200_000, 0)
    assert plain.low <= 1e-3 <= plain.high
    assert plain.low <= np.mean([one.probability for one in repeated("corner", 1e-3, 30)]) * 1.15
    assert len(plain.below) == round(plain.probability * 200_000)
    assert (function(plain.below.u, plain.below.seeds) <= bound(1e-3)).all()


def test_the_same_seed_gives_the_same_bits_however_the_function_splits_its_samples():
    function, bound = EVENTS["plane"]

    def in_pieces(u, seeds):
        return np.concatenate([function(u[k : k + 7], seeds[k : k + 7]) for k in range(0, len(u), 7)])

    one, other = subset(function, 8, bound(1e-4), 300, 5), subset(in_pieces, 8, bound(1e-4), 300, 5)
    assert one.probability == other.probability
    assert one.below.u.tobytes() == other.below.u.tobytes()
    assert subset(function, 8, bound(1e-4), 300, 6).probability != one.probability


def test_noise_of_the_run_counts_and_no_chain_lives_off_its_luck():
    """Half of the event is the run's own noise, which follows from its seed."""

    def noisy(u, seeds):
        noise = np.array([np.random.default_rng(seed).standard_normal() for seed in seeds])
        return -(u.sum(axis=1) / np.sqrt(u.shape[1]) + noise) / np.sqrt(2)

    found = [subset(noisy, 4, NORMAL.inv_cdf(1e-3), 600, seed) for seed in range(12)]
    assert np.mean([one.probability for one in found]) == pytest.approx(1e-3, rel=0.35)


def test_what_never_happens_has_an_upper_end_and_what_always_does_is_certain():
    never = subset(lambda u, _: np.ones(len(u)), 2, 0.0, 200, 0)
    assert (never.probability, never.low) == (0.0, 0.0)
    assert 0 < never.high < 0.05
    always = subset(lambda u, _: -np.ones(len(u)), 2, 0.0, 200, 0)
    assert (always.probability, always.high) == (1.0, 1.0)
    assert 0.95 < always.low < 1.0
    assert always.runs == 200


def test_a_few_chains_have_a_wider_interval_that_still_covers_and_fewer_are_refused():
    function, bound = EVENTS["corner"]
    few = [subset(function, 8, bound(1e-4), 100, seed) for seed in range(100)]
    assert np.mean([one.low <= 1e-4 <= one.high for one in few]) >= 0.9
    assert np.median([one.high / one.low for one in few]) > 10
    with pytest.raises(MjmergeError, match="at least 100"):
        subset(function, 8, bound(1e-4), 90, 0)


def test_what_flattens_out_above_the_bound_has_an_upper_end_below_its_last_level():
    found = subset(lambda u, _: np.maximum(-u[:, 0], -2.0), 4, -3.0, 1000, 0)
    assert (found.probability, found.low) == (0.0, 0.0)
    assert 1e-3 < found.high < 0.03


def test_many_equal_values_do_not_stop_it():
    """Delays act through the grid of ticks, so ties occur."""
    found = subset(lambda u, _: -np.floor(u[:, 0] * 2) / 2, 3, -3.0, 1000, 1)
    assert found.low <= 1 - NORMAL.cdf(3.0) <= found.high
