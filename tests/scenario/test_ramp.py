"""The end of a lane: where the road ends, how far a body is from that, and what of it is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.config.document import parse
from mjmerge.errors import ScenarioError
from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.load import dump, load
from mjmerge.scenario.ramp import EDGE_DISTANCE, END_DISTANCE, END_RATE, Ramp
from mjmerge.scenario.schema import Road
from mjmerge.state import norm

CAR = data_sheet("rc")
R_M = 0.6


def ramp(ends_m=10.0, taper_m=0.8, lane_m=1.2, told="obstacle", **more) -> Ramp:
    """A lane beside that of a leader at y = 0."""
    road = Road(lane_width_m=1.2, ends_m=ends_m, taper_m=taper_m, told=told)
    made = Ramp.at(road, np.array([[lane_m, 0.0]]), CAR, R_M, **more)
    assert made is not None
    return made


def no_road(of: Ramp, points: np.ndarray) -> np.ndarray:
    """Whether points, (M, 2), are beyond the edge line, by its two corners alone."""
    inner, outer = of.inner_m[0], of.outer_m[0]
    across = (points[:, 1] - inner) / (outer - inner)
    return (across > 0) & (points[:, 0] > of.ends_m - of.taper_m * across)


def body(front_m: np.ndarray, heading_rad: float, points: int = 81) -> np.ndarray:
    """A grid of points over a car's body, (M, 2)."""
    along = np.linspace(CAR.front_overhang_m - CAR.length_m, CAR.front_overhang_m, points)
    beside = np.linspace(-CAR.width_m / 2, CAR.width_m / 2, points)
    a, b = (grid.ravel() for grid in np.meshgrid(along, beside))
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    return front_m + np.stack([a * cos - b * sin, a * sin + b * cos], axis=-1)


places = st.tuples(st.floats(8.0, 12.0), st.floats(-0.5, 1.8))
tapers = st.sampled_from([0.0, 0.8, 3.0])


@given(at=places, heading=st.floats(-3.1, 3.1), taper_m=tapers, lane_m=st.sampled_from([1.2, -1.2]))
def test_a_body_is_off_the_road_exactly_where_some_point_of_it_is(at, heading, taper_m, lane_m):
    of, front = ramp(taper_m=taper_m, lane_m=lane_m), np.array(at) * [1, np.sign(lane_m)]
    edge_m = float(of.edge_distance_m(front[None], np.array([heading]))[0])
    points = body(front, heading)
    off = no_road(of, points).any()
    assert not (off and edge_m > 1e-9)
    assert off or edge_m > -0.03  # a corner that slips between points of the grid
    tick = 0.7 * CAR.length_m / 80
    if not off:  # never more than there is: a body moved by less stays on the road
        for way in ((1, 0), (0, 1), (0, -1), (0.7, 0.7), (0.7, -0.7)):
            assert not no_road(of, points + max(edge_m - tick, 0.0) * np.array(way)).any()


@pytest.mark.parametrize(("front", "heading", "left_m"), [
    ((9.0, 1.2), 0.0, 10.0 - 9.0 - CAR.front_overhang_m),  # before the end, by its nose
    ((12.0, 0.3), 0.0, 0.6 - 0.3 - CAR.width_m / 2),  # past it, by its side
    ((12.0, 0.0), np.pi / 2, 0.6 - CAR.front_overhang_m),  # past it and across the road, by its nose
    ((9.95, 1.2), 0.0, 10.0 - 9.95 - CAR.front_overhang_m),  # over it, by as much
])  # fmt: skip
def test_what_is_left_to_the_edge_is_that_of_the_nearest_face(front, heading, left_m):
    found = ramp(taper_m=0.0).edge_distance_m(np.array([front]), np.array([heading]))
    assert found[0] == pytest.approx(left_m, abs=1e-12)


def test_a_car_that_turns_around_the_apex_is_as_far_from_it_as_its_side_is():
    heading = -0.5
    ahead, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    front = np.array([10.0, 0.6]) - left * (CAR.width_m / 2 + 0.05) + ahead * 0.1
    found = ramp(taper_m=0.0).edge_distance_m(front[None], np.array([heading]))
    assert found[0] == pytest.approx(0.05, abs=1e-12)


def test_who_passes_the_end_at_the_margin_touches_the_edge_with_its_side():
    of = ramp()
    passing = np.array([[12.0, of.corner_m[0, 1] - R_M]])
    found = of.columns(passing, np.zeros((1, 2)), np.zeros(1))
    assert found[END_DISTANCE] == pytest.approx(0.0, abs=1e-12)
    assert found[EDGE_DISTANCE] == pytest.approx(0.0, abs=1e-12)


def test_a_point_has_no_heading_and_its_body_lies_along_the_road():
    front, turned = np.array([[9.0, 1.2]]), np.array([2.0])
    points = ramp(turns=False)
    assert points.edge_distance_m(front, turned) == points.edge_distance_m(front, np.zeros(1))
    assert ramp().edge_distance_m(front, turned) != points.edge_distance_m(front, turned)


