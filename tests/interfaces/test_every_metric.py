"""What every metric promises.

``pytest tests/interfaces/test_every_metric.py --metric mine.py:headway_s`` asks it of one's own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mjmerge.plant import PLANTS
from mjmerge.scenario.load import load
from mjmerge.scenario.metrics import metric_name
from mjmerge.simulation.loop import simulate
from mjmerge.starts.make import make
from mjmerge.verdict import own


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "given" in metafunc.fixturenames:
        metafunc.parametrize("given", metafunc.config.getoption("--metric") or ["of `mjmerge new metric`"])


@pytest.fixture
def reference(given: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The metric's name; without any, that which a new one starts as."""
    if given.startswith("of "):
        monkeypatch.chdir(tmp_path)
        make("metric", "headway_s", tmp_path)
        return "headway_s.py:headway_s"
    return given


@pytest.fixture
def scenario(reference: str):
    keys = [f'metrics=["{reference}"]', "duration_s=0.3", "physics_step_s=0.002"]
    return load("charge", [*keys, "mismatch.neighbour_position_noise_m=0.01"]).settled()


@pytest.mark.parametrize("plant", PLANTS)
def test_it_is_a_number_for_each_simulation_and_the_same_again(scenario, reference, plant):
    trace = simulate(scenario, plant, runs=3)
    (values,) = own.measured(trace).values()
    assert own.names(scenario) == (metric_name(reference),)
    assert values.shape == (3,)
    assert values.dtype == np.float64
    assert np.array_equal(values, *own.measured(trace).values(), equal_nan=True)


def test_it_leaves_the_trace_alone_and_does_not_depend_on_who_runs_beside(scenario):
    trace = simulate(scenario, "bicycle", runs=3)
    before = trace.front_m.copy()
    (together,) = own.measured(trace).values()
    (alone,) = own.measured(simulate(scenario, "bicycle", seed=2)).values()
    assert np.array_equal(trace.front_m, before)
    assert np.array_equal(together[2:], alone, equal_nan=True)


def test_it_knows_of_a_run_that_stopped_at_once_only_what_there_is(scenario, monkeypatch):
    monkeypatch.setattr("mjmerge.plant.kinematic._BEYOND", 1.0)
    trace = simulate(scenario, "double_integrator", runs=2)
    assert len(trace.stops) == 2
    (values,) = own.measured(trace).values()
    assert values.shape == (2,)
