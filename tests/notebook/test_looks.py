"""What a notebook shows, and what is named there is named as everywhere else."""

from __future__ import annotations

import re
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import mjmerge
from mjmerge import MjmergeError
from mjmerge.figures.overview import overview
from mjmerge.figures.runs import comparison, distances, opinion
from mjmerge.notebook.html import lines, table
from mjmerge.record.read import read, recording
from mjmerge.review.convert import flat
from mjmerge.run import run
from mjmerge.simulation.trace import Stop
from mjmerge.sweep.campaign import plan
from mjmerge.sweep.sweep import sweep

SCENARIO = mjmerge.load("charge", ["duration_s=0.5", "mismatch.position_noise_m=0.01"])
TRACE = mjmerge.simulate(SCENARIO, "bicycle", runs=3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder, with a recording in both formats."""
    there = tmp_path_factory.mktemp("notebook") / "runs" / "charge-bicycle-2"
    run(SCENARIO, "bicycle", seed=2, folder=there)
    return there


def texts(html):
    """Everything that is read on a page; the page is well-formed."""
    return [text.strip() for text in ElementTree.fromstring(html).itertext() if text.strip()]


def test_a_scenario_is_a_line_with_what_was_given_beside_its_file():
    cars = "<Scenario charge: 3 cars (rc), 0.5 s, law opinion_dynamics (literal)"
    assert repr(SCENARIO) == str(SCENARIO) == f"{cars}; set duration_s=0.5, mismatch.position_noise_m=0.01>"
    other = mjmerge.load("charge", ["law.kind=cbf_qp"])
    assert repr(other).endswith("12 s, law cbf_qp; set law.kind=cbf_qp>")
    assert "set" not in repr(mjmerge.load("charge"))


def test_a_page_of_a_scenario_says_who_drives_what_and_what_is_different():
    said = texts(mjmerge.load("paper", ["mismatch.friction=0.4"])._repr_html_())
    assert {"ego", "vehicle_1", "vehicle_2", "steady", "gap", "friction=0.4"} <= {*said}
    assert "friction=0.4" not in texts(mjmerge.load("paper")._repr_html_())


def test_a_trace_is_a_line_with_the_least_of_each_distance(make_trace):
    assert len(repr(TRACE)) < 200
    for j, least in enumerate(TRACE.min_distance_m.min(axis=0)):
        assert f"d_{j + 1} {least:.3f} m" in repr(TRACE)
    assert "charge on bicycle: 3 runs, seeds 0 to 2; 51 ticks to 0.5 s" in repr(TRACE)
    empty = make_trace(runs=2, stops=[Stop(1, 0.2, "ego", "unstable")])
    assert "least d_1 -, d_2 -; 1 stopped" in repr(empty)


def test_a_page_of_a_trace_has_the_worst_run_first_and_draws_it(make_trace):
    distance_m = np.full((12, 40, 2), 3.0)
    distance_m[7, 20] = -0.25, 1.5
    trace = make_trace(runs=12, distance_m=distance_m, stops=[Stop(7, 0.3, "ego", "d_1 <= 0")])
    said = texts(trace._repr_html_())
    row = said.index("stopped") + 1
    assert said[row : row + 5] == ["7", "-0.250 m", "1.500 m", "-", "0.30 s: ego, d_1 <= 0"]
    assert "and 2 more" in said
    assert trace._repr_html_().count("<polyline") == 2
    assert min(map(float, re.findall(r'text-anchor="end">(.*?)<', trace._repr_html_()))) <= -0.25
    assert "<svg" not in make_trace()._repr_html_(), "nothing is drawn of nothing"


def test_a_verdict_is_a_line_and_its_page_has_its_grounds():
    verdict = mjmerge.judge(TRACE)[1]
    assert repr(verdict) == f"<Verdict on run 1: {verdict.verdict}: {verdict.reason}; safety floor held>"
    assert {f"Verdict on run 1: {verdict.verdict}", verdict.reason, "held"} <= {*texts(verdict._repr_html_())}


def test_what_stands_in_a_table_is_text_whatever_it_says():
    rows = [["<script>", "a & b"], ['"', "'"]]
    assert texts(table(["<b>"], rows)) == ["<b>", "<script>", "a & b", '"', "'"]


@given(
    arrays(float, st.integers(1, 600), elements=st.floats(-1e6, 1e6) | st.just(np.nan)),
    st.floats(1e-3, 1e3),
)
def test_a_line_keeps_within_its_drawing_and_shows_its_least_and_largest(y, step):
    html = lines(step * np.arange(len(y)), {"d": (y, "red")}, "d (m)", "t (s)")
    assert len(html) < 12_000
    if np.isnan(y).all():
        assert html == ""
        return
    points = np.array([p.split(",") for p in re.search(r'points="(.*?)"', html)[1].split()], float)
    width, height = (float(re.search(rf'{name}="(\d+)"', html)[1]) for name in ("width", "height"))
    assert (points >= 0).all()
    assert (points <= [width, height]).all()
    tick_y = [float(v) for v in re.findall(r'<path d="M[\d.]+ ([\d.]+)H', html)]
    tick = [float(v) for v in re.findall(r'text-anchor="end">(.*?)<', html)]
    back = np.interp(points[:, 1], tick_y[::-1], tick[::-1])
    pixel = (tick[-1] - tick[0]) / (tick_y[0] - tick_y[-1])
    assert back.min() == pytest.approx(np.nanmin(y), abs=0.2 * pixel)
    assert back.max() == pytest.approx(np.nanmax(y), abs=0.2 * pixel)


def test_a_frame_has_the_names_and_numbers_of_a_converted_recording(folder):
    alone = TRACE.frame(run=2)
    columns = flat(read(recording(folder)))
    assert [alone.index.name, *alone.columns] == [*columns]
    assert alone.index.to_numpy().tobytes() == columns["time_s"].tobytes()
    for name in alone:
        np.testing.assert_array_equal(alone[name].to_numpy(), columns[name], err_msg=name)


@pytest.mark.parametrize(("run", "says"), [(3, "run is 3; .* at most 2"), ("0", "whole")])
def test_a_frame_or_figure_of_a_run_that_is_not_there_is_refused(run, says):
    for asked in (TRACE.frame, lambda run: overview(TRACE, run)):
        with pytest.raises(MjmergeError, match=says):
            asked(run)


def test_without_pandas_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MjmergeError, match=r"pip install 'mjmerge\[notebook\]'"):
        TRACE.frame()


@pytest.mark.parametrize("name", ["", "run.mcap", "run.rrd"])
def test_a_run_is_read_as_the_trace_that_it_was(folder, name):
    found, was = mjmerge.read(folder / name), TRACE.alone(2, SCENARIO)
    assert found.scenario == SCENARIO
    assert isinstance(found, mjmerge.Trace)
    assert [found.plant, *found.seeds] == ["bicycle", 2]
    for column in was.columns:
        np.testing.assert_array_equal(found.column(column.name), was.column(column.name), err_msg=column.name)
    assert found.verdict == mjmerge.judge(was)[0]
    assert found.verdict.verdict == found.recorded.verdict
    assert found.frame().equals(was.frame())


def test_a_run_is_read_by_its_name_and_a_wrong_name_is_told_with_the_nearest(folder, monkeypatch):
    monkeypatch.chdir(folder.parents[1])
    assert mjmerge.read("charge-bicycle-2").seeds == [2]
    for wrong, right in (
        ("charge-bicycle-3", "charge-bicycle-2"),
        ("runs/charge-bycicle-2", "charge-bicycle-2"),
        (folder / "run.mcab", "run.mcap"),
    ):
        with pytest.raises(MjmergeError, match=re.escape(f"of that name; did you mean '{right}'?")):
            mjmerge.read(wrong)
    with pytest.raises(MjmergeError, match=r"of that name$"):
        mjmerge.read("nothing/like/it")


@pytest.mark.parametrize("given", [None, 3, b"run.mcap", SCENARIO])
def test_what_is_no_path_cannot_be_read(given):
    with pytest.raises(MjmergeError, match="expected the path of a run folder, recording or sweep, got"):
        mjmerge.read(given)


def test_a_sweep_is_read_as_its_table_and_not_before_there_is_one(tmp_path):
    (tmp_path / "two.yaml").write_text(
        "blocks: [{scenarios: [paper], plants: [bicycle], set: {duration_s: 0.2}}]"
    )
    runs = plan(tmp_path / "two.yaml")
    made = sweep(runs, tmp_path / "swept")
    assert mjmerge.read(tmp_path / "swept").equals(made)
    (tmp_path / "swept" / "table.parquet").unlink()
    with pytest.raises(MjmergeError, match="not finished: run it again"):
        mjmerge.read(tmp_path / "swept")
    (tmp_path / "swept" / "table.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(MjmergeError, match="cannot read"):
        mjmerge.read(tmp_path / "swept")


PANELS = [
    (lambda axes: overview(TRACE, 1, axes=axes), 3),
    (lambda axes: opinion(TRACE, axes=axes), 2),
    (lambda axes: opinion(TRACE, TRACE, axes=axes), 4),
    (lambda axes: distances(TRACE, axes=axes), 1),
    (lambda axes: distances(TRACE, TRACE, axes=axes), 2),
    (lambda axes: comparison(TRACE, TRACE, ("a", "b"), axes=axes), 4),
]


@pytest.mark.parametrize(("draw", "wanted"), PANELS)
def test_a_figure_is_returned_and_drawn_into_the_axes_that_are_given(draw, wanted):
    from matplotlib.figure import Figure

    own = draw(None)
    assert isinstance(own, Figure)
    mine = Figure()
    axes = mine.subfigures(1, 2)[1].subplots(wanted)
    assert draw(axes) is mine
    for panel, there in zip(own.axes, np.ravel(axes), strict=True):
        assert panel.get_ylabel() == there.get_ylabel()
        assert [line.get_xydata().tobytes() for line in panel.lines] == [
            line.get_xydata().tobytes() for line in there.lines
        ]
    with pytest.raises(MjmergeError, match=f"has {wanted} panels: pass as many axes, got {wanted + 1}"):
        draw(mine.subplots(wanted + 1))
