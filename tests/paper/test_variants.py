"""The law's variants: what each changes and what it leaves, how they combine, and how they are named."""

from itertools import combinations, permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge import MjmergeError, load, simulate
from mjmerge.errors import ScenarioError
from mjmerge.law import VARIANTS, OpinionDynamics, Sensed
from mjmerge.law.opinion_dynamics.barrier import barrier
from mjmerge.law.opinion_dynamics.law import decide
from mjmerge.law.opinion_dynamics.opinion import advance, bifurcation_input
from mjmerge.law.opinion_dynamics.variants import PARTS, reading

LITERAL = OpinionDynamics(r_rho_m=-1.2, r_eta_m=1.4)
ALL = [c for n in range(1, len(PARTS) + 1) for c in combinations(PARTS, n)]

angle, distance, rate = st.floats(-np.pi, np.pi), st.floats(-3, 10), st.floats(-5, 5)


def law(variant, **keys):
    return LITERAL.model_copy(update={"variant": variant, **keys})


def u_c(variant, a, d, d_dot, **keys):
    """Barrier's push along g against one neighbour, the other keeping its distance."""
    g = np.array([[[np.cos(a), np.sin(a)], [1.0, 0.0]]])
    pushed = barrier(law(variant, **keys), g, np.array([[d, 1.0]]), np.array([[d_dot, 0.0]]))
    return float(pushed[0] @ g[0, 0])


def situation(seed, runs=40):
    """What egos sense anywhere, some of them inside a margin."""
    rng = np.random.default_rng(seed)
    shapes = ((2,), (2,), (2, 2), (2, 2), (2,))
    return Sensed(*(rng.uniform(-2, 2, (runs, *s)) for s in shapes)), rng.uniform(0, 0.2, runs)


def test_each_is_explained_in_a_line():
    assert set(VARIANTS) == {"literal", *PARTS}
    for why in VARIANTS.values():
        assert 20 < len(why) < 110
        assert "\n" not in why


@pytest.mark.parametrize(
    ("variant", "message"),
    [
        ("gatd", "no law variant called 'gatd': did you mean 'gated'?"),
        ("gated+one-sided", "no law variant called 'one-sided': did you mean 'one_sided'?"),
        ("gated+gated", "'gated' stands in 'gated+gated' more than once"),
        ("gated+literal", "'literal' is the law without any other part; drop it from 'gated+literal'"),
        ("literal+literal", "'literal' stands in 'literal+literal' more than once"),
        ("gated+", "no law variant called '': valid names: capped, gated"),
        ("", "no law variant called ''"),
    ],
)
def test_a_variant_that_is_none_is_refused_before_anything_runs(variant, message):
    with pytest.raises(ScenarioError) as refused:
        load("paper", [f'law.variant="{variant}"'])
    (problem,) = refused.value.problems
    assert problem.key == "law.variant"
    assert message in problem.message
    with pytest.raises(MjmergeError):
        reading(variant)


def test_every_wrong_name_is_reported():
    with pytest.raises(ScenarioError) as refused:
        load("paper", ["law.variant=gatd+caped+gated"])
    assert len(refused.value.problems) == 2


def test_the_order_of_the_parts_does_not_matter_to_the_last_bit():
    sensed, z = situation(0)
    for names in permutations(("capped", "guarded", "one_sided")):
        made = decide(law("+".join(names)), sensed, z)
        assert np.array_equal(made.u, decide(law("capped+guarded+one_sided"), sensed, z).u)


@pytest.mark.parametrize("names", ALL, ids="+".join)
def test_any_combination_gives_numbers_and_changes_only_what_its_parts_say(names):
    variant = law("+".join(names))
    sensed, z = situation(1)
    made, printed = decide(variant, sensed, z), decide(LITERAL, sensed, z)
    for name, value in (vars(made) | vars(made.geometry)).items():
        assert name == "geometry" or np.isfinite(value).all(), name
    for name in ("d", "d_dot", "dbar", "dbar_dot"):
        assert np.array_equal(getattr(made.geometry, name), getattr(printed.geometry, name))
    for name in ("w", "e_1_star"):
        assert np.array_equal(getattr(made, name), getattr(printed, name))
    assert np.array_equal(made.mu_input, printed.mu_input) == ("gated" not in names)
    assert np.array_equal(made.u_n, printed.u_n) == ("no_u1" not in names)
    about_the_barrier = {"one_sided", "guarded", "capped"} & set(names)
    assert np.array_equal(made.u_c, printed.u_c) == (not about_the_barrier)
    low = np.full(3, 1e-9)
    stepped = advance(variant, low, low, low - 0.5, 0.01)[0]
    assert np.all(stepped == variant.z_floor) == ("z_floor" in names)


