"""Delays, step by step: MuJoCo reads the command it should, by an oracle that is a shift of the commands."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.vehicle.delay import Age, Past, asked_s, steps_late

STEPS_S = (1e-3, 2e-3, 5e-4, 1 / 3000, 7e-4, 0.02)
MOTOR = """
<mujoco>
  <option timestep="{step_s!r}" gravity="0 0 0"/>
  <worldbody><body><geom size="1" mass="1e9"/><joint name="rail" type="slide"/></body></worldbody>
  <actuator><motor joint="rail" nsample="{room}"/></actuator>
</mujoco>
"""


def given_and_used(step_s, late, room, duration_s, hold=1, start_s=0.0):
    """The command of every physics step, and the one whose force MuJoCo applied, from 1 on."""
    model = mujoco.MjModel.from_xml_string(MOTOR.format(step_s=step_s, room=room))
    model.actuator_delay[0] = asked_s(late, step_s)
    data = mujoco.MjData(model)
    data.time = start_s
    commands = 1.0 + np.arange(round(duration_s / step_s)) // hold
    used, ctrl, force = np.empty_like(commands), data.ctrl, data.actuator_force
    for k, command in enumerate(commands.tolist()):
        ctrl[0] = command
        mujoco.mj_step(model, data)
        used[k] = force[0]
    return commands, used


def late_by(commands, late):
    """The oracle: what was given that many steps before, and nothing before the first."""
    return np.concatenate([np.zeros(late), commands])[: len(commands)]


def test_every_step_of_15_s_uses_the_command_of_a_delay_ago_whatever_the_buffers_length(long):
    """At 1/3 of a millisecond and at 20 ms, none, less than a step, whole steps and parts of them."""
    rng = np.random.default_rng(5)
    for _ in range(500 if long else 12):
        step_s = float(rng.choice(STEPS_S))
        whole = int(rng.integers(0, 1 + round(0.3 / step_s)))
        delay_s = step_s * rng.choice([0, whole, whole + rng.uniform(0.01, 0.99), rng.uniform(0.01, 0.99)])
        late = int(steps_late(delay_s, step_s))
        room = max(late, 1) + int(rng.choice([0, 1, 2, rng.integers(300)]))
        commands, used = given_and_used(step_s, late, room, 15, hold=int(rng.choice([1, 10])))
        wrong = np.count_nonzero(used != late_by(commands, late))
        assert not wrong, f"{wrong} steps with {delay_s} s, {step_s} s and room for {room}"


@pytest.mark.parametrize("start_s", [1000.0, 3590.0])
def test_the_clocks_rounding_of_an_hour_makes_no_difference(start_s):
    """The longest delay, with buffers as long and longer."""
    for step_s in (1e-3, 1 / 3000, 1e-4):
        late = int(steps_late(2.0, step_s))
        for room in (late, late + 17):
            commands, used = given_and_used(step_s, late, room, 5.0, start_s=start_s)
            assert np.array_equal(used, late_by(commands, late))


def test_the_clock_wanders_far_less_than_half_a_step():
    """As MuJoCo adds it up: over the longest delay, at the end of the longest run, with the shortest step."""
    for step_s in (1e-5, 3e-5, 1e-4, 1e-3):
        count = int(steps_late(2.0, step_s))
        stamps = np.cumsum(np.concatenate([[3600.0], np.full(count, step_s)]))  # one after the other
        assert abs(stamps[-1] - stamps[0] - count * step_s) < 0.02 * step_s / 2


@pytest.mark.parametrize("step_s", [1e-5, 1e-4, 1 / 3000, 7e-4, 1e-3, 2e-3])
def test_a_delay_of_whole_steps_is_that_many_steps(step_s):
    """However it is written: as a product, in decimals, as a sum."""
    steps = np.arange(0, round(2 / step_s) + 1, max(1, round(0.001 / step_s)))
    assert np.array_equal(steps_late(steps * step_s, step_s), steps)
    assert np.array_equal(steps_late([float(f"{n * step_s:.15g}") for n in steps.tolist()], step_s), steps)
    assert np.array_equal(steps_late(asked_s(steps, step_s), step_s), steps)


@given(st.floats(0, 2), st.sampled_from(STEPS_S))
def test_a_delay_of_parts_of_a_step_is_the_next_whole_number_of_them(delay_s, step_s):
    late = int(steps_late(delay_s, step_s))
    assert late * step_s >= delay_s - 1e-9 * step_s - 1e-15
    assert (late - 1) * step_s < delay_s or late == 0


@pytest.mark.parametrize("step_s", [0.01, 0.1, 0.02, 1 / 30, 0.07])
def test_an_age_of_whole_ticks_reads_them_exactly_whatever_the_room(step_s):
    ages_s = np.arange(40) * step_s
    ages = Age.of(ages_s, step_s)
    pasts = [Past(np.full(40, -1.0), longest_s, step_s) for longest_s in (ages_s[-1], 3 * ages_s[-1])]
    values = np.random.default_rng(1).normal(size=200)
    for k, value in enumerate(values):
        for past in pasts:
            past.push(np.full(40, value))
            expected = [values[k - i] if i <= k else -1.0 for i in range(40)]
            assert past.ago(ages).tolist() == expected
