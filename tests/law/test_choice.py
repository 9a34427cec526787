"""Between which two neighbours the ego means to merge: named, or chosen as it goes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjmerge.errors import MjmergeError, ScenarioError
from mjmerge.law import Sensed, kinds
from mjmerge.law.asked import decided
from mjmerge.law.choice import FOLLOWER, LEADER, Two, chosen
from mjmerge.record.read import read
from mjmerge.review.derived import derived
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.load import load
from mjmerge.simulation.continuous import check
from mjmerge.simulation.loop import simulate
from mjmerge.verdict.metrics import events

R_M = 0.6
WAYS = ("nearest", "largest", "first_open")


def law(choice, kind="opinion_dynamics", **more):
    return load("charge", [f"law.kind={kind}"]).law.model_copy(update={"choice": choice, "r_m": R_M, **more})


def seen(x_m, ego_m=0.0, ego_across_m=1.2, across_m=None, runs=1):
    """Neighbours at these places along the road, in one lane unless it is said otherwise."""
    across = np.zeros(len(x_m)) if across_m is None else np.array(across_m)
    p_j = np.broadcast_to(np.stack([np.array(x_m, float), across], axis=-1), (runs, len(x_m), 2)).copy()
    v_j = np.broadcast_to(np.array([2.0, 0.0]), p_j.shape).copy()
    p = np.broadcast_to(np.array([ego_m, ego_across_m]), (runs, 2)).copy()
    return Sensed(p, np.full((runs, 2), [2.0, 0.0]), p_j, v_j, np.zeros((runs, 2)))


def two(found):
    return int(np.asarray(found.j_1)[0]), int(np.asarray(found.j_2)[0])


def in_words(choice, x_m, ego_m):
    """The same choice said once more, gap by gap."""
    order = sorted(range(len(x_m)), key=lambda j: -x_m[j])
    gaps = list(pairwise(order))

    def away(gap):
        return abs((x_m[gap[0]] + x_m[gap[1]]) / 2 - ego_m)

    def width(gap):
        return x_m[gap[0]] - x_m[gap[1]]

    if choice == "nearest":
        return min(gaps, key=away)
    if choice == "largest":
        return max(gaps, key=width)
    return min(gaps, key=lambda gap: (width(gap) <= 3 * R_M, away(gap)))


places = st.lists(
    st.integers(-400, 400), min_size=2, max_size=8, unique=True
)  # in tenths of a metre, so that no two gaps differ by rounding alone


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(WAYS), places, st.integers(-300, 300))
def test_it_is_the_gap_that_is_meant(choice, tenths, ego):
    x_m = [x / 10 for x in tenths]
    found, expected = two(chosen(law(choice), seen(x_m, ego / 10))), in_words(choice, x_m, ego / 10)
    if found != expected:  # two that are as good: the first one along the road is taken

        def cost(gap):
            width, away = x_m[gap[0]] - x_m[gap[1]], abs((x_m[gap[0]] + x_m[gap[1]]) / 2 - ego / 10)
            return {"nearest": away, "largest": -width}.get(choice, (width <= 3 * R_M, away))

        assert np.allclose(np.array(cost(found), float), np.array(cost(expected), float), atol=1e-9)


def test_who_is_in_another_lane_is_nobody_to_merge_between():
    x_m, across = [9.0, 3.0, 0.0, -3.0], [0.0, 0.0, 1.2, 0.0]
    assert two(chosen(law("nearest"), seen(x_m, across_m=across))) == (1, 3)
    alone = chosen(law("nearest"), seen([3.0, 0.0, -3.0], across_m=[0.0, 1.2, 1.2]))
    assert two(alone) == (0, 1), "without a gap it stays with the named ones"


@pytest.mark.parametrize(
    ("ego_m", "across_m", "expected"), [(-1.7, 1.2, (0, 1)), (-1.9, 1.2, (1, 2)), (-1.9, 0.5, (0, 1))]
)
def test_it_changes_only_for_what_is_better_by_r_and_not_any_more_near_the_lane(ego_m, across_m, expected):
    """The gaps' middles are at 0 and -3: at -1.5 - r/2 the second is nearer by r."""
    now = seen([1.5, -1.5, -4.5], ego_m, across_m)
    assert two(chosen(law("nearest"), now)) == (1, 2), "it is the nearer one"
    before = Two(R_M, np.array([0]), np.array([1]))
    assert two(chosen(law("nearest"), now, before)) == expected


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 7), st.integers(0, 1000), st.integers(0, 1), st.integers(0, 1))
def test_any_neighbour_comes_to_any_place_and_back(neighbours, seed, leader, follower):
    rng = np.random.default_rng(seed)
    named = law("nearest", leader=f"vehicle_{1 + leader}", follower=f"vehicle_{2 - leader}")
    pairs = np.array([rng.permutation(neighbours)[:2] for _ in range(5)])
    them = Two(R_M, pairs[:, 0], pairs[:, 1])
    x = np.arange(neighbours) * 10.0 + follower
    there = seen(x, runs=5)
    shown = them.arranged(named, there)
    rows = np.arange(5)
    assert np.array_equal(shown.p_j[rows, named.j_1], there.p_j[rows, pairs[:, 0]])
    assert np.array_equal(shown.p_j[rows, named.j_2], there.p_j[rows, pairs[:, 1]])
    assert np.array_equal(np.sort(shown.p_j[..., 0], axis=1), np.sort(there.p_j[..., 0], axis=1))
    decision = decided(named, shown, named.start(5, {"z": 0.1, "mu": 0.0}), 0.01)
    back = them.put_back(named, decision).signals
    plain = decided(named, there, named.start(5, {"z": 0.1, "mu": 0.0}), 0.01).signals
    assert np.array_equal(back["sensed_distance_m"], plain["sensed_distance_m"])
    assert back[LEADER.name].tolist() == (pairs[:, 0] + 1).tolist()
    assert back[FOLLOWER.name].tolist() == (pairs[:, 1] + 1).tolist()


