"""dm_env's own conformance tests, and the same episodes by its interface."""

import numpy as np
import pytest
from absl.testing import absltest
from dm_env import StepType
from dm_env.test_utils import EnvironmentTestMixin

from mjmerge import load, simulate
from mjmerge.envs import dm

SETTINGS = ["duration_s=0.1"]


class Conforms(EnvironmentTestMixin):
    def make_action_sequence(self):
        for _ in range(15):  # an episode has 11 steps
            yield self.make_action()


class MergeTest(Conforms, absltest.TestCase):
    def make_object_under_test(self):
        return dm.merge(settings=SETTINGS, cases=[{"friction": 0.3}])


class SteeringTest(Conforms, absltest.TestCase):
    def make_object_under_test(self):
        return dm.merge(plant="bicycle", action="steering", settings=SETTINGS)


class AdversaryTest(Conforms, absltest.TestCase):
    def make_object_under_test(self):
        return dm.adversary(plant="double_integrator", settings=SETTINGS)


def test_the_papers_commands_give_the_bits_of_simulate():
    expected = simulate(load("paper", SETTINGS), "bicycle", seed=3)
    env = dm.merge(plant="bicycle", settings=SETTINGS, seed=3)
    steps = [env.reset(), *(env.step(u) for u in expected.u_mps2[0, :, 0])]
    assert [step.step_type for step in steps] == [StepType.FIRST, *[StepType.MID] * 10, StepType.LAST]
    assert steps[-1].discount == 1.0
    assert env.last["verdict"] == "vacuous"
    for column in expected.columns:
        theirs = expected.column(column.name)
        assert np.array_equal(env.trace.column(column.name), theirs, equal_nan=True), column.name


def test_a_failure_has_no_future_and_every_part_has_its_name():
    env = dm.merge(plant="double_integrator", settings=["duration_s=5"])
    step = env.reset()
    assert step.observation["neighbour_offset_m"][0] == pytest.approx([1.504, -1.457])
    while not step.last():
        step = env.step(np.array([4.0, -3.0]))
    assert step.discount == 0.0
    assert env.last["verdict"] == "refuted"
