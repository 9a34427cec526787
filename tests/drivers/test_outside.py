"""A driver from outside drives in every command, and what it gets wrong is said by its name."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from mjmerge import judge, load, simulate
from mjmerge.cli import main
from mjmerge.config.doors import DoorError
from mjmerge.errors import MjmergeError, ScenarioError, UnreadableError
from mjmerge.record.read import read
from mjmerge.review.claims import allow
from mjmerge.review.replay import replay
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.distinct import random as varies
from mjmerge.starts.make import make

STEADY = """
from typing import ClassVar
from pydantic import Field
from mjmerge.drivers import Driver

class Mine(Driver):
    can_lead: ClassVar[bool] = True
    speed_mps: float = Field(gt=0)

    def acceleration_mps2(self, time_s, own, leader, drawn, hold_s=0.0):
        return 2.0 * (self.speed_mps - own.speed_mps)
"""
"""The shipped ``steady``, brought by somebody."""
LEADS = "drivers.vehicle_1={kind: 'mine.py:Mine', speed_mps: 2.0}"
SHORT = "duration_s=1"


def command(*words: str) -> int:
    with pytest.raises(SystemExit) as end:
        main([*words])
    return int(end.value.code or 0)


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(STEADY)
    return tmp_path


def brought(text: str) -> None:
    """Vehicle 1's driver is now this."""
    Path("mine.py").write_text(STEADY.replace("        return 2.0 * (self.speed_mps - own.speed_mps)", text))


def queue(keys: str) -> int:
    """A scenario of one's own whose Vehicle 1 has these keys; the line that they stand in."""
    text = make("scenario", "waiting", Path()).read_text()
    old = "vehicle_1: {kind: steady, speed_mps: 1.5}"
    Path("waiting.yaml").write_text(text.replace(old, f"vehicle_1: {{{keys}}}"))
    return next(i for i, row in enumerate(text.splitlines(), 1) if old in row)


def many(plant: str, seeds: int) -> None:
    """A campaign whose Vehicle 1 is driven by that driver."""
    driver = "drivers.vehicle_1: {kind: 'mine.py:Mine', speed_mps: 2}"
    Path("many.yaml").write_text(
        f"description: d\nblocks:\n  - {{scenarios: [charge], plants: [{plant}], seeds: {seeds}, "
        f"set: {{duration_s: 1}}, mismatches: {{own: {{{driver}}}}}}}\n"
    )


@pytest.mark.parametrize("plant", ["double_integrator", "bicycle", "bicycle_limited", "mujoco"])
def test_it_drives_as_a_shipped_one_would_bit_for_bit_on_every_plant(here, plant):
    own = simulate(load("charge", [SHORT, LEADS]), plant)
    shipped = simulate(load("charge", [SHORT]), plant)
    assert own.front_m.tobytes() == shipped.front_m.tobytes()
    assert own.u_mps2.tobytes() == shipped.u_mps2.tobytes()
    assert judge(own) == judge(shipped)


def test_it_drives_in_continuous_time_at_another_size_and_again_from_its_resolved_scenario(here):
    scenario = load("charge", [SHORT, LEADS])
    assert len(simulate(scenario, "bicycle", continuous=True).time_s) == 101
    assert scenario.scaled(2.0).drivers.vehicle_1.speed_mps == pytest.approx(2.0 * np.sqrt(2.0))
    assert command("run", "charge", "--set", SHORT, "--set", LEADS, "--out", "a", "--plant", "bicycle") == 0
    assert load(here / "a" / "scenario.yaml").drivers == scenario.drivers
    assert scenario.drivers.vehicle_1.kind == f"{here / 'mine.py'}:Mine"


