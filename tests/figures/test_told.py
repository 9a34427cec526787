"""Figures say what ran and what broke, in marks and words as well as colours, and hide nothing."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mjmerge
from mjmerge.figures.overview import overview
from mjmerge.figures.runs import comparison, distances, opinion
from mjmerge.figures.style import LETTERS, End, ends, fold, sheet, words
from mjmerge.search.breaking import Break, Range, Tried
from mjmerge.search.ladder import Ladder, Rung, waterfall
from mjmerge.search.report import along_axes, frontier
from mjmerge.sweep.campaign import plan
from mjmerge.sweep.figures import figures

SHORT = ["duration_s=1"]


@pytest.fixture(scope="module")
def paper():
    return mjmerge.simulate(mjmerge.load("paper", ["duration_s=5"]), "double_integrator")


def legends(figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@given(st.integers(-999, 999), st.sampled_from(["m", "mm", "s", "m/s", "m/s²"]), st.integers(0, 120))
def test_a_number_has_the_minus_of_the_axes_and_stands_beside_its_unit(number, unit, before):
    text = f"{'x' * before} least {number} {unit}; law.k_o={number}, car-518, $a"
    assert fold(text)[0].count("x") == min(before, LETTERS)
    assert any(f"{number} {unit}" in line for line in fold(text))
    minus = f"{number}".replace("-", "\N{MINUS SIGN}")
    assert words(text) == text.replace(f" {number} ", f" {minus} ").replace(
        f"={number}", f"={minus}"
    ).replace("$", "\\$")


def test_before_a_car_runs_away_everything_can_be_seen(paper):
    late = ["duration_s=8", "mismatch.command_delay_s=0.2", "law.k_o=0.4"]
    trace = mjmerge.simulate(mjmerge.load("charge", late), "bicycle")
    assert np.nanmax(np.abs(trace.front_m[0, :, 0, 1])) > 1e4, "it runs away"
    width_m = trace.scenario.road.lane_width_m
    for figure in (overview(trace), opinion(trace), distances(trace)):
        for axes in figure.axes:
            assert np.ptp(axes.get_ylim()) < 40 * width_m
            assert all(0 <= text.get_position()[1] < 1.1 for text in axes.texts), "and every name"
    near = distances(paper).axes[0].get_ylim()
    assert near[0] < np.nanmin(paper.distance_m) < np.nanmax(paper.distance_m) < near[1]


@pytest.mark.parametrize("last", [-9.0, 0.5, 9.0])
def test_a_curve_that_ends_outside_its_panel_has_its_name_beside_it(last):
    _, (axes,) = sheet((1,), 3.0)
    axes.set_ylim(0, 1)
    ends(axes, [End("far", np.array([0.5, last, np.nan]), "black")])
    assert [text.get_position()[1] for text in axes.texts] == [np.clip(last, 0, 1)]


def test_an_edge_far_away_leaves_the_distances_their_room():
    trace = mjmerge.simulate(mjmerge.load("ramp_small", SHORT), "bicycle")
    axes = overview(trace).axes[2]
    assert np.nanmax(trace.edge_distance_m) > 10 > 1.2 * np.nanmax(trace.distance_m) > axes.get_ylim()[1]
    assert f"edge, least {np.nanmin(trace.edge_distance_m):.3f} m" in [t.get_text() for t in axes.texts]


def test_which_gap_it_goes_for_is_told_below_and_hides_no_curve():
    trace = mjmerge.simulate(mjmerge.load("platoon_8_small", ["duration_s=3"]), "bicycle")
    figure = overview(trace)
    told = figure.get_supxlabel().splitlines()
    assert told[0] == "1  0.00 s  the ego goes for the gap between vehicles 3 and 4"
    assert told[1].endswith("s  the ego goes for the gap between vehicles 5 and 6")
    inside = [text for text in figure.axes[0].texts if 0 <= text.get_position()[1] <= 1]
    assert [text for text in inside if "between" in text.get_text()] == []
    names = [text.get_text() for text in figure.axes[1].texts]
    assert names == ["ego", "vehicles 1 to 6", "vehicles 7, 8"], "curves that cover each other have one name"


def test_of_many_choices_the_last_is_told(monkeypatch):
    trace = mjmerge.simulate(mjmerge.load("platoon_8_small", SHORT), "double_integrator")
    monkeypatch.setattr("mjmerge.figures.overview.chosen_anew", lambda *_: [*range(0, 60, 5)])
    (told,) = overview(trace).get_supxlabel().splitlines()
    assert told.startswith(
        f"1  {trace.time_s[55]:.2f} s  the ego, for the last of 12 times, goes for the gap"
    )


@pytest.mark.parametrize("draw", [opinion, distances])
def test_a_figure_of_the_paper_names_its_runs_and_has_no_legend(paper, draw):
    other = mjmerge.simulate(mjmerge.load("paper", ["duration_s=5", "law.k_o=0.5"]), "double_integrator")
    ran = "paper on double_integrator, seed 0"
    assert draw(paper).get_suptitle() == f"{ran}\nset: duration_s=5"
    figure = draw(other, paper)
    assert figure.get_suptitle().splitlines() == [
        f"line: {ran}; set: duration_s=5, law.k_o=0.5",
        f"broad, pale: {ran}; set: duration_s=5",
    ]
    assert [axes.get_legend() for axes in figure.axes] == [None] * len(figure.axes)
    assert "vehicle 2 closes the gap" in [text.get_text() for text in figure.axes[0].texts]


def test_a_comparison_says_nothing_twice_and_names_the_curves_of_both(paper):
    eight = mjmerge.simulate(mjmerge.load("platoon_8_small", SHORT), "double_integrator")
    figure = comparison(eight, paper, ("A: x", "paper on double_integrator, seed 0"))
    said = figure.get_suptitle()
    assert said.count("paper on double_integrator") == 1
    assert {text.get_text() for text in figure.axes[2].texts} == {f"$d_{{{j}}}$" for j in range(1, 9)}


def test_a_ladders_bars_end_at_what_they_say_and_its_steps_have_the_unit_of_a_person():
    scenario = mjmerge.load("charge")
    case = SimpleNamespace(batch=SimpleNamespace(overrides=("law.k_o=1",)))
    for least, unit in (((0.2, 0.15, -0.3), "m"), ((0.2, 0.19, 0.192), "mm")):
        costs = (None, *(a - b for a, b in pairwise(least)))
        rungs = [
            Rung(str(k), "", case, {"min_distance_m": m}, cost, {})
            for k, (m, cost) in enumerate(zip(least, costs, strict=True))
        ]
        figure = waterfall(Ladder(scenario, 0.02, True, tuple(rungs)))
        bars, steps = figure.axes
        assert [bar.get_height() for bar in bars.patches] == list(least)
        scale = 1e3 if unit == "mm" else 1.0
        assert [bar.get_height() for bar in steps.patches] == pytest.approx([-scale * c for c in costs[1:]])
        assert steps.get_ylabel() == f"this step adds ({unit})"
        assert "set: law.k_o=1" in figure.get_suptitle()
        assert words(f"{least[-1]:.3f} m") in [text.get_text() for text in bars.texts]
        assert all(text.get_text()[0] in "+\N{MINUS SIGN}" for text in steps.texts)


def tried(value: float, least_m: float, **found) -> Tried:
    row = {"min_distance_m": least_m, "first_contact_s": None, "stopped": None} | found
    return Tried(value, least_m <= 0 or bool(found), 1, row, None)


def test_breaking_points_and_their_frontier_say_what_broke_below_all_panels():
    points = (tried(0.0, 0.2), tried(0.5, 0.1, first_contact_s=1.0), tried(1.0, -0.1))
    line = Break(Range("mismatch.friction", 0.0, 1.0), 0.5, points)
    safe = Break(Range("mismatch.steer_lag", 0.0, 1.0), None, points[:1])
    alone = along_axes([line, safe], "charge on mujoco; set: law.k_o=1", "unsafe")
    both = frontier([line], "charge on mujoco", Range("law.k_o", 0.0, 1.0), "unsafe")
    assert legends(alone) == ["safe", "bodies touch", "$d_j$ falls to 0"]
    assert legends(both) == [*legends(alone), "first break, or end of the search"]
    assert legends(along_axes([line], "", "floor"))[0] == "above the floor"
    assert alone.get_suptitle() == "charge on mujoco; set: law.k_o=1"
    assert alone.axes[1].get_title(loc="left") == "does not break, up to mismatch.steer_lag = 1"
    marks = {tuple(c.get_paths()[0].vertices.ravel()) for c in both.axes[0].collections}
    assert len(marks) == 3, "a mark each, not a colour alone"


def test_a_campaigns_marks_tell_laws_apart_and_open_ones_failed(tmp_path):
    text = (
        "blocks: [{scenarios: [charge], plants: [double_integrator], variants: [literal, gated], "
        "set: {duration_s: 0.5}, %s}]"
    )
    named = "mismatches: {none: {}, late: {mismatch.command_delay_s: 0.1}}"
    grid = "random: {draws: 4, axes: {mismatch.command_delay_s: {uniform: [0, 0.2]}}}"
    for more, at in ((named, 0), (grid, 1)):
        (tmp_path / "c.yaml").write_text(text % more)
        runs = plan(tmp_path / "c.yaml")
        rows = [
            {
                **{axis: case.value(axis) for axis in runs.axes},
                "scenario": "charge",
                "plant": "double_integrator",
                "variant": case.batch.scenario.law.label,
                "mismatch": case.point,
                "outcome": "failed" if k % 2 else "passed",
                "min_distance_m": 0.1 * k,
                "first_contact_s": 1.0 if k % 2 else None,
                "stopped": None,
                "floor_m": 0.0,
            }
            for k, case in enumerate(runs.cases)
        ]
        ((_, figure),) = figures(runs, rows)
        assert figure.get_suptitle() == "charge on double_integrator; set: duration_s=0.5"
        shown = [c for c in figure.axes[0].collections if len(c.get_offsets())]
        shapes = {tuple(c.get_paths()[0].vertices.ravel()) for c in shown}
        assert len(shapes) == 2, "a mark for each law"
        is_open = [
            tuple(c.get_facecolor()[0][:3]) == (1, 1, 1) if len(c.get_facecolor()) else True for c in shown
        ]
        assert sorted(is_open) == [False, False, True, True]
        assert ("bodies touch" in legends(figure)) == bool(at)
