"""Numbers read off a trace, on traces small enough to check by hand."""

import numpy as np
import pytest

from mjmerge.simulation.trace import Stop
from mjmerge.verdict.metrics import (
    MERGED_M,
    clear_ticks_without_margin,
    events,
    merged_at_s,
    saturated,
    touching_ticks_in_margin,
    turned_rad,
    turned_words,
)


@pytest.fixture
def across(make_trace):
    """A trace in which the ego is a given distance across from Vehicle 1."""

    def build(lateral_m, **given):
        lateral_m = np.atleast_2d(lateral_m)
        front = np.zeros((*lateral_m.shape, 3, 2))
        front[:, :, 0, 1] = 3.0 + lateral_m
        front[:, :, 1, 1] = 3.0
        along = {"heading_rad": 0.0} | given
        return make_trace(ticks=lateral_m.shape[1], runs=len(lateral_m), front_m=front, **along)

    return build


def test_merged_is_from_the_tick_after_which_the_ego_stays(across):
    assert merged_at_s(across([1.0, 0.5, 0.05, -0.05, 0.0])) == pytest.approx([0.02])
    assert merged_at_s(across([-1.0, -0.05, 0.0, 0.0, 0.0])) == pytest.approx([0.01])


def test_leaving_the_lane_again_starts_the_merge_over(across):
    assert merged_at_s(across([1.0, 0.0, 0.0, 0.2, 0.0])) == pytest.approx([0.04])
    assert np.isnan(merged_at_s(across([1.0, 0.0, 0.0, 0.0, 0.2])))


def test_the_bound_of_the_lane_is_not_in_it(across):
    """Around zero, where subtracting lanes keeps the bound exact."""
    trace = across([1.0, 0.0, 0.0])
    trace.front_m[:] = 0
    trace.front_m[0, :, 0, 1] = [1.0, MERGED_M, MERGED_M * (1 - 1e-9)]
    assert merged_at_s(trace) == pytest.approx([0.02])


def test_who_starts_in_the_lane_has_merged_at_once(across):
    assert merged_at_s(across([0.0, 0.0])) == pytest.approx([0.0])


def test_missing_data_never_count_as_merged(across):
    assert np.isnan(merged_at_s(across([np.nan] * 5))).all()
    assert np.isnan(merged_at_s(across([1.0, 0.0, 0.0, np.nan, np.nan]))).all()


