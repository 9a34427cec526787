"""What docs/verdicts.md says of a run is what comes of it."""

import json
import re
import shlex
from pathlib import Path

import pytest

from mjmerge.cli import main
from mjmerge.law import Law
from mjmerge.law.cbf_qp import CbfQp
from mjmerge.law.opinion_dynamics import law
from mjmerge.law.opinion_dynamics.parameters import Parameters
from mjmerge.verdict.hypotheses import HYPOTHESES
from mjmerge.verdict.judge import VERDICTS

DOC = Path(__file__).parents[2] / "docs" / "verdicts.md"
TEXT = DOC.read_text(encoding="utf-8")
RUNS = re.findall(r"^\| `(.+?)` \| ([a-z ]+) \| (.+) \|$", TEXT[TEXT.index("<!-- runs -->") :], re.MULTILINE)


def block(name):
    return re.search(rf"<!-- {name} -->\n```\w+\n(.*?)```", TEXT, re.DOTALL).group(1)


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("words", "verdict", "why"), RUNS, ids=[words for words, _, _ in RUNS])
def test_every_run_of_the_page_gets_the_verdict_it_says(words, verdict, why, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pushed.yaml").write_text(block("pushed"), encoding="utf-8")
    with pytest.raises(SystemExit):
        main(["run", *shlex.split(words), "--no-record", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == verdict
    told = r"'[^']+' broke at [\d.]+ s|hits vehicle_\d at [\d.]+ s|runs off [a-z ]+ at [\d.]+ s|at [\d.]+ m/s"
    for number in re.findall(told, why):
        assert number in found["reason"]


def test_every_verdict_has_a_run_that_shows_it_but_for_the_one_that_no_run_has():
    assert {verdict for _, verdict, _ in RUNS} == set(VERDICTS) - {"refuted"}


def test_a_barrier_with_the_wrong_sign_is_refuted_as_the_page_says(monkeypatch, capsys):
    monkeypatch.setattr(law, "barrier", law.barrier)  # put back afterwards
    exec(block("refuted"), {})
    assert capsys.readouterr().out == "refuted\n"


def test_the_table_of_hypotheses_is_that_of_their_declarations():
    (told,) = re.findall(r"<!-- hypotheses -->\n(.*)<!-- /hypotheses -->", TEXT, re.DOTALL)
    head = ["| hypothesis | what must be true | asked |", "|---|---|---|"]
    rows = [
        f"| {one.name} | {one.asks.replace('|', chr(92) + '|')} | {where(one)} |"
        for one in HYPOTHESES.values()
    ]
    assert told.splitlines() == [*head, *rows]


def where(one):
    plants = {4: "everywhere", 3: "on wheels", 2: "where there are limits", 1: "where there are bodies"}
    whose = {Law: "", Parameters: ", of the paper's law", CbfQp: ", of `cbf_qp`"}[one.laws[0]]
    ends = ", where the ego's lane ends" if one.ends else ""
    return plants[len(one.plants)] + (", not in continuous time" if one.sampled else "") + whose + ends
