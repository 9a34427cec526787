"""The gate's own logic on scenarios of a user's, with the ideal plants: every way to fail, and to be told."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from mjmerge import gate, share
from mjmerge.cli import main
from mjmerge.errors import MjmergeError, ScenarioError, UnknownNameError
from mjmerge.report import gate_failure

pytest_plugins = ["pytester"]

ROWS = """
gate:
  - {name: ideal, plant: double_integrator, at_least_m: 0.19}
  - {name: late, plant: double_integrator, set: [mismatch.sensing_delay_s=0.1], at_least_m: 0.19}
"""


@pytest.fixture
def folder(tmp_path):
    """A user's folder of scenarios: ``charge``, shortened, with a gate of two rows."""
    write(tmp_path, ROWS)
    return tmp_path


def write(folder: Path, rows: str, *changes: tuple[str, str]) -> Path:
    text = share.scenarios()["charge"].read_text(encoding="utf-8").partition("\ngate:")[0]
    for old, new in (("duration_s: 12", "duration_s: 6"), *changes):
        assert old in text
        text = text.replace(old, new)
    file = folder / "mine.yaml"
    file.write_text(text + rows, encoding="utf-8")
    return file


def check(*arguments, code=0):
    with pytest.raises(SystemExit) as ended:
        main(["check", *map(str, arguments)])
    assert ended.value.code == code


def results(folder):
    return {r.row.check.name: r for r in gate.run(gate.rows([folder]))}


def test_a_row_without_a_baseline_fails_and_update_makes_one(folder, capsys):
    check(folder, code=1)
    assert "there is no baseline for this row" in capsys.readouterr().out
    check(folder, "--update")
    assert "mine, late: new" in capsys.readouterr().out
    check(folder)
    assert (folder / "baselines" / "mine.csv").read_text().startswith("row,min_d_1_m,min_d_2_m,")


