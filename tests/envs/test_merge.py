"""The merge as a task: what is seen, what is given, and that only merging pays."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge import MjmergeError, load, simulate
from mjmerge.envs.episodes import Episodes
from mjmerge.envs.make import cases_of, merging
from mjmerge.envs.merge import FAILED, LOST, MOST_MPS2
from mjmerge.envs.parts import Part, bounds, places
from mjmerge.envs.parts import seen as shown
from mjmerge.envs.task import State, only
from mjmerge.scenario.cars import believed_sheets
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.simulation.trace import Stop
from mjmerge.verdict.metrics import MERGED_M

SHORT = ["duration_s=0.5"]


def begun(task, seeds=(0,), cases=None):
    """Episodes of a task, and what is seen first."""
    episodes = Episodes(task, len(seeds))
    cases = [task.scenario.mismatch] * len(seeds) if cases is None else cases
    seen, _ = episodes.reset(np.arange(len(seeds)), seeds, cases)
    return episodes, seen


def part(task, seen, name):
    """A part of what is seen, by its name."""
    (at,) = [(p, where) for p, where in task.where_seen.items() if p.name == name]
    return seen[..., at[1]].reshape(*seen.shape[:-1], *at[0].shape)


def keeps_its_speed(task, seen, time_s, rng):
    return 0.0, 0.0


def brakes_and_parks(task, seen, time_s, rng):
    x, y = part(task, seen, "velocity_mps")
    return -min(4.0, 2.0 * x), -3.0 * y


def goes_round_in_circles(task, seen, time_s, rng):
    x, y = part(task, seen, "velocity_mps")
    return -2.0 * y, 2.0 * x


def weaves(task, seen, time_s, rng):
    return 0.0, 1.5 * np.cos(2.0 * time_s)


def rides_beside_the_gap(task, seen, time_s, rng):
    ahead, closing = (
        part(task, seen, f"neighbour_{what}")[:, 0].mean() for what in ("offset_m", "velocity_mps")
    )
    return 2.0 * ahead + 3.0 * closing, -3.0 * part(task, seen, "velocity_mps")[1]


def throws_dice(task, seen, time_s, rng):
    return rng.uniform(-MOST_MPS2, MOST_MPS2, 2)


LAZY = (
    keeps_its_speed, brakes_and_parks, goes_round_in_circles, weaves, rides_beside_the_gap, throws_dice,
)  # fmt: skip


@pytest.fixture(scope="module")
def earned():
    """What the law and lazy policies earn in the paper's run, side by side, what is said, and its trace."""
    task = merging(plant="double_integrator")
    law = simulate(task.scenario, task.plant).u_mps2[0, :, 0]
    episodes, seen = begun(task, range(1 + len(LAZY)))
    rng, total, ends = np.random.default_rng(0), np.zeros(1 + len(LAZY)), {}
    for k, u in enumerate(law):
        actions = [u, *(act(task, one, 0.01 * k, rng) for act, one in zip(LAZY, seen[1:], strict=True))]
        out = episodes.step(actions)
        total, seen, ends = total + out.reward, out.observation, ends | out.ends
    assert episodes.over.all()
    names = ["law", *(act.__name__ for act in LAZY)]
    ends = {names[i]: end for i, end in ends.items()}
    return dict(zip(names, total.tolist(), strict=True)), ends, episodes.trace(0)


def test_the_law_earns_a_second_for_each_that_it_is_in_the_gap_and_one_for_going_there(earned):
    x, y = np.moveaxis(earned[2].front_m[0], -1, 0)
    there = (np.abs(y[:, 0] - y[:, 1]) < MERGED_M) & (x[:, 0] < x[:, 1]) & (x[:, 0] > x[:, 2])
    assert there.sum() * 0.01 > 10
    assert earned[0]["law"] == pytest.approx(there.sum() * 0.01 + 1, abs=0.1)


@pytest.mark.parametrize("lazy", [act.__name__ for act in LAZY])
def test_who_does_not_merge_earns_less_than_a_tenth_of_what_the_law_does(earned, lazy):
    assert earned[0][lazy] < earned[0]["law"] / 10


def test_to_wait_is_better_than_to_park_and_to_park_than_to_crash(earned):
    waits, parks = earned[0]["keeps_its_speed"], earned[0]["brakes_and_parks"]
    assert FAILED + 1 < parks < waits - 3
    assert abs(waits) < 0.5


