"""Who is there is the scenario's to say: any number of neighbours, on every plant, in every table."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from mcap.reader import make_reader

from mjmerge.cli import main
from mjmerge.drivers import ahead
from mjmerge.errors import ScenarioError
from mjmerge.law import Sensed, geometry
from mjmerge.law.opinion_dynamics.barrier import barrier
from mjmerge.law.opinion_dynamics.law import decide
from mjmerge.plant import PLANTS
from mjmerge.record.read import read
from mjmerge.review.replay import replay
from mjmerge.review.verify import verify
from mjmerge.roster import EGO, MOST_CARS, in_order, neighbour, paint, roster, slot
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.load import dump, load
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.loop import simulate
from mjmerge.simulation.trace import COLUMNS
from mjmerge.verdict.judge import judge
from tests.recording import rewrite

COUNTS = (3, 4, 6, 9)
BEYOND_M = ((2.0, 1.2), (2.0, 0.0), (-5.0, 1.2), (-5.5, 0.0), (4.0, 0.0), (4.0, 1.2))
"""Where the further neighbours start: both lanes, ahead and behind."""
CROWD = ("command_delay_s", "sensing_delay_s", "position_noise_m", "neighbour_dropout")


def crowd(cars: int, duration_s: float = 2.0, **keys: object) -> Scenario:
    """A merge between two of many; the third neighbour, in the ego's lane, is slower."""
    plain: dict = {
        "duration_s": duration_s,
        "physics_step_s": 0.002,
        "initial": {
            "ego": {"front_m": [-1.75, 1.2], "speed_mps": 1.0},
            "vehicle_1": {"front_m": [0.0, 0.0], "speed_mps": 1.0},
            "vehicle_2": {"front_m": [-3.5, 0.0], "speed_mps": 1.0},
        },
        "law": {"r_rho_m": -1.5, "r_eta_m": 1.2},
        "drivers": {
            "vehicle_1": {"kind": "steady", "speed_mps": 1.0},
            "vehicle_2": {"kind": "gap", "gap_m": 3.5},
        },
    }
    for j, at in zip(range(2, cars - 1), BEYOND_M, strict=False):
        plain["initial"][neighbour(j)] = {"front_m": list(at), "speed_mps": 1.0}
        plain["drivers"][neighbour(j)] = {"kind": "steady", "speed_mps": 1.0}
    return load(plain, [f"{key}={value}" for key, value in keys.items()])


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("cars", COUNTS)
def test_every_column_has_as_many_as_there_are_and_distances_are_those_of_positions(cars, plant):
    trace = simulate(crowd(cars, 0.5), plant, runs=2)
    for column in COLUMNS:
        assert getattr(trace, column.name).shape[2:] == column.shape(trace.roster), column.name
    between = trace.front_m[:, :, 0, None] - trace.front_m[:, :, 1:]
    assert trace.distance_m.shape == (2, 51, cars - 1)
    assert np.hypot(*np.moveaxis(between, -1, 0)) - 0.6 == pytest.approx(trace.distance_m, abs=1e-12)
    assert trace.clearance_m.shape[2] == cars * (cars - 1) // 2
    assert not np.isnan(trace.front_m).any()


@pytest.mark.parametrize("plant", PLANTS)
def test_run_i_among_others_is_run_i_alone_with_six_cars(plant):
    scenario, rng = crowd(6, 1.0), np.random.default_rng(3)
    cases = [(0, Mismatch())]
    for seed in range(1, 4):
        drawn = {axis: float(rng.uniform(0, 0.1)) for axis in rng.choice(CROWD, 2, replace=False)}
        cases.append((seed, Mismatch(**drawn)))
    together = simulate(scenario, plant, cases=cases)
    for i, case in enumerate(cases):
        alone = simulate(scenario, plant, cases=[case])
        for column in COLUMNS:
            one, other = getattr(alone, column.name)[0], getattr(together, column.name)[i]
            assert one.tobytes() == other.tobytes(), (i, column.name)


