"""gymnasium's own checks, and N environments on one batch as N environments one after the other."""

import importlib
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import mjmerge.envs
from mjmerge import MjmergeError, load, simulate
from mjmerge.envs import stepper

IDS = sorted(mjmerge.envs.IDS)
OFTEN = {"plant": "double_integrator", "settings": ["duration_s=0.4", "control_step_s=0.05"]}
CASES = [{}, {"neighbour_position_noise_m": 0.05}, {"sensing_delay_s": 0.1}]


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("plant", ["double_integrator", "mujoco"])
def test_gymnasium_finds_nothing_wrong(name, plant):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*symmetric and normalized")  # actions are in SI units
        check_env(gymnasium.make(name, plant=plant, settings=["duration_s=0.1"]).unwrapped)


@pytest.mark.parametrize("name", IDS)
def test_gymnasiums_names_make_one_and_many(name):
    one, many = gymnasium.make(name, **OFTEN), gymnasium.make_vec(name, num_envs=3, **OFTEN)
    assert one.observation_space == many.single_observation_space
    assert one.action_space == many.single_action_space
    assert many.observation_space.shape == (3, *one.observation_space.shape)
    assert many.action_space.shape == (3, *one.action_space.shape)
    assert type(many.unwrapped).__name__ == "Vector"
    for space in (one.observation_space, one.action_space):
        assert np.isfinite([space.low, space.high]).all()


def test_the_papers_commands_give_the_bits_of_simulate_one_after_the_other_and_64_on_one_batch(monkeypatch):
    settings, began = ["duration_s=0.5"], []
    ticks = stepper.ticks
    monkeypatch.setattr(stepper, "ticks", lambda *given, **how: began.append(1) or ticks(*given, **how))
    expected = simulate(load("paper", settings), "bicycle", runs=64, seed=5)
    u = expected.u_mps2[:, :, 0]
    envs = gymnasium.make_vec("mjmerge/Merge-v0", num_envs=64, plant="bicycle", settings=settings)
    one = gymnasium.make("mjmerge/Merge-v0", plant="bicycle", settings=settings)
    envs.reset(seed=5)
    one.reset(seed=5)
    for k in range(u.shape[1]):
        assert len(began) == 2
        ended = envs.step(u[:, k])[3]
        alone = one.step(u[0, k])[3]
        assert ended.tolist() == [k == u.shape[1] - 1] * 64
        assert alone == ended[0]
    for i, trace in [(0, one.unwrapped.trace), *((i, envs.unwrapped.trace(i)) for i in (0, 40, 63))]:
        assert trace.seeds.tolist() == [5 + i]
        for column in expected.columns:
            theirs = expected.column(column.name)[i : i + 1]
            assert np.array_equal(trace.column(column.name), theirs, equal_nan=True), column.name


def equal(one, other):
    """Whether two infos of many say the same of those that they say anything of."""
    assert one.keys() == other.keys()
    for name, mine in one.items():
        theirs = other[name]
        if isinstance(mine, dict):
            equal(mine, theirs)
        elif mine.dtype == object:
            assert all(data_equivalence(a, b, exact=True) for a, b in zip(mine, theirs, strict=True)), name
        else:
            assert np.array_equal(mine, theirs), name


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("name", IDS)
def test_many_are_what_gymnasium_makes_of_as_many_single_ones(name, mode):
    """Some crash, each at another time, and begin anew, alone or with others, in all three modes."""
    near = ["duration_s=0.8", "control_step_s=0.05", "initial.ego.front_m=[-0.5, 0.9]"]
    how = OFTEN | {"cases": CASES, "settings": near}
    mine = gymnasium.make_vec(name, num_envs=4, autoreset_mode=mode, **how)
    makers = [lambda: gymnasium.make(name, disable_env_checker=True, **how)] * 4
    theirs = SyncVectorEnv(makers, autoreset_mode=mode)
    assert mine.metadata["autoreset_mode"] is mode
    rng, early = np.random.default_rng(0), 0
    seen, expected = mine.reset(seed=7), theirs.reset(seed=7)
    assert np.array_equal(seen[0], expected[0])
    equal(seen[1], expected[1])
    for k in range(60):
        actions = rng.uniform(mine.action_space.low, mine.action_space.high)
        actions[:2, -1] = -10.0  # into the neighbours' lane
        (*got, told), (*want, says) = mine.step(actions), theirs.step(actions)
        for a, b in zip(got, want, strict=True):
            assert np.array_equal(a, b)
        equal(told, says)
        early += got[2].any() and not got[2].all()
        over = got[2] | got[3]
        over[3] |= k % 13 == 5  # in the middle of an episode
        if mode is AutoresetMode.DISABLED and over.any():
            seed = rng.integers(100, size=4).tolist()
            again = (e.reset(seed=seed, options={"reset_mask": over.copy()}) for e in (mine, theirs))
            (seen, told), (expected, says) = again
            assert np.array_equal(seen, expected)
            equal(told, says)
    assert early or name == "mjmerge/Adversary-v0"


