"""Breaking points: found where they are, with the interval they lie in, and honest where they are not one."""

from __future__ import annotations

from math import sin

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mjmerge
from mjmerge.errors import MjmergeError
from mjmerge.search import breaking
from mjmerge.search import report as breaking_report
from mjmerge.search.breaking import FRONTIER, WITHIN, Range, Tried, ranged, search
from mjmerge.sweep.workers import Workers

KEY = "mismatch.neighbour_position_noise_m"
OTHER = "mismatch.position_noise_m"


@pytest.fixture(scope="module")
def world():
    """Searches a made-up world, in which the margin is a function of both axes."""

    def find(margin, axis, **more):
        def measured(plan, team):
            del team
            rows = []
            for case in plan.cases:
                d = margin(case.value(KEY), case.value(OTHER), case.seed)
                rows.append(
                    {
                        "min_distance_m": d,
                        "min_clearance_m": None,
                        "unsafe_at_s": 1.0 if d is not None and d <= 0 else None,
                        "stopped": None,
                        "outcome": "failed" if d is None or d < 0.1 else "passed",
                        "verdict": "held",
                        "first_broken": None,
                        "broken_at_s": None,
                    }
                )
            return pa.Table.from_pylist(rows)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(breaking, "measured", measured)
            return search("paper", "double_integrator", [axis], {}, Workers(1), **more)

    return find


@settings(max_examples=20)
@given(st.floats(0.02, 0.98), st.sampled_from([(0.0, 1.0), (0.2, 3.0)]))
def test_a_threshold_is_found_in_an_interval_as_narrow_as_promised(world, part, ends):
    start, end = ends
    threshold = start + part * (end - start)
    (found,) = world(lambda x, _, __: threshold - x, Range(KEY, start, end))
    assert found.passes.value < threshold <= found.fails.value
    assert found.fails.value - found.passes.value <= WITHIN * (end - start)
    assert not found.again


def test_an_axis_that_gets_severe_downwards_is_searched_downwards(world):
    (found,) = world(lambda x, _, __: x - 0.3, Range(KEY, 1.0, 0.0))
    assert found.fails.value <= 0.3 < found.passes.value
    assert found.text.startswith("between 0.30")


def test_what_passes_again_beyond_the_first_break_is_reported(world):
    (found,) = world(lambda x, _, __: sin(8 * x + 1), Range(KEY, 0.0, 1.0))
    assert found.fails.value == pytest.approx(0.2677, abs=2e-3)
    assert found.again
    assert all(t.value > 0.66 for t in found.again)
    report = breaking_report.markdown([found], "x\nmismatch: friction 0.5\nset: law.k_o=0.4", "unsafe")
    assert "passes again" in report
    assert report.startswith("# Breaking points of x\n\n**mismatch: friction 0.5; set: law.k_o=0.4**\n")


def test_nothing_breaks_everything_breaks(world):
    (never,) = world(lambda *_: 1.0, Range(KEY, 0.0, 1.0))
    assert (never.fails, never.text) == (None, f"never, up to {KEY} = 1")
    (already,) = world(lambda *_: -1.0, Range(KEY, 0.0, 1.0))
    assert (already.passes, already.text) == (None, f"already at {KEY} = 0")


def test_a_point_without_data_or_with_one_bad_seed_has_failed(world):
    (found,) = world(lambda x, _, __: None if x > 0.5 else 1.0, Range(KEY, 0.0, 1.0))
    assert found.fails.value == pytest.approx(0.5, abs=1e-3)
    (found,) = world(lambda x, _, seed: 0.5 - x if seed == 2 else 1.0, Range(KEY, 0.0, 1.0), seeds=range(4))
    assert found.fails.value == pytest.approx(0.5, abs=1e-3)
    assert found.fails.case.seed == 2


def test_the_floor_breaks_before_the_margin(world):
    (found,) = world(lambda x, _, __: 0.5 - x, Range(KEY, 0.0, 1.0), until="floor")
    assert found.fails.value == pytest.approx(0.4, abs=1e-3)