def test_the_barrier_sums_over_all_neighbours():
    law, rng = load("paper").law, np.random.default_rng(0)
    for count in (2, 3, 5, 8):
        g, d, d_dot = (
            rng.normal(size=(4, count, 2)),
            rng.uniform(0.1, 2, (4, count)),
            rng.normal(size=(4, count)),
        )
        g /= np.linalg.norm(g, axis=-1, keepdims=True)
        expected = -law.k_o * np.einsum("nj,njx->nx", d_dot / d, g)
        assert barrier(law, g, d, d_dot) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_the_law_is_the_same_whatever_its_neighbours_are_called(order):
    """Leader and follower are named; everyone else is a neighbour like any other."""
    rng = np.random.default_rng(1)
    law = load("paper").law
    sensed = Sensed(*(rng.normal(size=shape) for shape in ((5, 2), (5, 2), (5, 3, 2), (5, 3, 2), (5, 2))))
    called = law.model_copy(
        update={"leader": neighbour(order.index(0)), "follower": neighbour(order.index(1))}
    )
    again = Sensed(sensed.p, sensed.v, sensed.p_j[:, order], sensed.v_j[:, order], sensed.u_1)
    z = rng.uniform(0, 0.2, 5)
    one, other = decide(law, sensed, z), decide(called, again, z)
    assert other.u == pytest.approx(one.u, rel=1e-9)
    assert other.mu_input.tobytes() == one.mu_input.tobytes()
    assert geometry(called, again).dbar.tobytes() == geometry(law, sensed).dbar.tobytes()
    assert other.geometry.d.tobytes() == one.geometry.d[:, order].tobytes()


def test_a_run_whose_cars_are_called_otherwise_is_the_same_run():
    plain = json.loads(json.dumps(crowd(4, 3.0).model_dump(mode="json")))
    other = json.loads(json.dumps(plain))
    for section in ("initial", "drivers"):
        was = plain[section]
        other[section] |= {
            "vehicle_1": was["vehicle_3"], "vehicle_2": was["vehicle_1"], "vehicle_3": was["vehicle_2"],
        }  # fmt: skip
    other["law"] |= {"leader": "vehicle_2", "follower": "vehicle_3"}
    one, two = (simulate(load(p), "bicycle") for p in (plain, other))
    assert two.front_m[:, :, [0, 2, 3, 1]] == pytest.approx(one.front_m, abs=1e-9)
    assert two.opinion == pytest.approx(one.opinion, abs=1e-9)
    assert judge(two)[0].verdict == judge(one)[0].verdict


@pytest.mark.parametrize("speed_mps", [0.4, 0.5, 0.6, 0.7])
def test_the_ego_keeps_away_from_a_third_car_that_is_in_its_way_because_of_the_barrier(speed_mps):
    """Pushed back from the one ahead it comes closer to one behind: the barrier is needed all the same."""
    keys = {"initial.vehicle_3.front_m": "[0.2, 1.2]", "initial.vehicle_3.speed_mps": speed_mps}
    keys |= {"drivers.vehicle_3.speed_mps": speed_mps, "initial.z": 0}
    trace = simulate(crowd(4, 4.0, **keys), "double_integrator")
    (verdict,) = judge(trace)
    assert 0 < trace.distance_m[0, :, 2].min() == trace.distance_m.min()
    assert verdict.verdict == "held"
    assert verdict.needed
    assert verdict.without_barrier_m is not None
    assert verdict.without_barrier_m < 0
    bare = simulate(crowd(4, 4.0, **{**keys, "law.k_o": 0.0}), "double_integrator")
    assert bare.distance_m[0, :, 2].min() == pytest.approx(verdict.without_barrier_m)
    (off,) = judge(bare)
    assert off.verdict == "assumption broken"


def test_a_third_cars_collision_is_a_collision():
    keys = {"initial.vehicle_3.front_m": "[0.0, 1.2]", "initial.vehicle_3.speed_mps": 0}
    keys |= {"drivers.vehicle_3.speed_mps": 0, "initial.z": 0, "law.k_o": 0.0}
    trace = simulate(crowd(4, 3.0, **keys), "mujoco")
    (verdict,) = judge(trace)
    assert verdict.collisions[0].a == EGO
    assert verdict.collisions[0].b == "vehicle_3"
    assert verdict.verdict == "assumption broken"
    assert verdict.unsafe_at_s is not None
    assert "hits vehicle_3" in verdict.reason
    assert not verdict.floor_held


@pytest.mark.parametrize("plant", ["double_integrator", "mujoco"])
def test_a_third_car_that_hits_the_leader_breaks_assumption_1(plant):
    keys = {"initial.vehicle_3.front_m": "[-0.8, 0.0]", "initial.vehicle_3.speed_mps": 3.0}
    keys |= {"drivers.vehicle_3.speed_mps": 3.0}
    trace = simulate(crowd(4, 1.5, **keys), plant)
    (verdict,) = judge(trace)
    assert "neighbours keep apart" in [breach.hypothesis for breach in verdict.breaches]
    if plant == "mujoco":
        assert {verdict.collisions[0].a, verdict.collisions[0].b} == {"vehicle_1", "vehicle_3"}


