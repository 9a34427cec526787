"""The command line as other programs rely on it: exit codes, one JSON object, the run folder."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import mujoco
import pytest

from mjmerge.cli import COMMANDS, main
from mjmerge.config import shipped
from mjmerge.drivers import kinds
from mjmerge.record import FORMATS
from mjmerge.scenario.axis import axes
from mjmerge.scenario.mismatch import Mismatch

SHORT = ["--duration", "0.5", "--plant", "double_integrator"]


def run(capsys, *args: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in args])
    out, err = capsys.readouterr()
    return stop.value.code or 0, out, err


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        "run paper --runs 0",
        "run paper --seed=-1",
        "run paper --threads=-1",
        "check --threads=-1",
        "replay run.mcap --threads=-1",
        "sweep mismatch_core --workers=-1",
        "sweep paper --break mismatch.friction --seeds 0",
        "theorem --runs 0",
        "survey --runs 0",
    ],
)
def test_a_number_below_its_bound_is_named_and_nothing_is_left(capsys, tmp_path, words):
    code, _, err = run(capsys, *words.split())
    assert code == 2
    option = words.replace("=", " ").split()[-2]
    assert f"{option} is " in err
    assert "must be at least" in err
    assert not any(tmp_path.iterdir())


def test_a_run_that_holds_ends_with_0_and_a_table(capsys):
    code, out, _ = run(capsys, "run", "paper", "--plant", "double_integrator", "--no-record")
    assert code == 0
    assert "min d_1" in out
    assert "held" in out


def test_a_run_below_the_floor_ends_with_1_and_says_when(capsys):
    code, out, _ = run(
        capsys, "run", "paper", "--plant", "double_integrator", "--no-record", "--set", "law.k_o=0"
    )
    assert code == 1
    assert "BROKEN" in out
    assert "unsafe at 6.2" in out


def test_json_is_exactly_one_object_with_the_contracts_keys(capsys):
    code, out, _ = run(capsys, "run", "paper", *SHORT, "--json")
    found = json.loads(out)
    assert code == 0
    assert out.count("\n") == 1
    assert set(found) >= {
        *(
            "scenario",
            "plant",
            "seed",
            "runs",
            "verdict",
            "min_distance_m",
            "t_min_distance_s",
            "min_clearance_m",
        ),
        *("merged_at_s", "duration_s", "real_time_factor", "run_dir", "versions"),
    }
    assert found["scenario"] == "paper"
    assert set(found["min_distance_m"]) == set(found["t_min_distance_s"]) == {"vehicle_1", "vehicle_2"}
    assert found["min_clearance_m"] is None  # a point mass has no body: unknown, not zero
    assert found["duration_s"] == 0.5
    assert found["versions"]["mujoco"] == mujoco.__version__
    assert found["run_dir"] == str(Path("runs") / "paper-double_integrator-0")


def test_the_run_folder_holds_everything_and_its_scenario_gives_the_same_run(capsys, tmp_path):
    assert run(capsys, "run", "charge", "--duration", "1", "--out", "a", "--set", "law.k_v=1.5")[0] == 0
    names = {p.name for p in (tmp_path / "a").iterdir()}
    assert names == {"run.rrd", "run.mcap", "scenario.yaml", "world.xml", "summary.json", "figure.png"}
    assert run(capsys, "run", "a/scenario.yaml", "--out", "b", "--plant", "mujoco")[0] == 0
    one, two = (json.loads((tmp_path / d / "summary.json").read_text()) for d in "ab")
    assert one["min_distance_m"] == two["min_distance_m"]
    mujoco.MjModel.from_xml_path(str(tmp_path / "a" / "world.xml"))


def test_equal_seeds_give_the_same_mcap_bytes_in_another_process_and_with_other_threads(capsys, tmp_path):
    args = ["run", "flips", "--duration", "1", "--seed", "3"]
    assert run(capsys, *args, "--out", "a", "--threads", "1")[0] == 0
    again = [sys.executable, "-m", "mjmerge", *args, "--out", "b", "--threads", "2"]
    assert subprocess.run(again, capture_output=True, timeout=120, check=False).returncode == 0
    assert run(capsys, *args[:-1], "4", "--out", "c")[0] == 0
    a, b, c = ((tmp_path / d / "run.mcap").read_bytes() for d in "abc")
    assert a == b
    assert a != c


def test_an_earlier_run_in_the_default_folder_makes_way_and_is_named(capsys):
    run(capsys, "run", "paper", *SHORT)
    code, out, _ = run(capsys, "run", "paper", *SHORT)
    assert code == 0
    assert "replaced" in out


def test_a_folder_that_was_asked_for_is_never_overwritten(capsys, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("years of work")
    code, _, err = run(capsys, "run", "paper", *SHORT, "--out", "mine")
    assert code == 2
    assert "--out" in err
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["thesis.tex"]


def test_a_default_folder_with_foreign_files_is_left_alone(capsys, tmp_path):
    folder = tmp_path / "runs" / "paper-double_integrator-0"
    folder.mkdir(parents=True)
    (folder / "notes.txt").write_text("keep me")
    code, _, err = run(capsys, "run", "paper", *SHORT)
    assert code == 2
    assert "notes.txt" in err
    assert (folder / "notes.txt").read_text() == "keep me"


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["run", "papre"], "did you mean 'paper'?"),
        (["run", "paper", "--set", "law.k_0=0"], "did you mean 'k_o' or"),
        (["run", "paper", "--set", "law.k_o"], "law.k_o"),
        (["run", "paper", "--set", "law.k_o=fast"], "number"),
        (["run", "paper", "--duration", "-1"], "duration_s"),
        (["run", "paper", "--duration", "nan"], "duration_s"),
        (["run", "paper", "--runs", "0"], "--runs"),
        (["run", "paper", "--seed", "-1"], "--seed"),
        (["run", "paper", "--out", "/proc/nothing/here"], "cannot write"),
        (["run", "no/such/file.yaml"], "no/such/file.yaml"),
        (["export", "papre"], "did you mean 'paper'?"),
        (["view", "no-such-run"], "no-such-run"),
    ],
)
def test_bad_input_ends_with_2_and_says_what_to_do(capsys, args, says):
    code, out, err = run(capsys, *args)
    assert code == 2
    assert says in err
    assert "Traceback" not in err
    assert not out


@pytest.mark.parametrize(
    "args", [["rnu", "paper"], ["run", "paper", "--plan", "bicycle"], ["run", "paper", "--plant", "x"]]
)
def test_a_misspelt_command_or_option_ends_with_2(capsys, args):
    assert run(capsys, *args)[0] == 2


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["rnu", "charge"], "no command called 'rnu': did you mean 'run'?"),
        (["chekc"], "no command called 'chekc': did you mean 'check'?"),
        (["figures"], "no command called 'figures': valid names: check, compare"),
    ],
)
def test_a_command_that_is_none_is_told_with_the_nearest(capsys, args, words):
    code, out, err = run(capsys, *args)
    assert (code, out) == (2, "")
    assert words in err


def test_a_misspelt_option_is_told_by_the_options_of_its_own_command_alone(capsys):
    code, _, said = run(capsys, "run", "charge", "--sed", "3")
    assert code == 2
    assert "--seed N" in said
    assert "mjmerge run --help" in said
    assert "harden" not in said


def test_it_says_which_version_it_is(capsys):
    assert run(capsys, "--version") == (0, f"mjmerge {version('mjmerge')}\n", "")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_names_what_it_takes_and_shows_no_default_that_is_none(capsys, name):
    code, said, _ = run(capsys, name, "--help")
    assert code == 0
    assert said.startswith(f"usage: mjmerge {name} ")
    for odd in ("None", "STR", "(default: )", "(default: False)", "INT"):
        assert odd not in said


def test_a_recorder_that_breaks_leaves_the_run_whole_and_ends_with_3(capsys, tmp_path, monkeypatch):
    def broken(path, header, scene):
        raise OSError("no space left on device")

    monkeypatch.setattr("mjmerge.run.FORMATS", {**FORMATS, "run.rrd": broken})
    code, out, err = run(capsys, "run", "paper", *SHORT, "--out", "a")
    assert code == 3
    assert "no space left" in err
    assert "min d_1" in out
    assert (tmp_path / "a" / "run.mcap").is_file()
    assert not (tmp_path / "a" / "run.rrd").exists()


def test_of_many_runs_the_worst_is_recorded_and_equals_that_run_alone(capsys, tmp_path):
    args = ["run", "flips", "--duration", "6", "--plant", "double_integrator"]
    _, out, _ = run(capsys, *args, "--runs", "4", "--out", "many", "--json")
    found = json.loads(out)
    assert sum(found["verdicts"].values()) == found["runs"] == 4
    run(capsys, *args, "--seed", found["worst_seed"], "--out", "alone")
    assert (tmp_path / "many" / "run.mcap").read_bytes() == (tmp_path / "alone" / "run.mcap").read_bytes()


def test_list_names_every_kind_and_entry(capsys):
    code, out, _ = run(capsys, "list")
    assert code == 0
    for name in (
        "paper",
        "charge",
        "blocked",
        "flips",
        "rc",
        "literal",
        "leader_brakes",
        "stop_and_go",
        "steady",
        "gap",
        "speeds",
        "idm",
        "double_integrator",
        "mujoco",
    ):
        assert name in out


def test_list_as_json_is_one_object_by_kind_and_name(capsys):
    _, out, _ = run(capsys, "list", "--json")
    found = json.loads(out)
    kinds = ["scenarios", "campaigns", "models", "laws", "drivers", "plants", "metrics", "axes"]
    assert list(found) == kinds
    for kind in kinds:
        _, out, _ = run(capsys, "list", kind, "--json")
        assert json.loads(out) == {kind: found[kind]}
        _, out, _ = run(capsys, "list", kind)
        assert all(name in out for name in found[kind])


def test_list_has_all_of_an_axis_on_a_line(capsys):
    code, out, _ = run(capsys, "list", "axes")
    assert code == 0
    (line,) = [line for line in out.splitlines() if line.startswith(" command_delay_s ")]
    cells = ["command_delay_s", "s", "0 to 2", "0", "0.01, 0.02, 0.1", "0.05, 0.24, 0.4", "every plant"]
    assert re.split(r"  +", line.strip()) == [*cells, axes(Mismatch)["command_delay_s"].changes]
    assert " front_stiffness and rear_stiffness: only on tyres that slip (mismatch.tyres)\n" in out
    _, out, _ = run(capsys, "list", "axes", "--json")
    patch = json.loads(out)["axes"]["patch_friction"]
    assert patch["levels"]["full"]["mild"] == {
        "patch_friction": 0.6,
        "patch_start_m": 60.0,
        "patch_length_m": 10.0,
    }
    assert (patch["unit"], patch["default"], patch["plants"]) == ("1", None, ["mujoco"])
    assert patch["range"] == {"exclusiveMinimum": 0, "maximum": 2}


def test_list_drivers_says_of_every_key_its_unit_default_and_meaning(capsys):
    _, shown, _ = run(capsys, "list", "drivers")
    _, out, _ = run(capsys, "list", "drivers", "--json")
    listed = json.loads(out)["drivers"]
    assert {*listed} == {*kinds()}
    for name, cls in kinds().items():
        told = listed[name]["keys"]
        assert {key for key in told if "." not in key} == {*cls.model_fields} - {"kind"}
        assert told.keys() == {*re.findall(r"^ ([\w.\[\]]+) ", of_driver(shown, name), re.MULTILINE)}
        for key, said in told.items():
            assert said["meaning"], f"{name}.{key} has no meaning"
            assert said["meaning"] in of_driver(shown, name)
    gap = listed["gap"]["keys"]
    some = [gap[key] for key in ("moves[].start_s", "bandwidth_radps", "sway", "moves[].step")]
    assert [key["unit"] for key in some] == ["s", "rad/s", "-", "-"]
    assert [key["required"] for key in some] == [True, False, False, False]
    assert [key["default"] for key in some] == [None, 3.0, None, "quintic"]
    (line,) = [line for line in of_driver(shown, "idm").splitlines() if " exponent " in line]
    assert re.split(r"  +", line.strip())[:3] == ["exponent", "1", "4"]


def of_driver(shown, name):
    """What is shown of one driver."""
    return re.search(rf"^{name}  .*\n((?: .*\n)*)", shown, re.MULTILINE)[1]


def test_export_prints_a_world_that_compiles(capsys):
    code, out, _ = run(capsys, "export", "paper")
    assert code == 0
    assert mujoco.MjModel.from_xml_string(out).nu == 33


def test_schema_is_json(capsys):
    _, out, _ = run(capsys, "schema")
    assert json.loads(out)["title"] == "Scenario"


def test_names_and_folders_with_odd_letters_are_shown_as_they_are_and_quoted(capsys, tmp_path):
    odd = "it's [red] $x_{$ & 50%"
    text = shipped.scenarios()["paper"].read_text()
    (tmp_path / f"{odd}.yaml").write_text(text)
    code, out, err = run(capsys, "run", f"{odd}.yaml", *SHORT, "--out", f"out {odd}")
    assert (code, err) == (0, "")
    assert f"{odd} on double_integrator" in out
    (line,) = (line for line in out.splitlines() if line.startswith("look at it:"))
    assert shlex.split(line.removeprefix("look at it:")) == ["mjmerge", "view", f"out {odd}"]
    again = ["compare", f"out {odd}", f"out {odd}", "--out", f"both {odd}"]
    assert run(capsys, *again)[0] == 0
    block = {"scenarios": [f"{odd}.yaml"], "plants": ["double_integrator"], "set": {"duration_s": 0.1}}
    campaign = json.dumps({"blocks": [block]})
    (tmp_path / f"c {odd}.yaml").write_text(campaign)
    assert run(capsys, "sweep", f"c {odd}.yaml", "--workers", "1")[0] == 0


def test_a_file_name_that_is_no_text_is_refused(capsys, tmp_path):
    name = os.fsdecode(b"\xff.yaml")
    (tmp_path / name).write_text(shipped.scenarios()["paper"].read_text())
    code, _, err = run(capsys, "run", name, *SHORT)
    assert code == 2
    assert "rename it" in err
