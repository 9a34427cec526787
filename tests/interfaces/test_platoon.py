"""Many neighbours and a gap to choose: nobody is hit on the plant of the proof while its hypotheses hold."""

import numpy as np
import pytest

from mjmerge.record.read import read
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.load import load
from mjmerge.simulation.loop import simulate
from mjmerge.verdict.judge import judge

GAPS = (
    "law.choice=first_open",
    "law.choice=nearest",
    "law.choice=largest",
    "law={choice: named, leader: vehicle_3, follower: vehicle_4}",
    "law={choice: named, leader: vehicle_5, follower: vehicle_6}",
)


def keys(gap):
    """Each part of a law as a key of its own."""
    if "{" not in gap:
        return [gap]
    return [f"law.{part.replace(': ', '=')}" for part in gap.removeprefix("law={").rstrip("}").split(", ")]


@pytest.mark.parametrize("gap", GAPS)
def test_nobody_is_hit_whichever_gap_it_goes_for(gap, long):
    name, seeds = ("platoon_8", 100) if long else ("platoon_8_small", 3)
    short = [] if long else ["duration_s=6"]
    trace = simulate(load(name, [*keys(gap), *short]), "double_integrator", runs=seeds)
    assert not trace.stops
    assert len({row.tobytes() for row in trace.front_m}) == seeds, "every seed is another run"
    verdicts = judge(trace)
    for run_, verdict in enumerate(verdicts):
        safe = bool((trace.distance_m[run_] > 0).all())
        assert safe or verdict.verdict == "assumption broken", (gap, run_, verdict.reason)
    assert sum(v.verdict in ("held", "vacuous") for v in verdicts) == seeds, {v.reason for v in verdicts}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of nine cars in its folder."""
    folder = tmp_path_factory.mktemp("nine") / "run"
    run(
        load("platoon_8_small", ["duration_s=2.6", "control_step_s=0.02"]), "double_integrator", folder=folder
    )
    return folder


@pytest.mark.parametrize("name", ["run.mcap", "run.rrd"])
def test_a_recording_of_nine_cars_verifies(folder, name):
    assert verify(folder / name).right
    numbers = read(folder / name, wary=False).columns["leader_number"]
    assert np.unique(numbers).tolist() == [3.0, 5.0]
    assert (folder / "figure.png").stat().st_size > 10_000