def test_the_page_says_what_they_earn(earned):
    page = (Path(__file__).parents[2] / "docs" / "environments.md").read_text(encoding="utf-8")
    table = page.partition("<!-- paid -->")[2].partition("\n\n")[0]
    said = {row.split("`")[1]: row.split("|")[2].strip() for row in table.splitlines() if "`" in row}
    assert said == {name: f"{value:.2f}" for name, value in earned[0].items()}


def test_whoever_drives_no_verdict_claims_that_its_guard_was_needed(earned):
    assert {end["verdict"] for end in earned[1].values()} == {"vacuous"}


def state(ego, gap=(0.0, -2.0), unsafe=False):
    front_m = np.array([[ego, [gap[0], 0.0], [gap[1], 0.0]]])
    return State(0.0, front_m, np.ones((1, 2)), np.array([unsafe]))


place = st.tuples(st.floats(-20, 20), st.floats(-20, 20))


@given(st.lists(place, max_size=8))
def test_a_way_that_leads_back_to_where_it_began_earns_nothing_but_its_time_in_the_gap(way):
    task, start = merging(settings=SHORT), (-1.0, 1.5)
    score, path = task.begin(state(start)), [start, *way, start]
    total = sum(float(score(state(p), None)[0]) for p in path)
    there = sum(abs(y) < MERGED_M and -2 < x < 0 for x, y in path)
    assert total == pytest.approx(task.scenario.control_step_s * there, abs=1e-9)


def test_to_go_to_the_middle_earns_one_to_be_lost_costs_no_more_than_it_may_and_to_fail_what_it_says():
    task = merging(settings=SHORT)
    h = task.scenario.control_step_s
    for end, unsafe, expected in (
        ((-1.0, 0.0), False, 1 + h),
        ((-1.0, 0.75), False, 0.5),
        ((1000.0, 0.0), False, 1 - LOST),
        ((-1.0, 1.5), True, FAILED),
        ((-2.5, 0.0), False, 0.0),  # behind the gap, as far from it as at first
    ):
        score = task.begin(state((-1.0, 1.5)))
        total = [float(score(state(p, unsafe=u), None)[0]) for p, u in (((-1.0, 1.5), False), (end, unsafe))]
        assert sum(total) == pytest.approx(expected)


def test_the_agent_sees_what_the_law_is_told_and_not_the_truth():
    task = merging(plant="bicycle", settings=SHORT)
    false = Mismatch(neighbour_position_noise_m=0.1, heading_noise_rad=0.1, sensing_delay_s=0.05)
    episodes, first = begun(task, [0, 1], [false, Mismatch()])
    rows = [first, *(episodes.step(np.full((2, 2), 0.5)).observation for _ in range(30))]
    seen = np.stack(rows[:-1], axis=1)
    for i in (0, 1):
        trace = episodes.trace(i)
        told, truth = trace.sensed_front_m[0, :30], trace.front_m[0, :30]
        theta = trace.sensed_heading_rad[0, :30]
        assert np.array_equal(part(task, seen, "neighbour_offset_m")[i], told[:, 1:] - told[:, :1])
        assert np.array_equal(part(task, seen, "heading")[i], np.stack([np.cos(theta), np.sin(theta)], -1))
        assert np.array_equal(
            part(task, seen, "leader_acceleration_mps2")[i], trace.sensed_leader_mps2[0, :30]
        )
        assert np.array_equal(part(task, seen, "steer_rad")[i][:, 0], trace.sensed_steer_rad[0, :30])
        assert (np.abs(told - truth).max() > 0.01) == (i == 0)


def test_every_part_says_its_unit_and_its_bounds_and_everything_seen_is_within():
    for how in ({"plant": "double_integrator"}, {"plant": "bicycle", "action": "steering"}):
        task = merging(settings=["duration_s=3", "control_step_s=0.05"], **how)
        assert all(p.unit and p.doc and np.isfinite(p.most) and p.most > 0 for p in (*task.sees, *task.acts))
        episodes, seen = begun(task)
        while not episodes.over.all():
            assert (np.abs(seen) <= task.most_seen).all()
            seen = episodes.step(np.full((1, 2), 1e9)).observation
        asked = "u_mps2" if how["plant"] == "double_integrator" else "a_mps2"
        given = episodes.trace(0).column(asked)[0, :, 0]
        assert np.abs(given).max() == pytest.approx(MOST_MPS2, abs=1e-6)


