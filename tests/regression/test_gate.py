"""The regression gate: floors, baselines, and proof that it can fail."""

from __future__ import annotations

import pandas as pd
import pytest
from pytest_regressions.dataframe_regression import DataFrameRegressionFixture

import mjmerge.law.merge as merge
from tests.regression.gate import FLOORS_M, baseline, measure, measured, problems

CHARGE = ("charge", "double_integrator", "")


@pytest.mark.parametrize("case", FLOORS_M, ids=lambda case: "-".join(filter(None, case)))
def test_the_safety_floor_holds(case):
    assert not list(problems(measured(*case), FLOORS_M[case]))


@pytest.mark.parametrize("scenario", ["paper", "charge"])
def test_margins_are_those_of_the_baseline(scenario, dataframe_regression: DataFrameRegressionFixture):
    """Regenerate on purpose only, with ``--force-regen``; the CSV names the MuJoCo version it is from."""
    dataframe_regression.check(
        pd.DataFrame(baseline(scenario)), basename=scenario, default_tolerance={"atol": 2e-4, "rtol": 0}
    )


@pytest.mark.parametrize("scenario", ["paper", "charge"])
def test_the_gate_fails_without_the_barrier(scenario):
    case = (scenario, "double_integrator", "")
    assert list(problems(measure(*case, "law.k_o=0"), FLOORS_M[case]))


def test_the_gate_fails_when_g_has_the_wrong_sign_in_the_barrier(monkeypatch):
    right = merge.barrier
    monkeypatch.setattr(merge, "barrier", lambda law, g, d, d_dot: right(law, -g, d, d_dot))
    assert list(problems(measure(*CHARGE), FLOORS_M[CHARGE]))


def test_the_gate_fails_when_g_has_the_wrong_sign_everywhere(monkeypatch):
    """The command is even in g_j, so every distance stays as it was; the recorded rate gives it away."""
    right = merge._unit
    monkeypatch.setattr(merge, "_unit", lambda a, length: -right(a, length))
    found = list(problems(measure(*CHARGE), FLOORS_M[CHARGE]))
    assert len(found) == 1
    assert "sign of g_j" in found[0]


def test_the_gate_fails_on_missing_data():
    found = measured(*CHARGE)
    assert list(problems(type(found)(float("nan"), 1.0, 1.0, 0.0, True), 0.1))


@pytest.mark.parametrize("mismatch", ["mismatch.friction=0.2", "mismatch.command_delay_s=0.2"])
def test_charge_breaks_where_physics_says_so(mismatch):
    assert not measured("charge", "mujoco", mismatch).safe


def test_physics_costs_charge_less_than_3_cm_on_grippy_ground():
    ideal, real = measured(*CHARGE), measured("charge", "mujoco", "")
    assert real.min_d_1_m == pytest.approx(ideal.min_d_1_m, abs=0.03)
    assert real.min_d_2_m == pytest.approx(ideal.min_d_2_m, abs=0.03)