def test_a_file_beside_the_scenario_is_meant_from_wherever_the_command_runs(
    here, tmp_path_factory, monkeypatch
):
    text = Path(make("scenario", "waiting", here)).read_text()
    (here / "waiting.yaml").write_text(
        text.replace("vehicle_1: {kind: steady, speed_mps", "vehicle_1: {kind: 'mine.py:Mine', speed_mps")
    )
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert load(here / "waiting.yaml").drivers.vehicle_1.kind == f"{here / 'mine.py'}:Mine"


def test_a_module_on_the_import_path_is_meant_by_its_name(here, monkeypatch):
    monkeypatch.syspath_prepend(here)
    (here / "a_package_of_mine.py").write_text(STEADY)
    scenario = load("charge", [SHORT, LEADS.replace("mine.py", "a_package_of_mine")])
    assert scenario.drivers.vehicle_1.kind == "a_package_of_mine:Mine"
    assert len(simulate(scenario, "bicycle").time_s) == 101
    sys.modules.pop("a_package_of_mine")


def test_an_entry_point_of_an_installed_package_is_a_kind(here, monkeypatch, capsys):
    info = here / "theirs-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[mjmerge.drivers]\nof_theirs = theirs_module:Mine\n")
    (here / "theirs_module.py").write_text(STEADY)
    monkeypatch.syspath_prepend(here)
    scenario = load("charge", [SHORT, "drivers.vehicle_1={kind: of_theirs, speed_mps: 2.0}"])
    assert scenario.drivers.vehicle_1.kind == "theirs_module:Mine"
    assert command("list", "drivers") == 0
    assert "of_theirs" in capsys.readouterr().out
    sys.modules.pop("theirs_module")


def test_it_drives_in_worker_processes_and_the_gate(here):
    many("bicycle", 3)
    assert command("sweep", "many.yaml", "--workers", "2", "--out", "swept") == 0
    assert pq.read_table("swept/table.parquet").num_rows == 3
    text = Path(make("scenario", "waiting", here)).read_text()
    Path("waiting.yaml").write_text(
        text.replace("{kind: steady, speed_mps", "{kind: 'mine.py:Mine', speed_mps")
    )
    assert command("check", "waiting.yaml", "--update") == 0


def test_a_recording_carries_its_code_and_nothing_of_it_is_run_to_verify_it(here):
    scenario = load("charge", ["duration_s=0.5", LEADS])
    run(scenario, "bicycle", folder=here / "a")
    for name in ("run.mcap", "run.rrd"):
        (code,) = read(here / "a" / name).manifest["code"].values()
        assert code["source"] == STEADY
    (here / "mine.py").write_text("from pathlib import Path\nPath('ran').touch()\n" + STEADY)
    for name in ("run.mcap", "run.rrd"):
        found = verify(here / "a" / name)
        assert found.right
        (verdict,) = [check for check in found.checks if check.name == "verdict"]
        assert verdict.right is None
        assert "mine.py:Mine is not let in" in verdict.says
    assert not (here / "ran").exists()


def test_the_scenario_of_a_recording_runs_no_code_whatever_is_done_with_it(here):
    """As in a process that has never seen the driver."""
    run(load("charge", ["duration_s=0.2", LEADS]), "bicycle", folder=here / "a")
    (here / "other.py").write_text("from pathlib import Path\nPath('ran').touch()\n" + STEADY)
    scenario = read(here / "a" / "run.mcap").scenario()
    driver = scenario.drivers.vehicle_1.model_copy(update={"kind": f"{here / 'other.py'}:Mine"})
    drivers = scenario.drivers.model_copy(update={"vehicle_1": driver})
    scenario = scenario.model_copy(update={"drivers": drivers})
    with pytest.raises(MjmergeError, match="has not been let in"):
        simulate(scenario, "bicycle")
    with pytest.raises(MjmergeError, match="has not been let in"):
        scenario.scaled(2.0)
    assert not (here / "ran").exists()


