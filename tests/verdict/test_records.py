"""How far neighbours stray from their records, and what a summary says of it."""

import numpy as np
import pytest

from mjmerge.scenario.load import load
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import Stop
from mjmerge.verdict.judge import judge
from mjmerge.verdict.records import off_record_m, sentence, strays
from mjmerge.verdict.summary import ground, summary
from mjmerge.verdict.table import table

KEYS = "drivers.vehicle_2={kind: recorded, time_s: [0, 10], travelled_m: [0, 20]}"
CHANGES = [KEYS, "duration_s=0.39"]


def front_m(off_m):
    """Front axles of cars at 2 m/s, Vehicle 2 so far ahead of its record, (N, T, 3, 2)."""
    off_m = np.atleast_2d(off_m)
    x = np.zeros((*off_m.shape, 3, 2))
    x[..., 0] = 0.02 * np.arange(off_m.shape[1])[:, None]
    x[:, :, 2, 0] += off_m - 7.0
    return x


def test_it_is_how_far_the_car_has_come_less_how_far_it_had(make_trace):
    off_m = 0.01 * np.arange(40)
    trace = make_trace(overrides=CHANGES, front_m=front_m(off_m))
    ((car, found),) = off_record_m(trace).items()
    assert car == "vehicle_2"
    assert found[0] == pytest.approx(off_m)
    one = strays(trace)["vehicle_2"]
    assert one.most_m == pytest.approx(0.39)
    assert one.usual_m == pytest.approx(np.percentile(off_m, 95))


def test_it_is_that_of_the_worst_simulation_to_either_side(make_trace):
    off_m = np.zeros((3, 40))
    off_m[1, 1:] = -0.02
    off_m[2, 20] = 0.03
    one = strays(make_trace(runs=3, overrides=CHANGES, front_m=front_m(off_m)))["vehicle_2"]
    assert (one.usual_m, one.most_m) == pytest.approx((0.02, 0.03))


@pytest.mark.parametrize(
    ("model", "peak_m", "always_m", "within"),
    [
        ("sedan", 0.58, 0.28, True),
        ("sedan", 0.61, 0.0, False),
        ("sedan", 0.31, 0.31, False),
        ("rc", 0.07, 0.035, True),  # 0.58 m long
        ("rc", 0.074, 0.0, False),
        ("rc", 0.037, 0.037, False),
    ],
)
def test_beyond_its_bounds_the_verdict_is_in_doubt(make_trace, model, peak_m, always_m, within):
    off_m = np.full(40, always_m)
    off_m[0], off_m[20] = 0, peak_m
    room = ["initial.ego.front_m=[-6, 6]", "initial.vehicle_2.front_m=[-12, 0]"]
    trace = make_trace(overrides=[*CHANGES, *room, f"models.vehicle_2={model}"], front_m=front_m(off_m))
    one = strays(trace)["vehicle_2"]
    assert one.within is within
    found = {"strays": {"vehicle_2": {"usual_m": one.usual_m, "most_m": one.most_m, "within": one.within}}}
    doubts = ground(trace.scenario, "bicycle", {}, found, continuous=False)["verdict_doubts"]
    told = [f"vehicle_2 strays up to {peak_m:.2g} m from its record"]
    assert doubts == ([] if within else told)


def test_after_its_end_a_simulation_strays_nowhere_and_without_a_tick_nobody_knows(make_trace):
    off_m = np.full(40, 0.01)
    off_m[0] = 0
    x = front_m(np.stack([off_m, off_m]))
    x[1, 20:] = np.nan
    stop = Stop(1, 0.2, "ego", "unstable")
    one = strays(make_trace(runs=2, overrides=CHANGES, stops=[stop], front_m=x))["vehicle_2"]
    assert (one.most_m, one.within) == (pytest.approx(0.01), True)
    x[1] = np.nan
    one = strays(make_trace(runs=2, overrides=CHANGES, stops=[stop], front_m=x))["vehicle_2"]
    assert np.isnan(one.most_m)
    assert not one.within
    said = sentence("vehicle_2", {"usual_m": None, "most_m": None, "within": False})
    assert said == "how far vehicle_2 strays from its record is not known"


def test_nothing_is_said_where_nobody_follows_a_record(make_trace):
    assert strays(make_trace(front_m=0.0)) == {}


def test_it_is_in_the_summary_and_on_the_terminal():
    changes = [KEYS, "duration_s=0.1", "initial.vehicle_2.speed_mps=2.02"]
    trace = simulate(load("paper", changes), "double_integrator")
    found = summary(trace, judge(trace))
    (one,) = found["strays"].values()
    away_m = 0.02 * trace.time_s * np.exp(-2 * trace.time_s)  # too fast by 0.02 m/s, and coming back
    assert one["usual_m"] == pytest.approx(np.percentile(away_m, 95), rel=0.02)
    assert (one["most_m"], one["within"]) == (pytest.approx(away_m[-1], rel=0.02), True)
    grid = table(found | {"real_time_factor": 1.0})
    rows = dict(zip(*(column.cells for column in grid.columns), strict=True))
    assert rows["records"] == f"vehicle_2 strays up to {one['most_m']:.2g} m from its record"
