"""A law from outside drives the ego in every command, and what it gets wrong is said by its name and line."""

from __future__ import annotations

import json
import pickle
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from mjmerge import judge, load, simulate
from mjmerge.cli import main
from mjmerge.errors import MjmergeError, ScenarioError, UnreadableError
from mjmerge.law import OpinionDynamics
from mjmerge.law.asked import TAKEN
from mjmerge.record.digest import digests
from mjmerge.record.read import read
from mjmerge.review.convert import flat
from mjmerge.review.replay import replay
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.simulation.trace import COLUMNS, END_COLUMNS
from mjmerge.starts.make import KINDS, make
from mjmerge.verdict.hypotheses import broken

SHORT = "duration_s=1"
OURS = "law.kind=mine.py:mine"
PLANTS = ["double_integrator", "bicycle", "bicycle_limited", "mujoco"]

CLASS = """import numpy as np
from mjmerge.law import Decision, Law, Signal

class mine(Law):
    kind: str
    def decide(self, seen, memory, step_s): return Decision(seen.p)"""

TWICE = """
from mjmerge.law import Decision, Law, Signal

class mine(Law):
    kind: str

    @property
    def signals(self):
        return Signal("a_m", ""), Signal("a_m", "")

    def decide(self, seen, memory, step_s):
        return Decision(seen.p, {"a_m": seen.p[:, 0]})
"""

PAPER = '''
from mjmerge.law import OpinionDynamics

class Mine(OpinionDynamics):
    """The paper's law, brought by somebody."""
    kind: str
'''


def command(*words: object) -> int:
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    return int(end.value.code or 0)


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    make("law", "mine", tmp_path)
    return tmp_path


def law(body: str, head: str = "def mine(seen, memory, dt):") -> None:
    """The law is now this; the body begins in the second line below its head."""
    lines = "\n".join(f"    {line}" for line in body.splitlines())
    Path("mine.py").write_text(f"import numpy as np\nfrom mjmerge.law import each_run\n{head}\n{lines}\n")


def queue() -> None:
    """A scenario of one's own whose law is this."""
    make("scenario", "waiting", Path())
    text = Path("waiting.yaml").read_text()
    text = text.replace("\nduration_s: 20", "\nduration_s: 9\nphysics_step_s: 0.002")
    Path("waiting.yaml").write_text(
        re.sub(r"\nlaw:.*\n", "\nlaw:\n  kind: 'mine.py:mine'\n", text).replace("  r_eta_m", "  # r_eta_m")
    )


def refused(*more: str) -> str:
    with pytest.raises(ScenarioError) as error:
        load("charge", [SHORT, OURS, *more])
    (problem,) = error.value.problems
    assert problem.key == "law.kind"
    return problem.message


# the paper's law


@pytest.mark.parametrize("plant", PLANTS)
def test_the_papers_law_as_a_plug_in_gives_the_same_bits_and_the_same_verdict(here, plant):
    Path("paper.py").write_text(PAPER)
    keys = [SHORT, "mismatch.sensing_delay_s=0.05", "mismatch.position_noise_m=0.01"]
    own = simulate(load("charge", [*keys, "law.kind=paper.py:Mine"]), plant, runs=3)
    shipped = simulate(load("charge", keys), plant, runs=3)
    for column in shipped.columns:
        assert own.column(column.name).tobytes() == shipped.column(column.name).tobytes(), column.name
    verdicts = judge(own), judge(shipped)
    assert [v.verdict for v in verdicts[0]] == [v.verdict for v in verdicts[1]]


@pytest.mark.parametrize(
    ("seconds", "keys"),
    [
        (1, ["law.kind=paper.py:Mine"]),
        (7, ["law.kind=paper.py:Mine", "law.k_o=0"]),
        (7, [OURS, "law.guarded=false"]),
        (1, [f"{OURS}_each"]),
    ],
)
def test_whatever_it_is_derived_from_its_recording_is_right_without_its_code(here, keys, seconds):
    Path("paper.py").write_text(PAPER)
    run(load("charge", [f"duration_s={seconds}", *keys]), "bicycle", folder=Path("out"))
    for name in ("run.mcap", "run.rrd"):
        found = verify(Path("out") / name)
        assert [check for check in found.checks if check.right is False] == []