def test_what_is_handed_out_is_nobodys_but_the_agents():
    envs = gymnasium.make_vec("mjmerge/Merge-v0", num_envs=2, autoreset_mode="Disabled", **OFTEN)
    envs.reset(seed=0)
    for _ in range(9):
        seen, *_ = envs.step(np.zeros((2, 2)))
    kept = seen.copy()
    seen[:] = 7.0
    assert np.array_equal(envs.step(np.zeros((2, 2)))[0], kept)


def test_the_last_step_tells_the_verdict_and_when_each_hypothesis_broke():
    env = gymnasium.make("mjmerge/Merge-v0", cases=[{"neighbour_position_bias_m": 0.3}], **OFTEN)
    _, first = env.reset(seed=0)
    assert first.keys() == {"time_s", "distance_m", "in_gap"}
    assert first["distance_m"] == pytest.approx([1.4938, 0.9019], abs=1e-3)
    over = False
    while not over:
        _, _, failed, over, info = env.step(np.zeros(2))
        assert ("verdict" in info) == over
    assert not failed
    assert info["verdict"] == "vacuous"
    assert info["broken_at_s"]["distances known"] == 0.0
    assert info["broken_at_s"]["neighbours bounded"] == np.inf
    assert info["time_s"] == pytest.approx(0.4)
    with pytest.raises(MjmergeError, match="reset comes first"):
        env.unwrapped.step(np.zeros(2))


def test_an_episode_that_is_left_in_the_middle_is_over_and_tells_no_verdict():
    env = gymnasium.make("mjmerge/Merge-v0", **OFTEN)
    for steps in (3, 9):
        env.reset(seed=0)
        told = ["verdict" in env.step(np.zeros(2))[4] for _ in range(steps)]
    assert told == [False] * 8 + [True]


def test_episodes_draw_from_the_cases_and_from_nothing_else():
    env = gymnasium.make("mjmerge/Merge-v0", cases=CASES, **OFTEN)
    drawn = []
    for seed in (3, None, None, None, None, None, None, None):
        env.reset(seed=seed)
        drawn.append((env.unwrapped.trace.mismatch[0], int(env.unwrapped.trace.seeds[0])))
    assert {case for case, _ in drawn} == {*env.unwrapped.cases}
    assert drawn[0][1] == 3
    assert len({seed for _, seed in drawn}) == 8


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"reset_maks": np.ones(2, dtype=bool)}, "takes the option reset_mask, got reset_maks"),
        ({"reset_mask": np.zeros(2, dtype=bool)}, "2 times true or false, and once true"),
        ({"reset_mask": np.ones(3, dtype=bool)}, "2 times true or false"),
        ({"reset_mask": [1, 0]}, "2 times true or false"),
    ],
)
def test_options_that_are_none_are_refused(options, says):
    envs = gymnasium.make_vec("mjmerge/Merge-v0", num_envs=2, **OFTEN)
    with pytest.raises(MjmergeError, match=says):
        envs.reset(options=options)
    with pytest.raises(MjmergeError, match="2 environments, and 3 seeds"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises(MjmergeError, match="takes no options, got speed"):
        gymnasium.make("mjmerge/Merge-v0", **OFTEN).reset(options={"speed": 3})
    with pytest.raises(MjmergeError, match="no autoreset mode called 'nextstep': did you mean 'NextStep'"):
        gymnasium.make_vec("mjmerge/Merge-v0", num_envs=2, autoreset_mode="nextstep", **OFTEN)
    with pytest.raises(MjmergeError, match="num_envs is 0; it must be at least 1"):
        gymnasium.make_vec("mjmerge/Merge-v0", num_envs=0, **OFTEN)
    with pytest.raises(MjmergeError, match=r"cases\[0\].*friction"):
        gymnasium.make("mjmerge/Merge-v0", **OFTEN, cases=[{"friction": 0.3}])


def test_without_gymnasium_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium.spaces", None)
    for name in ("spaces", "single"):
        monkeypatch.delitem(sys.modules, f"mjmerge.envs.{name}", raising=False)
    with pytest.raises(MjmergeError, match=r"need gymnasium: pip install 'mjmerge\[envs\]'"):
        importlib.import_module("mjmerge.envs.single")