def test_baselines_can_live_elsewhere(folder, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "new"
    check(folder, "--baselines", elsewhere, "--update")
    assert [p.name for p in elsewhere.iterdir()] == ["mine.csv"]
    check(folder, "--baselines", elsewhere)
    check(folder, code=1)


def test_a_margin_that_moved_fails_both_ways_and_says_from_where_to_where(folder, capsys):
    check(folder, "--update")
    file = folder / "baselines" / "mine.csv"
    good = file.read_text()
    line = good.splitlines()[1]
    d_1 = line.split(",")[1]
    for shift in (-3e-4, 3e-4):
        file.write_text(good.replace(d_1, f"{float(d_1) + shift:.6f}", 1))
        check(folder, code=1)
        said = capsys.readouterr().out
        assert f"min_d_1_m was {float(d_1) + shift:.4f}" in said
        assert "see it:  mjmerge run" in said
    file.write_text(good.replace(d_1, f"{float(d_1) + 1e-4:.6f}", 1))
    check(folder)


def test_another_version_is_named_beside_what_moved(folder):
    check(folder, "--update")
    file = folder / "baselines" / "mine.csv"
    lines = [line.split(",") for line in file.read_text().splitlines()]
    for line in lines[1:]:
        line[1], line[-2] = "9", "2.9.9"
    file.write_text("\n".join(map(",".join, lines)) + "\n")
    assert "mujoco 2.9.9 then" in gate_failure(results(folder)["ideal"])


def test_a_floor_is_one_sided_and_no_update_lowers_it(folder):
    write(folder, ROWS.replace("at_least_m: 0.19}", "at_least_m: 0.25}", 1))
    check(folder, "--update")
    check(folder, code=1)
    assert any("below the floor of 0.25 m" in p for p in results(folder)["ideal"].problems)
    write(folder, ROWS.replace("0.19", "-5"))
    check(folder)


def test_no_floor_excuses_an_unsafe_run(folder):
    write(folder, ROWS.replace("0.19", "-5"), ("law: ", "law:\n  k_o: 0   #"))
    check(folder, "--update")
    ideal = results(folder)["ideal"]
    assert ideal.measured.min_d_2_m < 0
    assert any("assumption broken" in p or "unsafe" in p for p in ideal.problems)


def test_a_row_that_is_safe_without_the_barrier_too_fails_as_vacuous(folder):
    quiet = (
        "{start_s: 3.939, duration_s: 1.181, gap_m: 1.645}",
        "{start_s: 3.939, duration_s: 1.181, gap_m: 3.4}",
    )
    write(folder, ROWS, quiet)
    check(folder, "--update")
    (problem,) = results(folder)["ideal"].problems
    assert problem.startswith("vacuous: safe, but not because of the barrier")


def test_a_test_of_grip_in_which_nothing_slides_fails_as_vacuous(folder):
    row = "{name: mu %s, at_least_m: 0, needs: [grip], set: [mismatch.friction=%s]}"
    rows = "\ngate:\n" + "".join(f"  - {row % (mu, mu)}\n" for mu in (0.7, 1.0))
    write(folder, rows)
    check(folder, "--update")
    found = results(folder)  # Vehicle 2 is asked for 7.4 m/s^2
    assert found["mu 0.7"].problems == ()
    assert found["mu 1.0"].problems == ("vacuous: no car was asked for more than the road gives",)


def test_rows_run_together_come_to_what_they_come_to_alone(folder):
    together = results(folder)
    for row in gate.rows([folder]):
        (alone,) = gate.run([row])
        assert alone.measured.min_d_1_m == together[row.check.name].measured.min_d_1_m
        assert alone.measured.min_d_2_m == together[row.check.name].measured.min_d_2_m


def test_only_picks_rows_and_update_leaves_the_others(folder, capsys):
    check(folder, "--update")
    before = (folder / "baselines" / "mine.csv").read_text()
    capsys.readouterr()
    check(folder, "--only", "late", "--update")
    assert "ideal" not in capsys.readouterr().out.partition("mine, late")[2]
    assert (folder / "baselines" / "mine.csv").read_text() == before
    check(folder, "--only", "nothing", code=2)


def test_a_row_that_is_gone_leaves_the_baseline(folder, capsys):
    check(folder, "--update")
    write(folder, ROWS.rpartition("  - ")[0])
    check(folder, "--update")
    assert "mine, late: gone" in capsys.readouterr().out
    assert "late" not in (folder / "baselines" / "mine.csv").read_text()


def test_the_json_is_one_object_and_the_junit_file_has_a_case_per_row(folder, capsys, tmp_path):
    check(folder, "--update")
    write(folder, ROWS.replace("at_least_m: 0.19}", "at_least_m: 0.25}", 1))
    capsys.readouterr()
    junit = tmp_path / "out.xml"
    check(folder, "--json", "--junit", junit, code=1)
    found = json.loads(capsys.readouterr().out)
    assert (found["passed"], found["failed"]) == (False, 1)
    assert [(r["row"], bool(r["problems"])) for r in found["rows"]] == [("ideal", True), ("late", False)]
    assert found["rows"][0]["measured"]["min_clearance_m"] is None
    suite = ElementTree.parse(junit).getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    assert "see it:" in suite.find("testcase/failure").text


@pytest.mark.parametrize(
    ("rows", "error", "words"),
    [
        ("", MjmergeError, "has a gate"),
        (ROWS + "  - {name: ideal, at_least_m: 0}\n", MjmergeError, "two rows are called 'ideal'"),
        (ROWS.replace("sensing_delay_s", "sensing_delay"), ScenarioError, "did you mean 'sensing_delay_s'"),
        (
            ROWS.replace("double_integrator", "double_integrater"),
            UnknownNameError,
            "did you mean 'double_integrator'",
        ),
        (ROWS.replace("at_least_m: 0.19}", "at_leest_m: 0.19}"), ScenarioError, "did you mean 'at_least_m'"),
        (ROWS.replace("0.19}", "0.19, needs: [barier]}", 1), ScenarioError, "'barrier' or 'grip'"),
    ],
    ids=["no gate", "same name", "unknown key", "unknown plant", "typo", "unknown need"],
)
def test_a_gate_that_is_wrong_is_refused_before_anything_runs(tmp_path, rows, error, words):
    write(tmp_path, rows)
    with pytest.raises(error, match=words):
        gate.rows([tmp_path])
    check(tmp_path, code=2)


def test_a_place_that_is_none_and_a_baseline_that_is_none_are_refused(folder, tmp_path):
    with pytest.raises(UnknownNameError):
        gate.rows([tmp_path / "nowhere"])
    (folder / "baselines").mkdir()
    (folder / "baselines" / "mine.csv").write_text("a,b\n1,2\n")
    check(folder, code=2)


def test_each_row_is_an_item_of_pytest(folder, pytester):
    check(folder, "--update")
    write(folder, ROWS.replace("at_least_m: 0.19}", "at_least_m: 0.25}", 1))
    pytester.makeini(f"[pytest]\nmjmerge_scenarios = {folder}\n")
    (pytester.path / "test_own.py").write_text("def test_own():\n    pass\n")
    done = pytester.runpytest_subprocess("-v", str(folder), str(pytester.path))
    done.assert_outcomes(passed=2, failed=1)
    done.stdout.fnmatch_lines(
        ["*mine.yaml::ideal FAILED*", "*mine.yaml::late PASSED*", "*below the floor of 0.25 m*"]
    )