def test_and_in_continuous_time(here):
    Path("paper.py").write_text(PAPER)
    own, shipped = (
        simulate(load("charge", [SHORT, *more]), "bicycle", continuous=True)
        for more in (["law.kind=paper.py:Mine"], [])
    )
    assert own.front_m.tobytes() == shipped.front_m.tobytes()
    assert own.opinion.tobytes() == shipped.opinion.tobytes()


# a function, in every command


@pytest.mark.parametrize("plant", PLANTS)
def test_a_run_is_the_same_alone_and_in_a_batch_and_called_for_each(here, plant):
    noise = "mismatch.position_noise_m=0.01"
    several = simulate(load("charge", [SHORT, OURS, noise]), plant, runs=3)
    alone = simulate(load("charge", [SHORT, OURS, noise]), plant, seed=2)
    for column in several.columns:
        both = several.column(column.name)[2:], alone.column(column.name)
        assert both[0].tobytes() == both[1].tobytes(), column.name
    each = simulate(load("charge", [SHORT, f"{OURS}_each", noise]), plant, runs=3)
    assert np.allclose(each.front_m, several.front_m, rtol=0, atol=1e-9)
    assert each.signals["least_d_m"].shape == several.signals["least_d_m"].shape == (3, 101)
    least = np.minimum.accumulate(several.sensed_distance_m.min(axis=2), axis=1)
    assert np.allclose(several.signals["least_d_m"], least, rtol=0, atol=1e-12)


def test_its_guard_is_what_its_verdict_is_about_and_without_such_a_key_nobody_knows(here):
    held = judge(simulate(load("charge", [OURS]), "double_integrator"))[0]
    assert (held.verdict, held.needed) == ("held", True)
    assert "its guard was needed: without its guard the ideal comes to d_" in held.reason
    off = judge(simulate(load("charge", [OURS, "law.guarded=false"]), "double_integrator"))[0]
    assert off.verdict == "assumption broken"
    text = Path("mine.py").read_text()
    Path("mine.py").write_text(text.replace(", guarded=True", "").replace("guarded * ", ""))
    open_ = judge(simulate(load("charge", [OURS]), "double_integrator"))[0]
    assert (open_.verdict, open_.needed) == ("vacuous", None)
    assert "how it would end without its guard is not known" in open_.reason


def test_a_recording_of_it_verifies_converts_and_replays_only_with_the_same_code(here):
    done = run(load("charge", [SHORT, OURS]), "mujoco", folder=Path("out"))
    assert not done.failures
    for name in ("run.mcap", "run.rrd"):
        found = verify(Path("out") / name)
        assert found.right, [check for check in found.checks if check.right is False]
        notes = {check.name: check.says for check in found.checks if check.right is None}
        assert "what the law mine.py:mine decides" in notes["not derived"]
        table = flat(read(Path("out") / name))
        assert table["least_d_m"].tobytes() == done.trace.signals["least_d_m"][0].tobytes()
        assert replay(Path("out") / name).same
    Path("mine.py").write_text(Path("mine.py").read_text() + "\n# other\n")
    assert verify(Path("out/run.mcap")).right
    with pytest.raises(UnreadableError, match=r"its law .*mine.py:mine is other code here"):
        replay(Path("out/run.mcap"))
    assert replay(Path("out/run.mcap"), any_code=True).same
    Path("mine.py").unlink()
    assert verify(Path("out/run.rrd")).right


def test_a_forged_signal_is_wrong(here):
    run(load("charge", [SHORT, OURS]), "bicycle", folder=Path("out"))
    found = read(Path("out/run.mcap"))
    columns = {name: values.copy() for name, values in found.columns.items()}
    columns["least_d_m"][7] += 1e-9
    changed = digests(columns, found.texts)
    assert {name for name in changed if changed[name] != found.sha256[name]} == {"least_d_m"}