def test_the_frontier_of_two_axes_is_the_line_on_which_the_margin_ends(world):
    across = Range(OTHER, 0.0, 1.0)
    found = world(lambda x, y, _: 0.9 - x - 0.5 * y, Range(KEY, 0.0, 1.0), across=across)
    assert len(found) == FRONTIER
    for line in found:
        assert line.fails.value == pytest.approx(0.9 - 0.5 * line.fixed, abs=1.1e-3)


def test_real_runs_on_both_sides_of_a_breaking_point_are_what_it_says(tmp_path):
    keys = {"duration_s": 7, "control_step_s": 0.02}
    axis = ranged("law.k_o=1:0", "charge", keys)
    (found,) = search("charge", "double_integrator", [axis], keys, Workers(1))
    for tried, safe in ((found.passes, True), (found.fails, False)):
        scenario = mjmerge.load("charge", [f"law.k_o={tried.value!r}", "duration_s=7", "control_step_s=0.02"])
        trace = mjmerge.simulate(scenario, "double_integrator")
        assert (trace.min_distance_m.min() > 0) == safe
        assert trace.min_distance_m.min() == tried.row["min_distance_m"]
    breaking_report.write([found], tmp_path, "charge", "unsafe")
    assert {p.name for p in tmp_path.iterdir()} == set(breaking_report.FILES)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("mismatch.friction", Range("mismatch.friction", 1.0, 0.01)),  # its bound, which it may not reach
        ("mismatch.neighbour_dropout", Range("mismatch.neighbour_dropout", 0.0, 0.99)),
        ("mismatch.command_delay_s", Range("mismatch.command_delay_s", 0.0, 2.0)),
        ("mismatch.friction=0.9:0.4", Range("mismatch.friction", 0.9, 0.4)),
        ("law.k_o=1:0", Range("law.k_o", 1.0, 0.0)),
    ],
)
def test_an_axis_is_searched_up_to_its_bound_or_as_told(text, expected):
    found = ranged(text, "paper", {})
    assert found.key == expected.key
    assert (found.start, found.end) == pytest.approx((expected.start, expected.end))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("mismatch.frictoin", "did you mean 'mismatch.friction'"),
        ("mismatch.tyres", "no axis of numbers"),
        ("mismatch.friction=1", "START:END"),
        ("mismatch.friction=1:1", "START:END"),
        ("law.k_o", "give a range"),
        ("law.variant", "no number"),
        ("mismatch.patch_start_m", "which way"),
    ],
)
def test_what_is_no_axis_is_refused_with_advice(text, says):
    with pytest.raises(MjmergeError, match=says):
        ranged(text, "paper", {})


@pytest.mark.parametrize(
    ("found", "what"),
    [
        ({"min_distance_m": 0.1}, "below a floor"),
        ({"min_distance_m": -0.1}, "d_j falls to 0"),
        ({"min_distance_m": 0.0}, "d_j falls to 0"),
        ({"min_distance_m": 0.1, "first_contact_s": 3.0}, "bodies touch"),
        ({"min_distance_m": -0.1, "first_contact_s": 3.0}, "bodies touch"),
        ({"min_distance_m": 0.1, "min_edge_distance_m": -0.1}, "runs off the road"),
        ({"min_distance_m": 0.1, "stopped": "ego: it is off its wheels"}, "ends early"),
        ({"min_distance_m": None, "stopped": "ego: its state is not finite"}, "ends early"),
        ({"min_distance_m": 0.0, "stopped": "ego: it touches"}, "d_j falls to 0"),
    ],
)
def test_a_plot_tells_bodies_from_margins(found, what):
    row = {"first_contact_s": None, "stopped": None} | found
    assert breaking_report.came(Tried(1.0, failed=True, runs=1, row=row, case=None)) == what
    assert breaking_report.came(Tried(1.0, failed=False, runs=1, row=row, case=None)) == "safe"
