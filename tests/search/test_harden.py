"""A law is hardened against a failure that was planted: judged by the scenario's own r, and for its costs."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mjmerge import load
from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.config.document import parse
from mjmerge.scenario.space import Distribution
from mjmerge.search import methods
from mjmerge.search.candidate import Candidate, counted_m, held_against
from mjmerge.search.falsify import search
from mjmerge.search.harden import Hardened, harden, worst_cases, worst_m
from mjmerge.search.harden_report import FILES, write
from mjmerge.search.hardened import options, section
from mjmerge.search.keys import chosen, keys_of
from mjmerge.search.margin import margin, pairs
from mjmerge.search.space import Ground
from mjmerge.simulation.each import simulate_each
from mjmerge.sweep.workers import Workers

PLANT = "bicycle"
KEYS = (
    "duration_s=9",
    "control_step_s=0.05",
    "search={axes: {mismatch.command_delay_s: {uniform: [0.0, 0.3]}}, neighbours: {vehicle_2: {changes: 1, "
    "acceleration_mps2: 7.5, gap_m: [1.7, 3.6]}}}",
)
"""A dead time that the inverse on a bicycle does not stand."""
CHOSEN = ("law.k_o=0.5:4", "actuation.inverse=measured,commanded")
FEW = 8
"""Runs of a batch, in place of a population of the usual size."""


class Apart(Workers):
    """Two who would be other processes: each gets its part of the work as another process would."""

    def __init__(self) -> None:
        super().__init__(2)

    def each(self, task: Callable[[Any, int], Any], items: Sequence[Any], *_: Any) -> list[Any]:
        other = pickle.loads(pickle.dumps(task))
        return [one for item in reversed(items) for one in other([item], 1)][::-1]


@pytest.fixture(scope="module")
def ground() -> Ground:
    return Ground.around(load("charge", KEYS), PLANT)


@pytest.fixture(scope="module")
def found(ground) -> Hardened:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(methods, "TOGETHER", FEW)
        patch.setattr("mjmerge.search.harden.CASES", 4)
        return harden(ground, keys_of(ground, CHOSEN), budget=FEW, tries=3, rounds=2, fresh=1, seed=1)


def test_the_winner_stands_the_cases_better_than_the_law_as_it_was(ground, found):
    last = found.rounds[-1]
    assert found.first.failures
    assert last.chosen.settings
    assert last.before.settings == {}
    assert last.chosen.worst_m > last.before.worst_m
    assert last.chosen.merged_s is not None
    assert last.chosen.holds
    assert len(last.chosen.stood) + last.chosen.left_out == last.cases
    assert all(one.worst_m <= last.chosen.worst_m for one in last.candidates if one.solves)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mjmerge.search.harden.CASES", 4)
        cases = worst_cases(ground, [one.search for one in found.rounds])
    law, actuation = found.scenario.law, found.scenario.actuation
    again = [(n, one.model_copy(update={"law": law, "actuation": actuation})) for n, one in cases]
    for pair, margin_m in zip(pairs(again, PLANT, r_m=0.6), last.chosen.margins_m, strict=True):
        assert pair.fair == (margin_m is not None)
        if margin_m is not None:
            assert counted_m(pair.real.least_m, pair.real.kind) == margin_m


def test_it_does_not_depend_on_who_does_the_work(ground, found, monkeypatch):
    monkeypatch.setattr(methods, "TOGETHER", FEW)
    monkeypatch.setattr("mjmerge.search.harden.CASES", 4)
    ground, first = replace(ground, r_m=ground.scenario.r_m), found.rounds[0]
    assert search(ground, FEW, seed=1, team=Apart()).looks == found.first.looks
    laws = [first.before, *first.candidates]
    cases = worst_cases(ground, [found.first])
    again = held_against(ground, [one.settings for one in laws], cases, team=Apart())
    assert again == [replace(one, margins_m=(), enters=0) if not one.may_solve else one for one in laws]


def test_fresh_searches_use_seeds_that_no_round_did_and_the_same_for_both(found):
    used = {one.search.seed for one in found.rounds}
    fresh, after = ([one.search.seed for one in of] for of in (found.fresh, found.hardened))
    assert fresh == after
    assert used.isdisjoint(fresh)
    assert found.hardened[0].search.ground.scenario == found.scenario
    assert found.fresh[0].search.ground.scenario == found.ground.scenario
    looks = [look for look in found.fresh[0].search.looks if look.fair]
    assert worst_m(found.fresh) == min(counted_m(look.margin_m, look.kind) for look in looks)


def test_the_section_pasted_and_the_options_give_the_same_scenario(found):
    file = parse(shipped.scenarios()["charge"].read_text(encoding="utf-8")).value
    assert load(file | parse(section(found)).value, KEYS) == found.scenario
    assert load("charge", [*KEYS, *options(found.winner).split()[1::2]]) == found.scenario


def test_nothing_on_the_frontier_is_beaten_in_both(found):
    good = [one for one in (found.rounds[-1].before, *found.rounds[-1].candidates) if one.solves]
    for one in found.frontier:
        assert not any(o.worst_m > one.worst_m and o.merged_s < one.merged_s for o in good)
    assert found.winner in found.frontier


def test_a_law_is_judged_by_the_scenarios_r_and_not_by_its_own(ground):
    (trace,) = simulate_each([(0, load("charge", ["law.r_m=0.7", "duration_s=2"]))], "double_integrator")
    assert margin(trace, 0.6).min_distance_m == pytest.approx(margin(trace).min_distance_m + 0.1)
    ground = replace(ground, r_m=ground.scenario.r_m)
    alone, same = held_against(ground, [{}, {"law.k_o": 1.0}], [])
    assert same.nominal_m == alone.nominal_m


def test_what_cannot_be_a_solution_is_none(ground):
    ground = replace(ground, r_m=ground.scenario.r_m)
    cases = [(0, ground.scenario)]
    own, late, none = held_against(ground, [{}, {"law.k_p": 0.0}, {"law.r_m": 5.0}], cases)
    assert (late.merged_s, late.margins_m, late.solves) == (None, (), False)
    assert none is None
    (wide,) = held_against(
        ground, [{"law.r_m": 0.83}], cases, anyway=True
    )  # 2r is more than Vehicle 2 leaves
    assert (wide.left_out, wide.stood, wide.solves) == (1, (), False)
    assert (own.left_out, own.enters, own.solves) == (0, 1, True)


def test_a_law_has_what_it_has(ground):
    inverse = "actuation.inverse"
    for kind, has in (
        ("mpc", {"law.r_m", "law.k_v", inverse}),
        ("rss", {"law.r_m", "law.k_v", inverse}),
        ("idm_mobil", {"law.r_m", inverse}),
        ("opinion_dynamics", {"law.r_m", "law.k_o", "law.k_v", "law.variant", inverse}),
    ):
        other = load("charge", [*KEYS, f"law.kind={kind}"])
        there = Ground.around(other, PLANT)
        assert keys_of(there).keys() == has
        assert inverse not in keys_of(replace(there, plant="double_integrator"))
    named = keys_of(Ground.around(load("charge", [*KEYS, "law.kind=mpc"]), PLANT), ["law.steps=5:9"])
    assert chosen(load("charge", ["law.kind=mpc"]), named, [0.5]) in ({"law.steps": n} for n in range(5, 10))
    unsaid = replace(ground, space=ground.space.model_copy(update={"axes": {"law.k_o": Distribution()}}))
    assert "law.k_o" not in keys_of(unsaid)


def test_a_law_from_outside_has_its_own_keys(tmp_path):
    (tmp_path / "mine.py").write_text(
        "from mjmerge.law import Decision, Law\n\n\nclass Mine(Law):\n    push: float = 1.0\n\n"
        "    def decide(self, seen, memory, step_s):\n        return Decision(0 * seen.p)\n"
    )
    file = parse(shipped.scenarios()["charge"].read_text(encoding="utf-8")).value
    ground = Ground.around(load(file | {"law": {"kind": f"{tmp_path}/mine.py:Mine"}}, KEYS), PLANT)
    assert {"law.r_m"} <= keys_of(ground).keys() <= {"law.r_m", "actuation.inverse"}
    (law,) = held_against(replace(ground, r_m=0.6), [{"law.push": 2.0}], [])
    assert law.merged_s is None
    assert keys_of(ground, ["law.push=-1:2"]) == {"law.push": Distribution(uniform=(-1.0, 2.0))}


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--key", "law.k_0=1:2"], "did you mean 'law.k_o'"),
        (["--key", "k_o=1:2"], "law.k_o"),
        (["--key", "law.k_o=2:1"], "the smaller number comes first"),
        (["--key", "law.k_o"], "KEY=LOW:HIGH"),
        (["--key", "law.k_o=1"], "KEY=LOW:HIGH"),
        (["--key", "law.k_o=-1:1"], "law.k_o"),
        (["--key", "law.k_o=1:2", "--key", "law.k_o=2:3"], "given twice"),
        (["--key", "law.variant=literal,gatd"], "gated"),
        (["--key", "law.r_m=3:4"], "r_m"),
        (["--key", "law.d_cap_m=0.1:0.2"], "acts only under the law variants capped"),
        (
            ["--key", CHOSEN[1], "--plant", "double_integrator", "--set", KEYS[2]],
            "actuation.inverse: acts on bicycle",
        ),
        (["--key", "law.k_p=1:2", "--set", "search={axes: {law.k_p: {uniform: [1, 2]}}}"], "search.axes"),
        (["--key", "law.k_p=1:2", "--set", "law.kind=idm_mobil"], "no key of the law idm_mobil"),
        (["--rounds", "0"], "--rounds is 0"),
        (["--fresh", "0"], "--fresh is 0"),
        (["--tries", "0"], "--tries is 0"),
        (["--budget", "0"], "--budget is 0"),
        (["--seed=-1"], "--seed is -1"),
        (["--set", "law.k_0=1"], "k_o"),
    ],
)
def test_bad_input_is_refused_before_anything_runs(tmp_path, monkeypatch, capsys, words, says):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("mjmerge.search.harden.search", lambda *_, **__: pytest.fail("it ran"))
    with pytest.raises(SystemExit) as end:
        main(["harden", "charge", *words])
    assert end.value.code == 2
    assert says in capsys.readouterr().err
    assert not list(Path().iterdir())


def test_keys_that_only_act_beside_others_may_be_chosen_with_them(ground):
    both = ["law.d_cap_m=0.1:0.2", "law.variant=literal,capped"]
    assert list(keys_of(ground, both)) == ["law.d_cap_m", "law.variant"]


@pytest.mark.parametrize("better", [True, False])
def test_the_command_says_whether_it_is_better(tmp_path, monkeypatch, capsys, found, better):
    monkeypatch.chdir(tmp_path)
    margins = (worst_m(found.fresh), worst_m(found.hardened))
    turned = (
        found
        if (margins[1] > margins[0]) == better
        else replace(found, fresh=found.hardened, hardened=found.fresh)
    )
    monkeypatch.setattr("mjmerge.search.harden.harden", lambda *_, **__: turned)
    words = ["harden", "charge", "--plant", PLANT, "--workers", "1", *(w for k in KEYS for w in ("--set", k))]
    with pytest.raises(SystemExit) as end:
        main([*words, "--json"])
    said = capsys.readouterr().out
    one = json.loads(said)
    assert said.count("\n") == 1
    assert (end.value.code, one["better"]) == ((0, True) if better else (1, False))
    assert one["settings"] == dict(found.winner.settings)
    folder = Path(one["out"])
    assert folder.parent == Path("hardened")
    assert {p.name for p in folder.iterdir()} == set(FILES)
    kept = json.loads((folder / "results.json").read_text())
    assert {key: kept[key] for key in one if key != "out"} == {k: one[k] for k in one if k != "out"}
    report = (folder / "report.md").read_text()
    assert ("does not rise" in report) != better
    assert report.splitlines()[2].startswith("**set: "), "below its title"
    assert (folder / "law.yaml").read_text() == section(found)
    with pytest.raises(SystemExit) as end:
        main(words)
    out, err = capsys.readouterr()
    assert end.value.code == (0 if better else 1)
    assert section(found).rstrip() in out
    assert "was replaced" in err


def test_where_no_failure_is_found_there_is_nothing_to_harden(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(methods, "TOGETHER", FEW)
    quiet = "search={axes: {mismatch.position_noise_m: {uniform: [0, 0.0001]}}}"
    words = ["harden", "charge", "--plant", "double_integrator", "--budget", "4", "--workers", "1"]
    with pytest.raises(SystemExit) as end:
        main([*words, "--set", quiet, "--set", "duration_s=4", "--set", KEYS[1], "--json", "--out", "out"])
    said = json.loads(capsys.readouterr().out)
    assert end.value.code == 0
    assert said["nothing_to_harden"]
    assert (said["runs"], said["law"], said["better"]) == (4, None, False)
    assert {p.name for p in Path("out").iterdir()} == {"report.md", "results.json"}
    assert "Nothing to harden against: no failure in 4 runs" in Path("out/report.md").read_text()


def test_where_no_law_is_better_it_says_so(found, tmp_path):
    last = found.rounds[-1]
    worse = tuple(replace(one, merged_s=None, margins_m=(), enters=0) for one in last.candidates)
    stays = replace(last, candidates=worse, chosen=last.before)
    same = replace(found, rounds=(stays,), hardened=found.fresh)
    write(same, tmp_path)
    assert not same.better
    assert same.scenario == found.ground.scenario
    assert "No better law was found" in (tmp_path / "report.md").read_text()


def test_a_failure_never_counts_as_a_margin():
    assert counted_m(0.2, None) == 0.2
    assert counted_m(0.2, "ran off") == 0.0
    assert counted_m(-0.2, "d<=0") == -0.2
    assert counted_m(float("nan"), None) == counted_m(None, "unstable") == 0.0
    assert np.isnan(Candidate({}, holds=True, nominal_m=0.2, merged_s=1.0, peak_mps2=1.0).worst_m)
