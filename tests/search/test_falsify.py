"""A failure that was planted is found, shrunk to itself, and had again from its YAML."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mjmerge import load
from mjmerge.cli import main
from mjmerge.cli.findings import cleared, record
from mjmerge.errors import MjmergeError, ScenarioError
from mjmerge.scenario.load import dump
from mjmerge.scenario.ran import beneath
from mjmerge.search import methods
from mjmerge.search.against import Against
from mjmerge.search.falsify import Look, Search, search
from mjmerge.search.falsify_report import counted, write
from mjmerge.search.findings import LOOKS, differing, log, logged
from mjmerge.search.margin import margin, pairs
from mjmerge.search.methods import folded
from mjmerge.search.space import Ground
from mjmerge.simulation.each import simulate_each
from mjmerge.sweep.workers import workers

PLANTED = (
    "search={axes: {mismatch.command_delay_s: {uniform: [0.0, 0.18]}, mismatch.position_noise_m: "
    "{uniform: [0, 0.001]}}, neighbours: {vehicle_2: {changes: 2, acceleration_mps2: 7.5, "
    "gap_m: [1.5, 3.6]}}}"
)
"""A dead time that the inverse on a bicycle does not stand, among noise that nobody notices."""
SHORT = "duration_s=8"
BUDGET = 32


def ended(words: list[str]) -> object:
    with pytest.raises(SystemExit) as end:
        main(words)
    return end.value.code


@pytest.fixture(scope="module")
def ground() -> Ground:
    return Ground.around(load("charge", [SHORT, PLANTED]), "bicycle")


@pytest.fixture(scope="module")
def found(ground):
    return search(ground, BUDGET, seed=1)


@pytest.fixture(scope="module")
def findings(found):
    return differing(found, 1)


def test_it_is_found_and_what_is_not_fair_does_not_count(found):
    assert len(found.looks) == BUDGET
    assert found.failures
    assert found.first_failure_at_run == found.failures[0].number + 1
    assert all(look.fair for look in found.failures)
    assert found.best.margin_m == min(look.margin_m for look in found.looks if look.fair)
    unfair = [look for look in found.looks if not look.fair]
    assert all(look.cost > 100 for look in unfair)
    assert all(look.margin_m is None for look in unfair)


def test_it_shrinks_to_itself_and_fails_with_some_to_spare(findings):
    (one,) = findings
    assert set(one.shrunk.parts.axes) == {"mismatch.command_delay_s"}
    assert sum(map(len, one.shrunk.parts.moves.values())) <= 2
    assert one.shrunk.runs <= 100
    assert one.shrunk.spare
    assert one.shrunk.half is None, "no bodies, no step"
    assert one.shrunk.pair.seed == 0, "noise has no part in it"
    assert len(str(one.shrunk.parts.axes["mismatch.command_delay_s"])) <= 5
    assert one.shrunk.pair.ideal.holds
    assert not one.shrunk.pair.ideal.broken
    assert one.shrunk.pair.ideal.verdict == "held"
    assert one.real.verdict == "assumption broken"


def test_it_is_had_again_from_its_yaml_which_the_gate_takes(found, findings, tmp_path):
    write(found, findings, tmp_path)
    (one,), place = findings, tmp_path / "finding-1"
    scenario = load(place / "scenario.yaml")
    (again,) = pairs([(one.shrunk.pair.seed, scenario)], "bicycle", judged=True)
    assert repr(again.real) == repr(one.shrunk.pair.real), "to the last bit; NaN, where there are no bodies"
    assert repr(again.ideal) == repr(one.shrunk.pair.ideal)
    (row,) = scenario.gate
    assert (row.plant, row.seed, row.at_least_m) == ("bicycle", 0, 0.1)
    assert one.sentence in (place / "finding.md").read_text()
    report = (tmp_path / "report.md").read_text()
    assert one.sentence in report
    assert "\n".join(beneath(found.ground.scenario, "bicycle")) in report
    assert beneath(found.ground.scenario, "bicycle")
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["failures"] == len(found.failures)
    assert results["findings"][0]["axes"].keys() == {"mismatch.command_delay_s"}
    for picture in ("margins.png", "space.png"):
        assert (tmp_path / picture).stat().st_size > 10_000
    cleared(tmp_path)
    assert not (place / "scenario.yaml").exists()


def test_the_same_seed_finds_the_same_and_what_was_looked_at_is_not_looked_at_again(
    ground, found, tmp_path, monkeypatch
):
    (tmp_path / LOOKS).write_text(log(found, "mine"))
    known = logged(tmp_path / LOOKS, "mine")
    assert known == list(found.looks)
    assert logged(tmp_path / LOOKS, "another") == []
    half = search(ground, BUDGET, seed=1, before=known[:20])
    assert half.looks == found.looks
    (tmp_path / LOOKS).write_text(log(found, "mine")[:-200])
    cut = logged(tmp_path / LOOKS, "mine")
    assert cut == known[: len(cut)]
    assert len(cut) in (BUDGET - 2, BUDGET - 1)
    monkeypatch.setattr("mjmerge.search.falsify.pairs", None)  # nothing is run
    assert search(ground, BUDGET, seed=1, before=known).looks == found.looks


def test_it_finds_the_same_with_any_number_of_workers(ground, found):
    with workers(2) as team:
        two = search(ground, 16, seed=1, team=team)
    assert two.looks == found.looks[:16]


def test_it_depends_on_everything_that_a_run_follows_from(ground):
    other = Ground.around(load("charge", [SHORT, PLANTED, "law.k_o=0.9"]), "bicycle")
    assert len({ground.digest(), other.digest(), ground.digest("cma"), ground.digest("cma", "1")}) == 4


def test_a_law_is_held_against_another_on_the_same_plant():
    """Without its barrier the law fails where with it nothing happens, and not the other way round."""
    scenario = load("charge", [SHORT])
    bare = load("charge", [SHORT, "law.k_o=0"])
    with_barrier = Against("with", scenario.law)
    (fails,) = pairs([(0, bare)], "bicycle_limited", against=with_barrier)
    assert fails.fails
    assert fails.tested
    (other,) = pairs([(0, scenario)], "bicycle_limited", against=Against("bare", bare.law))
    assert not other.fair
    assert other.real is None


def test_against_is_the_name_of_a_plant_of_a_variant_or_of_a_law():
    def other(key: str):
        return load("charge", [key])

    assert Against.named("bicycle", other) == Against("bicycle")
    assert Against.named("gated", other).law.variant == "gated"
    assert Against.named("rss", other).law.kind == "rss"
    with pytest.raises(MjmergeError, match="bicycle"):
        Against.named("bicycel", other)


def test_without_a_failure_it_says_what_that_is_worth(ground):
    looks = [Look(k, k, (0.5,) * ground.size, 1.0, True, None, 0.3, 0.4) for k in range(300)]
    drawn, chosen = (Search(ground, how, 0, tuple(looks)) for how in ("random", "cma"))
    assert "95 % confidence less than 0.012" in counted(drawn)
    assert "bounds nothing" in counted(chosen)


def test_points_are_folded_back_into_the_cube():
    rng = np.random.default_rng(0)
    assert folded(np.array([-0.25, 0.25, 1.25, 2.25])).tolist() == [0.25, 0.25, 0.75, 0.25]
    far = folded(rng.normal(0, 50, (100, 3)))
    assert ((far >= 0) & (far <= 1)).all()


def searched(cost, batches, size=3, seed=0):
    """The batches that CMA-ES asks for, each (M, D)."""
    method, asked = methods.Cma(size, seed), []
    for _ in range(batches):
        asked.append(method.ask())
        method.tell([cost(point) for point in asked[-1]])
    return asked


@pytest.mark.parametrize("others", ["another search between its batches", "whoever draws from numpy"])
def test_a_search_asks_for_its_points_whatever_else_draws(others):
    def points(disturb):
        method, beside, asked = methods.Cma(4, 3), methods.Cma(4, 5), []
        for _ in range(12):
            asked.append(method.ask())
            method.tell([float(np.sum((point - 0.3) ** 2)) for point in asked[-1]])
            if disturb and others.startswith("another"):
                beside.tell([float(np.sum(point)) for point in beside.ask()])
            elif disturb:
                np.random.rand()  # noqa: NPY002  # the stream that all share
        return np.concatenate(asked)

    np.testing.assert_array_equal(points(disturb=True), points(disturb=False))


def test_a_method_starts_at_the_best_of_what_was_drawn_and_begins_anew_when_it_is_still():
    goal = np.array([0.4, 0.6, 0.5])
    asked = searched(lambda point: float(np.linalg.norm(point - goal)), 60)
    drawn = np.concatenate(asked[:4])
    best = drawn[np.argmin(np.linalg.norm(drawn - goal, axis=1))]
    assert np.abs(asked[4].mean(axis=0) - best).max() < 0.15
    spread = np.array([batch.std(axis=0).max() for batch in asked])
    still = int(np.argmax(spread < 0.01))
    assert still > 4, "it comes to an end"
    assert spread[still:].max() > 0.05, "and begins with a wide one"


def test_a_method_finds_a_small_corner_that_random_draws_miss():
    def runs(method: str, seed: int) -> int:
        asked, most = methods.METHODS[method](10, seed), 1200
        for first in range(0, most, methods.TOGETHER):
            costs = np.linalg.norm(asked.ask() - 0.8, axis=1)
            if costs.min() < 0.1:
                return first
            asked.tell(costs.tolist())
        return most

    assert np.median([runs("cma", seed) for seed in range(5)]) < 1000
    assert np.median([runs("random", seed) for seed in range(5)]) == 1200


def test_a_margin_is_the_least_of_all_distances_and_what_is_not_known_is_none():
    (trace,) = simulate_each([(0, load("charge", ["duration_s=1"]))], "double_integrator")
    found = margin(trace)
    assert found.least_m == trace.min_distance_m.min()
    assert np.isnan(found.min_clearance_m)
    assert found.kind is None
    assert found.holds


def test_the_command_prints_one_object_ends_with_1_and_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["falsify", "charge", "--plant", "bicycle", "--budget", "16", "--seed", "1", "--findings", "0",
             "--workers", "1", "--set", SHORT, "--set", PLANTED, "--json"]  # fmt: skip
    codes, said = [], []
    for _ in range(2):
        codes.append(ended(words))
        said.append(json.loads(capsys.readouterr().out))
        monkeypatch.setattr("mjmerge.search.falsify.pairs", None)  # nothing is run again
    assert said[0] == said[1]
    assert codes == [1, 1]
    assert said[0]["failures"] > 0
    names = {"runs", "valid", "failures", "first_failure_at_run", "best_margin_m", "findings"}
    assert names <= said[0].keys()


def test_it_goes_on_from_samples_that_failed_in_an_estimate(found, ground, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    samples = [{"seed": look.seed, "point": look.point, "margin_m": 0.0} for look in found.failures[:2]]
    lines = [{"of": ground.digest(), "below_m": 0.0}, *samples]
    Path("kept").mkdir()
    Path("kept", LOOKS).write_text("".join(json.dumps(line) + "\n" for line in lines))
    words = ["falsify", "charge", "--plant", "bicycle", "--from", "kept", "--findings", "0", "--workers", "1",
             "--set", SHORT, "--set", PLANTED, "--json"]  # fmt: skip
    assert ended(words) == 1
    said = json.loads(capsys.readouterr().out)
    assert (said["method"], said["runs"], said["failures"]) == ("samples", 2, 2)
    assert said["best_margin_m"] == min(look.margin_m for look in found.failures[:2])
    assert ended([*words, "--set", "law.k_o=0.9"]) == 2
    assert "is of another scenario" in capsys.readouterr().err
    assert ended([*words, "--both"]) == 2


def test_each_finding_is_recorded_beside_its_ideal(found, findings, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert record(found, findings, tmp_path) == []
    write(found, findings, tmp_path)
    assert "figure.png" in (tmp_path / "report.md").read_text()
    place = tmp_path / "finding-1"
    there = {str(path.relative_to(place)) for path in place.rglob("*") if path.is_file()}
    assert {"run/run.rrd", "run/run.mcap", "ideal/run.mcap", "compare.rrd", "figure.png"} <= there
    both = [json.loads((place / which / "summary.json").read_text()) for which in ("run", "ideal")]
    assert [one["verdict"] for one in both] == ["assumption broken", "held"]
    least = findings[0].real.min_distance_m
    assert both[0]["min_distance_m"]["vehicle_2"] == least or both[0]["min_distance_m"]["vehicle_1"] == least
    cleared(tmp_path)
    assert not [path for path in place.rglob("*") if path.is_file()]


def test_what_is_no_space_is_bad_input(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert ended(["falsify", "charge", "--set", "search={axes: {law.k_0: {uniform: [1, 2]}}}"]) == 2
    assert "k_o" in capsys.readouterr().err
    assert ended(["falsify", "charge", "--against", "bicycel"]) == 2
    assert "bicycle" in capsys.readouterr().err
    assert ended(["falsify", "charge", "--budget", "0"]) == 2
    assert not list(Path().iterdir())
    with pytest.raises(ScenarioError):
        load("charge", ["search=5"])


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("mine").mkdir()
    Path("mine/notes.txt").write_text("do not touch")
    words = ["falsify", "charge", "--budget", "1", "--out", "mine"]
    assert ended(words) == 2
    assert "choose another --out" in capsys.readouterr().err
    assert [path.name for path in Path("mine").iterdir()] == ["notes.txt"]


def test_without_the_library_it_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(methods, "find_spec", lambda _: None)
    assert ended(["falsify", "charge", "--budget", "1"]) == 2
    assert "mjmerge[search]" in capsys.readouterr().err
    assert not list(Path().iterdir())


def test_a_gate_row_runs_with_its_seed(tmp_path):
    from mjmerge.gate.gate import rows, run

    what = "needs: [], set: [mismatch.position_noise_m=0.05]"
    noisy = f"gate=[{{name: a, plant: double_integrator, seed: 3, at_least_m: 0, {what}}}]"
    scenario = load("charge", ["duration_s=2", noisy])
    (tmp_path / "noisy.yaml").write_text(dump(scenario))
    (row,) = rows([tmp_path / "noisy.yaml"])
    (result,) = run([row])
    theirs, others = (simulate_each([(n, row.scenario)], "double_integrator")[0] for n in (3, 0))
    assert result.measured.min_d_m == tuple(theirs.min_distance_m[0])
    assert result.measured.min_d_m != tuple(others.min_distance_m[0])
    assert "--seed 3" in row.command
