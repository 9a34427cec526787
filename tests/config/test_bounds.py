"""What would take too much memory or time is refused at once, with the bound, before it is begun."""

from __future__ import annotations

import time

import pytest

import mjmerge
from mjmerge.cli import main
from mjmerge.config import bounds
from mjmerge.errors import MjmergeError, ScenarioError
from mjmerge.sweep import campaign
from mjmerge.world.compose import build

KEYS = ("k_o", "k_p", "k_v", "k", "eps", "k_mu", "k_w", "k_s")
FASTEST_S = 3.0  # on a machine that does other things, too


def refused(capsys, *args: str) -> str:
    began = time.monotonic()
    with pytest.raises(SystemExit) as stop:
        main(list(args))
    assert time.monotonic() - began < FASTEST_S
    out, err = capsys.readouterr()
    assert (stop.value.code, out) == (2, ""), err
    return err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("run paper --runs 1000000000", "--runs is 1000000000; it must be at most 1000000"),
        ("run paper --runs 1000000", "ticks need about 3.55e+03 GB of memory; the most is "),
        ("run paper --seed 9223372036854775807 --runs 2", "at most 9223372036854775807"),
        ("run paper --seed 99999999999999999999", "--seed is 99999999999999999999; it must be at most"),
        ("run paper --threads 1000000", "--threads is 1000000; it must be at most"),
        ("run paper --set initial.ego.speed_mps=1e9", "must be at most 1000, got 1000000000.0"),
        ("run paper --set initial.vehicle_1.speed_mps=-1e9", "must be at least -1000"),
        ("run paper --set initial.ego.front_m=[-1e300,1]", "must be at least -1e+09"),
        ("run paper --set road.lane_width_m=1.2e-12", "must be at least 0.01, got 1.2e-12"),
        ("run paper --set road.lane_width_m=1e300", "must be at most 1000"),
        (
            "run paper --set control_step_s=0.0001 --set physics_step_s=0.0001 --duration 3600",
            "at most 4000000",
        ),
        ("run paper --duration 3601", "must be at most 3600"),
        ("run flips --set drivers.vehicle_2.hold_min_s=1e-12", "must be at least 0.01"),
        ("theorem --runs 1000000000", "--runs is 1000000000; it must be at most"),
        ("theorem --duration 1e12", "it must be above 0 and at most 3600 s"),
        ("survey --runs 1000000000", "--runs is 1000000000; it must be at most"),
        ("survey --seed 9223372036854775807", "at most 9223372036854775807"),
        ("sweep mismatch_core --workers 1000000", "--workers is 1000000; it must be at most"),
        (
            "sweep paper --break mismatch.friction --seeds 1000000",
            "--seeds is 1000000; it must be at most 1000",
        ),
        ("sweep paper --break mismatch.load_kg=-1e308:1e308", "a range is START:END"),
        ("check --threads 1000000", "--threads is 1000000; it must be at most"),
        ("replay run.mcap --threads 1000000", "--threads is 1000000; it must be at most"),
        ("video run.mcap --speed 1e-9", "--speed must be from 0.01 to 100"),
    ],
)
def test_what_is_too_much_is_refused_at_once_with_the_bound(capsys, tmp_path, monkeypatch, words, says):
    monkeypatch.chdir(tmp_path)
    assert says in refused(capsys, *words.split())
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("block", "key", "says"),
    [
        ({"grid": {f"law.{k}": [*range(1, 11)] for k in KEYS}},
         "blocks.0.grid", "that makes 100000000 runs or more; a campaign has at most 1000000"),
        ({"seeds": 1_000_000, "levels": ["mild"]}, "blocks.0.seeds", "at most 1000000"),
        ({"random": {"draws": 1_000_000, "axes": {"mismatch.friction": {"uniform": [0.2, 1]}}}, "seeds": 2},
         "blocks.0.random.draws", "that makes 2000000 runs"),
        ({"random": {"draws": 20_000, "axes": {"law.k_o": {"uniform": [0.2, 1]}}}},
         "blocks.0.random.draws", "20000 scenarios or more that differ"),
        ({"first_seed": 2**63 - 2, "seeds": 3}, "blocks.0.first_seed", "is at most 9223372036854775807"),
        ({"random": {"draws": 1, "seed": 2**63, "axes": {"mismatch.friction": {"uniform": [0.2, 1]}}}},
         "blocks.0.random.seed", "must be at most 9223372036854775807"),
    ],
)  # fmt: skip
def test_a_campaign_is_counted_before_it_is_listed(block, key, says):
    began = time.monotonic()
    with pytest.raises(ScenarioError) as refused:
        campaign.plan({"blocks": [{"scenarios": ["charge"], "plants": ["bicycle"], **block}]})
    assert time.monotonic() - began < FASTEST_S
    (problem,) = refused.value.problems
    assert problem.key == key
    assert says in problem.message


