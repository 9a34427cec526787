"""Decision metrics on traces made by hand, tick by tick."""

import numpy as np
import pytest

from mjmerge import load, simulate
from mjmerge.verdict.decision import conditions, decision

T, H = 100, 0.01
GOOD = {"x": -1.2, "gap": 2.0, "rate": 0.0}  # beside a gap that is wide (2 r = 1.2) and stays so


@pytest.fixture
def made(make_trace):
    """A trace from functions of the tick: what the gap is like, what drives mu, and what the ego wants."""

    def build(situation, weight=0.0, mu_input=0.0, y=1.0, **given):
        where = [situation(k) for k in range(T)]
        front = np.zeros((1, T, 3, 2))
        front[0, :, 0, 0] = [s["x"] for s in where]
        front[0, :, 0, 1] = y
        front[0, :, 2, 0] = -2.6
        columns = {
            "front_m": front,
            "gap_m": np.array([[s["gap"] for s in where]]),
            "gap_rate_mps": np.array([[s["rate"] for s in where]]),
            "weight": weight,
            "mu_input_per_s": mu_input,
            "opinion": 0.1,
        }
        return make_trace(ticks=T, overrides=["law.r_eta_m=1.0"], **(columns | given))

    return build


def only(trace):
    (found,) = decision(trace)
    return found


def after(tick, late):
    """``GOOD`` until a tick, then with something else."""
    return lambda k: GOOD | (late if k >= tick else {})


@pytest.mark.parametrize(
    ("change", "which"),
    [({"x": 0.5}, 0), ({"x": -3.0}, 0), ({"gap": 1.19}, 1), ({"rate": -1.01}, 2)],
    ids=["ahead", "behind", "narrow", "closing"],
)
def test_each_condition_is_about_one_thing(made, change, which):
    """The gap stays open while its rate is above -eps_1 times its width: -1 m/s here."""
    found = conditions(made(after(0, change)))[0, 0]
    assert [bool(c) for c in found] == [i != which for i in range(3)]


def test_wrong_sign_time_counts_ticks_where_mu_is_driven_up_against_a_condition(made):
    up = np.where(np.arange(T) % 2, 0.9, -0.9)[None]
    assert only(made(after(60, {"gap": 1.0}), mu_input=up)).wrong_sign_s == pytest.approx(20 * H)
    assert only(made(after(T, {}), mu_input=up)).wrong_sign_s == 0


def test_refusal_memory_is_the_time_from_all_true_again_to_wanting(made):
    weight = (np.arange(T) >= 70)[None] * 0.9
    narrow = lambda k: GOOD | ({"gap": 1.0} if k < 40 else {})  # noqa: E731
    assert only(made(narrow, weight=weight)).refusal_memory_s == pytest.approx(30 * H)
    assert only(made(narrow, weight=0.0)).refusal_memory_s is None  # never came back
    assert only(made(narrow, weight=0.9)).refusal_memory_s is None  # never stopped wanting


def test_a_chance_that_passes_unused_is_no_memory(made):
    weight = (np.arange(T) >= 70)[None] * 0.9
    briefly = lambda k: GOOD | ({} if 20 <= k < 30 or k >= 65 else {"gap": 1.0})  # noqa: E731
    assert only(made(briefly, weight=weight)).refusal_memory_s == pytest.approx(5 * H)


def test_abort_time_is_from_a_condition_turning_false_to_no_longer_wanting(made):
    weight = (np.arange(T) < 55)[None] * 0.9
    assert only(made(after(40, {"gap": 1.0}), weight=weight)).abort_s == pytest.approx(15 * H)
    assert only(made(after(40, {"gap": 1.0}), weight=0.1)).abort_s is None  # had not meant to


def test_straddling_is_between_a_fifth_and_four_fifths_of_the_way_across(made):
    y = np.linspace(1.0, 0.0, T)  # lanes 1 m apart
    assert only(made(after(T, {}), y=y)).straddling_s == pytest.approx(0.6, abs=2 * H)
    assert only(made(after(T, {}), y=-y)).straddling_s == pytest.approx(0.6, abs=2 * H)


def test_an_opinion_below_the_smallest_normal_number_is_an_underflow(made):
    z = np.full((1, T), 0.1)
    z[0, 50] = 1e-300
    assert not only(made(after(T, {}), opinion=z)).underflow
    z[0, 50] = 1e-310
    assert only(made(after(T, {}), opinion=z)).underflow


def test_missing_ticks_count_for_nothing(made):
    front = np.full((1, T, 3, 2), np.nan)
    found = only(
        made(after(T, {}), front_m=front, gap_m=np.nan, weight=np.nan, mu_input=np.nan, opinion=np.nan)
    )
    assert (found.wrong_sign_s, found.refusal_memory_s, found.abort_s, found.straddling_s) == (
        0,
        None,
        None,
        0,
    )
    assert not found.underflow


def test_the_gated_law_is_never_driven_the_wrong_way():
    """Where the literal product is: a gap too narrow that closes fast."""
    drivers = (
        "drivers.vehicle_2={kind: gap, gap_m: 1.9, moves: [{start_s: 0.5, duration_s: 0.6, gap_m: 1.3}]}"
    )
    start = ["initial.vehicle_2.front_m=[-1.9, 0]", "law.r_rho_m=-0.9", "duration_s=2", drivers]
    wrong = {}
    for variant in ("literal", "gated"):
        scenario = load("paper", [*start, f"law.variant={variant}"])
        wrong[variant] = only(simulate(scenario, "double_integrator")).wrong_sign_s
    assert wrong["gated"] == 0
    assert wrong["literal"] > 0
