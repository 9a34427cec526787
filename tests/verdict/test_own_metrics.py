"""Metrics of one's own: found by name, run on the trace, in every table, held against bounds, recorded."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import mjmerge
from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.config.doors import DoorError
from mjmerge.errors import ScenarioError
from mjmerge.gate import gate
from mjmerge.record.read import read
from mjmerge.review.folder import beside, verify_run
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.load import dump, load
from mjmerge.scenario.schema import Bound
from mjmerge.sweep.folder import TABLE
from mjmerge.verdict import own
from tests.recording import rewrite

MINE = '''"""Somebody's own."""
import numpy as np
from pathlib import Path

with open(str(Path(__file__)) + ".ran", "a") as file:
    file.write("x")


def least_z(trace):
    """Smallest opinion.

    And more about it.
    """
    return np.nanmin(trace.opinion, axis=1)


def nobody_knows_s(trace):
    return np.full(trace.runs, np.nan)


def from_the_seed(trace):
    return trace.seeds.astype(float)
'''
PLANT = ("--plant", "double_integrator")
NOISE = "mismatch.neighbour_position_noise_m=0.01"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where somebody works: a scenario of 1 s without metrics, and a file with some."""
    monkeypatch.chdir(tmp_path)
    text = shipped.scenarios()["charge"].read_text(encoding="utf-8").partition("\nexpect:")[0]
    (tmp_path / "base.yaml").write_text(text.replace("duration_s: 12", "duration_s: 1"), encoding="utf-8")
    write("mine.py:least_z", "mine.py:nobody_knows_s")
    Path("mine.py").write_text(MINE)
    return tmp_path


def write(*metrics: str, expect: str = "", gate_rows: str = "") -> Path:
    """``mine.yaml``: the scenario with these metrics."""
    lines = ["", "metrics:", *(f"  - {metric}" for metric in metrics)]
    lines += [f"expect: {{metrics: {expect}}}"] if expect else []
    lines += [f"gate:\n{gate_rows}"] if gate_rows else []
    Path("mine.yaml").write_text(Path("base.yaml").read_text() + "\n".join(lines) + "\n")
    return Path("mine.yaml")


def does(capsys, *args: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(list(map(str, args)))
    return int(ended.value.code or 0), *capsys.readouterr()


def ran(capsys, *args: object, code: int = 0) -> dict[str, Any]:
    ended, out, err = does(capsys, "run", "mine.yaml", *PLANT, *args, "--json")
    assert ended == code, err
    return json.loads(out)


def ran_code() -> int:
    """How often somebody's file was run."""
    marks = Path("mine.py.ran")
    return len(marks.read_text()) if marks.exists() else 0


# --- a run


def test_a_run_has_them_in_its_table_its_summary_and_its_json(folder, capsys):
    code, out, _ = does(capsys, "run", "mine.yaml", *PLANT)
    trace = mjmerge.simulate(load("mine.yaml"), "double_integrator")
    least = float(trace.opinion.min())
    assert code == 0
    lines = [line.split() for line in out.splitlines()]
    assert ["least_z", f"{least:.4g}"] in lines
    assert ["nobody_knows_s", "-"] in lines
    found = json.loads(Path("runs/mine-double_integrator-0/summary.json").read_text())
    assert found["metrics"] == {"least_z": least, "nobody_knows_s": None}
    assert not {"metrics_range", "metrics_bounds", "metrics_held"} & found.keys()


@pytest.mark.parametrize(
    ("bound", "code"),
    [
        ("{least_z: {at_least: 0.01}}", 0),
        ("{least_z: {at_least: 0.01, at_most: 0.3}}", 0),
        ("{least_z: {at_least: 0.3}}", 1),
        ("{least_z: {at_most: 0.01}}", 1),
        ("{nobody_knows_s: {at_least: -1e9}}", 1),
        ("{nobody_knows_s: {at_most: 1e9}}", 1),
    ],
)
def test_the_exit_code_says_whether_bounds_held_and_what_is_not_known_is_within_none(
    folder, capsys, bound, code
):
    write("mine.py:least_z", "mine.py:nobody_knows_s", expect=bound)
    found = ran(capsys, "--no-record", code=code)
    assert (found["floor_held"], found["metrics_held"]) == (True, code == 0)
    (says,) = found["metrics_bounds"].values()
    assert (says["held_runs"], says["first_broken_seed"]) == (1 - code, 0 if code else None)
    _, out, _ = does(capsys, "run", "mine.yaml", *PLANT, "--no-record")
    assert ("BROKEN" in out) == bool(code)


def test_of_several_runs_the_worst_has_the_value_and_every_one_counts(folder, capsys):
    write("mine.py:from_the_seed", expect="{from_the_seed: {at_most: 2.5}}")
    found = ran(capsys, "--runs", 5, "--set", NOISE, "--out", "many", code=1)
    assert found["metrics"] == {"from_the_seed": found["worst_seed"]}
    assert found["metrics_range"] == {"from_the_seed": {"least": 0.0, "most": 4.0, "unknown": 0}}
    said = {"at_least": None, "at_most": 2.5, "held_runs": 3, "first_broken_seed": 3}
    assert found["metrics_bounds"] == {"from_the_seed": said}
    assert {p.name for p in Path("many").glob("violation-*")} <= {"violation-3.rrd", "violation-4.rrd"}
    assert any(Path("many").glob("violation-*")) or found["worst_seed"] > 2
    first = verify(Path("many/run.mcap"))
    assert [c.says for c in (*first.checks, *beside(first)) if c.right is False] == []
    for change in (
        {"metrics": {"from_the_seed": 7.0}},
        {"metrics_range": {"from_the_seed": {"least": 9.0, "most": 9.0, "unknown": 0}}},
        {"metrics_range": {}},
        {"metrics_bounds": {"from_the_seed": said | {"held_runs": 5}}},
        {"metrics_bounds": {"from_the_seed": said | {"at_most": 9.0}}},
        {"metrics_held": True},
    ):
        Path("many/summary.json").write_text(json.dumps(found | change))
        assert "summary.json" in {c.name for c in beside(first) if c.right is False}, change


def test_without_metrics_nothing_says_a_word_of_them(folder, capsys):
    Path("mine.yaml").write_text(Path("base.yaml").read_text())
    found = ran(capsys)
    assert not any("metrics" in key for key in found)
    assert "metrics" not in Path(found["run_dir"], "scenario.yaml").read_text()
    assert "metrics" not in read(Path(found["run_dir"], "run.mcap")).manifest
    assert "metrics" not in json.dumps(verify(Path(found["run_dir"], "run.mcap")).as_dict())


def test_a_metric_cannot_alter_what_it_measures(folder, capsys):
    Path("mine.py").write_text(
        "def least_z(trace):\n    trace.opinion[:] = 0\n    return trace.opinion[:, 0]\n"
    )
    write("mine.py:least_z")
    code, _, err = does(capsys, "run", "mine.yaml", *PLANT, "--no-record")
    assert code == 2
    assert "line 2: ValueError: assignment destination is read-only" in err


# --- found, or told why not


@pytest.mark.parametrize(
    ("reference", "code", "says"),
    [
        ("mine.py:leest_z", MINE, "has no 'leest_z': did you mean 'least_z'?"),
        ("mnie.py:least_z", MINE, "there is no file mnie.py"),
        ("mine.py", MINE, "mine.py is a file and names no function in it: write file.py:headway_s"),
        ("mine.py:f", "def f(x:\n", "mine.py, line 1: "),
        ("mine.py:f", "import nothing_of_that_name", "No module named 'nothing_of_that_name'"),
        ("mine.py:f", "f = 3", "mine.py:f is 3; a metric is a function of a trace"),
        ("mine.py:f", "class f:\n    pass", "mine.py:f is a class; a metric is a function of a trace"),
        ("mine.py:f", "def f(): pass", "mine.py:f() must take one argument, the trace"),
        ("mine.py:f", "def f(a, b): pass", "mine.py:f(a, b) must take one argument, the trace"),
        ("mine.py:f", "def f(*, trace): pass", "must take one argument, the trace"),
        ("nothing.of.that.name:f", "", "no module called 'nothing.of.that.name'"),
        ("json:lods", "", "json has no 'lods': did you mean 'loads'?"),
        ("headway_s", "", "no metric called 'headway_s'"),
        ('""', "", "no metric called ''"),
        ("'mine.py:'", MINE, "mine.py has no ''"),
        ("3", "", "must be text, got 3"),
    ],
)
def test_what_is_no_metric_is_told_with_its_line_before_anything_runs(folder, capsys, reference, code, says):
    Path("mine.py").write_text(code)
    file = write("mine.py:least_z", reference) if code is MINE else write(reference)
    line = 1 + max(i for i, text in enumerate(file.read_text().splitlines()) if text.startswith("  - "))
    ended, out, err = does(capsys, "run", file, *PLANT)
    assert (ended, out) == (2, "")
    assert err.startswith(f"mjmerge: mine.yaml:{line}: metrics.")
    assert says in err
    assert not Path("runs").exists()


def test_all_that_is_wrong_with_metrics_and_bounds_is_told_at_once(folder):
    write(
        "mine.py:least_z",
        "mine.py:least_z",
        "mine.py:no_such",
        expect="{leest_z: {at_least: 1}, least_z: {at_least: 2, at_most: 1}, no_such: {}}",
        gate_rows="  - {name: a, at_least_m: 0, metrics: {least_x: {at_leest: 1}, other_s: {at_most: 2}}}",
    )
    with pytest.raises(ScenarioError) as refused:
        load("mine.yaml")
    said = {problem.key: problem.message for problem in refused.value.problems}
    assert said["metrics.1"].startswith("two metrics are called 'least_z'")
    assert "did you mean" in said["metrics.2"] or "has no 'no_such'" in said["metrics.2"]
    assert said["gate.0.metrics.least_x.at_leest"] == "unknown key; did you mean 'at_least'?"
    write("mine.py:least_z", expect="{leest_z: {at_least: 1}, least_z: {at_least: 2, at_most: 1}}")
    with pytest.raises(ScenarioError) as refused:
        load("mine.yaml", ["gate=[{name: a, at_least_m: 0, metrics: {other_s: {at_most: 2}, least_z: {}}}]"])
    assert {problem.key: problem.message for problem in refused.value.problems} == {
        "expect.metrics.leest_z": "the scenario has no metric called 'leest_z': did you mean 'least_z'?",
        "expect.metrics.least_z": "nothing is at least 2.0 and at most 1.0",
        "gate.0.metrics.other_s": "the scenario has no metric called 'other_s': valid names: least_z",
        "gate.0.metrics.least_z": "must have at_least or at_most",
    }


def test_a_module_and_an_entry_point_do_as_well_as_a_file(folder, capsys, monkeypatch):
    place = folder / "site"
    (place / "bright").mkdir(parents=True)
    (place / "bright" / "ideas.py").write_text(
        'def idea_s(trace):\n    """It is 3."""\n    return trace.seeds + 3\n'
    )
    about = place / "bright-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: bright\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[mjmerge.metrics]\nbright_idea = bright.ideas:idea_s\n")
    monkeypatch.syspath_prepend(str(place))
    for reference in ("bright.ideas:idea_s", "bright_idea"):
        write(reference)
        assert load("mine.yaml").metrics == ("bright.ideas:idea_s",)
        assert ran(capsys, "--no-record")["metrics"] == {"idea_s": 3.0}
    write("bright_ideas")
    assert "did you mean 'bright_idea'?" in does(capsys, "run", "mine.yaml")[2]
    assert "bright.ideas:idea_s" in does(capsys, "list", "metrics")[1]
    sys.modules.pop("bright.ideas", None)


@pytest.mark.parametrize(
    ("returns", "says"),
    [
        ("1 / 0", "line 2: ZeroDivisionError: division by zero"),
        ("np.nanmin(trace.opinion)", "an array of shape (1,), got one of shape ()"),
        ("trace.opinion", "an array of shape (1,), got one of shape (1, 101)"),
        ("None", "1 numbers, one for each simulation, got nothing (null)"),
        ("['0.3']", "1 numbers, one for each simulation, got values of type <U3"),
        ("trace.opinion[:, 0] > 0", "got values of type bool"),
        ("trace.opinion[:, 0] * 1j", "got values of type complex128"),
        ("trace.opinion[:, 0] + np.inf", "is infinite with seed 0: give NaN where it is not known"),
        ("[[1], [2, 3]]", "ValueError"),
        ("trace.headway_s", "AttributeError: 'Trace' object has no attribute 'headway_s'"),
    ],
)
def test_what_gives_no_number_for_each_simulation_is_told_and_nothing_looks_finished(
    folder, capsys, returns, says
):
    Path("mine.py").write_text(f"import numpy as np; f_s = lambda trace: (\n    {returns})\n")
    write("mine.py:f_s")
    code, out, err = does(capsys, "run", "mine.yaml", *PLANT)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "f_s" in err
    assert f"{folder / 'mine.py'}" in err
    assert says in err
    left = {path.name for path in Path("runs/mine-double_integrator-0").iterdir()}
    assert left == {"scenario.yaml", "run.rrd.partial", "run.mcap.partial"}


def test_a_file_that_was_edited_since_its_scenario_was_read_is_not_run(folder):
    scenario = load("mine.yaml")
    trace = mjmerge.simulate(scenario, "double_integrator")
    assert own.measured(trace)["least_z"] == trace.opinion.min()
    Path("mine.py").write_text(MINE + "\n# more\n")
    with pytest.raises(DoorError, match=r"least_z of .*mine\.py was edited since its scenario was read"):
        own.measured(trace)
    other = trace.scenario.model_copy(update={"metrics": ("mine.py:nobody_knows_s",)})
    with pytest.raises(DoorError, match="were not found when it was read"):
        own.metrics(other)


def test_a_dump_names_the_file_wherever_it_is_and_loads_again(folder, monkeypatch):
    write("mine.py:least_z", expect="{least_z: {at_least: 0.01}}")
    scenario = load("mine.yaml")
    (folder / "else").mkdir()
    Path("else/resolved.yaml").write_text(dump(scenario))
    monkeypatch.chdir(folder / "else")
    assert load("resolved.yaml") == scenario
    assert hash(load("resolved.yaml")) == hash(scenario)
    assert load("resolved.yaml").metrics == (f"{folder / 'mine.py'}:least_z",)


def test_bounds_are_scaled_with_the_units_of_their_names(folder):
    names = ("a_m", "b_s", "c_mps", "d_n_s", "e")
    Path("mine.py").write_text("".join(f"def {name}(trace): pass\n" for name in names))
    expect = "{" + ", ".join(f"{name}: {{at_least: 1, at_most: 3}}" for name in names) + "}"
    write(*(f"mine.py:{name}" for name in names), expect=expect)
    bounds = load("mine.yaml").scaled(4.0).expect.metrics
    assert {n: (b.at_least, b.at_most) for n, b in bounds.items()} == {
        "a_m": (4, 12), "b_s": (2, 6), "c_mps": (2, 6), "d_n_s": (1, 3), "e": (1, 3),
    }  # fmt: skip


# --- sweeps, ladders, the gate

CAMPAIGN = """
blocks:
  - {scenarios: [mine.yaml, base.yaml], plants: [double_integrator], seeds: 2,
     grid: {law.k_o: [0.8, 1.0], mismatch.neighbour_position_noise_m: [0.01]}}
"""


def test_a_sweep_has_a_column_for_each_in_worker_processes_too(folder, capsys):
    write("mine.py:least_z", "mine.py:from_the_seed", expect="{from_the_seed: {at_most: 0.5}}")
    Path("c.yaml").write_text(CAMPAIGN)
    tables = []
    for workers in ("1", "2"):
        code, out, err = does(capsys, "sweep", "c.yaml", "--workers", workers, "--out", workers, "--json")
        assert code == 0, err
        tables.append(pq.read_table(Path(workers) / TABLE))
    assert tables[0].equals(tables[1])
    rows = tables[0].to_pylist()
    mine = [row for row in rows if row["scenario"] == "mine"]
    assert [row["metric.from_the_seed"] for row in mine] == [row["seed"] for row in mine]
    assert all(0 < row["metric.least_z"] < 0.3 for row in mine)
    assert [row["metrics_held"] for row in mine] == [row["seed"] == 0 for row in mine]
    assert all(row["outcome"] == "failed" for row in mine if row["seed"] == 1)
    others = [row for row in rows if row["scenario"] == "base"]
    assert {row[key] for row in others for key in row if "metric" in key} == {None}
    assert "failed" not in {row["outcome"] for row in others}
    group, other = json.loads(out)["groups"]
    assert group["metrics"]["from_the_seed"] == {"least": 0.0, "median": 0.5, "most": 1.0, "unknown": 0}
    assert other["metrics"] == {}
    report = Path("2/report.md").read_text()
    assert "| mine | double_integrator | literal | from_the_seed | 0 | 0.5 | 1 | 0 |" in report
    assert "In 2 runs some metric is out of its bounds." in report


def test_a_sweep_that_was_begun_with_another_metric_does_not_go_on(folder, capsys):
    Path("c.yaml").write_text(CAMPAIGN)
    assert does(capsys, "sweep", "c.yaml", "--workers", 1, "--out", "s")[0] == 0
    Path("mine.py").write_text(MINE + "\n# more\n")
    code, _, err = does(capsys, "sweep", "c.yaml", "--workers", 1, "--out", "s")
    assert code == 2
    assert "begun with another" in err


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_metric_that_fails_ends_a_sweep_without_a_table(folder, capsys, workers):
    Path("mine.py").write_text("def f(trace):\n    raise RuntimeError('no idea')\n")
    write("mine.py:f")
    Path("c.yaml").write_text(CAMPAIGN)
    code, out, err = does(capsys, "sweep", "c.yaml", "--workers", workers, "--out", "s")
    assert (code, out) == (2, "")
    assert "line 2: RuntimeError: no idea" in err
    assert not (Path("s") / TABLE).exists()


def test_a_ladder_has_them_on_every_rung(folder, capsys):
    code, out, _ = does(capsys, "sweep", "mine.yaml", "--ladder", "--workers", 1, "--json")
    assert code == 0
    rungs = json.loads(out)["rungs"]
    assert all(0 < rung["metric.least_z"] < 0.3 for rung in rungs)
    assert "metric.least_z" in Path("ladders/mine/ladder.csv").read_text().splitlines()[0]


def test_a_row_of_the_gate_has_bounds_of_its_own(folder, capsys):
    rows = "".join(
        f"  - {{name: {name}, plant: double_integrator, at_least_m: -9, needs: [], metrics: {bound}}}\n"
        for name, bound in {
            "good": "{least_z: {at_least: 0.01}}",
            "bad": "{least_z: {at_least: 0.9}}",
            "unknown": "{nobody_knows_s: {at_most: 9}}",
            "free": "{}",
        }.items()
    )
    metrics = ("mine.py:least_z", "mine.py:nobody_knows_s")
    write(*metrics, expect="{least_z: {at_least: 5}}", gate_rows=rows)  # a row's bounds are its own
    does(capsys, "check", "mine.yaml", "--update")
    code, out, _ = does(capsys, "check", "mine.yaml", "--json")
    assert code == 1
    found = {row["row"]: row for row in json.loads(out)["rows"]}
    least = found["good"]["metrics"]["least_z"]
    assert found["good"]["metrics"]["nobody_knows_s"] is None
    assert {name: row["problems"] for name, row in found.items()} == {
        "good": [],
        "bad": [f"least_z is {least:.6g}, below its bound of 0.9"],
        "unknown": ["nobody_knows_s is not known, and must be at most 9"],
        "free": [],
    }
    row = "  - {name: a, at_least_m: 0, set: [expect.metrics.least_z.at_least=1]}"
    write(*metrics, gate_rows=row)
    with pytest.raises(ScenarioError, match="the bounds of a row are its metrics"):
        gate.rows([Path("mine.yaml")])


# --- recordings


@pytest.fixture(scope="module")
def kept():
    """The recordings that one test made, for the others; they name the folder of that one."""
    return {}


@pytest.fixture
def recorded(folder, capsys, kept, monkeypatch):
    if "folder" not in kept:
        write("mine.py:least_z", "mine.py:nobody_knows_s", expect="{least_z: {at_least: 0.01}}")
        kept["folder"], kept["run"] = folder, Path(ran(capsys)["run_dir"])
        shutil.copytree(folder, folder.with_name(f"{folder.name}_kept"))
    shutil.rmtree(kept["folder"])
    shutil.copytree(kept["folder"].with_name(f"{kept['folder'].name}_kept"), kept["folder"])
    monkeypatch.chdir(kept["folder"])
    return kept["run"]


@pytest.mark.parametrize("kind", ["mcap", "rrd"])
def test_a_recording_carries_what_was_measured_and_verify_runs_none_of_it(recorded, kind):
    file = recorded / f"run.{kind}"
    found = read(file)
    assert [(m["name"], m["description"]) for m in found.manifest["metrics"]] == [
        ("least_z", "Smallest opinion."),
        ("nobody_knows_s", ""),
    ]
    assert {code["source"] for code in found.manifest["code"].values()} == {MINE}
    before = ran_code()
    Path("mine.py").write_text(MINE + "\n# another\n")
    verified = verify(file)
    assert ran_code() == before
    assert [c.says for c in verified.checks if c.right is False] == []
    (says,) = (c.says for c in verified.checks if c.name == "not derived")
    assert says.startswith("what the scenario's own metrics came to (least_z, nobody_knows_s): their code is")
    assert [c.says for c in verify_run(recorded).checks if c.right is False] == []
    assert ran_code() == before


@pytest.mark.parametrize(
    ("name", "change", "check"),
    [
        ("summary.json", {"metrics": {"least_z": 0.001, "nobody_knows_s": None}}, "summary"),
        ("summary.json", {"metrics": {"least_z": 0.2}}, "summary"),
        ("summary.json", {"metrics": {"least_z": 0.2, "nobody_knows_s": None, "more": 1}}, "summary"),
        ("summary.json", {"metrics_held": False}, "summary"),
        ("summary.json", {"metrics_bounds": {}}, "summary"),
        ("manifest.json", {"metrics": []}, "manifest"),
        ("manifest.json", {"code": {}}, "manifest"),
        ("manifest.json", {"code": None}, "manifest"),
        ("manifest.json", {"source": "# nothing was measured"}, "manifest"),
    ],
)
def test_a_recording_that_contradicts_itself_about_them_is_wrong(recorded, name, change, check):
    source = recorded / "run.mcap"
    found = read(source)
    there = dict(found.summary) if name == "summary.json" else json.loads(json.dumps(found.manifest))
    if "source" in change:
        for code in there["code"].values():
            code |= change
    else:
        there |= change
    path = rewrite.mcap(source, recorded / "forged.mcap", attachments={name: json.dumps(there).encode()})
    assert check in {c.name for c in verify(path).checks if c.right is False}


@pytest.mark.parametrize("value", ["1" + "0" * 400, "1e999", "NaN", '"0.2"', "true", "[0.2]", "{}"])
def test_a_claim_that_is_no_number_is_one_line(recorded, capsys, value):
    text = json.dumps(dict(read(recorded / "run.mcap").summary) | {"metrics": {"least_z": "here"}})
    said = {"summary.json": text.replace('"here"', value).encode()}
    path = rewrite.mcap(recorded / "run.mcap", Path("odd.mcap"), attachments=said)
    for command in (["verify", path], ["replay", path], ["compare", path, path]):
        code, _, err = does(capsys, *command)
        assert (code, err.count("\n")) == (2, 1)
        assert "summary.json: metrics: not a number per metric" in err


def test_what_a_metric_prints_is_no_part_of_the_json(folder, capsys):
    Path("mine.py").write_text("print('read')\ndef f(trace):\n    print('run')\n    return trace.seeds\n")
    write("mine.py:f")
    assert ran(capsys, "--no-record")["metrics"] == {"f": 0.0}


def test_a_claim_that_keeps_its_bounds_only_replay_finds(recorded, capsys):
    source = recorded / "run.mcap"
    there = dict(read(source).summary)
    there["metrics"] = {"least_z": 0.15, "nobody_knows_s": None}
    path = rewrite.mcap(source, Path("forged.mcap"), attachments={"summary.json": json.dumps(there).encode()})
    assert verify(path).right
    code, out, _ = does(capsys, "replay", path)
    assert code == 1
    assert "DIFFERENT: metrics.least_z: the file says 0.15, the run again says" in out


def test_replay_runs_the_same_code_and_leaves_out_any_other_and_says_so(recorded, capsys):
    before = ran_code()
    Path("mine.py").write_text(MINE.replace("np.nanmin", "np.nanmax"))
    code, out, _ = does(capsys, "replay", recorded)
    assert (code, ran_code()) == (0, before)
    place = f"{Path('mine.py').resolve()}:least_z"
    assert f"left out: the metric least_z: {place} is other code here than in the recording" in out
    code, out, _ = does(capsys, "replay", recorded, "--any-code")
    assert code == 1
    assert "DIFFERENT: metrics.least_z" in out
    Path("mine.py").unlink()
    code, out, _ = does(capsys, "replay", recorded, "--json")
    assert code == 0
    assert len(json.loads(out)["metrics_left_out"]) == 2
    Path("mine.py").write_text(MINE)
    code, out, _ = does(capsys, "replay", recorded)
    assert code == 0
    assert "left out" not in out


def test_compare_and_recover_take_them_as_recorded(recorded, capsys):
    before = ran_code()
    code, out, _ = does(capsys, "compare", recorded, recorded, "--out", "both")
    assert code == 0
    assert "least_z, as recorded" in out
    Path("mine.py").write_text("raise SystemExit(3)")
    cut = Path("cut.mcap.partial")
    whole = (recorded / "run.mcap").read_bytes()
    cut.write_bytes(whole[: int(len(whole) * 0.75)])
    assert does(capsys, "recover", cut)[0] == 0
    found = read(Path("cut.recovered.mcap"))
    assert found.summary["metrics"] == {"least_z": None, "nobody_knows_s": None}
    assert found.summary["metrics_held"] is False
    assert [c.says for c in verify(Path("cut.recovered.mcap")).checks if c.right is False] == []
    assert ran_code() == before


def test_a_scenario_from_a_recording_is_never_measured(recorded):
    trace = read(recorded / "run.mcap").trace()
    assert trace.scenario.metrics
    with pytest.raises(DoorError, match="those of a recording are not run"):
        own.measured(trace)
    with pytest.raises(DoorError):
        run(trace.scenario, "double_integrator", record=False)


def test_the_values_are_those_of_the_function(make_trace):
    trace = make_trace(runs=3, opinion=np.arange(120.0).reshape(3, 40))
    assert own.measured(trace) == {}
    bounds = {"a": {"at_least": 1.0}, "b": {"at_most": 2.0}}
    bounds = {name: Bound(**sides) for name, sides in bounds.items()}
    assert list(own.broken(bounds, {"a": 1.0, "b": 2.0})) == []
    assert list(own.broken(bounds, {"a": 0.5, "b": np.nan})) == [
        "a is 0.5, below its bound of 1",
        "b is not known, and must be at most 2",
    ]
