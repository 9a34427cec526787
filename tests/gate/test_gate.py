"""The gate's own logic on scenarios of a user's, with the ideal plants: every way to fail, and to be told."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from lxml import etree

from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.errors import MjmergeError, ScenarioError, UnknownNameError
from mjmerge.gate import baseline, gate
from mjmerge.gate.report import gate_failure
from mjmerge.simulation.trace import Stop

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
    text = shipped.scenarios()["charge"].read_text(encoding="utf-8").partition("\ngate:")[0]
    quick = ("duration_s: 12", "duration_s: 6"), ("control_step_s: 0.01", "control_step_s: 0.02")
    for old, new in (*quick, *changes):
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
    assert ideal.measured.min_d_m[1] < 0
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
        assert alone.measured.min_d_m == together[row.check.name].measured.min_d_m


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
            ScenarioError,
            r"mine.yaml:46: gate.1.plant: row 'late': .* the plants are double_integrator, bicycle, ",
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


def test_everything_wrong_with_the_rows_is_told_at_once_with_its_line(tmp_path):
    more = """\
  - {name: ideal, plant: /etc/passwd, at_least_m: 0}
  - name: two
    at_least_m: 0
    set:
      - law.k_o=1
      - law.k_0=2
      - law.k_p=-1
"""
    file = write(tmp_path, ROWS + more)
    with pytest.raises(ScenarioError) as refused:
        gate.rows([file])
    at = len(file.read_text().splitlines())
    assert [(p.line, p.key) for p in refused.value.problems] == [
        (at - 6, "gate.2.name"),
        (at - 6, "gate.2.plant"),
        (at - 1, "gate.3.set.1"),
        (at, "gate.3.set.2"),
    ]
    assert "row 'two': law.k_0: unknown key; did you mean 'k_o'" in str(refused.value)


@pytest.mark.parametrize("name", ["mu = 0.3 (wet): a/b, 50 %", "größer als d_1 < 0", "[bold]it's[/x]"])
def test_a_row_may_be_called_anything_that_fits_on_a_line(tmp_path, capsys, name):
    write(
        tmp_path, f"\ngate:\n  - {{name: {json.dumps(name)}, plant: double_integrator, at_least_m: 0.19}}\n"
    )
    junit = tmp_path / "out.xml"
    check(tmp_path, "--junit", junit, code=1)
    assert name in capsys.readouterr().out
    assert ElementTree.parse(junit).getroot().find("testcase").get("name") == name


@pytest.mark.parametrize("name", ["", " x", "a\nb", "a\x00b", "a::b", "x" * 101])
def test_a_name_that_nothing_could_show_is_explained(tmp_path, name):
    write(tmp_path, f"\ngate:\n  - {{name: {json.dumps(name)}, at_least_m: 0}}\n")
    with pytest.raises(
        ScenarioError, match=r"gate\.0\.name: must (be printable text|not be empty|have at most)|not text"
    ):
        gate.rows([tmp_path])


def test_the_command_of_a_row_is_quoted_for_the_shell(tmp_path):
    folder = tmp_path / "it's here"
    folder.mkdir()
    write(
        folder,
        "\ngate:\n  - {name: a, at_least_m: 0, plant: bicycle, set: ['initial.ego.front_m=[-1.6, 1.2]']}\n",
    )
    (row,) = gate.rows([folder])
    words = shlex.split(row.command)
    assert words == ["mjmerge", "run", str(folder / "mine.yaml"), "--plant", "bicycle",
                     "--set", "initial.ego.front_m=[-1.6, 1.2]"]  # fmt: skip
    assert words != row.command.split()


BASELINE = """\
row,min_d_1_m,min_d_2_m,min_clearance_m,mjmerge,mujoco,numpy
ideal,0.396055,0.219738,nan,0.1.0,3.17.0,2.4.6
late,0.396764,0.220277,nan,0.1.0,3.17.0,2.4.6
"""


@pytest.fixture
def csv_file(folder) -> Path:
    file = folder / "baselines" / "mine.csv"
    file.parent.mkdir()
    file.write_text(BASELINE)
    return file


@pytest.mark.parametrize(
    "saved", ["utf-8-sig", "utf-16", "semicolons", "tabs", "blank lines", "quotes", "windows"]
)
def test_a_baseline_that_a_spreadsheet_saved_is_read(csv_file, saved):
    text, encoding = BASELINE, saved if saved.startswith("utf") else "utf-8"
    good = repr(baseline.read(csv_file))
    if saved == "semicolons":
        text = text.replace(",", ";").replace("0.3", "0,3").replace("0.2", "0,2").replace("nan", " NaN ")
    elif saved == "tabs":
        text = text.replace(",", "\t")
    elif saved == "blank lines":
        text = text.replace("\n", "\n\n") + ",,,,,,\n"
    elif saved == "quotes":
        text = "\n".join(",".join(f'"{v}"' for v in line.split(",")) for line in text.splitlines())
    elif saved == "windows":
        text = text.replace("\n", "\r\n")
    csv_file.write_bytes(text.encode(encoding))
    assert repr(baseline.read(csv_file)) == good


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("\nlate,", "\nideal,", "mine.csv:3: 'ideal' is there twice, on lines 2 and 3"),
        ("nan", "n.a.", "mine.csv:2: 'ideal': 'n.a.' is no number"),
        ("nan", "inf", "mine.csv:2: 'ideal': 'inf' is no length"),
        ("min_d_2_m", "min_d2", "mine.csv:1: it has no column min_d_2_m"),
        (",nan", "", "mine.csv:2: 'ideal': '0.1.0' is no number"),
        ("\nlate", "\nlate,1,2,3,4,5,6,7,8,9", "values in 7 columns"),
        ("\nlate", '\n"late', "no table of values"),
    ],
)
def test_a_baseline_that_cannot_be_meant_is_refused_with_its_line_before_anything_runs(
    folder, csv_file, capsys, monkeypatch, old, new, says
):
    csv_file.write_text(BASELINE.replace(old, new, 1))
    monkeypatch.setattr(gate, "simulate", lambda *_, **__: pytest.fail("it ran"))
    check(folder, code=2)
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "content", [b"\xff\x00\xfe", b"PK\x03\x04\x00", b"x" * 1_100_000, b"\x00" * 50, b"\xff\xfe\x00"]
)
def test_a_file_that_is_no_table_is_one_line(folder, capsys, content):
    (folder / "baselines").mkdir()
    (folder / "baselines" / "mine.csv").write_bytes(content)
    check(folder, code=2)
    err = capsys.readouterr().err
    assert err.startswith(f"mjmerge: {folder}/baselines/mine.csv:")
    assert err.count("\n") == 1


def test_a_stale_row_is_said_and_a_renamed_one_is_recognised(folder, capsys):
    check(folder, "--update")
    file = folder / "baselines" / "mine.csv"
    text = file.read_text()
    file.write_text(text + text.splitlines()[1].replace("ideal", "gone row") + "\n")
    capsys.readouterr()
    check(folder)
    assert "the gate of mine has no row 'gone row'; --update takes it out" in capsys.readouterr().out
    check(folder, "--json")
    assert "gone row" in json.loads(capsys.readouterr().out)["stale"][0]
    file.write_text(text.replace("\nlate,", "\nwas late,"))
    check(folder, code=1)
    assert (
        "no baseline for this row; was it 'was late', which the gate does not have" in capsys.readouterr().out
    )
    check(folder, "--update")
    assert file.read_text() == text


def test_two_scenarios_of_one_name_do_not_share_a_baseline(folder, tmp_path, capsys):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write(tmp_path / name, ROWS)
    check(tmp_path / "a", tmp_path / "b", "--baselines", tmp_path / "all", "--update", code=2)
    assert "would share the baseline" in capsys.readouterr().err
    assert len(gate.rows([tmp_path / "a", tmp_path / "a", tmp_path / "a" / "mine.yaml"])) == 2


JUNIT_XSD = """
<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" elementFormDefault="qualified">
  <xs:simpleType name="seconds"><xs:restriction base="xs:string">
    <xs:pattern value="(([0-9]{0,3},)*[0-9]{3}|[0-9]{0,3})*(\\.[0-9]{0,3})?"/>
  </xs:restriction></xs:simpleType>
  <xs:simpleType name="moment"><xs:restriction base="xs:dateTime">
    <xs:pattern value="[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}"/>
  </xs:restriction></xs:simpleType>
  <xs:complexType name="reason"><xs:simpleContent><xs:extension base="xs:string">
    <xs:attribute name="type" type="xs:string" use="required"/>
    <xs:attribute name="message" type="xs:string"/></xs:extension></xs:simpleContent></xs:complexType>
  <xs:element name="testsuite"><xs:complexType><xs:sequence>
    <xs:element name="properties"><xs:complexType><xs:sequence/></xs:complexType></xs:element>
    <xs:element name="testcase" minOccurs="0" maxOccurs="unbounded"><xs:complexType>
      <xs:choice minOccurs="0">
        <xs:element name="skipped"/>
        <xs:element name="error" type="reason"/>
        <xs:element name="failure" type="reason"/>
      </xs:choice>
      <xs:attribute name="name" type="xs:token" use="required"/>
      <xs:attribute name="classname" type="xs:token" use="required"/>
      <xs:attribute name="time" type="seconds" use="required"/></xs:complexType></xs:element>
    <xs:element name="system-out" type="xs:string"/>
    <xs:element name="system-err" type="xs:string"/></xs:sequence>
    <xs:attribute name="name" type="xs:token" use="required"/>
    <xs:attribute name="timestamp" type="moment" use="required"/>
    <xs:attribute name="hostname" type="xs:token" use="required"/>
    <xs:attribute name="tests" type="xs:int" use="required"/>
    <xs:attribute name="failures" type="xs:int" use="required"/>
    <xs:attribute name="errors" type="xs:int" use="required"/>
    <xs:attribute name="skipped" type="xs:int"/>
    <xs:attribute name="time" type="seconds" use="required"/></xs:complexType></xs:element>
