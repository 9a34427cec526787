"""The probability of a small margin: levels agree with independent samples, and what is kept is enough."""

from __future__ import annotations

import json
from math import log1p, sqrt
from pathlib import Path

import numpy as np
import pytest

from mjmerge import load
from mjmerge.cli import main
from mjmerge.errors import MjmergeError, OutputError
from mjmerge.search import probability as estimates
from mjmerge.search.kept import FIGURE, REPORT, RESULTS, SAMPLED, Margins, failing, looks, settled
from mjmerge.search.margin import Margin, margins
from mjmerge.search.probability import LEAST_BUDGET, Asked, probability
from mjmerge.search.probability_report import markdown
from mjmerge.search.space import Ground
from mjmerge.sweep.workers import workers

SPACE = (
    "search={axes: {mismatch.command_delay_s: {lognormal: [0.04, 0.5]}, mismatch.sensing_delay_s: "
    "{lognormal: [0.05, 0.5]}, mismatch.neighbour_position_noise_m: {lognormal: [0.003, 0.5]}, "
    "mismatch.neighbour_position_bias_m: {normal: [0.0, 0.02]}}}"
)
"""Delays, noise and a bias that the double integrator knows too."""
KEYS = (SPACE, "duration_s=5.2", "control_step_s=0.04")
FINE = (SPACE, "duration_s=6", "control_step_s=0.02")
ONE = "search={axes: {mismatch.command_delay_s: {lognormal: [0.04, 0.5]}, mismatch.friction: {choice: [1]}}}"
"""One axis; the other is as in the scenario."""


@pytest.fixture(scope="module")
def ground() -> Ground:
    return Ground.around(load("charge", KEYS), "double_integrator")


@pytest.fixture(scope="module")
def by_levels(ground):
    return probability(ground, Asked(0.15, LEAST_BUDGET, seed=2))


@pytest.fixture
def quick(monkeypatch) -> list[int]:
    """No simulation: a margin that follows from the delay, and how many there were, batch by batch."""
    batches: list[int] = []

    def made(cases, plant, **_):
        batches.append(len(cases))
        delays = [scenario.mismatch.command_delay_s for _, scenario in cases]
        found = [0.25 - 2 * delay + (0.01 if plant == "double_integrator" else 0.0) for delay in delays]
        return [Margin(one, one, float("nan"), None, one > 0, ()) for one in found]

    monkeypatch.setattr(estimates, "margins", made)
    return batches


def agree(one, other) -> bool:
    """Whether two estimates are as close as both say that they are, at 99 %."""
    spread = [log1p((e.high - e.low) / (2 * 1.96 * e.probability)) for e in (one, other)]
    return abs(np.log(one.probability / other.probability)) < 2.6 * sqrt(sum(s * s for s in spread))


def test_levels_agree_with_independent_samples_on_the_double_integrator(ground, by_levels, long):
    if long:
        fine = Ground.around(load("charge", FINE), "double_integrator")
        plain = probability(fine, Asked(-0.1, 100_000, way="montecarlo"))
        rare = probability(fine, Asked(-0.1, 5000, seed=1))
        assert agree(plain.estimate, rare.estimate)
        assert rare.runs < 6000
    plain = probability(ground, Asked(0.15, 256, way="montecarlo"))
    assert len(by_levels.estimate.levels) == 2
    assert agree(plain.estimate, by_levels.estimate)
    assert plain.estimate.low <= plain.estimate.probability <= plain.estimate.high


def test_any_number_of_workers_and_any_interruption_give_the_same_bits(ground, by_levels):
    told = []
    with workers(2) as team:
        other = probability(ground, by_levels.asked, team=team, told=told.append)
    assert other.estimate.probability == by_levels.estimate.probability
    assert other.below.u.tobytes() == by_levels.below.u.tobytes()
    assert looks(other) == looks(by_levels)
    known = np.concatenate(told).tolist()
    assert len(known) == by_levels.runs
    rest = []
    again = probability(ground, by_levels.asked, known=known[:-30], told=rest.append)
    assert np.concatenate(rest).tolist() == known[-30:]
    assert looks(again) == looks(by_levels)


