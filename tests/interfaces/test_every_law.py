"""What every law promises, shipped or not.

``pytest tests/interfaces/test_every_law.py --law '{kind: "mine.py:law", k_o: 2}'`` asks it of one of your
own: its keys as they stand under ``law`` of a scenario. Keys that stand in ``charge`` need not be repeated.
"""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from mjmerge.config.document import parse
from mjmerge.law import Sensed, decided, kinds, remembered
from mjmerge.plant import PLANTS
from mjmerge.record.read import read
from mjmerge.review.replay import replay
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.load import dump, load
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.sweep.plan import written
from mjmerge.verdict.judge import INCOMPLETE, REFUTED, judge

STEP_S = 0.01


def under(keys: str, *more: str, name: str = "charge") -> Scenario:
    """A scenario under this law."""
    given = parse(keys).value
    return load(name, [*(f"law.{key}={written(value)}" for key, value in given.items()), *more]).settled()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "keys" in metafunc.fixturenames:
        own = metafunc.config.getoption("--law")
        metafunc.parametrize("keys", own or [f"{{kind: {kind}}}" for kind in kinds()])


def around(runs: int, neighbours: int = 2, seed: int = 0) -> Sensed:
    """Cars some metres apart, in many simulations."""
    rng = np.random.default_rng(seed)
    p = np.array([0.0, 1.2]) + rng.uniform(-0.3, 0.3, (runs, 2))
    v = np.array([2.0, 0.0]) + rng.uniform(-0.3, 0.3, (runs, 2))
    x = np.linspace(2.0, -2.0, neighbours)[None, :, None] * np.array([1.0, 0.0])
    p_j = x + rng.uniform(-0.3, 0.3, (runs, neighbours, 2))
    v_j = np.array([2.0, 0.0]) + rng.uniform(-0.3, 0.3, (runs, neighbours, 2))
    return Sensed(p, v, p_j, v_j, rng.uniform(-1, 1, (runs, 2)))


def course(law, seen: Sensed, initial, ticks: int = 5):
    """What it decides in some ticks while nobody moves, and what it remembers at the end."""
    memory, made = law.start(len(seen.p), initial), []
    for _ in range(ticks):
        made.append(decided(law, seen, memory, STEP_S))
        memory = remembered(law, memory, made[-1], STEP_S)
    return made, memory


def rows(seen: Sensed, which: slice) -> Sensed:
    return Sensed(**{name: values[which] for name, values in vars(seen).items()})


@pytest.mark.parametrize("neighbours", [2, 3, 6])
def test_it_gives_a_finite_command_and_the_signals_that_it_declares(keys, neighbours):
    scenario = under(keys)
    made, _ = course(scenario.law, around(4, neighbours), scenario.initial.opinion)
    own = {signal.name for signal in scenario.law.signals}
    for one in made:
        assert one.u.shape == (4, 2)
        assert np.isfinite(one.u).all()
        assert not one.failed
        assert one.signals.keys() == own | set(scenario.law.gives)
        assert all(len(values) == 4 for values in one.signals.values())


def test_a_simulation_alone_gets_the_bits_that_it_gets_among_others(keys):
    scenario, seen = under(keys), around(5)
    together, _ = course(scenario.law, seen, scenario.initial.opinion)
    for k in range(5):
        alone, _ = course(scenario.law, rows(seen, slice(k, k + 1)), scenario.initial.opinion)
        for one, all_ in zip(alone, together, strict=True):
            assert one.u.tobytes() == all_.u[k : k + 1].tobytes()
            for name, values in one.signals.items():
                assert values.tobytes() == all_.signals[name][k : k + 1].tobytes()


def test_it_is_pure_and_alters_nothing_that_it_is_given(keys):
    scenario, seen = under(keys), around(3)
    before = {name: values.copy() for name, values in vars(seen).items()}
    once, again = (course(scenario.law, seen, scenario.initial.opinion)[0] for _ in range(2))
    for a, b in zip(once, again, strict=True):
        assert a.u.tobytes() == b.u.tobytes()
    assert all(np.array_equal(values, getattr(seen, name)) for name, values in before.items())


def test_without_its_guard_it_is_the_same_law_and_has_no_more_to_take_out(keys):
    law = under(keys).law
    without = law.unguarded()
    if without is not None:
        assert type(without) is type(law)
        assert without.unguarded() == without
        assert without.signals == law.signals


def test_it_comes_back_from_its_file_and_from_another_process(keys, tmp_path):
    scenario = under(keys)
    (tmp_path / "again.yaml").write_text(dump(scenario))
    assert load(tmp_path / "again.yaml").law == scenario.law
    assert pickle.loads(pickle.dumps(scenario)).law == scenario.law


@pytest.mark.parametrize("plant", PLANTS)
def test_it_drives_on_every_plant_alone_as_in_a_batch_and_is_judged(keys, plant):
    scenario = under(keys, "duration_s=0.6", "physics_step_s=0.002", "mismatch.position_noise_m=0.005")
    several = simulate(scenario, plant, runs=3)
    alone = simulate(scenario, plant, seed=2)
    assert not several.stops
    for column in several.columns:
        one, among = alone.column(column.name), several.column(column.name)[2:]
        assert one.tobytes() == among.tobytes(), column.name
    assert all(verdict.verdict not in (INCOMPLETE, REFUTED) for verdict in judge(several))


def test_it_is_recorded_verified_and_replayed(keys, tmp_path, request, long):
    done = run(under(keys, "duration_s=0.6"), "bicycle", folder=tmp_path / "run")
    assert not done.failures
    both = long or request.config.getoption("--law") or "cbf_qp" in keys
    for name in ("run.mcap", "run.rrd") if both else ("run.mcap",):
        found = verify(tmp_path / "run" / name)
        assert found.right, [check for check in found.checks if check.right is False]
        columns = read(tmp_path / "run" / name).columns
        for signal in done.trace.scenario.law.signals:
            assert columns[signal.name].tobytes() == done.trace.signals[signal.name][0].tobytes()
    assert replay(tmp_path / "run" / "run.mcap").same


def test_it_runs_in_continuous_time_or_says_that_it_has_none(keys):
    scenario = under(keys, "duration_s=0.3")
    if scenario.law.flow() is not None:
        trace = simulate(scenario, "double_integrator", continuous=True)
        assert np.isfinite(trace.u_mps2).all()