def test_an_acceleration_and_a_steering_angle_are_what_the_car_is_told():
    task = merging(plant="bicycle", action="steering", settings=["duration_s=1"])
    episodes, _ = begun(task)
    for _ in range(60):
        episodes.step([[0.7, 0.2]])
    trace = episodes.trace(0)
    a, steer = trace.a_mps2[0, :60, 0], trace.steer_command_rad[0, :60, 0]
    assert a == pytest.approx(0.7, abs=1e-9)
    rate = believed_sheets(task.scenario)[0].steer_rate_limit_radps * task.scenario.control_step_s
    assert np.abs(np.diff(steer, prepend=0.0)).max() <= rate + 1e-12
    assert steer[-1] == pytest.approx(0.2, abs=1e-9)
    assert np.abs(trace.steer_clipped_rad[0, :60, 0]).max() == 0.0


def test_points_have_no_wheels_to_steer():
    with pytest.raises(MjmergeError, match="double_integrator has no wheels to steer"):
        merging(plant="double_integrator", action="steering")


@pytest.mark.parametrize("plant", ["double_integrator", "bicycle"])
def test_who_drives_into_the_leader_is_over_and_it_is_nobody_elses_fault(plant):
    task = merging(plant=plant)
    episodes, _ = begun(task, [0, 1])
    out, steps = episodes.step(np.zeros((2, 2))), 1
    while not out.terminated.any():
        before, out, steps = out, episodes.step([[4.0, -3.0], [0.0, 0.0]]), steps + 1
    trace = episodes.trace(0)
    rows = np.flatnonzero(~np.isnan(trace.distance_m[0, :, 0]))
    assert len(rows) == steps
    d = trace.distance_m[0, rows].min(axis=1)
    assert d[-1] <= 0 < d[-2]
    assert out.terminated.tolist() == [True, False]
    assert not (before.terminated | before.truncated | out.truncated).any()
    assert out.ends[0]["verdict"] == "refuted"
    assert set(out.ends[0]["broken_at_s"].values()) == {np.inf}
    assert "hold small against d" not in out.ends[0]["broken_at_s"]  # of the law that looked on
    assert out.reward[0] < FAILED + 1
    waits = episodes.step(np.zeros((2, 2)))
    assert np.isnan(episodes.trace(0).distance_m[0, steps:]).all()  # it is over in truth, too
    assert not np.isnan(episodes.trace(1).distance_m[0, : steps + 1]).any()
    assert waits.terminated.tolist() == [True, False]
    assert waits.reward[0] == 0
    assert np.array_equal(waits.observation[0], out.observation[0])


def test_bodies_that_touch_on_mujoco_end_it_though_the_margin_is_kept():
    task = merging(settings=["duration_s=3", "law.r_m=0.05"])
    episodes, _ = begun(task)
    out = episodes.step(np.zeros((1, 2)))
    while not episodes.over.all():
        out = episodes.step([[1.0, -2.0]])
    trace = episodes.trace(0)
    assert out.terminated.all()
    assert trace.touching_ego[0].any()
    assert np.nanmin(trace.distance_m) > 0


@pytest.mark.parametrize(
    ("clearance_m", "impulse_n_s", "unsafe"),
    [
        ((0.1, 0.1, 0.1), (0.0, 0.0, 0.0), False),
        ((-0.1, 0.1, 0.1), (0.0, 0.0, 0.0), True),
        ((0.1, 0.1, 0.1), (0.0, 2.0, 0.0), True),  # they touched since the last tick
        ((0.1, 0.1, -0.1), (0.0, 0.0, 2.0), False),  # the neighbours did, each other
    ],
)
def test_unsafe_is_when_bodies_touch_the_egos(clearance_m, impulse_n_s, unsafe):
    front_m = np.array([[[0.0, 0.0], [2.0, 0.0], [-2.0, 0.0]]])
    cars = SimpleNamespace(front_m=front_m, clearance_m=np.array([clearance_m]))
    impulse = np.array([impulse_n_s])
    turn = SimpleNamespace(cars=cars, time_s=0.0, plant=SimpleNamespace(contacts=lambda: (impulse, impulse)))
    stepper = SimpleNamespace(scenario=load("paper"), plant="mujoco", ramp=None)
    state = State.of(turn, stepper)
    assert state.distance_m == pytest.approx(np.array([[1.4, 1.4]]))
    assert state.unsafe.tolist() == [unsafe]


def test_what_is_seen_is_kept_within_its_bounds_and_is_0_where_nothing_is_known():
    parts = [Part(name, "m", name, (2,), 3.0, lambda turn: turn.cars) for name in ("a", "b")]
    cars = np.array([[5.0, -5.0], [np.nan, 1.0]])
    turn = SimpleNamespace(running=np.array([True, False]), cars=cars)
    assert shown(places(parts), bounds(parts), turn).tolist() == [[3, -3, 3, -3], [0, 1, 0, 1]]