def test_samples_that_fail_are_kept_with_their_seeds_and_fail_again(ground, by_levels, tmp_path):
    (tmp_path / "looks.jsonl").write_text(looks(by_levels))
    kept = failing(tmp_path, ground)
    assert len(kept) == len(set(kept)) == len(by_levels.below) > 3
    assert by_levels.below.values.tolist() == sorted(by_levels.below.values)
    some = kept[:8]
    again = margins([(seed, ground.at(np.array(point))) for seed, point in some], ground.plant)
    assert [one.least_m for one in again] == by_levels.below.values[:8].tolist()
    other = Ground.around(load("charge", [*KEYS, "law.k_o=0.9"]), ground.plant)
    with pytest.raises(MjmergeError, match="another scenario"):
        failing(tmp_path, other)
    with pytest.raises(MjmergeError, match="holds no samples"):
        failing(tmp_path / "nowhere", ground)


def test_what_never_happens_has_an_upper_end_and_what_always_does_is_1(ground):
    never = probability(ground, Asked(-5.0, LEAST_BUDGET), known=[0.2] * 100)
    assert never.interval[:2] == (0.0, 0.0)
    assert 0.03 < never.interval[2] < 0.05
    assert failing_lines(never) == 0
    assert "None was seen" in markdown(never)
    assert "**set: duration_s=5.2, control_step_s=0.04**" in markdown(never), (
        "what was set stands below the title"
    )
    always = probability(ground, Asked(5.0, LEAST_BUDGET), known=[0.2] * 100)
    assert always.interval[0] == always.interval[2] == 1.0
    assert 0.95 < always.interval[1] < 1.0
    one = probability(ground, Asked(0.0, 1, way="montecarlo"), known=[0.2])
    assert one.interval == pytest.approx((0.0, 0.0, 0.975))
    nowhere = probability(ground, Asked(0.0, 10, way="montecarlo"), known=[np.inf] * 10)
    assert nowhere.nowhere == 1.0
    assert "100.00% of independent samples are no scenario" in markdown(nowhere)


def failing_lines(found) -> int:
    return looks(found).count("\n") - 1


