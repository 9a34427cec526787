"""Lane frames: along and across are what geometry says, however the bounds are sampled."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.traffic.lanes import frame, goes_on, located
from mjmerge.traffic.tracks import OUTSIDE, Lane


def arc(name, radius_m, from_rad, to_rad, points, after=(), turned_rad=0.0, width_m=3.5):
    """A lane around the origin, to the left, sampled unevenly."""
    angle = from_rad + (to_rad - from_rad) * np.linspace(0, 1, points) ** 1.3 + turned_rad
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Lane(name, (radius_m - width_m / 2) * unit, (radius_m + width_m / 2) * unit, after)


def line(name, start_m, end_m, after=(), y_m=0.0):
    x = np.array([start_m, end_m])
    return Lane(name, *(np.stack([x, np.full(2, y_m + up)], axis=1) for up in (1.75, -1.75)), after)


@given(
    radius_m=st.floats(150, 1000),
    angle=st.floats(0.1, 0.9),
    across_m=st.floats(-4, 4),
    points=st.integers(12, 200),
    turned_rad=st.floats(-3, 3),
)
def test_along_and_across_a_circle_are_its_arc_and_radius(radius_m, angle, across_m, points, turned_rad):
    whole_rad = min(1.5, 300 / radius_m)
    lanes = {"a": arc("a", radius_m, 0.0, whole_rad, max(points, round(40 * whole_rad)), (), turned_rad)}
    at = whole_rad * angle + turned_rad
    point = (radius_m - across_m) * np.array([[np.cos(at), np.sin(at)]])
    found = frame(lanes, "a")
    along_m, off_m = found.place(point)[0]
    sag_m = radius_m * (whole_rad / (points - 1) * 1.3) ** 2 / 8 + 8**2 / (2 * radius_m)
    assert abs(off_m - across_m) <= sag_m + 0.02
    assert abs(along_m - radius_m * (at - turned_rad)) <= 0.01 * along_m + 0.25
    assert found.moved_m <= sag_m + 0.02


@given(start_m=st.floats(-100, 100), x_m=st.floats(-500, 500), y_m=st.floats(-20, 20))
def test_along_and_across_a_straight_lane_are_exact_and_it_goes_on_beyond_its_ends(start_m, x_m, y_m):
    found = frame({"a": line("a", start_m, start_m + 50.0)}, "a")
    np.testing.assert_allclose(found.place(np.array([[x_m, y_m]])), [[x_m - start_m, y_m]], atol=1e-9)
    np.testing.assert_allclose((found.start_m, found.end_m, found.moved_m), (0.0, 50.0, 0.0), atol=1e-9)


def test_a_frame_runs_through_the_lanes_before_and_after_straightest_first():
    bend, up = arc("bend", 60.0, -np.pi / 2, 0.0, 20), np.array([0.0, 60.0])
    lanes = {
        "a": line("a", -80.0, 0.0, ("bend", "b")),
        "b": line("b", 0.0, 70.0),
        "bend": Lane("bend", bend.left_m + up, bend.right_m + up),
        "before": line("before", -100.0, -80.0, ("a",)),
    }
    found = frame(lanes, "a")
    assert found.lanes == {"before", "a", "b"}
    np.testing.assert_allclose([found.start_m, found.end_m], [-20.0, 150.0])
    np.testing.assert_allclose(found.place(np.array([[0.0, 1.0]])), [[80.0, 1.0]], atol=1e-6)


def test_lanes_that_lead_into_one_another_in_a_ring_end_nowhere_and_are_gone_through_once():
    half = [
        arc(name, 50.0, start, start + np.pi, 60, (other,))
        for name, start, other in (("a", 0.0, "b"), ("b", np.pi, "a"))
    ]
    lanes = {lane.id: lane for lane in half}
    assert frame(lanes, "a").lanes == {"a", "b"}
    assert goes_on(lanes, "a", "b")
    assert goes_on(lanes, "a", "a")
    assert not goes_on(lanes, "a", "c")


@given(st.lists(st.tuples(st.floats(-10, 60), st.floats(-6, 9)), min_size=1, max_size=20))
def test_a_position_is_in_the_lane_whose_bounds_are_around_it(points):
    lanes = {"right": line("right", 0.0, 50.0), "left": line("left", 0.0, 50.0, y_m=3.5)}
    points_m = np.array(points)
    for (x, y), name in zip(points, located(points_m, lanes), strict=True):
        if min(abs(x - 0), abs(x - 50), abs(y + 1.75), abs(y - 1.75), abs(y - 5.25)) < 1e-9:
            continue  # on an edge
        there = "" if not 0 < x < 50 else "right" if -1.75 < y < 1.75 else "left" if 1.75 < y < 5.25 else ""
        assert name == there
        assert OUTSIDE == ""


def test_where_lanes_overlap_a_car_stays_in_the_one_that_it_comes_from():
    lanes = {
        "off": line("off", 50.0, 90.0, y_m=0.5),
        "b": line("b", 0.0, 50.0, y_m=1.0),
        "a": line("a", 0.0, 50.0, ("on",)),
        "on": line("on", 50.0, 90.0),
    }
    x = np.arange(5.0, 80.0, 5.0) + 1.0
    found = located(np.stack([x, np.where(x < 15.0, -1.0, 0.5)], axis=1), lanes)
    assert set(found[x < 50]) == {"a"}
    assert set(found[x > 50]) == {"on"}