def test_everyone_follows_the_nearest_that_starts_ahead_in_its_way():
    sheets = car_sheets(load("paper"))[1:2] * 6
    lane = [[0.0, 0.0], [-4.0, 0.0], [2.0, 1.2], [-2.0, 0.05], [-9.0, 1.2], [-6.0, 0.0]]
    assert ahead(lane, sheets) == (None, 3, None, 0, 2, 1)
    apart = [[0.0, 0.0], [-4.0, 3.0]]
    assert ahead(apart, sheets[:2]) == (None, 0)  # the paper's two are one queue in any lane
    assert ahead(apart[::-1], sheets[:2], (1, 0)) == (1, None)


def test_a_car_that_cuts_in_between_is_the_one_that_is_followed():
    """An IDM follower brakes for the third car, which stands between it and the leader."""
    idm = "{kind: idm, desired_speed_mps: 1.0, time_gap_s: 1.0, standstill_gap_m: 0.3}"
    keys = {"drivers.vehicle_2": idm, "initial.vehicle_3.front_m": "[-2.4, 0.0]"}
    keys |= {"initial.vehicle_3.speed_mps": 0.0, "drivers.vehicle_3.speed_mps": 0.0}
    trace = simulate(crowd(4, 4.0, **keys), "bicycle")
    assert trace.speed_mps[0, -1, 2] < 0.1
    assert (trace.front_m[0, :, 3, 0] > trace.front_m[0, :, 2, 0]).all()


@pytest.mark.parametrize(("cars", "plant"), [(4, "mujoco"), (9, "bicycle")])
def test_recordings_of_many_verify_replay_and_come_back(cars, plant, tmp_path):
    path, out = tmp_path / "many.yaml", tmp_path / "run"
    path.write_text(dump(crowd(cars, 0.6, **{"mismatch.neighbour_position_noise_m": 0.002})))
    with pytest.raises(SystemExit) as ended:
        main(["run", str(path), "--plant", plant, "--out", str(out)])
    assert not ended.value.code
    trace = simulate(load(path), plant)
    for name in ("run.mcap", "run.rrd"):
        found = verify(out / name)
        assert [c for c in found.checks if c.right is False] == []
        again = read(out / name).trace()
        assert again.roster == roster(cars - 1)
        for column in COLUMNS:
            assert getattr(again, column.name).tobytes() == getattr(trace, column.name).tobytes(), column.name
        assert replay(out / name).same
    said = json.loads((out / "summary.json").read_text())
    assert list(said["min_distance_m"]) == list(roster(cars - 1).neighbours)


@pytest.mark.parametrize("name", ["scenario.yaml", "world.xml", "manifest.json"])
def test_a_recording_whose_parts_do_not_have_the_same_cars_is_never_right(name, tmp_path, capsys):
    for cars in (4, 6):
        (tmp_path / f"{cars}.yaml").write_text(dump(crowd(cars, 0.1)))
        with pytest.raises(SystemExit):
            main(["run", str(tmp_path / f"{cars}.yaml"), "--out", str(tmp_path / str(cars))])
    with (tmp_path / "6/run.mcap").open("rb") as file:
        other = {a.name: a.data for a in make_reader(file).iter_attachments()}
    forged = rewrite.mcap(tmp_path / "4/run.mcap", tmp_path / "forged.mcap", attachments={name: other[name]})
    for command in ("verify", "replay", "recover"):
        with pytest.raises(SystemExit) as ended:
            main([command, str(forged)])
        assert ended.value.code in (1, 2), command
    capsys.readouterr()


