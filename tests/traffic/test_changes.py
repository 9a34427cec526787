"""Lane changes: each is found once, with its leader and follower or with a reason."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjmerge.traffic.changes import Change, Skipped, lane_changes
from mjmerge.traffic.commonroad import read_commonroad
from tests.traffic.files import LANE_M, Car, changing, commonroad, merging, steady, straight


def found_in(folder, cars, lanes=None):
    path = folder / "a.xml"
    path.write_text(commonroad(cars, lanes), encoding="utf-8")
    return list(lane_changes(read_commonroad(path)))


def test_leader_and_follower_are_the_next_cars_in_the_new_lane_when_it_is_entered(tmp_path):
    others = [
        steady("far", 150.0, 15.0),
        steady("beside", 110.0, 15.0, y_m=LANE_M),
        steady("behind", 60.0, 15.0),
    ]
    (found,) = found_in(tmp_path, [*others, *merging()])
    assert isinstance(found, Change)
    assert found.three == ("7", "8", "9")
    assert (found.from_lane, found.to_lane) == ("101", "100")
    assert (found.crossed, found.first, found.last) == (36, 0, 79)
    assert (found.others, found.between) == (3, ())


@settings(max_examples=12)
@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(0, 2), st.integers(5, 25), st.integers(0, 8)),
        min_size=1,
        max_size=6,
    )
)
def test_every_car_that_ends_in_another_lane_is_a_change_or_has_a_reason(tmp_path_factory, ways):
    cars = [
        changing(str(k), 60.0 + 40 * k, 15.0, LANE_M * a, LANE_M * b, begins=begins, steps=60, first=late)
        for k, (a, b, begins, late) in enumerate(ways)
    ]
    found = found_in(tmp_path_factory.getbasetemp(), cars, straight(3))
    counts = Counter(one.car if isinstance(one, Change) else one.id.split()[1] for one in found)
    assert counts == Counter({str(k): abs(a - b) for k, (a, b, *_) in enumerate(ways) if a != b})


REASONS = {
    "no leader": ([0, 2], "no leader is seen in lane 100 when it is entered"),
    "no follower": ([0, 1], "no follower is seen in lane 100 when it is entered"),
}


@pytest.mark.parametrize("name", REASONS)
def test_a_change_with_nobody_ahead_or_behind_is_skipped_and_says_so(tmp_path, name):
    which, why = REASONS[name]
    assert found_in(tmp_path, [merging()[k] for k in which]) == [Skipped("car 7 at 3.6 s", why)]


def test_a_car_that_only_touches_the_other_lane_has_not_changed_lanes(tmp_path):
    car = merging()[0]
    y = np.full(80, LANE_M)
    y[30:36] = 1.5
    (found,) = found_in(tmp_path, [Car("7", car.x_m, y), *merging()[1:]])
    assert found == Skipped("car 7 at 3.0 s", "is in lane 100 for 0.6 s only, and comes back")


def test_a_change_whose_leader_leaves_too_soon_is_skipped_and_says_so(tmp_path):
    short = steady("8", 120.0, 15.0, steps=41)
    (found,) = found_in(tmp_path, [merging()[0], short, merging()[2]])
    assert isinstance(found, Skipped)
    assert "are seen together, in their lanes, for 0.4 s after it; at least 1.0 s are needed" in found.why


def test_only_the_time_in_which_leader_and_follower_are_in_the_new_lane_is_used(tmp_path):
    late = changing("8", 120.0, 15.0, LANE_M, 0.0, begins=0, lasts=21)
    leaves = changing("9", 80.0, 15.0, 0.0, -LANE_M, begins=50, lasts=21)
    found = [one for one in found_in(tmp_path, [merging()[0], late, leaves]) if isinstance(one, Change)]
    (one,) = (one for one in found if one.car == "7")
    assert (one.first, one.last) == (11, 60)


def test_who_is_no_car_on_four_wheels_makes_no_scenario(tmp_path):
    (own,) = found_in(tmp_path, [changing("7", 100, 15.0, LANE_M, 0.0, kind="motorcycle"), *merging()[1:]])
    assert own.why == "is a motorcycle"
    (other,) = found_in(tmp_path, [*merging()[:2], steady("9", 80.0, 15.0, kind="bicycle")])
    assert other.why == "is between road users of which 9 is a bicycle"


def test_who_is_between_leader_and_follower_for_a_while_is_told(tmp_path):
    cutter = changing("6", 110.0, 15.0, 0.0, -LANE_M, begins=0, lasts=20)
    (found,) = (one for one in found_in(tmp_path, [*merging(), cutter]) if isinstance(one, Change))
    assert found.between == ("6",)