def test_recover_adds_the_verdict_of_what_was_cut_off(here):
    run(load("charge", ["duration_s=3", OURS]), "bicycle", folder=Path("out"))
    data = Path("out/run.mcap").read_bytes()
    Path("cut.mcap").write_bytes(data[: 2 * len(data) // 3])
    assert command("recover", "cut.mcap", "--out", "again.mcap") == 0
    assert "least_d_m" in read(Path("again.mcap")).columns


def test_a_sweep_has_it_beside_others_on_two_workers_and_the_command_of_a_row_gives_the_row(here, capsys):
    Path("many.yaml").write_text(
        "description: d\nblocks:\n  - {scenarios: [charge], plants: [bicycle], seeds: 2, variants: [gated],\n"
        "     laws: ['mine.py:mine', nominal, {kind: 'mine.py:mine_each', k_o: 2}, opinion_dynamics],\n"
        "     set: {duration_s: 1}, mismatches: {noise: {mismatch.position_noise_m: 0.01}}}\n"
    )
    assert command("sweep", "many.yaml", "--workers", 2, "--out", "out") in (0, 1)
    rows = pq.read_table("out/table.parquet").to_pylist()
    names = ["gated", "mine.py:mine", "nominal", "mine.py:mine_each", "literal"]
    assert [row["variant"] for row in rows] == [name for name in names for _ in range(2)]
    capsys.readouterr()
    keys = [word for text in rows[3]["set"] for word in ("--set", text)]
    again = "run", "charge", "--plant", "bicycle", "--seed", 1, *keys, "--no-record", "--json"
    command(*again)
    assert json.loads(capsys.readouterr().out)["min_distance_m"]["vehicle_1"] == rows[3]["min_d_1_m"]


def test_ladder_break_check_list_and_view_take_it(here, capsys):
    keys = "--set", "duration_s=0.3", "--set", "physics_step_s=0.002", "--set", OURS
    assert command("sweep", "--ladder", "charge", *keys, "--out", "ladder") in (0, 1)
    axis = "--break", "mismatch.command_delay_s=0:0.1", "charge"
    quick = "--set", "duration_s=0.3", "--set", OURS, "--plant", "bicycle"
    assert command("sweep", *axis, *quick, "--out", "break") in (0, 1)
    queue()
    assert command("check", "waiting.yaml", "--update") == 0
    assert command("check", "waiting.yaml") == 0
    capsys.readouterr()
    assert command("list", "laws", "--json") == 0
    assert json.loads(capsys.readouterr().out)["laws"].keys() >= {"opinion_dynamics", "nominal"}


def test_a_new_one_runs_as_it_is_with_the_command_that_is_printed(here, capsys):
    (line,) = KINDS["law"].then("./mine.py", "mine")
    assert command(*shlex.split(line)[1:], "--plant", "bicycle", "--no-record") == 0
    assert "held" in capsys.readouterr().out


def test_it_goes_to_another_process_as_it_is(here):
    scenario = load("charge", [SHORT, OURS, "law.k_o=1.5"])
    again = pickle.loads(pickle.dumps(scenario))
    assert again.law == scenario.law
    assert again.law.signals == scenario.law.signals


def test_its_keys_are_the_scenarios_and_a_files_keys_of_another_law_are_left_out(here):
    scenario = load("charge", [SHORT, OURS, "law.k_o=1.5"])
    assert scenario.law.k_o == 1.5
    assert scenario.law.r_rho_m == load("charge").law.r_rho_m
    assert scenario.r_m == load("charge").r_m
    assert not hasattr(scenario.law, "k_w")
    with pytest.raises(ScenarioError, match=r"law.k_ow: unknown key; did you mean 'k_o'"):
        load("charge", [OURS, "law.k_ow=1"])
    with pytest.raises(ScenarioError, match=r"law.k_o: must be a number"):
        load("charge", [OURS, "law.k_o=much"])


# what is wrong is said before anything runs


WRONG = {
    "no such file": ("", "there is no file"),
    "shape": ("return seen.p[:, 0]", r"gives a command of shape \(3,\); .* \(3, 2\)"),
    "nothing": ("pass", "gives u as nothing"),
    "not finite": ("return seen.p / 0.0", "a command that is not finite"),
    "raises": ("x = 1\nreturn seen.q", r"mine.py, line 5: AttributeError: .*'q'"),
    "writes to what it sees": ("seen.p[:] = 0\nreturn seen.p", r"mine.py, line 4: ValueError: .*read-only"),
    "draws": (
        "return np.random.default_rng().normal(size=(len(seen.p), 2))",
        "gives another command when it",
    ),
    "keeps outside": (
        "global k\nk = globals().get('k', 0) + 1\nreturn seen.p * k",
        "belongs into its memory",
    ),
    "mixes runs": ("return seen.p - seen.p.mean(axis=0)", "for a simulation alone than among 3"),
    "memory": ("memory['k'] = 1\nreturn seen.p", r"remembers k as .*a row for each of the 3 simulations"),
    "signal's name": ("return seen.p, {'Big Name': seen.d[:, 0]}", "a signal called 'Big Name'"),
    "column's name": ("return seen.p, {'front_m': seen.d[:, 0]}", "front_m, which is a column of every run"),
    "complex": ("return seen.p * 1j", "gives u as an array of complex128; it must be numbers"),
    "signal's shape": (
        "return seen.p, {'x_m': np.zeros((len(seen.p), 3, 3))}",
        "gives x_m as an array of shape",
    ),
    "exits": ("raise SystemExit", "SystemExit"),
}


def test_no_signal_can_be_called_as_a_column_of_every_run_is(here):
    assert {column.name for column in (*COLUMNS, *END_COLUMNS)} | {"time_s"} == TAKEN
    Path("mine.py").write_text(TWICE)
    assert "a signal called a_m, which is there twice" in refused()


LIES = {
    "init": (
        "def __init__(self, **keys): raise KeyError('no')",
        r"cannot be made: .*mine.py, line 7: KeyError",
    ),
    "problems": ("def problems(self): raise KeyError('no')", r"mine.py, line 7: KeyError"),
    "start": ("def start(self, runs, initial): return None", r"starts with nothing .* arrays by name"),
    "starts with a number": (
        "def start(self, runs, initial): return {'a': 5.0}\n"
        "    def advance(self, memory, decision, step_s): return {'a': decision.u[:, 0]}",
        r"remembers a as 5.0; it must be an array with a row for each of the 3",
    ),
    "starts with one row": (
        "def start(self, runs, initial): return {'a': np.zeros(1)}\n"
        "    def advance(self, memory, decision, step_s): return {'a': decision.u[:, 0]}",
        r"remembers a as a ndarray; .* a row for each of the 3",
    ),
    "is equal to all": ("def __eq__(self, other): return 5", r"__eq__ is not for a law to say"),
    "has a hash": ("def __hash__(self): raise ValueError('no')", r"__hash__ is not for a law to say"),
    "advance": ("def advance(self, *given): return None", r"gives nothing .* as its memory"),
    "signals": ("signals = property(lambda self: ['a_m'])", r"has a list of 1 for its signals"),
    "a signal": (
        "signals = property(lambda self: ('a_m',))",
        r"for its signals; it must be a tuple of mjmerge.law.Signal",
    ),
    "label": ("label = property(lambda self: 5)", r"has 5 for its label; it must be text"),
    "guard": ("guard = property(lambda self: None)", r"for its guard; it must be text"),
    "unguarded": ("def unguarded(self): return 5", r"has 5 for its unguarded; it must be a law, or None"),
    "raises there": ("def unguarded(self): raise KeyError('no')", r"mine.py, line 7: KeyError"),
    "flow": ("def flow(self): return 5", r"has 5 for its flow"),
    "gives the truth": ("gives = ('front_m',)", r"gives 'front_m'; it can be any of target_m, "),
    "remembers a column": (
        "remembers = ('distance_m',)",
        r"remembers 'distance_m'; it can be any of opinion",
    ),
    "signals that are a number": ("signals = property(lambda self: 5)", r"has 5 for its signals"),
    "a signal's name": (
        "signals = property(lambda self: (Signal('a_m', ''), Signal(np.zeros(0), '')))",
        r"each with texts, and for its axes one of",
    ),
    "a signal's axes": (
        "signals = property(lambda self: (Signal('a_m', '', axes=(np.zeros(2),)),))",
        r"each with texts, and for its axes one of",
    ),
    "needs": ("needs = 5", r"needs 5; it must be extras by the name of a module"),
    "a need that is a key": ("needs: int = -1", r"needs can be no key of a law; call it otherwise"),
    "needs what is nowhere": ("needs = {'no.where': 'it'}", r"needs no.where: pip install 'mjmerge\[it\]'"),
    "what is not its own": (
        "j_1 = property(lambda self: 5)",
        r"j_1 is not for a law to say; call it otherwise",
    ),
    "what is pydantic's": ("def model_dump(self): return 5", r"model_dump is not for a law to say"),
    "a key of every law": ("r_m: float = -1.0", r"r_m is a key of every law; call it otherwise"),
    "a key of every law that means something else": (
        "r_m: __import__('mjmerge.config.frozen').config.frozen.Positive = 0.6\n    'Width of a hat, m.'",
        r"r_m is a key of every law",
    ),
    "a key that is a method": ("def r_m(self): return 5", r"r_m is a key of every law"),
    "made as another": (
        "def __new__(cls, *a, **k): return Law.__new__(type(cls.__name__, (cls,), {}))",
        r"another thing",
    ),
    "ends as a generator": ("def start(self, runs, initial): raise GeneratorExit", r"line 7: GeneratorExit"),
    "remembers not": ("remembers = ('opinion',)", r"says that it remembers opinion, and does not"),
}


@pytest.mark.parametrize(("member", "says"), LIES.values(), ids=LIES)
@pytest.mark.filterwarnings("ignore:Field name")  # pydantic's own word on a field of that name
def test_what_a_class_says_of_itself_is_asked_before_anything_runs(here, member, says):
    Path("mine.py").write_text(f"{CLASS}\n    {member}\n")
    with pytest.raises(MjmergeError, match=says):
        load("charge", [SHORT, OURS])


def test_no_signal_takes_the_place_of_a_hypothesis_that_is_asked_anyway(here):
    """A law that says that the start is safe is asked whether it is."""
    signals = "@property\n    def signals(self): return (Signal('safe_start', '', asks='yes'),)"
    text = CLASS.replace("Decision(seen.p)", "Decision(seen.p, {'safe_start': seen.p[:, 0] * 0 + 1})")
    Path("mine.py").write_text(f"{text}\n    {signals}\n")
    trace = simulate(load("charge", [SHORT, OURS]), "double_integrator")
    inside = replace(trace, distance_m=np.full_like(trace.distance_m, -1.0))
    assert broken(inside)["safe start"].any()


@pytest.mark.parametrize(("body", "says"), WRONG.values(), ids=WRONG)
def test_what_a_law_gets_wrong_is_said_with_its_line_before_anything_runs(here, body, says):
    if body:
        law(body)
    else:
        Path("mine.py").unlink()
    assert re.search(says, refused()), refused()


def test_a_missing_name_wrong_arguments_and_what_is_no_law_are_said(here):
    Path("mine.py").write_text("def mime(seen, memory, dt):\n    return seen.p\n")
    assert "has no 'mine': did you mean 'mime'" in refused()
    law("return seen.p", head="def mine(seen):")
    assert re.search(r"mine.py, line 3: mine must take three arguments, as in `def mine", refused())
    Path("mine.py").write_text("mine = 3\n")
    assert "is no law: a function law(seen, memory, dt), or a class" in refused()
    Path("mine.py").write_text("def mine(seen, memory, dt, *, r_m=1.0):\n    return seen.p\n")
    assert "r_m is a key of every law" in refused()
    Path("mine.py").write_text("def mine(:\n")
    assert re.search(r"mine.py, line 1: ", refused())


def test_the_command_line_ends_with_2_and_the_line_of_the_scenario(here, capsys):
    law("return seen.q", head="def mine(seen, memory, dt, *, r_rho_m):")
    queue()
    assert command("run", "waiting.yaml", "--out", "out") == 2
    said = capsys.readouterr().err
    where = r"waiting.yaml:\d+: law.kind: .*mine.py, line 4: AttributeError"
    assert re.search(where, said.replace("\n", " "))
    assert not Path("out").exists()


# and what goes wrong later stops that run alone


TIME = "memory['t'] = memory.get('t', np.zeros(len(seen.p))) + dt\n"
AT_HALF = TIME + "who = (seen.p[:, 1] > {y}) & (np.abs(memory['t'] - 0.51) < 0.004)\n"


@pytest.mark.parametrize(
    ("does", "says"),
    [
        ("assert not who.any(), 'too far'\n", r"mine.py, line 6: AssertionError: too far"),
        (
            "return np.where(who[:, None], np.nan, -seen.v)\n",
            r"gives a command that is not finite: \[nan, nan\]",
        ),
        ("if who.any(): return seen.p[:, 0]\n", r"gives a command of shape"),
    ],
)
def test_a_law_that_fails_in_mid_run_stops_that_run_and_leaves_the_others_alone(here, does, says):
    plant = "mujoco" if "assert" in does else "bicycle"
    law(AT_HALF.format(y=-9) + "return -seen.v")
    noisy = [SHORT, OURS, "mismatch.position_noise_m=0.05"]
    ends = simulate(load("charge", noisy), plant, runs=6).sensed_front_m[:, 50, 0, 1]
    y = np.sort(ends)[2:4].mean()
    law(AT_HALF.format(y=y) + does + "return -seen.v")
    trace = simulate(load("charge", noisy), plant, runs=6)
    failed = {stop.run: stop for stop in trace.stops}
    assert 0 < len(failed) < 6
    for stop in failed.values():
        assert stop.car == "ego"
        assert stop.time_s == pytest.approx(0.5)
        assert re.search(says, stop.reason), stop.reason
    for i in range(6):
        alone = simulate(load("charge", noisy), plant, seed=i)
        assert alone.front_m.tobytes() == trace.front_m[i : i + 1].tobytes()
        verdict = judge(trace)[i].verdict
        assert (verdict == "incomplete") == (i in failed)


def test_a_run_that_its_law_stopped_ends_with_3_and_is_recorded_as_far_as_it_went(here, capsys):
    law(TIME + "assert (memory['t'] < 0.3).all()\nreturn -seen.v")
    assert command("run", "charge", "--set", SHORT, "--set", OURS, "--plant", "bicycle", "--out", "out") == 3
    assert "AssertionError" in capsys.readouterr().out.replace("\n", " ")
    found = read(Path("out/run.mcap"))
    assert 0.2 < found.last_s < 0.31
    assert verify(Path("out/run.mcap")).verdict.verdict == "incomplete"


def test_continuous_time_takes_a_law_without_memory_and_refuses_a_function(here):
    nominal = load("charge", [SHORT, "law.kind=nominal"])
    assert len(simulate(nominal, "double_integrator", continuous=True).time_s) == 101
    with pytest.raises(MjmergeError, match=r"mine has no continuous time"):
        simulate(load("charge", [SHORT, OURS]), "double_integrator", continuous=True)


def test_a_recording_never_runs_the_law_that_it_names(here):
    run(load("charge", [SHORT, OURS]), "bicycle", folder=Path("out"))
    Path("mine.py").write_text("raise SystemExit('it ran')")
    scenario = read(Path("out/run.mcap")).scenario()
    assert not isinstance(scenario.law, OpinionDynamics)
    assert scenario.law.k_o == 1.0
    with pytest.raises(MjmergeError, match="not known without its code"):
        simulate(scenario, "bicycle")