def run(capsys, *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as end:
        main(["probability", "charge", "--workers", "1", *words])
    said = capsys.readouterr()
    return int(end.value.code or 0), said.out, said.err


def test_the_command_keeps_everything_and_says_the_same_again(tmp_path, monkeypatch, capsys, quick):
    monkeypatch.chdir(tmp_path)
    words = ("--plant", "bicycle", "--below", "0.05", "--budget", "370", "--set", ONE.replace("[1]", "[0.5]"))
    code, out, err = run(capsys, *words, "--json")
    said = json.loads(out)
    assert code == 0
    assert "left out: mismatch.friction acts on mujoco only, not on bicycle" in err
    (folder,) = Path("probabilities").iterdir()
    assert folder.name.startswith("charge-bicycle-below_0.05-budget_370-search")
    assert {p.name for p in folder.iterdir()} == {SAMPLED, RESULTS, REPORT, FIGURE, "looks.jsonl"}
    assert json.loads((folder / RESULTS).read_text()) | {"out": str(folder)} == said
    assert said["low"] <= said["probability"] <= said["high"]
    assert (
        said["runs"]
        == sum(quick)
        == sum(level["samples"] for level in said["levels"]) - 10 * (len(said["levels"]) - 1)
    )
    assert said["failing"] == len((folder / "looks.jsonl").read_text().splitlines()) - 1
    report = (folder / REPORT).read_text()
    assert "lognormal, median 0.04, standard deviation of the logarithm 0.5" in report
    assert "10 chains of 10 samples each" in report
    files = {p.name: p.read_bytes() for p in folder.iterdir() if p.name != SAMPLED}
    quick.clear()
    assert json.loads(run(capsys, *words, "--json")[1]) == said
    assert quick == []
    assert {p.name: p.read_bytes() for p in folder.iterdir() if p.name != SAMPLED} == files
    _, out, _ = run(capsys, *words)
    assert out.startswith("charge on bicycle: a margin of at most 0.05 m has a probability of ")


def test_an_estimate_that_is_interrupted_looks_unfinished_and_goes_on(tmp_path, monkeypatch, capsys, quick):
    monkeypatch.chdir(tmp_path)
    words = ("--plant", "bicycle", "--method", "montecarlo", "--budget", "200", "--set", ONE, "--json")
    whole = json.loads(run(capsys, *words, "--out", "whole")[1])
    made = estimates.margins

    def interrupted(cases, plant, **more):
        if sum(quick) >= 328:
            raise KeyboardInterrupt
        return made(cases, plant, **more)

    monkeypatch.setattr(estimates, "margins", interrupted)
    code, _, err = run(capsys, *words, "--out", "part")
    assert code != 0
    assert "run it again to go on" in err
    assert [p.name for p in Path("part").iterdir()] == [SAMPLED]
    monkeypatch.setattr(estimates, "margins", made)
    quick.clear()
    assert json.loads(run(capsys, *words, "--out", "part")[1]) == whole | {"out": "part"}
    assert 0 < sum(quick) < 100


def test_a_folder_of_something_else_is_left_alone(ground, tmp_path):
    asked = Asked(0.0, 400)
    Margins(tmp_path, ground, asked).add(np.array([0.1, np.inf]))
    assert Margins(tmp_path, ground, asked).known == [0.1, np.inf]
    with (tmp_path / SAMPLED).open("a") as file:
        file.write("[0.3, 0.")
    assert settled(tmp_path, ground, asked) == tmp_path
    assert Margins(tmp_path, ground, asked).known == [0.1, np.inf]
    for other in (Asked(0.1, 400), Asked(0.0, 400, seed=1), Asked(0.0, 400, screen="bicycle")):
        with pytest.raises(OutputError, match="nothing is overwritten"):
            Margins(tmp_path, ground, other)
        beside = settled(tmp_path, ground, other)
        assert beside.name.startswith(f"{tmp_path.name}-")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "looks.jsonl").write_text("{}")
    with pytest.raises(OutputError, match="nothing is overwritten"):
        Margins(tmp_path / "other", ground, asked)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--budget", "50"), "370 at least, and --method montecarlo any number"),
        (("--budget", "0"), "must be at least 1"),
        (("--below", "nan"), "must be a finite number"),
        (("--screen", "mujoco"), "the plant itself"),
        (("--screen", "bicycel"), "did you mean 'bicycle'"),
        (("--screen", "bicycle", "--budget", "99"), "takes 100 at least"),
        (("--screen", "bicycle", "--method", "montecarlo"), "goes with --method subset"),
        (("--set", "search={axes: {law.k_0: {uniform: [1, 2]}}}"), "k_o"),
        (("--set", "search={axes: {law.k_o: {normal: [1, -2]}}}"), "standard deviation"),
        (
            ("--plant", "bicycle", "--set", "search={axes: {mismatch.friction: {choice: [1, 0.5]}}}"),
            "nothing",
        ),
    ],
)
def test_what_cannot_be_estimated_is_bad_input_before_there_is_a_folder(
    tmp_path, monkeypatch, capsys, words, says
):
    monkeypatch.chdir(tmp_path)
    code, _, err = run(capsys, *words)
    assert code == 2
    assert says in err
    assert not list(Path().iterdir())


def test_screening_is_corrected_in_words_and_numbers(tmp_path, monkeypatch, capsys, quick):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(estimates, "CHEAP_EACH", 100)
    words = ("--plant", "bicycle", "--screen", "double_integrator", "--budget", "100", "--set", ONE)
    code, out, _ = run(capsys, *words, "--json", "--out", "out")
    said = json.loads(out)
    by = said["screen"]
    assert code == 0
    assert said["runs"] <= 100
    assert said["runs"] + by["runs"] == sum(quick)
    assert by["offset_m"] == pytest.approx(0.01)
    assert sum(one["weight"] for one in by["strata"]) == pytest.approx(1.0)
    assert by["found"]["probability"] + by["missed"]["probability"] == pytest.approx(said["probability"])
    truth = 0.0114  # of a lognormal delay that is 0.125 s or more: 2.28 standard deviations
    assert said["low"] <= truth <= said["high"]
    report = (Path("out") / REPORT).read_text()
    assert "double_integrator looked first: its margin is at most 0 + 0.01 = 0.01 m" in report
    assert "what double_integrator misses" in report
    assert (Path("out") / FIGURE).stat().st_size > 5000