def test_blocks_are_counted_together():
    block = {"scenarios": ["charge"], "plants": ["double_integrator"], "seeds": 600_000}
    with pytest.raises(ScenarioError, match=r"blocks\.1\.seeds: that makes 1200000 runs"):
        campaign.plan({"blocks": [block, block]})


@pytest.mark.parametrize(
    ("axis", "says"),
    [
        ("{uniform: [1.0, 0.25]}", "uniform: goes from 1.0 down to 0.25; the smaller number comes first"),
        ("{log_uniform: [1.0, 0.25]}", "log_uniform: goes from 1.0 down to 0.25"),
        (
            "{uniform: [-1.0e+308, 1.0e+308]}",
            "uniform: -1e+308 to 1e+308 is wider than numbers can tell apart",
        ),
        ("{uniform: [0.1, .inf]}", "must be a finite number"),
        ("{log_uniform: [0, 1]}", "log_uniform: both must be positive"),
        ("{normal: [1, -0.1]}", "normal: the standard deviation must not be negative, got -0.1"),
        ("{normal: [1, 1.0e+308]}", "normal: it reaches further than numbers do"),
        ("{lognormal: [0, 1]}", "lognormal: the median must be positive, got 0.0"),
        ("{lognormal: [1, 200]}", "lognormal: it reaches further than numbers do"),
        ("{uniform: [0, 1], choice: [1]}", "must be one of uniform, log_uniform, normal, lognormal, choice"),
    ],
)
def test_a_range_that_is_none_is_told_with_its_line(tmp_path, axis, says):
    file = tmp_path / "mine.yaml"
    file.write_text(
        f"blocks:\n- scenarios: [charge]\n  random:\n    draws: 2\n    axes:\n      law.k_o: {axis}\n"
    )
    with pytest.raises(ScenarioError) as refused:
        campaign.plan(file)
    assert all(p.line == 6 for p in refused.value.problems)
    assert says in str(refused.value)


def test_the_bound_is_the_most_that_still_runs():
    scenario = mjmerge.load("paper", ["duration_s=0.02"])
    last = mjmerge.simulate(scenario, "double_integrator", seed=bounds.MOST_SEED)
    assert last.seeds.tolist() == [bounds.MOST_SEED]
    with pytest.raises(MjmergeError, match="at most 9223372036854775807"):
        mjmerge.simulate(scenario, "double_integrator", seed=bounds.MOST_SEED, runs=2)
    with pytest.raises(MjmergeError, match="runs is 0; it must be at least 1"):
        mjmerge.simulate(scenario, "double_integrator", runs=0)
    with pytest.raises(MjmergeError, match="GB of memory"):
        mjmerge.simulate(scenario.model_copy(update={"duration_s": 3600.0}), "double_integrator", runs=10_000)


def test_what_is_remembered_counts_as_memory():
    far_back = [
        "control_step_s=1e-5",
        "physics_step_s=1e-5",
        "duration_s=0.001",
        "mismatch.sensing_delay_s=2",
    ]
    with pytest.raises(MjmergeError, match="GB of memory"):
        mjmerge.simulate(mjmerge.load("paper", far_back), "double_integrator", runs=2_000)


def test_a_long_road_has_as_many_dashes_as_any_and_still_two_edges():
    long = build(mjmerge.load("highway", ["duration_s=3600"]))
    short = build(mjmerge.load("highway"))
    names = [long.drawn.geom(i).name for i in range(long.drawn.ngeom)]
    dashes = [name for name in names if name.startswith("dash_")]
    assert 900 < len(dashes) <= bounds.MOST_DASHES
    assert {"edge_left", "edge_right"} < set(names)
    apart = [short.drawn.geom(f"dash_{i}").pos[0] for i in (0, 1)]
    assert apart[1] - apart[0] == pytest.approx(mjmerge.load("highway").road.lane_width_m)
    last, edge = long.drawn.geom(dashes[-1]), long.drawn.geom("edge_left")
    assert last.pos[0] == pytest.approx(edge.pos[0] + edge.size[0], rel=0.01)


@pytest.mark.parametrize(("load", "times"), [(0.0, 1.0), (1.0, 1.0), (8.0, 4.0), (400.0, 10.0)])
def test_a_busy_machine_gets_more_patience_and_never_without_end(monkeypatch, load, times):
    monkeypatch.setattr("os.getloadavg", lambda: (load, 0.0, 0.0))
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert bounds.patience_s(6.0) == 6.0 * times