@pytest.mark.parametrize("variant", ["gated+one_sided+z_floor", "capped+guarded+no_u1"])
def test_a_combination_runs(variant):
    trace = simulate(load("charge", [f"law.variant={variant}", "duration_s=6"]), "double_integrator")
    assert not trace.stops
    assert (trace.min_distance_m > 0).all()


def conditions(beside, room, open_):
    """Arguments of the mu-law with the three conditions at these margins."""
    dbar = 2 * LITERAL.r_m + room
    return np.array([[0.6, -0.6 * beside]]), np.array([dbar]), np.array([(open_ - LITERAL.eps_1) * dbar])


margin = st.floats(-0.5, 0.5)


@given(margin, margin, margin)
def test_gated_mu_rises_only_if_all_three_hold_and_as_much_as_printed(beside, room, open_):
    arguments = conditions(beside, room, open_)
    gated = bifurcation_input(law("gated"), *arguments)[0]
    printed = bifurcation_input(LITERAL, *arguments)[0]
    assert abs(gated) == abs(printed)
    if gated > 0:
        assert min(beside, room, open_) > -1e-12
    if min(beside, room, open_) > 1e-12:
        assert gated == printed
        assert gated >= 0


@pytest.mark.parametrize("signs", list(product((1, -1), repeat=3)))
@pytest.mark.parametrize("at_zero", range(3))
def test_gated_does_not_jump_where_a_condition_changes(signs, at_zero):
    sides = []
    for side in (1e-9, -1e-9):
        margins = [0.4 * s for s in signs]
        margins[at_zero] = side
        sides.append(bifurcation_input(law("gated"), *conditions(*margins))[0])
    assert sides == pytest.approx([0, 0], abs=1e-7)


@given(angle, distance, rate)
def test_one_sided_is_the_printed_barrier_while_closing_and_nothing_else(a, d, d_dot):
    assert u_c("one_sided", a, d, d_dot) == (u_c("literal", a, d, d_dot) if d_dot < 0 else 0)


@given(angle, distance, rate)
def test_capped_is_the_printed_barrier_up_to_its_cap(a, d, d_dot):
    pushed = u_c("capped", a, d, d_dot, d_cap_m=0.2)
    if d >= 0.2:
        assert pushed == u_c("literal", a, d, d_dot)
    else:
        assert pushed == pytest.approx(-LITERAL.k_o * d_dot / 0.2, rel=1e-9, abs=1e-12)


@given(angle, st.one_of(distance, st.sampled_from([0.0, -0.0, 1e-320, -1e-320])), rate)
def test_guarded_never_pulls_inward_inside_the_margin(a, d, d_dot):
    pushed = u_c("guarded", a, d, d_dot)
    if d > 0:
        assert pushed == u_c("literal", a, d, d_dot)
    else:
        assert pushed == pytest.approx(LITERAL.k_o * max(-d_dot, 0) / LITERAL.d_cap_m, rel=1e-9, abs=1e-12)


def test_no_u1_is_the_printed_law_beside_a_leader_that_does_not_accelerate():
    sensed, z = situation(2)
    quiet = Sensed(sensed.p, sensed.v, sensed.p_j, sensed.v_j, np.zeros_like(sensed.u_1))
    assert np.array_equal(decide(law("no_u1"), sensed, z).u, decide(LITERAL, quiet, z).u)


def test_a_floor_under_z_bounds_the_memory_of_a_refusal():
    def time_to_agree(variant, refused_s, h=0.01):
        z, mu = np.array([0.15]), np.array([0.2])
        for _ in range(round(refused_s / h)):
            z, mu = advance(variant, z, mu, np.array([-1.0]), h)
        for k in range(10_000):
            if np.tanh(variant.k_w * z[0]) > 0.5:
                return k * h
            z, mu = advance(variant, z, mu, np.array([1.0]), h)
        return np.inf

    assert time_to_agree(LITERAL, 20.0) == pytest.approx(20.0, abs=1.0)  # as long as it was refused
    assert time_to_agree(LITERAL, 200.0) == np.inf  # underflow
    floor = law("z_floor")
    assert time_to_agree(floor, 20.0) < 1.5
    assert time_to_agree(floor, 200.0) == time_to_agree(floor, 20.0)