@pytest.mark.parametrize(
    ("override", "key", "said"),
    [
        ("initial.vehicle_9={front_m: [9, 9], speed_mps: 1}", "initial.vehicle_9", "no vehicle_4"),
        ("initial.vehicle_5={front_m: [9, 9], speed_mps: 1}", "drivers.vehicle_5", "nobody drives it"),
        (
            f"initial.vehicle_{MOST_CARS}={{front_m: [9, 9], speed_mps: 1}}",
            f"initial.vehicle_{MOST_CARS}",
            "at most",
        ),
        (
            "initial.vehicel_3={front_m: [9, 9], speed_mps: 1}",
            "initial.vehicel_3",
            "unknown key; did you mean",
        ),
        (
            "initial.vehicle_03={front_m: [9, 9], speed_mps: 1}",
            "initial.vehicle_03",
            "unknown key; did you mean",
        ),
        ("drivers.vehicle_5={kind: steady, speed_mps: 1}", "drivers.vehicle_5", "no vehicle_5 under initial"),
        ("models.vehicle_4=van", "models.vehicle_4", "no vehicle_4 under initial"),
        ("models.vehicle_3=vann", "models.vehicle_3", "did you mean 'van'"),
        ("drivers.vehicle_3.kind=stedy", "drivers.vehicle_3.kind", "did you mean 'steady'"),
        ("drivers.vehicle_3={kind: gap, gap_m: 2}", "drivers.vehicle_3.kind", "nobody ahead of it"),
        ("initial.vehicle_3.speed_mps=fast", "initial.vehicle_3.speed_mps", "must be a number"),
        (
            "initial.vehicle_3.front_m=[0.1, 0]",
            "initial.vehicle_3.front_m",
            "vehicle_1 and vehicle_3 overlap",
        ),
        ("initial.vehicle_3.front_m=[-1.7, 1.6]", "initial.ego.front_m", "from vehicle_3"),
        ("law.leader=vehicle_9", "law.leader", "did you mean"),
        ("law.leader=ego", "law.leader", "must be a neighbour"),
        ("law.follower=vehicle_1", "law.follower", "the same car"),
        ("law.leader=vehicle_2", "law.follower", "the same car"),
    ],
)
def test_a_roster_that_cannot_be_is_refused_by_key_with_what_is_wrong(override, key, said):
    with pytest.raises(ScenarioError) as caught:
        load(crowd(4).model_dump(mode="json"), [override])
    assert [p for p in caught.value.problems if p.key == key and said in p.message], caught.value.problems


def test_a_scenario_of_many_is_the_same_after_being_written_scaled_back_and_altered():
    scenario = crowd(6)
    assert load(json.loads(json.dumps(scenario.model_dump(mode="json")))) == scenario
    far = scenario.scaled(10.0)
    assert far.initial.vehicle_5.front_m == pytest.approx((-50.0, 12.0))
    assert far.initial.vehicle_5.speed_mps == pytest.approx(np.sqrt(10))
    back = far.scaled(0.1)
    for mine, theirs in zip(back.starts, scenario.starts, strict=True):
        assert (*mine.front_m, mine.speed_mps) == pytest.approx((*theirs.front_m, theirs.speed_mps))
    assert scenario != crowd(5)
    assert scenario.car_models == ("rc",) * 6


def test_names_of_cars_are_in_the_order_of_their_numbers():
    assert in_order(["z", "vehicle_10", "vehicle_2", "mu", "vehicle_1"]) == (
        "ego", "vehicle_1", "vehicle_2", "vehicle_10",
    )  # fmt: skip
    assert [slot(name) for name in ("vehicle_1", "vehicle_12", "vehicle_0", "vehicle_", "ego")] == [
        0, 11, None, None, None,
    ]  # fmt: skip
    assert len({paint(car) for car in roster(8).cars}) == 9


def test_a_sweep_and_a_ladder_have_a_column_for_every_neighbour(tmp_path, capsys):
    path = tmp_path / "many.yaml"
    path.write_text(dump(crowd(5, 0.3)))
    campaign = tmp_path / "c.yaml"
    block = {"scenarios": [str(path), "paper"], "plants": ["double_integrator"], "set": {"duration_s": 0.3}}
    campaign.write_text(json.dumps({"blocks": [block]}))
    with pytest.raises(SystemExit):
        main(["sweep", str(campaign), "--out", str(tmp_path / "out"), "--json"])
    capsys.readouterr()
    import pyarrow.parquet as pq

    rows = pq.read_table(tmp_path / "out" / "table.parquet").to_pylist()
    by_size = {row["min_d_4_m"] is None: row for row in rows}
    assert by_size[True]["min_d_3_m"] is None
    expected = simulate(load(path), "double_integrator").min_distance_m[0]
    assert [by_size[False][f"min_d_{j}_m"] for j in range(1, 5)] == pytest.approx(expected.tolist())
    assert by_size[False]["min_distance_m"] == pytest.approx(expected.min())