@pytest.mark.parametrize(
    ("claim", "judged", "let"),
    [
        ("held", "vacuous", True),
        ("vacuous", "vacuous", True),
        ("refuted", "vacuous", False),
        ("held", "assumption broken", False),
        ("vacuous", "incomplete", False),
    ],
)
def test_without_the_code_a_safe_run_may_claim_that_the_barrier_was_needed_and_nothing_else(
    here, claim, judged, let
):
    run(load("charge", ["duration_s=0.2", LEADS]), "bicycle", folder=here / "a")
    found = replace(read(here / "a" / "run.mcap"), verdict=claim)
    expected = {"verdict": judged, "verdicts": {judged: 1}, "needed": None}
    allow(found, {"needed": claim == "held"}, expected)
    assert (expected["verdict"] == claim) == let
    assert (expected["needed"] is None) != let


def test_replay_runs_the_same_code_and_another_only_when_told_to(here):
    run(load("charge", ["duration_s=0.5", LEADS]), "mujoco", folder=here / "a")
    file = here / "a" / "run.mcap"
    assert replay(file).same
    brought("        return 1.0 * (self.speed_mps - own.speed_mps) + 0.1")
    with pytest.raises(UnreadableError, match=r"mine.py:Mine is other code here .*--any-code runs it"):
        replay(file)
    assert not replay(file, any_code=True).same
    (here / "mine.py").unlink()
    with pytest.raises(UnreadableError, match=r"mine.py:Mine is not here"):
        replay(file)
    assert verify(file).right


def test_a_recording_that_was_cut_off_is_recovered_with_its_code(here):
    run(load("charge", ["duration_s=1.5", LEADS]), "bicycle", folder=here / "a")
    data = (here / "a" / "run.mcap").read_bytes()
    (here / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    assert command("recover", "cut.mcap", "--out", "again.mcap") == 0
    assert read(here / "again.mcap").manifest["code"] == read(here / "a" / "run.mcap").manifest["code"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "        return own.speed_mps[:0]",
            r"mine.py:Mine intends .*one acceleration for each of the 2 sim",
        ),
        ("        return 'fast'", "mine.py:Mine intends the text 'fast'"),
        ("        return None", "mine.py:Mine intends"),
        ("        return nothing", r"mine.py:Mine was asked for acceleration_mps2: .*line 11: NameError"),
        ("        raise SystemExit(0)", "SystemExit: 0"),
    ],
)
def test_what_it_gets_wrong_while_it_drives_is_bad_input_and_says_where(here, capsys, text, says):
    brought(text)
    scenario = load("charge", [SHORT, LEADS])
    with pytest.raises(DoorError, match=says):
        simulate(scenario, "bicycle", runs=2)
    assert command("run", "charge", "--set", SHORT, "--set", LEADS, "--plant", "bicycle", "--out", "a") == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (here / "a" / "summary.json").exists()


@pytest.mark.parametrize(
    ("member", "says"),
    [
        ("def switches(self, drawn): return 5", "switches at 5; it must be an array of times, s"),
        ("def switches(self, drawn): return ['x']", "it must be an array of times, s"),
        ("def switches(self, drawn): return [float('nan')]", "it must be an array of times, s"),
        ("switches = property(lambda self: 5)", "was asked for switches: TypeError"),
        ("def stands(self, *given): return own", "line 13: NameError"),
        (
            "def stands(self, *given): return 5",
            "means to stand with 5; it must be true or false for each of the 1",
        ),
        (
            "def draw(self, *given): return 'x'",
            "draws the text 'x'; it must be an array of numbers with a row",
        ),
        ("def draw(self, *given): return [[1, 2]] * 5", "a row for each of the 1 simulations, or None"),
        ("acceleration_mps2 = property(lambda self: 5)", "was asked for acceleration_mps2: TypeError"),
    ],
)
def test_whatever_it_answers_is_looked_at(here, member, says):
    Path("mine.py").write_text(f"{STEADY}\n    {member}\n")
    with pytest.raises(DoorError, match=re.escape(says)):
        simulate(load("charge", [SHORT, LEADS]), "bicycle", continuous="switches" in member)


