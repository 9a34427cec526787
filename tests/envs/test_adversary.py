"""The mirror image: what a neighbour may do, and that it is paid for nothing that is excused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjmerge import MjmergeError, load
from mjmerge.envs.adversary import BRAKES_MPS2
from mjmerge.envs.episodes import Episodes
from mjmerge.envs.make import opposing
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.verdict.hypotheses import broken
from mjmerge.verdict.judge import COMFORTABLE

COARSE = ["duration_s=6", "control_step_s=0.05"]


def played(task, act, cases=None, seeds=(0,)):
    """Plays episodes to their end: rewards, (N, T), and the episodes."""
    episodes = Episodes(task, len(seeds))
    cases = [task.scenario.mismatch] * len(seeds) if cases is None else cases
    episodes.reset(np.arange(len(seeds)), seeds, cases)
    rewards, outs = [], []
    while not episodes.over.all():
        outs.append(episodes.step(np.full((len(seeds), 1), act(len(rewards)))))
        rewards.append(outs[-1].reward)
    return np.stack(rewards, axis=1), episodes, outs


def paid(trace):
    """The reward of each tick by its definition, asked at every tick anew, over the whole trace, (T,)."""
    r_m, d = trace.scenario.r_m, trace.distance_m[0]
    broke = np.any([marks[0] for marks in broken(trace).values()], axis=0)
    least, rewards = d[0].min(), []
    for k in range(int((~np.isnan(d[:, 0])).sum())):
        apart = np.flatnonzero((d[: k + 1] >= COMFORTABLE * r_m).all(axis=1))
        excused = broke[(apart[-1] if apart.size else 0) : k + 1].any()
        now = d[k].min()
        rewards.append((least - now) / r_m if now < least and not excused else 0.0)
        least = now if now < least and not excused else least
    return np.array(rewards)


FALSE = [
    Mismatch(),
    Mismatch(neighbour_position_noise_m=0.004),  # too much now and then
    Mismatch(neighbour_position_noise_m=0.008),
    Mismatch(command_delay_s=0.15),  # it does not move as commanded, now and then
]


@settings(max_examples=12)
@given(st.lists(st.floats(-8, 8), min_size=1, max_size=6), st.sampled_from(["double_integrator", "bicycle"]))
def test_it_is_paid_by_the_definition_tick_by_tick_and_hypotheses_are_those_of_the_judge(moves, plant):
    task = opposing(plant=plant, settings=[*COARSE, "initial.ego.front_m=[-1.0,0.9]"])
    rewards, episodes, _ = played(task, lambda k: moves[k // 20 % len(moves)], FALSE, range(len(FALSE)))
    for i in range(len(FALSE)):
        expected = paid(episodes.trace(i))
        assert rewards[i, : len(expected)] == pytest.approx(expected, abs=1e-12)


def test_some_of_these_are_excused_and_some_are_not():
    task = opposing(plant="double_integrator", settings=COARSE)
    rewards, episodes, _ = played(
        task, lambda _: 3.0, [Mismatch(), Mismatch(neighbour_position_bias_m=0.3)], (0, 1)
    )
    assert rewards[0].sum() > 0.2
    assert not rewards[1].any()
    closest = np.nanmin(episodes.trace(1).distance_m)
    assert closest < episodes.trace(1).distance_m[0, 0].min()
    assert rewards[0].sum() <= episodes.trace(0).distance_m[0, 0].min() / task.scenario.r_m


def test_on_the_ideal_plant_it_cannot_bring_about_a_collision_whatever_it_does(long):
    task = opposing(plant="double_integrator", settings=["duration_s=10"])
    rng, runs = np.random.default_rng(0), 256 if long else 32
    moves = rng.choice([-1.0, 0.0, 1.0], size=(runs, 41)) * task.most_asked
    episodes, ends, k = Episodes(task, runs), {}, 0
    episodes.reset(np.arange(runs), range(runs), [Mismatch()] * runs)
    while not episodes.over.all():
        ends |= episodes.step(moves[:, [k // 25]]).ends
        k += 1
    assert len(ends) == runs
    assert "refuted" not in {end["verdict"] for end in ends.values()}


def test_it_accelerates_within_the_scenarios_bound_never_reverses_and_keeps_its_lane():
    task = opposing(plant="double_integrator", settings=COARSE)
    assert task.most_asked == pytest.approx([7.5])
    _, episodes, _ = played(task, lambda _: -100.0)
    trace = episodes.trace(0)
    u, v, y = trace.u_mps2[0, :, 2, 0], trace.velocity_mps[0, :, 2, 0], trace.front_m[0, :, 2, 1]
    assert u.min() == -7.5
    assert v.min() >= 0
    assert v[-1] == pytest.approx(0, abs=1e-12)
    assert np.abs(y).max() < 1e-12
    _, episodes, _ = played(task, lambda k: 100.0 if k < 5 else 0.0)
    assert episodes.trace(0).u_mps2[0, :5, 2, 0] == pytest.approx(7.5)


def test_where_the_scenario_names_no_bound_it_is_what_people_do_and_any_neighbour_can_be_driven():
    scenario = load("paper", COARSE).model_copy(update={"search": None})
    assert opposing(scenario, "double_integrator").most_asked == pytest.approx([BRAKES_MPS2])
    task = opposing(plant="double_integrator", car="vehicle_1", settings=COARSE)
    assert (task.drives, task.most_asked.tolist()) == ("vehicle_1", [BRAKES_MPS2])
    with pytest.raises(MjmergeError, match="no neighbour called 'ego': "):
        opposing(car="ego")


def test_it_sees_the_others_from_its_own_car_the_ego_first():
    task = opposing(plant="double_integrator", settings=COARSE)
    episodes = Episodes(task, 1)
    seen, _ = episodes.reset(np.arange(1), [0], [Mismatch()])
    assert seen[0] == pytest.approx([0.365925, 1.457, 1.869925, 0, 0, 0, 0, 0, 2.0])


def test_a_safe_episode_is_not_held_for_what_it_would_be_without_the_barrier_is_not_known():
    task = opposing(plant="double_integrator", settings=COARSE)
    *_, outs = played(task, lambda _: 0.0)
    (end,) = outs[-1].ends.values()
    assert end["verdict"] == "vacuous"
    assert "not known" in end["reason"]
    assert "hold small against d" in end["broken_at_s"]  # the law drives, and is asked all that it needs
