"""The survey of decisions: the same merges for every variant, counted right."""

import numpy as np
import pytest

from mjmerge import simulate
from mjmerge.errors import ScenarioError
from mjmerge.paper.survey import TOGETHER, random_scenario, survey
from mjmerge.verdict.decision import decision


def test_every_variant_gets_the_same_merges():
    for seed in range(20):
        literal, gated = random_scenario(seed, "literal"), random_scenario(seed, "gated")
        law = gated.law.model_copy(update={"variant": literal.law.variant})
        assert gated.model_copy(update={"law": law}) == literal
        assert literal != random_scenario(seed + 1, "literal")


def test_it_counts_what_the_traces_show():
    progress = []
    found = survey(TOGETHER + 1, 5, "literal", progress.append)  # rounded up
    traces = [
        simulate(random_scenario(s, "literal"), "double_integrator", runs=TOGETHER, seed=s * TOGETHER)
        for s in (5, 6)
    ]
    wrong = [d.wrong_sign_s for t in traces for d in decision(t)]
    assert progress == [TOGETHER, 2 * TOGETHER]
    assert found.runs == 2 * TOGETHER
    assert found.wrong_sign == np.count_nonzero(wrong)
    assert found.violated == sum((t.distance_m <= 0).any(axis=(1, 2)).sum() for t in traces)
    assert found.wrong_sign_s == pytest.approx(np.mean([w for w in wrong if w]) if any(wrong) else 0)


def test_the_gated_law_is_never_driven_the_wrong_way():
    assert survey(TOGETHER, 0, "literal").wrong_sign > 0
    assert survey(TOGETHER, 0, "gated").wrong_sign == 0


def test_a_variant_that_is_none_ends_it():
    with pytest.raises(ScenarioError, match="did you mean 'gated'"):
        survey(1, 0, "gatd")