def test_some_simulations_of_a_trace_are_what_each_is_alone(make_trace):
    stops = (Stop(0, 0.1, "ego", "it is off its wheels"), Stop(2, 0.2, "ego", "likewise"))
    z = np.arange(4.0)[:, None] * np.ones((4, 40))
    trace = make_trace(runs=4, stops=stops, opinion=z)
    some = only(trace, np.array([1, 2]))
    for run in (0, 1):
        mine, theirs = some.alone(run, some.scenario), trace.alone(run + 1, trace.scenario)
        assert (mine.stops, mine.seeds, mine.mismatch) == (theirs.stops, theirs.seeds, theirs.mismatch)
        assert np.array_equal(mine.opinion, theirs.opinion)
    assert [stop.run for stop in some.stops] == [1]


def test_a_simulation_that_cannot_go_on_fails_and_what_is_seen_stays_numbers():
    task = merging(settings=["duration_s=3", "mismatch.com_raised_m=1.0"])
    episodes, _ = begun(task)
    out = episodes.step(np.zeros((1, 2)))
    while not episodes.over.all():
        out = episodes.step([[0.0, MOST_MPS2]])
    assert out.terminated.all()
    assert not out.truncated.any()
    assert episodes.trace(0).stops
    assert out.reward[0] < FAILED + 1
    assert np.isfinite(out.observation).all()
    assert out.ends[0]["verdict"] == "incomplete"


def test_the_end_of_the_lane_is_seen_as_the_law_is_told_of_it_and_ends_an_episode():
    task = merging(plant="double_integrator", settings=["duration_s=6", "road.ends_m=4"])
    episodes, seen = begun(task)
    assert part(task, seen, "neighbour_offset_m").shape == (1, 3, 2)
    assert part(task, seen, "neighbour_offset_m")[0, 2, 0] > 0
    while not episodes.over.all():
        out = episodes.step(np.zeros((1, 2)))
    assert out.terminated.all()
    assert "runs off the end of its lane" in out.ends[0]["reason"]
    episodes, first = begun(merging(plant="bicycle", settings=["duration_s=0.05", "road.ends_m=4"]))
    while not episodes.over.all():
        out = episodes.step(np.zeros((1, 2)))
    assert out.truncated.all()
    assert out.observation == pytest.approx(first, abs=0.5)


@pytest.mark.parametrize(
    ("action", "says"),
    [
        ([[0.0, 0.0, 0.0]], r"shape \(1, 3\); they must have \(1, 2\): u_mps2 \(2,\)"),
        ([0.0, 0.0], r"shape \(2,\)"),
        ([[np.nan, 0.0]], "no number"),
        ([["left", "right"]], "must be numbers"),
        (None, "must be numbers|shape"),
    ],
)
def test_what_is_no_action_is_refused(action, says):
    episodes, _ = begun(merging(plant="double_integrator", settings=SHORT))
    with pytest.raises(MjmergeError, match=says):
        episodes.step(action)


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ({"scenario": "papre"}, "did you mean 'paper'"),
        ({"plant": "mujoca"}, "did you mean 'mujoco'"),
        ({"action": "steer"}, "did you mean 'steering'"),
        ({"settings": ["law.k_oo=1"]}, "k_o"),
        ({"scenario": load("paper"), "settings": ["law.k_o=1"]}, "has its own"),
    ],
)
def test_what_is_no_task_is_refused_with_the_nearest(how, says):
    with pytest.raises(MjmergeError, match=says):
        Episodes(merging(**how), 1)


@pytest.mark.parametrize(
    ("cases", "says"),
    [
        ([{"frictoin": 0.3}], r"cases\[0\]: frictoin: .*did you mean 'friction'"),
        ([{}, {"friction": -1}], r"cases\[1\]: friction"),
        ([0.3], r"cases\[0\] must be a mismatch or a mapping, got 0\.3"),
        ({"friction": 0.3}, "cases must be a list of mismatches, got a mapping"),
    ],
)
def test_what_is_no_case_is_refused(cases, says):
    with pytest.raises(MjmergeError, match=says):
        cases_of(merging(settings=SHORT), cases)


def test_a_case_says_what_is_different_from_the_scenarios_own():
    task = merging(settings=[*SHORT, "mismatch.friction=0.5"])
    assert cases_of(task, ()) == (task.scenario.mismatch,)
    (one,) = cases_of(task, [{"command_delay_s": 0.1}])
    assert (one.friction, one.command_delay_s) == (0.5, 0.1)