@given(at=places, taper_m=tapers, lane_m=st.sampled_from([1.2, -1.2]))
def test_the_obstacle_is_told_by_its_nearest_point(at, taper_m, lane_m):
    of, p = ramp(taper_m=taper_m, lane_m=lane_m), np.array([at]) * [1, np.sign(lane_m)]
    p_end, _ = of.nearest(p, np.zeros((1, 2)))
    s = np.linspace(0.0, 12.0, 24_001)
    sides = of.corner_m[0] + np.concatenate([s[:, None] * edge for edge in of.edges[0]])
    least = norm(p - sides).min()
    apex = np.array([of.ends_m, of.inner_m[0]])
    inside = no_road(of, p + apex - of.corner_m)[0]
    assert norm(p - p_end)[0] == pytest.approx(0.0 if inside else least, abs=3e-4)


@given(at=places, v=st.tuples(st.floats(-3, 3), st.floats(-3, 3)), taper_m=tapers)
def test_the_rate_of_a_distance_from_the_end_is_its_rate(at, v, taper_m):
    of, p, v, h = ramp(taper_m=taper_m), np.array([at]), np.array([v]), 1e-6
    before, now, after = (of.columns(p + k * h * v, v, np.zeros(1)) for k in (-1, 0, 1))
    by_hand = (after[END_DISTANCE] - before[END_DISTANCE]) / (2 * h)
    if now[END_DISTANCE] > 0.01 - R_M:
        assert now[END_RATE] == pytest.approx(by_hand, abs=1e-3)


@given(x=st.floats(5.0, 15.0), y=st.floats(0.0, 1.2), taper_m=st.sampled_from([0.0, 0.8]))
def test_whoever_keeps_r_from_the_obstacle_is_on_the_road(x, y, taper_m):
    found = ramp(taper_m=taper_m).columns(np.array([[x, y]]), np.zeros((1, 2)), np.zeros(1))
    if found[END_DISTANCE] > 0:
        assert found[EDGE_DISTANCE] > 0


RAMP = ["road.ends_m=40", "road.taper_m=2"]


@pytest.mark.parametrize(("keys", "key", "says"), [
    (["road.taper_m=2"], "road.taper_m", "give road.ends_m"),
    (["road.told=nothing"], "road.told", "give road.ends_m"),
    (["expect.min_edge_distance_m.at_least=0.1"], "expect.min_edge_distance_m", "give road.ends_m"),
    (["road.ends_m=-1.6"], "road.ends_m", "starts off the road: its nose is at -1.399 m"),
    (["road.ends_m=-1.0"], "road.ends_m", "from the end that the law is told of"),
    ([*RAMP, "initial.ego.front_m=[-1.5, 0.1]", "law.r_m=0.2"], "initial.ego.front_m", "cannot pass its end"),
    ([*RAMP, "initial.ego.front_m=[-1.5, 0.58]", "law.r_m=0.59"], "initial.ego.front_m", "cannot pass"),
    ([*RAMP, "initial.vehicle_3={front_m: [9, 1.0], speed_mps: 2}", "drivers.vehicle_3={kind: steady, "
      "speed_mps: 2}"], "initial.vehicle_3.front_m", "is in the lane that ends, at y = 1 m"),
    ([*RAMP, "road.told=nothing at all"], "road.told", "nothing"),
])  # fmt: skip
def test_what_an_end_cannot_be_is_refused_with_its_key(keys, key, says):
    with pytest.raises(ScenarioError) as caught:
        load("charge", keys)
    assert [p.key for p in caught.value.problems if says in p.message] == [key]


def test_an_end_that_the_law_is_not_told_of_needs_no_room_for_its_margin():
    keys = [*RAMP, "initial.ego.front_m=[-1.5, 0.58]", "law.r_m=0.59"]
    assert load("charge", [*keys, "road.told=nothing"]).road.ends_m == 40


def test_what_has_no_end_says_nothing_of_one_and_what_has_is_written_out():
    plain = parse(dump(load("charge"))).value
    assert plain["road"] == {"lane_width_m": 1.2}
    assert plain["expect"] == {"min_distance_m": {"at_least": 0.1}}
    scenario = load("ramp_blocked", ["road.told=nothing"])
    assert load(parse(dump(scenario)).value) == scenario
    assert scenario != load("ramp_blocked")


def test_a_larger_one_ends_at_the_same_place_among_larger_cars():
    scenario = load("ramp_blocked", ["road.told=nothing"])
    small, large = scenario.road, scenario.scaled(8.1).road
    assert large.ends_m == pytest.approx(8.1 * small.ends_m)
    assert (large.taper_m, large.told) == (pytest.approx(8.1 * small.taper_m), "nothing")
    assert scenario.scaled(8.1).expect.min_edge_distance_m.at_least == pytest.approx(8.1 * 0.4)
