"""Intervals of counted rates, against the binomial distribution itself."""

from __future__ import annotations

from math import log

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from mjmerge.sweep.statistics import clopper_pearson


@given(st.integers(1, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_ends_are_where_the_count_becomes_improbable(case):
    """By definition: at the lower end P(X >= k) = 2.5 %, at the upper P(X <= k) = 2.5 %."""
    k, n = case
    rate = clopper_pearson(k, n)
    assert rate.low <= k / n <= rate.high
    if k > 0:
        assert binom.sf(k - 1, n, rate.low) == pytest.approx(0.025, rel=1e-6)
    else:
        assert rate.low == 0
    if k < n:
        assert binom.cdf(k, n, rate.high) == pytest.approx(0.025, rel=1e-6)
    else:
        assert rate.high == 1


def test_no_failure_in_many_runs_leaves_the_rule_of_three():
    assert clopper_pearson(0, 1000).high == pytest.approx(-log(0.025) / 1000, rel=2e-3)


def test_nothing_counted_says_nothing():
    rate = clopper_pearson(0, 0)
    assert (rate.low, rate.high, rate.value) == (0, 1, None)


@pytest.mark.parametrize("case", [(2, 1), (-1, 3)])
def test_a_count_beyond_its_number_is_refused(case):
    with pytest.raises(ValueError, match="no count"):
        clopper_pearson(*case)
