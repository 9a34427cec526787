"""Phases: every state that a run was in, from its first tick to its last, and nothing twice."""

import numpy as np
import pytest

from mjmerge.scenario.load import load
from mjmerge.simulation.trace import Stop
from mjmerge.verdict.hypotheses import HYPOTHESES
from mjmerge.verdict.phases import ENDED, NAMES, ROAD, WATCHED, names, phases

T = 40


def trace_of(make_trace, **given):
    front = np.zeros((1, T, 3, 2))
    front[:, :, 0, 1] = 1.4
    still = {
        "front_m": front,
        "distance_m": 0.5,
        "clearance_m": 0.2,
        "weight": 0.0,
        "speed_mps": 2.0,
        "heading_rad": 0.0,
    }
    calm = {"velocity_mps": 0.0, "u_mps2": 0.0, "torque_clipped_n_m": 0.0, "steer_clipped_rad": 0.0}
    return make_trace(ticks=T, **(still | calm | given))


def of(subject, trace):
    return [(round(p.time_s, 3), p.state) for p in phases(trace) if p.subject == subject]


def test_every_subject_has_a_state_from_the_start(make_trace):
    found = phases(trace_of(make_trace))
    watched = names(load("paper").law)
    assert [p.subject for p in found if p.time_s == 0.0] == list(watched)
    assert len(found) == len(watched)
    assert set(watched) < set(NAMES) == set(HYPOTHESES) | set(WATCHED) | set(ROAD)


def test_a_merge_goes_through_its_three_states(make_trace):
    weight, front = np.zeros((1, T)), np.zeros((1, T, 3, 2))
    weight[:, 10:] = 0.9
    front[:, :30, 0, 1] = 1.4
    merge = of("decision", trace_of(make_trace, weight=weight, front_m=front))
    assert merge == [(0.0, "keeps its lane"), (0.1, "merging"), (0.3, "merged")]


def test_being_in_lane_without_meaning_to_is_no_merge(make_trace):
    assert of("decision", trace_of(make_trace, front_m=0.0)) == [(0.0, "keeps its lane")]


def test_a_margin_entered_and_left_and_a_touch_are_states_of_safety(make_trace):
    d, clearance = np.full((1, T, 2), 0.5), np.full((1, T, 3), 0.2)
    d[0, 10:20, 1] = 0.0
    clearance[0, 15, 0] = -0.01
    clearance[0, 30, 2] = -0.01  # the neighbours' affair
    safety = of("safety", trace_of(make_trace, distance_m=d, clearance_m=clearance))
    outside, inside = "outside both margins", "inside a margin"
    assert safety == [(0.0, outside), (0.1, inside), (0.15, "touching"), (0.16, inside), (0.2, outside)]


def test_a_hypothesis_may_break_and_hold_again(make_trace):
    speed = np.full((1, T, 3), 2.0)
    speed[0, 5:9, 0] = 0.0
    assert of("ego rolls", trace_of(make_trace, speed_mps=speed)) == [
        (0.0, "holds"),
        (0.05, "broken"),
        (0.09, "holds"),
    ]


@pytest.mark.parametrize("subject", names(load("paper").law))
def test_a_run_that_stops_ends_every_phase_there(make_trace, subject):
    front = np.zeros((1, T, 3, 2))
    front[:, 20:] = np.nan
    trace = trace_of(make_trace, front_m=front, stops=[Stop(0, 0.2, "ego", "gone")])
    assert of(subject, trace)[-1] == (0.2, ENDED)
