"""Item 1 of the lemma on random worlds, and that the search would notice if it were wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mjmerge.paper import theorem

DURATION_S = 6.0


@pytest.mark.parametrize("seed", range(3))
def test_no_random_world_contradicts_the_theorem(seed):
    outcome = theorem.run(theorem.draw(seed, DURATION_S, 20), DURATION_S)
    assert not outcome.violated.any()
    assert not outcome.stuck.any()
    assert outcome.close.sum() >= 5  # the barrier was really asked


@pytest.mark.parametrize("seed", range(20))
def test_every_draw_satisfies_the_hypotheses(seed):
    worlds = theorem.draw(seed, DURATION_S, 10)
    r, law = worlds.law.r_m, worlds.law
    p = worlds.start[:, :2]
    assert (np.hypot(*p.T) > r).all()
    assert (np.hypot(p[:, 0] + worlds.gaps_m[:, 0], p[:, 1]) > r).all()
    assert (worlds.start[:, 4] > 0).all()
    assert r < -law.r_rho_m < worlds.gaps_m.min() - r + 0.05
    for slot in range(worlds.gaps_m.shape[1] - 1):
        times = np.linspace(0, 2.0, 81)
        gap, rate = (np.array(values) for values in zip(*(worlds.gap(slot, t) for t in times), strict=True))
        assert gap.min() > 2 * r
        # The rate is piecewise linear, so the mean of its ends is exact but at the kinks.
        between = (rate[1:] + rate[:-1]) / 2
        assert np.diff(gap, axis=0) / 0.025 == pytest.approx(between, abs=0.03)
        assert (np.abs(np.diff(rate, axis=0)) / 0.025).max() <= 3.0 + 1e-9
        assert gap[-1] == pytest.approx(worlds.gaps_m[:, slot + 1])


def test_a_world_alone_does_what_it_does_among_others():
    worlds = theorem.draw(2, DURATION_S, 5)
    together = theorem.run(worlds, DURATION_S)
    for i in range(5):
        alone = theorem.run(worlds.one(i), DURATION_S)
        assert alone.least_m[0] == pytest.approx(together.least_m[i], rel=1e-3)


def test_without_the_barrier_the_search_finds_violations_and_shrinks_one_to_its_cause():
    worlds = theorem.draw(0, DURATION_S, 10)
    worlds = unguarded(worlds)
    bad = np.flatnonzero(theorem.run(worlds, DURATION_S).violated)
    assert bad.size
    world, duration_s = theorem.shrink(worlds.one(bad[0]), DURATION_S)
    assert theorem.run(world, duration_s).violated.all()
    paper = type(world.law)(r_rho_m=world.law.r_rho_m, r_eta_m=world.law.r_eta_m)
    changed = {name for name, value in world.law if value != getattr(paper, name)}
    assert "k_o" in changed
    assert len(changed) <= 2  # six gains were drawn at random; at most one of them is needed


def test_the_campaign_is_the_same_however_it_is_cut():
    whole = [o.least_m for _, o in theorem.campaign(100, 7, 2.0)]
    parts = [o.least_m for s in (7, 8) for _, o in theorem.campaign(50, s, 2.0)]
    assert np.array_equal(np.concatenate(whole), np.concatenate(parts))


def test_a_tally_counts_every_world_once_and_shrinks_what_it_finds(monkeypatch):
    done = []
    tally = theorem.tally(60, 3, 2.0, done.append)
    outcomes = [o for _, o in theorem.campaign(60, 3, 2.0)]
    assert (tally.runs, done[-1]) == (60, 60)
    assert (tally.violated, tally.stuck, tally.counterexamples) == (0, 0, ())
    assert tally.close == sum(o.close.sum() for o in outcomes)
    least = np.concatenate([np.where(o.unresolved, np.inf, o.least_m) for o in outcomes])
    assert tally.least_m == least.min()

    drawn = theorem.draw
    monkeypatch.setattr(theorem, "draw", lambda *args: unguarded(drawn(*args)))
    monkeypatch.setattr(theorem, "shrink", lambda world, duration_s: (world, duration_s / 2))
    tally = theorem.tally(20, 0, 2.0)
    assert tally.violated == len(tally.counterexamples) > 0
    for seed, i, world, duration_s in tally.counterexamples:
        assert (seed, duration_s) == (0, 1.0)
        assert np.array_equal(world.start, drawn(0, 2.0).one(i).start)
        assert theorem.run(world, 2.0).violated.all()


def unguarded(worlds):
    return replace(worlds, law=worlds.law.model_copy(update={"k_o": 0.0}))