</xs:schema>"""
"""What the schemas of Ant and of Jenkins' xUnit ask for, the stricter one wherever they differ."""


def test_the_junit_file_is_valid_where_all_passes_where_some_fail_and_where_a_run_stopped(
    folder, tmp_path, monkeypatch
):
    schema = etree.XMLSchema(etree.fromstring(JUNIT_XSD))
    assert not schema.validate(etree.fromstring('<testsuite name="a" tests="1" failures="0"/>'))
    junit = tmp_path / "out.xml"

    def counted(code) -> dict[str, str]:
        check(folder, "--junit", junit, code=code)
        suite = etree.parse(junit).getroot()
        schema.assertValid(suite)
        return {name: suite.get(name) for name in ("tests", "failures", "errors")}

    check(folder, "--update")
    assert counted(0) == {"tests": "2", "failures": "0", "errors": "0"}
    write(folder, ROWS.replace("at_least_m: 0.19}", "at_least_m: 0.25}", 1))
    assert counted(1) == {"tests": "2", "failures": "1", "errors": "0"}
    real = gate.simulate

    def stopped(*given, **more):
        trace = real(*given, **more)
        return replace(trace, stops=(Stop(0, 1.0, "ego", "it \x00\x1b left the road & <so>"),))

    monkeypatch.setattr(gate, "simulate", stopped)
    assert counted(3) == {"tests": "2", "failures": "0", "errors": "1"}


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


def test_a_scenario_is_meant_by_its_name_too_and_a_typo_is_told_the_nearest(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert gate.rows([Path("charge")]) == gate.rows([shipped.scenarios()["charge"]])
    with pytest.raises(
        MjmergeError, match="no scenario, file or folder called 'chagre': did you mean 'charge'"
    ):
        gate.rows([Path("chagre")])
    with pytest.raises(MjmergeError) as refused:
        gate.rows([Path("x" * 5000)])
    assert len(str(refused.value)) < 500
