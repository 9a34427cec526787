"""What every driver promises, shipped or not.

``pytest tests/interfaces/test_every_driver.py --driver '{kind: "mine.py:Mine", speed_mps: 2}'`` asks it
of one of your own: its keys as they stand under ``drivers.vehicle_2`` of a scenario.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from pydantic import ValidationError

from mjmerge.drivers import Along, Driver, kinds
from mjmerge.plant import PLANTS
from mjmerge.scenario.load import dump, load
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate

DURATION_S = 10.0
LISTS = {"time_s": [0.0, 0.2, 0.5, 7.0, 8.0], "travelled_m": [0.0, 0.4, 1.0, 9.0, 9.0]}
"""Keys that are no numbers, of a car that begins at 2 m/s and stands in the end."""


def driven(keys: str) -> Scenario:
    """A scenario in which the follower is driven so."""
    return load("paper", [f"drivers.vehicle_2={keys}", "duration_s=0.3", "physics_step_s=0.002"]).settled()


def shipped(kind: str) -> str:
    """A driver of a kind with 2.0 for every number that has no default."""
    given = {name: LISTS.get(name, 2.0) for name, f in kinds()[kind].model_fields.items() if f.is_required()}
    return str({"kind": kind} | given)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "keys" in metafunc.fixturenames:
        own = metafunc.config.getoption("--driver")
        metafunc.parametrize("keys", own or [shipped(kind) for kind in sorted(kinds())])


@pytest.fixture
def driver(keys: str) -> Driver:
    found: Driver = driven(keys).drivers.vehicle_2
    return found


def generators(seeds):
    return [np.random.default_rng(s) for s in seeds]


def columns(*cars: Along):
    """The arrays of what a driver is shown."""
    return [a for car in cars for a in (car.position_m, car.speed_mps, car.acceleration_mps2)]


def one(car: Along, row: slice) -> Along:
    """One simulation of a car."""
    return replace(car, **{name: a[row] for name, a in vars(car).items() if isinstance(a, np.ndarray)})


def moving(runs: int, seed: int = 0) -> tuple[Along, Along]:
    """A follower some metres behind a leader, in many simulations."""
    rng = np.random.default_rng(seed)
    own = Along(rng.uniform(-4, -1, runs), rng.uniform(1, 3, runs), np.zeros(runs), 0.1, 0.5)
    motion = rng.uniform(0, 1, runs), rng.uniform(1, 3, runs), rng.uniform(-1, 1, runs)
    return own, Along(*motion, 0.1, 0.5)


@pytest.mark.parametrize("runs", [1, 3])
@pytest.mark.parametrize("hold_s", [0.0, 0.01, 1.0])
def test_it_gives_one_finite_acceleration_per_simulation(driver, runs, hold_s):
    drawn = driver.draw(generators(range(runs)), DURATION_S)
    own, leader = moving(runs)
    for time_s, ahead in product((0.0, 0.5, 7.3, 10.0), (leader, None) if driver.can_lead else (leader,)):
        u = driver.acceleration_mps2(time_s, own, ahead, drawn, hold_s)
        assert u.shape == (runs,)
        assert u.dtype == np.float64
        assert np.isfinite(u).all()
        stands = driver.stands(time_s, own, hold_s)
        assert stands.shape == (runs,)
        assert stands.dtype == bool


def test_it_answers_the_same_to_the_same_question_and_leaves_it_alone(driver):
    drawn = driver.draw(generators(range(4)), DURATION_S)
    own, leader = moving(4)
    before = [a.copy() for a in columns(own, leader)]
    kept = None if drawn is None else drawn.copy()
    late, early = (driver.acceleration_mps2(t, own, leader, drawn) for t in (9.0, 2.0))
    assert np.array_equal(driver.acceleration_mps2(9.0, own, leader, drawn), late)
    assert np.array_equal(driver.acceleration_mps2(2.0, own, leader, drawn), early)
    for old, new in zip(before, columns(own, leader), strict=True):
        assert np.array_equal(old, new)
    assert kept is None or np.array_equal(kept, drawn)


def test_it_is_frozen(driver):
    for name in type(driver).model_fields:
        with pytest.raises(ValidationError, match="frozen"):
            setattr(driver, name, 3.0)


def test_it_does_in_a_batch_what_it_does_alone(driver):
    together = driver.draw(generators(range(5)), DURATION_S)
    own, leader = moving(5)
    u = driver.acceleration_mps2(3.0, own, leader, together)
    for i in range(5):
        row = slice(i, i + 1)
        alone = driver.draw(generators([i]), DURATION_S)
        assert (alone is None) == (together is None)
        assert alone is None or np.array_equal(alone[0], together[i])
        assert driver.acceleration_mps2(3.0, one(own, row), one(leader, row), alone)[0] == u[i]


def test_its_switches_are_times_in_order(driver):
    drawn = driver.draw(generators([0]), DURATION_S)
    times_s = driver.switches(None if drawn is None else drawn[0])
    assert times_s.ndim == 1
    assert (np.diff(times_s) >= 0).all()
    assert np.isfinite(times_s).all()


def test_it_has_nothing_against_its_own_keys_and_comes_back_from_its_scenario(driver, keys, tmp_path):
    assert list(driver.problems()) == []
    path = tmp_path / "again.yaml"
    path.write_text(dump(driven(keys)))
    assert load(path).drivers.vehicle_2 == driver


@pytest.mark.parametrize("plant", PLANTS)
def test_it_drives_the_same_run_alone_and_among_others(keys, plant):
    scenario = driven(keys)
    together, alone = simulate(scenario, plant, runs=3), simulate(scenario, plant, seed=2)
    assert together.u_mps2[2].tobytes() == alone.u_mps2[0].tobytes()
    assert together.front_m[2].tobytes() == alone.front_m[0].tobytes()
    assert not alone.stops
