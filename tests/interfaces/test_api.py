"""Whatever mjmerge's functions are called with by mistake, they answer with what to pass."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mjmerge
from mjmerge import MjmergeError

ROOT = Path(__file__).parents[2]
SCENARIO = mjmerge.load("paper", ["duration_s=0.1"])
TRACE = mjmerge.simulate(SCENARIO, "double_integrator")


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("paper", r"got the text 'paper'; pass one that was loaded: mjmerge\.load\('paper'\)"),
        (TRACE, r"got a trace; the scenario of a trace is trace\.scenario"),
        (None, "got nothing"),
        ({"law": {}}, "got a mapping"),
        ([SCENARIO], "got a list of 1"),
        (Path("paper.yaml"), "got a PosixPath"),
        (3, "got 3"),
    ],
)
def test_what_is_no_scenario_is_refused_with_what_to_pass(given, says):
    with pytest.raises(MjmergeError, match=says):
        mjmerge.simulate(given)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"runs": 0}, "runs is 0; it must be at least 1"),
        ({"runs": -3}, "runs is -3; it must be at least 1"),
        ({"runs": 2.0}, r"runs must be a whole number, got 2\.0"),
        ({"runs": "2"}, "runs must be a whole number, got the text '2'"),
        ({"runs": None}, "runs must be a whole number, got nothing"),
        ({"runs": True}, "runs must be a whole number, got true"),
        ({"seed": -1}, "seed is -1; it must be at least 0"),
        ({"seed": 0.5}, "seed must be a whole number"),
        ({"threads": -1}, "threads is -1; it must be at least 0"),
        ({"threads": "all"}, "threads must be a whole number"),
        ({"plant": "mujoca"}, "did you mean 'mujoco'"),
        ({"plant": None}, "the plant must be one of double_integrator, bicycle"),
        ({"plant": ["mujoco"]}, "the plant must be one of"),
        ({"continuous": "yes"}, "continuous must be a bool"),
        ({"world": "world.xml"}, "world must be a World"),
        ({"cases": []}, r"cases must be a list of pairs \(seed, mismatch\)"),
        ({"cases": [(0, None)]}, r"a case must be a pair \(seed, mismatch\), got a list of 2"),
        ({"cases": [(0, SCENARIO.mismatch), 3]}, "a case must be a pair"),
        ({"cases": [(-1, SCENARIO.mismatch)]}, "a seed is -1"),
        (
            {"cases": [(0, SCENARIO.mismatch.model_copy(update={"friction": -3.0}))]},
            "friction: must be greater than 0",
        ),
    ],
)
def test_an_argument_of_the_wrong_kind_is_named(arguments, says):
    with pytest.raises(MjmergeError, match=says):
        mjmerge.simulate(SCENARIO, **{"plant": "double_integrator", **arguments})


def altered(section: str, **keys):
    return {section: getattr(SCENARIO, section).model_copy(update=keys)}


@pytest.mark.parametrize(
    ("update", "says"),
    [
        ({"duration_s": -1.0}, "duration_s: must be greater than 0, got -1.0"),
        ({"duration_s": "long"}, "duration_s: must be a number"),
        ({"control_step_s": 0.0}, "control_step_s: must be greater than 0"),
        (
            {"control_step_s": 0.0125, "physics_step_s": 0.01},
            r"control_step_s: control step \(0.0125 s\) must be a whole multiple",
        ),
        ({"physics_step_s": float("nan")}, "physics_step_s: must be a finite number"),
        ({"law": None}, "law: must be a mapping of keys"),
        ({"law": SCENARIO.law.model_dump()}, "law: expected OpinionDynamics, got a mapping"),
        ({"models": "rc"}, "models: must be a mapping"),
        ({"duration": 3.0}, "duration: unknown key; did you mean 'duration_s'"),
        (altered("law", k_0=1.0), "law.k_0: unknown key; did you mean 'k_o'"),
        (altered("law", k_o="1"), r"law\.k_o: must be a number, got the text '1'; drop the quotes"),
        (altered("law", variant="litteral"), r"law\.variant: .*literal"),
        (altered("law", r_rho_m=1.0), r"law\.r_rho_m: must be negative"),
        (altered("initial", z=-1.0), r"initial\.z: must be at least 0"),
        (altered("mismatch", friction=7.0), r"mismatch\.friction: must be at most 2"),
    ],
)
def test_a_scenario_that_was_altered_into_none_is_told_by_key(update, says):
    with pytest.raises(MjmergeError, match=f"scenario 'paper', altered: {says}"):
        mjmerge.simulate(SCENARIO.model_copy(update=update), "double_integrator")


def test_a_scenario_that_was_altered_into_another_runs():
    slower = SCENARIO.model_copy(update=altered("law", k_o=0.5) | {"duration_s": 0.2})
    assert mjmerge.simulate(slower, "double_integrator", runs=np.int64(2)).distance_m.shape == (2, 21, 2)


@pytest.mark.parametrize("given", ["paper", None, SCENARIO, [TRACE], 3])
def test_what_is_no_trace_is_refused_with_what_to_pass(given):
    for function in (mjmerge.judge, mjmerge.events):
        with pytest.raises(MjmergeError, match=r"expected a trace, got .*; pass what mjmerge\.simulate"):
            function(given)


NO_RUNS = [(1, "run is 1; it must be at least 0 and at most 0"), (-1, "run is -1"), (0.0, "a whole number")]


@pytest.mark.parametrize(("run", "says"), NO_RUNS)
def test_a_run_that_is_not_there_is_told(run, says):
    with pytest.raises(MjmergeError, match=says):
        mjmerge.events(TRACE, run)


@pytest.mark.parametrize("given", [None, 3, TRACE, SCENARIO, b"paper", ["paper"]])
def test_what_cannot_be_loaded_is_refused_with_what_to_pass(given):
    with pytest.raises(MjmergeError, match="expected a scenario's name, path or mapping of keys, got"):
        mjmerge.load(given)


@pytest.mark.parametrize("given", ["law.k_o=1", None, {"law.k_o": 1}, [3], [("law.k_o", 1)]])
def test_overrides_that_are_none_are_refused_with_what_to_pass(given):
    with pytest.raises(MjmergeError, match=r"law\.k_o=0"):
        mjmerge.load("paper", given)


@pytest.mark.parametrize("size", [0, -1, "2", None, float("nan"), True])
def test_a_size_that_is_none_is_refused(size):
    with pytest.raises(MjmergeError, match="the scale must be a positive number"):
        SCENARIO.scaled(size)


SCRIPT = """\
import mjmerge

scenario = mjmerge.load("charge", ["mismatch.friction=0.4"])
trace = mjmerge.simulate(scenario, plant="mujoco", runs=8)
least: float = float(trace.min_distance_m.min())
for verdict in mjmerge.judge(trace):
    print(verdict.verdict, verdict.reason, least)
happened = [event.time_s for event in mjmerge.events(trace)]
large: mjmerge.Scenario = scenario.scaled(length=10)
reveal_type(trace)
reveal_type(verdict.verdict)
"""


def test_a_users_script_passes_the_strict_type_checker_and_a_wrong_one_does_not(tmp_path):
    (tmp_path / "right.py").write_text(SCRIPT)
    (tmp_path / "wrong.py").write_text(SCRIPT.replace("runs=8", 'runs="8"'))
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "right.py", "wrong.py"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MYPY_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
    errors = [line for line in done.stdout.splitlines() if ": error:" in line]
    assert len(errors) == 1, done.stdout
    assert errors[0].startswith("wrong.py:4: ")
    assert (
        'Revealed type is "mjmerge.simulation.trace.Trace"' in done.stdout
    )  # and not Any: it is shipped as typed
    assert 'right.py:11: note: Revealed type is "str"' in done.stdout
