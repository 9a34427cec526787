"""The shipped scenarios of braking: safe with the barrier, challenged without, and the queue stands."""

import numpy as np
import pytest

from mjmerge import judge, load, simulate
from mjmerge.drivers import kinds
from mjmerge.errors import ScenarioError

NAMES = ("leader_brakes", "stop_and_go", "highway_brakes")


@pytest.mark.parametrize("name", NAMES)
def test_the_ideal_is_safe_because_of_the_barrier_and_merges(name):
    scenario = load(name)
    trace = simulate(scenario, "double_integrator")
    (verdict,) = judge(trace)
    assert (verdict.verdict, verdict.floor_held) == ("held", True)
    bare = simulate(load(name, ["law.k_o=0"]), "double_integrator")
    assert bare.min_distance_m.min() < 0 < trace.min_distance_m.min() - scenario.law.r_m / 10
    assert abs(trace.front_m[0, -1, 0, 1]) < scenario.law.r_m / 6


def test_the_neighbours_brake_as_hard_as_told_and_stand_in_the_queue():
    trace = simulate(load("stop_and_go"), "bicycle")
    speed, t = trace.velocity_mps[0, :, :, 0], trace.time_s
    assert np.diff(speed[:, 1])[(t[:-1] > 9.1) & (t[:-1] < 9.6)] / 0.01 == pytest.approx(-2.0, abs=1e-6)
    for start_s, end_s in ((12.5, 14.0), (23.5, 25.0)):
        standing = (t > start_s) & (t < end_s)
        assert np.ptp(trace.front_m[0, standing, 1], axis=0).max() < 1e-6
        assert np.ptp(trace.front_m[0, standing, 2], axis=0).max() < 1e-3
    assert speed[:, 1:].min() > -1e-9
    assert speed[-1] == pytest.approx(1.5, abs=0.2)


@pytest.mark.parametrize("kind", sorted(kind for kind, driver in kinds().items() if not driver.can_lead))
@pytest.mark.parametrize("name", ["charge", "highway"])
def test_a_follower_is_refused_for_the_car_that_is_first(kind, name):
    keys = {"gap": "gap_m: 2", "flips": "closed_gap_m: 2, open_gap_m: 3"}[kind]
    with pytest.raises(ScenarioError) as refused:
        load(name, [f"drivers.vehicle_1={{kind: {kind}, {keys}}}"])
    (problem,) = refused.value.problems
    assert problem.key == "drivers.vehicle_1.kind"
    assert "nobody ahead of it; kinds that can lead: idm, recorded, speeds, steady" in problem.message