@pytest.mark.parametrize(
    ("member", "says"),
    [
        ("can_lead = 5", "can lead with 5; it must be true or false"),
        ("def random(self, duration_s): return 'x'", "is random with the text 'x'; it must be true or false"),
        ("def problems(self): return 5", "was asked for problems: TypeError"),
        ("def model_copy(self): return 5", "model_copy is not for a driver to say"),
        ("stands: bool = True", "stands can be no key of a driver"),
    ],
)
@pytest.mark.filterwarnings("ignore:Field name")  # pydantic's own word on a field of that name
def test_what_it_says_of_itself_is_asked_before_anything_runs(here, member, says):
    Path("mine.py").write_text(f"{STEADY}\n    {member}\n")
    with pytest.raises(MjmergeError, match=re.escape(says)):
        varies(load("charge", [SHORT, LEADS]), "bicycle")


def test_a_number_that_is_none_ends_the_run_and_is_no_verdict(here):
    brought("        return 0.0 * own.speed_mps + float('nan')")
    trace = simulate(load("charge", [SHORT, LEADS]), "double_integrator")
    (verdict,) = judge(trace)
    assert verdict.verdict not in ("held", "vacuous")


@pytest.mark.parametrize(
    ("keys", "key", "says"),
    [
        ("kind: 'mine.py:Mnie', speed_mps: 2", "kind", "has no 'Mnie': did you mean 'Mine'?"),
        ("kind: 'mien.py:Mine', speed_mps: 2", "kind", "there is no file mien.py"),
        ("kind: 'mine.py:Field', speed_mps: 2", "kind", "is no driver: a class derived from"),
        ("kind: 'mine.py:Driver', speed_mps: 2", "kind", "no driver yet: it lacks acceleration_mps2"),
        ("kind: 'mine.py:Mine', speed: 2", "speed", "unknown key; did you mean 'speed_mps'?"),
        ("kind: 'mine.py:Mine', speed_mps: -2", "speed_mps", "must be greater than 0, got -2"),
        ("kind: 'mine.py:Mine', speed_mps: fast", "speed_mps", "must be a number, got the text 'fast'"),
        ("kind: 'mine.py:Mine'", "speed_mps", "missing"),
    ],
)
def test_a_wrong_name_or_key_is_told_with_its_line_before_anything_runs(here, keys, key, says):
    line = queue(keys)
    with pytest.raises(ScenarioError) as refused:
        load(here / "waiting.yaml")
    problems = [p for p in refused.value.problems if says in p.message]
    assert [(p.key, p.line) for p in problems] == [(f"drivers.vehicle_1.{key}", line)]


@pytest.mark.parametrize(
    ("kind", "name"), [("driver", "very_late"), ("driver", "x-1"), ("metric", "clear-ance_m")]
)
def test_what_new_writes_runs_with_the_command_that_it_prints(here, capsys, kind, name):
    assert command("new", kind, name, "--json") == 0
    (then,) = json.loads(capsys.readouterr().out)["next"]
    words = shlex.split(then)
    assert words[0] == "mjmerge"
    assert command(*words[1:], "--plant", "double_integrator", "--no-record", "--json") in (0, 1)
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] in ("held", "vacuous")
    assert kind == "driver" or found["metrics"] == {"clear_ance_m": None}  # no bodies on that plant


def test_a_sweep_does_not_go_on_with_other_code(here, capsys):
    many("double_integrator", 1)
    assert command("sweep", "many.yaml", "--out", "swept") == 0
    brought("        return 1.9 * (self.speed_mps - own.speed_mps)")
    shutil.rmtree("swept/shards", ignore_errors=True)
    assert command("sweep", "many.yaml", "--out", "swept") == 2
    assert "code from outside" in capsys.readouterr().err
