"""The figure of a run says what ran, what came of it, and when what happened."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_hex

import mjmerge
from mjmerge.figures.overview import overview, ran
from mjmerge.figures.runs import comparison
from mjmerge.figures.style import apart, length, save
from mjmerge.roster import colour
from mjmerge.verdict.judge import judge

LATE = "mismatch.command_delay_s=0.2"


@pytest.fixture(scope="module")
def unsafe():
    """One that is too late, of two runs the second, on a plant with bodies but without physics."""
    trace = mjmerge.simulate(mjmerge.load("charge", ["duration_s=8", LATE, "law.k_o=0.4"]), "bicycle", runs=2)
    return trace, judge(trace)


def test_the_title_has_every_mismatch_and_all_that_was_given_beside_the_file(unsafe):
    trace, _ = unsafe
    title = overview(trace, 1).get_suptitle()
    assert title.splitlines()[0] == "charge on bicycle, seed 1"
    assert "mismatch: command_delay_s 0.2" in title
    assert "law.k_o=0.4" in title
    plain = mjmerge.simulate(mjmerge.load("charge"), "double_integrator")
    assert overview(plain).get_suptitle() == "charge on double_integrator, seed 0"


def test_the_mismatch_in_the_title_is_that_of_the_run_and_not_of_its_scenario():
    scenario = mjmerge.load("charge", ["duration_s=1"])
    cases = [(0, scenario.mismatch), (5, mjmerge.load("charge", [LATE]).mismatch)]
    trace = mjmerge.simulate(scenario, "bicycle", cases=cases)
    assert "command_delay" not in overview(trace, 0).get_suptitle()
    assert "seed 5\nmismatch: command_delay_s 0.2" in overview(trace, 1).get_suptitle()


def test_the_verdict_its_floor_and_what_happened_stand_in_it_in_order(unsafe):
    trace, verdicts = unsafe
    (verdict, figure) = verdicts[1], overview(trace, 1, verdict=verdicts[1])
    assert verdict.unsafe_at_s is not None
    said = figure.axes[0].get_title(loc="left").replace("\n", " ")
    assert said.startswith(f"{verdict.verdict}: {verdict.reason[:40]}")
    assert said.endswith("safety floor 0.1 m BROKEN")
    lines = figure.get_supxlabel().splitlines()
    assert [line.split()[0] for line in lines] == [str(i + 1) for i in range(len(lines))]
    times = [float(line.split()[1]) for line in lines]
    assert times == sorted(times)
    for breach in verdict.breaches:
        assert any(f"{breach.time_s:.2f} s  hypothesis broken: {breach.hypothesis}" in line for line in lines)
    at = [line.get_xdata()[0] for line in figure.axes[2].lines if len({*line.get_xdata()}) == 1]
    assert {breach.time_s for breach in verdict.breaches} <= {*at}


def test_every_curve_has_its_name_at_its_end_in_its_colour(unsafe):
    trace, _ = unsafe
    figure = overview(trace, 1)
    assert [axes.get_legend() for axes in figure.axes] == [None] * 3, "a legend would hide something"
    lateral = {text.get_text(): text.get_color() for text in figure.axes[1].texts}
    assert lateral == {"ego": colour("ego"), "vehicles 1, 2": colour("vehicle_1")}
    least = {text.get_text(): to_hex(text.get_color()) for text in figure.axes[2].texts}
    for j, car in enumerate(trace.roster.neighbours):
        d = f"{np.nanmin(trace.distance_m[1, :, j]):.3f} m".replace("-", "\N{MINUS SIGN}")
        assert least[f"$d_{{{j + 1}}}$, least {d}"] == colour(car)
    assert "floor 0.1 m" in least


@pytest.mark.parametrize("plant", ["double_integrator", "bicycle"])
def test_points_have_no_distance_between_bodies(plant):
    trace = mjmerge.simulate(mjmerge.load("charge", ["duration_s=1"]), plant)
    dashed = [line for line in overview(trace).axes[2].lines if line.get_linewidth() == 0.9]
    assert len(dashed) == (0 if np.isnan(trace.clearance_m).all() else 2) + 1  # and the floor


def test_what_ended_early_is_drawn_as_far_as_it_goes():
    trace = mjmerge.simulate(mjmerge.load("charge", ["duration_s=1"]), "double_integrator")
    for k in (0, 40):
        short = {n: np.where(np.arange(101) < k, getattr(trace, n).T, np.nan).T for n in ("opinion", "mu")}
        cut = {n: getattr(trace, n).copy() for n in ("distance_m", "front_m", "u_mps2")}
        for values in cut.values():
            values[:, k:] = np.nan
        figure = overview(type(trace)(**vars(trace) | short | cut), verdict=judge(trace)[0])
        figure.draw_without_rendering()


@given(st.lists(st.floats(0, 1), min_size=1, max_size=9), st.floats(0.01, 0.1))
def test_names_are_a_line_apart_in_the_order_of_their_curves_and_within_the_panel(at, gap):
    found = apart(at, gap)
    order = np.argsort(at, kind="stable")
    assert all(found[b] - found[a] >= gap - 1e-12 for a, b in pairwise(order))
    assert max(found) <= 1
    assert min(found) >= min(0.0, 1 - gap * (len(at) - 1)) - 1e-12
    if all(b - a >= gap for a, b in pairwise(sorted(at))):
        assert found == at, "nothing moves that need not"


@given(st.floats(1e6, 1e308))
def test_a_length_that_no_road_has_is_no_longer_a_text(value_m):
    for signed in (value_m, -value_m):
        assert len(length(signed)) < 14
        assert float(length(signed).split()[0]) == pytest.approx(signed, rel=0.006)


@given(st.floats(-1e4, 1e4))
def test_a_length_is_in_the_unit_of_a_person_and_right_to_its_digits(value_m):
    said = length(value_m)
    number, unit = said.split()
    back_m = float(number) * {"mm": 1e-3, "m": 1.0}[unit]
    assert (unit == "mm") == (abs(value_m) < 0.1)
    assert abs(back_m - value_m) <= max(0.006 * abs(value_m), 0.6e-5)
    assert "e" not in number
    assert length(value_m, sign="+").lstrip("+") == said


def test_however_long_the_names_of_two_runs_are_their_figure_has_room_and_says_them(tmp_path):
    trace = mjmerge.simulate(mjmerge.load("charge", ["duration_s=0.5"]), "double_integrator")
    late = mjmerge.simulate(mjmerge.load("charge", ["duration_s=0.5", LATE]), "bicycle")
    names = f"A: {'$a/very/long/folder' * 9}/run.mcap", f"B: {'b/' * 90}run.rrd"
    figure = comparison(trace, late, names)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of matplotlib: that no room is left for the panels
        save(figure, tmp_path / "figure.png")
    said = figure.get_suptitle().replace("\n", "").replace("\\$", "$").replace(" ", "")
    for name, one in zip(names, (trace, late), strict=True):
        assert name.replace(" ", "") + ";" + ";".join(ran(one)).replace(" ", "") in said
    assert [text.get_text() for text in figure.axes[0].get_legend().get_texts()] == ["A", "B"]