def test_simulations_merge_each_on_its_own(across):
    found = merged_at_s(across([[1.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [0.0, 0.0, np.nan]]))
    assert found == pytest.approx([0.01, np.nan, 0.02, np.nan], nan_ok=True)


@pytest.mark.parametrize("plant", ["bicycle", "bicycle_limited", "mujoco"])
def test_a_car_across_the_road_or_turning_has_not_merged_however_well_in_lane(across, plant):
    askew, turning = np.zeros((1, 60, 3)), np.zeros((1, 60, 3))
    askew[0, :30, 0] = -1.1
    turning[0, :30, 0] = 0.03 * np.sin(2 * np.pi * 5 * 0.01 * np.arange(30))
    straight = across([0.0] * 60, plant=plant)
    assert merged_at_s(straight) == pytest.approx([0.0])
    assert merged_at_s(across([0.0] * 60, heading_rad=askew, plant=plant)) == pytest.approx([0.4])
    assert 0.3 <= merged_at_s(across([0.0] * 60, heading_rad=turning, plant=plant))[0] <= 0.4
    assert np.isnan(merged_at_s(across([0.0] * 60, heading_rad=np.nan, plant=plant))).all()


def test_a_point_has_no_heading_to_be_askew(across):
    standing = across([0.0] * 5, plant="double_integrator", heading_rad=np.pi / 2)
    assert merged_at_s(standing) == pytest.approx([0.0])
    assert np.isnan(turned_rad(standing)).all()


def test_how_far_the_ego_turned_off_the_road_is_signed_and_an_event(across):
    heading = np.zeros((1, 60, 3))
    heading[0, 20:30, 0], heading[0, 40, 0] = -1.1, 0.4
    trace = across([0.0] * 60, heading_rad=heading)
    assert turned_rad(trace) == pytest.approx([-1.1])
    (event,) = [e for e in events(trace) if "across the road" in e.text]
    assert (event.time_s, event.car) == (pytest.approx(0.2), "ego")
    assert "-63 degrees" in event.text


def test_saturated_is_any_clipping_and_unknown_is_not(make_trace):
    torque, steer = np.zeros((1, 4, 3)), np.zeros((1, 4, 3))
    torque[0, 1, 0], steer[0, 2, 1] = -0.1, 0.01
    torque[0, 3], steer[0, 3] = np.nan, np.nan
    found = saturated(make_trace(ticks=4, torque_clipped_n_m=torque, steer_clipped_rad=steer))
    assert np.argwhere(found).tolist() == [[0, 1, 0], [0, 2, 1]]


def texts(trace, run=0):
    return [(round(e.time_s, 2), e.level, e.car, e.text) for e in events(trace, run)]


def test_a_trace_without_data_has_no_events(make_trace):
    assert events(make_trace()) == []


def test_intending_to_merge_and_giving_up_are_events(make_trace):
    weight = np.where((np.arange(40) >= 10) & (np.arange(40) < 20), 0.9, 0.1)
    found = texts(make_trace(weight=weight, opinion=0.02))
    assert [e[:3] for e in found] == [(0.1, "info", "ego"), (0.2, "info", "ego")]
    assert "intends to merge (z = 0.020)" in found[0][3]
    assert "gives up" in found[1][3]


def test_an_intention_cut_off_by_the_end_is_not_given_up(make_trace):
    weight = np.where(np.arange(40) >= 10, 0.9, 0.1)
    stopped = np.where(np.arange(40) >= 20, np.nan, weight)
    for w in (weight, stopped):
        assert len(events(make_trace(weight=w, opinion=0.02))) == 1


def test_the_margin_and_contact_are_errors_that_name_the_car(make_trace):
    d, clearance = np.ones((1, 40, 2)), np.ones((1, 40, 3))
    d[0, 10:15, 1] = [-0.1, -0.2, -0.3, -0.2, -0.1]
    clearance[0, 20:25, 2] = -0.01
    margin, touch = texts(make_trace(distance_m=d, clearance_m=clearance))
    assert margin[:3] == (0.1, "error", "ego")
    assert "d_2 <= 0" in margin[3]
    assert "vehicle_2" in margin[3]
    assert "-0.300" in margin[3]
    assert "0.05 s" in margin[3]
    assert touch[:3] == (0.2, "error", "vehicle_1")
    assert "touches vehicle_2" in touch[3]


def test_saturation_with_short_breaks_is_one_event_and_with_a_long_one_two(make_trace):
    torque = np.zeros((1, 100, 3))
    torque[0, [10, 11, 20, 21], 0] = 0.5
    trace = make_trace(ticks=100, torque_clipped_n_m=torque, steer_clipped_rad=0)
    assert [e[:3] for e in texts(trace)] == [(0.1, "warning", "ego")]
    torque[0, 90, 0] = 0.5
    trace = make_trace(ticks=100, torque_clipped_n_m=torque, steer_clipped_rad=0)
    assert [e[0] for e in texts(trace)] == [0.1, 0.9]


def test_events_are_in_order_and_only_of_the_simulation_asked_for(make_trace):
    d = np.ones((2, 40, 2))
    d[0, 30, 0], d[1, 5, 1] = -0.1, -0.1
    stops = [Stop(1, 0.2, "vehicle_1", "it is off its wheels")]
    trace = make_trace(runs=2, distance_m=d, stops=stops)
    assert [e[0] for e in texts(trace, 0)] == [0.3]
    assert [e[:3] for e in texts(trace, 1)] == [(0.05, "error", "ego"), (0.2, "error", "vehicle_1")]
    assert "it is off its wheels" in texts(trace, 1)[1][3]


def test_least_distances_ignore_missing_ticks_but_do_not_invent_any(make_trace):
    d = np.full((2, 40, 2), np.nan)
    d[0, :10] = [0.5, 0.7]
    d[0, 4, 0] = 0.2
    least = make_trace(runs=2, distance_m=d).min_distance_m
    assert least == pytest.approx(np.array([[0.2, 0.7], [np.nan, np.nan]]), nan_ok=True)


def test_a_touch_counts_with_its_impulse_and_speed_even_between_two_ticks(make_trace):
    impulse, speed = np.zeros((1, 100, 3)), np.zeros((1, 100, 3))
    impulse[0, [50, 52], 0] = 1.5, 0.25
    speed[0, [50, 52], 0] = 0.8, 0.1
    trace = make_trace(
        ticks=100, clearance_m=0.1, distance_m=0.1, contact_impulse_n_s=impulse, contact_speed_mps=speed
    )
    assert np.argwhere(trace.touching).tolist() == [[0, 50, 0], [0, 52, 0]]
    (touch,) = texts(trace)
    assert touch[:3] == (0.5, "error", "ego")
    assert "touches vehicle_1 at 0.80 m/s, 1.75 N s" in touch[3]


def test_the_margin_is_compared_with_the_bodies_tick_by_tick_and_run_by_run(make_trace):
    d, clearance, impulse = np.full((2, 10, 2), 0.1), np.full((2, 10, 3), 0.1), np.zeros((2, 10, 3))
    clearance[0, :3, 0] = -0.01  # touching, with d_1 > 0
    impulse[0, 3, 0] = 1.0
    clearance[0, :5, 2] = -0.01  # the neighbours' affair
    d[1, :7, 1] = -0.05  # d_2 <= 0
    clearance[1, :2, 1] = 0.0  # touching in two of those
    trace = make_trace(ticks=10, runs=2, distance_m=d, clearance_m=clearance, contact_impulse_n_s=impulse)
    assert touching_ticks_in_margin(trace).tolist() == [[4, 0], [0, 0]]
    assert clear_ticks_without_margin(trace).tolist() == [[0, 0], [0, 5]]
    without_bodies = make_trace(ticks=10, runs=2, distance_m=d)
    assert not touching_ticks_in_margin(without_bodies).any()
    assert not clear_ticks_without_margin(without_bodies).any()


@pytest.mark.parametrize("turns", [1.1, -3.0, 1e9])
def test_of_a_car_that_spins_nobody_counts_the_degrees(turns):
    assert turned_words(2 * np.pi * turns, "{} off the road") == "round and round"
    assert (
        turned_words(np.pi * np.sign(turns), "{} off the road")
        == f"{180 * np.sign(turns):.0f} degrees off the road"
    )