PLATOON = (
    "initial.ego.front_m=[-0.2, 1.457]",
    "initial.vehicle_3={front_m: [-4.2, 0.0], speed_mps: 2.0}",
    "initial.vehicle_4={front_m: [-8.0, 0.0], speed_mps: 2.0}",
    "drivers.vehicle_3={kind: gap, gap_m: 2.3}",
    "drivers.vehicle_4={kind: gap, gap_m: 3.8}",
    "control_step_s=0.02",
    "search=null",
    "gate=[]",
)


def platoon(*keys, duration_s=3):
    return load("charge", [*PLATOON, f"duration_s={duration_s}", *keys])


@pytest.mark.parametrize("kind", [kind for kind in kinds() if kind != "mpc"])
def test_any_law_does_with_chosen_ones_what_it_does_with_the_same_named(kind):
    keys = (f"law.kind={kind}", "mismatch.neighbour_position_noise_m=0.001")
    free = simulate(platoon(*keys, "law.choice=largest", duration_s=1), "bicycle_limited")
    said = platoon(*keys, "law.leader=vehicle_3", "law.follower=vehicle_4", duration_s=1)
    named = simulate(said, "bicycle_limited")
    assert set(free.signals[LEADER.name][0].tolist()) == {3.0}
    for name in ("u_mps2", "front_m", "gap_m", "sensed_distance_m", "sensed_leader_mps2", "target_m"):
        ours, theirs = free.column(name), named.column(name)
        assert np.allclose(ours, theirs, rtol=0, atol=1e-12, equal_nan=True), name  # sums in another order
    assert np.array_equal(free.leader_m, named.leader_m)
    assert np.array_equal(free.follower_m, named.follower_m)


@pytest.fixture(scope="module")
def changing():
    """Vehicle 4 comes up and Vehicle 2 falls back: another gap is the largest then."""
    return platoon(
        "law.choice=largest",
        "drivers.vehicle_4={kind: gap, gap_m: 3.8, moves: [{start_s: 0.2, duration_s: 2.0, gap_m: 1.5}]}",
        "mismatch.neighbour_position_noise_m=0.001",
    )


def test_a_change_is_recorded_an_event_and_followed_by_gap_leader_and_hypotheses(changing):
    trace = simulate(changing, "double_integrator")
    at = np.flatnonzero(np.diff(trace.signals[LEADER.name][0])) + 1
    assert len(at) == 1, "it changes once"
    texts = [e.text for e in events(trace) if e.text.startswith("chooses")]
    assert texts == [
        "chooses the gap between vehicle_3 and vehicle_4",
        "chooses the gap between vehicle_1 and vehicle_2",
    ]
    k = int(at[0])
    p = trace.front_m[0]
    for tick, (one, other) in ((k - 1, (3, 4)), (k, (1, 2))):
        assert trace.gap_m[0, tick] == pytest.approx(p[tick, one, 0] - p[tick, other, 0] - trace.scenario.r_m)
        assert trace.sensed_leader_mps2[0, tick].tolist() == trace.u_mps2[0, tick, one].tolist()


def test_runs_that_choose_differently_have_the_bits_that_each_has_alone(changing):
    noisy = changing.model_copy(
        update={"mismatch": changing.mismatch.model_copy(update={"neighbour_position_noise_m": 0.3})}
    )
    together = simulate(noisy, "bicycle_limited", runs=4, seed=3)
    numbers = together.signals[LEADER.name]
    assert any(not np.array_equal(numbers[0], one) for one in numbers[1:]), "they choose differently"
    alone = simulate(noisy, "bicycle_limited", seed=5)
    for name in ("front_m", "u_mps2", "gap_m", LEADER.name, FOLLOWER.name):
        assert np.array_equal(together.column(name)[2], alone.column(name)[0]), name


def test_among_two_there_is_nothing_to_choose_and_who_gives_it_is_told():
    with pytest.raises(ScenarioError, match="acts only among more than two neighbours"):
        simulate(load("charge", ["law.choice=nearest", "duration_s=0.1"]), "double_integrator")
    simulate(platoon("law.choice=nearest", duration_s=0.1), "double_integrator")


def test_in_continuous_time_the_two_are_named():
    check("bicycle", law("named"))
    with pytest.raises(MjmergeError, match=r"law\.choice must be 'named' in continuous time"):
        check("bicycle", law("nearest"))


@pytest.fixture(scope="module")
def recordings(changing, tmp_path_factory):
    """A run folder of it, with both recordings."""
    folder = tmp_path_factory.mktemp("platoon") / "run"
    run(changing, "bicycle_limited", folder=folder)
    return folder


@pytest.mark.parametrize("name", ["run.mcap", "run.rrd"])
def test_a_recording_says_whom_it_chose_and_verifies(recordings, name):
    found = read(recordings / name, wary=False)
    assert set(found.columns[LEADER.name]) == {1.0, 3.0}
    verified = verify(recordings / name)
    assert verified.right, [check for check in verified.checks if check.right is False]


@pytest.mark.parametrize("name", [LEADER.name, FOLLOWER.name, "gap_m", "sensed_distance_m"])
def test_a_choice_that_does_not_follow_from_what_was_seen_is_wrong(recordings, name):
    found = read(recordings / "run.mcap", wary=False)
    column = found.columns[name].copy()
    column[60:70] = 4.0 if name in (LEADER.name, FOLLOWER.name) else column[60:70] + 0.01
    forged = replace(found, columns={**found.columns, name: column})
    assert any(check.right is False for check in derived(forged, forged.trace()))
