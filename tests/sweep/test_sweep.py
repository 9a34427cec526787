"""Sweeps: the same table however they were run, killed or spread, and every row again by its command."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mjmerge
from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.errors import OutputError
from mjmerge.simulation.trace import Stop
from mjmerge.sweep import campaign, laws, tally, workers
from mjmerge.sweep import report as sweep_report
from mjmerge.sweep.folder import SHARDS, TABLE, code_files, identity
from mjmerge.sweep.rows import EMPTY, FAILED, PASSED, rows
from mjmerge.sweep.shards import Shard, dealt, measure, shards
from mjmerge.sweep.sweep import sweep
from mjmerge.verdict.judge import judge
from tests.interfaces.test_rooms import ARROWS

CAMPAIGN = """\
description: Small, and in many shards.
blocks:
  - scenarios: [paper, flips]
    plants: [double_integrator]
    variants: [literal, gated]
    set: {duration_s: 1, control_step_s: 0.02}
    grid: {law.k_o: [0.5, 0.8, 1, 1.5], mismatch.neighbour_position_noise_m: [0, 0.01]}
    seeds: 2
"""


@pytest.fixture
def file(tmp_path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(CAMPAIGN)
    return path


def started(file: Path, out: Path, *more: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "mjmerge", "sweep", str(file), "--out", str(out), *more]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_shards(process: subprocess.Popen, out: Path, count: int) -> None:
    until = time.monotonic() + 120
    while len(list((out / SHARDS).glob("*.parquet"))) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.01)


def children(pid: int) -> list[int]:
    try:
        return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_the_table_does_not_depend_on_processes_or_on_who_runs_together(file, tmp_path):
    plan = campaign.plan(file)
    alone = sweep(plan, tmp_path / "a")
    assert alone["run"].to_pylist() == list(range(64))
    assert alone.equals(sweep(plan, tmp_path / "b", processes=2))
    assert alone.equals(sweep(plan, tmp_path / "c", together=1))
    assert alone.equals(pq.read_table(tmp_path / "a" / TABLE))
    assert set(alone["campaign"].to_pylist()) == {"small"}
    assert set(alone["law.k_o"].to_pylist()) == {0.5, 0.8, 1.0, 1.5}
    versions = json.loads(alone.schema.metadata[b"mjmerge"])["versions"]
    assert versions["mjmerge"]
    assert versions["mujoco"]


def test_killed_and_run_again_it_gives_the_table_of_an_undisturbed_run(file, tmp_path, long):
    for finished in (0, 3, 9) if long else (3,):
        _killed_and_run_again(file, tmp_path / str(finished), finished)


def _killed_and_run_again(file, tmp_path, finished):
    out = tmp_path / "killed"
    process = started(file, out, "--workers", "2")
    wait_for_shards(process, out, finished)
    workers = children(process.pid)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    kept = {p.name: p.stat().st_mtime_ns for p in (out / SHARDS).glob("*.parquet")}
    assert not (out / TABLE).exists()
    assert len(kept) >= finished
    until = time.monotonic() + 30
    while any(alive(pid) for pid in workers):  # they follow their parent
        assert time.monotonic() < until
        time.sleep(0.05)

    again = started(file, out, "--workers", "1")
    assert again.communicate(timeout=300)[1] == ""
    assert again.returncode == 0
    assert pq.read_table(out / TABLE).equals(sweep(campaign.plan(file), tmp_path / "undisturbed"))
    assert {name: (out / SHARDS / name).stat().st_mtime_ns for name in kept} == kept  # not run twice
    assert not list(out.rglob("*.partial"))


def test_interrupted_it_keeps_what_is_finished_and_says_how_to_go_on(file, tmp_path):
    process = started(file, tmp_path / "out", "--workers", "2")
    wait_for_shards(process, tmp_path / "out", 2)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "run it again to go on" in err
    assert "Traceback" not in err
    assert len(list((tmp_path / "out" / SHARDS).glob("*.parquet"))) >= 2


DISTURBED = """
import os, signal, sys
from multiprocessing import util
from mjmerge.cli import main
start = util.spawnv_passfds
def disturbed(path, args, kept_open):
    pid = start(path, args, kept_open)
    if any(sys.argv[2] in os.fsdecode(word) for word in args):
        os.kill(os.getpid(), int(sys.argv[1]))
    return pid
util.spawnv_passfds = disturbed
main(sys.argv[3:])
"""


@pytest.mark.parametrize("process", ["spawn_main", "resource_tracker"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_stopped_while_a_process_is_half_started_it_ends_without_a_traceback(file, tmp_path, process, number):
    args = ["sweep", str(file), "--workers", "2", "--out", str(tmp_path / "out")]
    ended = subprocess.run(
        [sys.executable, "-c", DISTURBED, str(int(number)), process, *args],
        capture_output=True,
        text=True,
        timeout=120,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    said = [line for line in ended.stderr.splitlines() if not line.startswith("mjmerge: interrupted")]
    assert not said, ended.stderr
    assert ended.returncode == 128 + number
    assert not (tmp_path / "out" / TABLE).exists()


def test_another_campaign_scenario_or_version_in_the_same_folder_is_refused(file, tmp_path, monkeypatch):
    scenario = tmp_path / "mine.yaml"
    scenario.write_text(
        "description: mine\n" + (campaign.shipped.folder("scenarios") / "paper.yaml").read_text()
        .replace("description:", "# ")
    )  # fmt: skip
    text = "blocks: [{scenarios: [mine.yaml], plants: [double_integrator], set: {duration_s: 0.2}}]"
    file.write_text(text)
    sweep(campaign.plan(file), tmp_path / "out")
    sweep(campaign.plan(file), tmp_path / "out")  # the same again is no problem
    scenario.write_text(scenario.read_text() + "\nroad: {lane_width_m: 1.3}\n")
    with pytest.raises(OutputError, match=r"another scenario.*choose another --out"):
        sweep(campaign.plan(file), tmp_path / "out")
    scenario.write_text(scenario.read_text().replace("\nroad: {lane_width_m: 1.3}\n", ""))
    file.write_text(text.replace("0.2", "0.3"))
    with pytest.raises(OutputError, match="another campaign"):
        sweep(campaign.plan(file), tmp_path / "out")
    file.write_text(text)
    other = {"versions": {"mujoco": "9.9"}}
    monkeypatch.setattr("mjmerge.sweep.folder.computing", lambda: other)
    with pytest.raises(OutputError, match=r"version of mujoco \(3.*now 9\.9\)"):
        sweep(campaign.plan(file), tmp_path / "out")


def test_a_folder_with_other_files_is_left_alone(file, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("years of work")
    with pytest.raises(SystemExit) as stop:
        main(["sweep", str(file), "--out", str(tmp_path / "out")])
    assert stop.value.code == 2
    assert "--out" in capsys.readouterr().err
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["thesis.tex"]


def test_an_unfinished_sweep_goes_on_whatever_changed_but_what_computes_its_rows():
    package = Path(mjmerge.__file__).parent
    names = {"mjmerge." + ".".join(p.relative_to(package).with_suffix("").parts) for p in code_files()}
    computes, ways = set(), ["mjmerge.sweep.shards", "mjmerge.sweep.table"]
    while ways:  # what these import, and so on
        if (module := ways.pop()) not in computes:
            computes.add(module)
            ways += ARROWS[module]
    told = {
        "mjmerge.errors",
        "mjmerge.versions",
        "mjmerge.sweep.losses",
        "mjmerge.notebook.html",
    }  # of no row
    assert computes - told <= {name.removesuffix(".__init__") for name in names}
    rooms = {name.split(".")[1] for name in names}
    assert rooms == {name.split(".")[1] for name in computes - told}
    assert {"cli", "figures", "record", "search"}.isdisjoint(rooms)


def test_versions_of_what_only_records_do_not_part_rows(file):
    of = identity(campaign.plan(file))
    assert {"python", "mujoco", "numpy", "scipy"} <= of["versions"].keys()
    assert {"rerun-sdk", "mcap", "foxglove-sdk"}.isdisjoint(of["versions"])


def test_a_mesh_below_a_car_s_folder_is_part_of_what_a_sweep_depends_on(tmp_path):
    folder = tmp_path / "own"
    shutil.copytree(shipped.models()["rc"], folder)
    (folder / "meshes").mkdir()
    mesh = folder / "meshes" / "body.obj"
    mesh.write_text("v 0 0 0")
    text = shipped.scenarios()["paper"].read_text().partition("\ngate:")[0]
    (tmp_path / "mine.yaml").write_text(text.replace("drivers:", "models: {ego: ./own}\n\ndrivers:"))
    (tmp_path / "mine_campaign.yaml").write_text(
        "description: d\nblocks:\n  - {scenarios: [./mine.yaml], plants: [mujoco], seeds: 1}\n"
    )
    before = identity(campaign.plan(tmp_path / "mine_campaign.yaml"))
    mesh.write_text("v 0 0 1")
    after = identity(campaign.plan(tmp_path / "mine_campaign.yaml"))
    assert {key for key in before if before[key] != after[key]} == {"car models"}


def test_a_damaged_shard_is_run_again(file, tmp_path):
    plan = campaign.plan(file)
    whole = sweep(plan, tmp_path / "out")
    shard = tmp_path / "out" / SHARDS / "000003.parquet"
    good = shard.read_bytes()
    flipped = bytearray(good)
    at = good.index(b"\x28\xb5\x2f\xfd", len(good) // 3) + 12  # within a page, which zstd would let pass
    flipped[at] ^= 1
    shards = tmp_path / "out" / SHARDS
    other = (shards / "000001.parquet").read_bytes()
    pq.write_table(pq.read_table(shard).drop_columns("verdict"), tmp_path / "lacking.parquet")
    swapped = pq.read_table(shard)
    seed = swapped.column_names.index("seed")
    pq.write_table(swapped.set_column(seed, "seed", [swapped["seed"].to_pylist()[::-1]]), tmp_path / "swap")
    damaged = (good[:100], b"", bytes(flipped), other, (tmp_path / "lacking.parquet").read_bytes())
    for content in (*damaged, (tmp_path / "swap").read_bytes()):
        shard.write_bytes(content)
        assert sweep(plan, tmp_path / "out").equals(whole)
        assert shard.read_bytes() == good


@pytest.mark.parametrize("content", [b"\xff\xfe", b"[" * 100_000, b"{}", b"3", b'{"versions": 3}', b""])
def test_a_plan_file_that_is_none_is_no_sweep_of_ours(file, tmp_path, content):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "plan.json").write_bytes(content)
    with pytest.raises(OutputError, match="choose another --out"):
        sweep(campaign.plan(file), tmp_path / "out")


@pytest.mark.parametrize("plant", ["double_integrator", "mujoco"])
def test_a_row_is_had_again_bit_for_bit_by_the_command_that_the_report_prints(tmp_path, capsys, plant):
    axes = {
        "mismatch.neighbour_position_noise_m": {"log_uniform": [0.001, 0.1]},
        "mismatch.command_delay_s": {"uniform": [0.0, 0.1]},
    }
    if plant == "mujoco":
        axes["mismatch.friction"] = {"uniform": [0.2, 1.0]}
    keys = {"duration_s": 0.6, "initial.ego.front_m": [-1.2, 1.3]}
    block = {"scenarios": ["charge"], "plants": [plant], "set": keys, "random": {"draws": 4, "axes": axes}}
    plan = campaign.plan({"blocks": [block]})
    table = sweep(plan, tmp_path / "out")
    sweep_report.write(plan, table, tmp_path / "out")
    report = (tmp_path / "out" / sweep_report.REPORT).read_text()
    commands = [line.strip() for line in report.splitlines() if line.startswith("      mjmerge run")]
    assert len(commands) == 4
    least = sorted(table.to_pylist(), key=lambda row: row["min_distance_m"])
    assert len({row["min_distance_m"] for row in least}) > 1
    for command, row in zip(commands, least, strict=True):
        with pytest.raises(SystemExit):
            main([*shlex.split(command)[1:], "--no-record", "--json"])
        found = json.loads(capsys.readouterr().out)
        assert found["min_distance_m"] == {"vehicle_1": row["min_d_1_m"], "vehicle_2": row["min_d_2_m"]}
        assert found["verdict"] == row["verdict"]


def test_the_command_prints_one_object_and_the_folder_holds_table_report_and_figures(file, tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["sweep", str(file), "--out", str(tmp_path / "out"), "--workers", "1", "--json"])
    out = capsys.readouterr().out
    found = json.loads(out)
    assert stop.value.code == 0
    assert out.count("\n") == 1
    assert found["runs"] == 64
    assert sum(found["outcomes"].values()) == 64
    assert found["worst"][0]["command"].startswith("mjmerge run ")
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names >= {"table.parquet", "report.md", "plan.json", "shards"}
    assert any(name.startswith("axes_") and name.endswith(".png") for name in names)


def test_laws_stand_beside_each_other_with_what_each_buys_and_pays(tmp_path):
    block = {
        "scenarios": ["charge"],
        "plants": ["double_integrator"],
        "variants": ["literal"],
        "laws": ["cbf_qp", "nominal"],
        "set": {"control_step_s": 0.02},
    }
    planned = campaign.plan({"blocks": [block]})
    found = sweep(planned, tmp_path / "out")
    literal, filtered, nominal = laws.standings(found.to_pylist())
    assert (literal.law, filtered.law, nominal.law) == ("literal", "cbf_qp", "nominal")
    assert [one.failed.count for one in (literal, filtered, nominal)] == [0, 0, 1]
    assert [one.merged for one in (literal, filtered, nominal)] == [0, 1, 1]
    assert (literal.own_broken, nominal.own_broken, filtered.own_broken) == (0, None, 1)
    assert nominal.worst_m < 0 < filtered.worst_m
    assert 0 < nominal.jerk_mps3 < filtered.jerk_mps3
    sweep_report.write(planned, found, tmp_path / "out")
    text = (tmp_path / "out" / "report.md").read_text()
    assert "## Laws" in text
    assert "- **nominal** keeps its floor in 0 of the 1 runs that put it to the test, with -0.1" in text
    assert len(laws.summary(found.to_pylist())) == 3


def test_the_report_says_first_what_is_set_in_all_runs_of_a_block_as_far_as_it_acts_there(tmp_path):
    def swept(*blocks):
        shared = {"plants": ["double_integrator"]}
        planned = campaign.plan({"blocks": [shared | block for block in blocks]})
        return planned, sweep(planned, tmp_path / str(len(blocks)))

    def said(*swept):
        return [note for note in tally.notes(*swept) if note.startswith("set")]

    short = {"control_step_s": 0.02, "duration_s": 0.1}
    grid = {"duration_s": [0.08, 0.12], "mismatch.sensing_delay_s": [0, 0.02]}
    one = {"scenarios": ["paper", "charge"], "set": short}
    other = {"scenarios": ["charge"], "set": short | {"mismatch.command_delay_s": 0.02}, "grid": grid}
    unset = {"scenarios": ["charge"], "mismatches": {"short": {"duration_s": 0.1}}}
    unknown = short | {"mismatch.leader_acceleration": "unknown"}  # nobody listens without u_1
    idle = {"scenarios": ["charge"], "set": unknown, "variants": ["literal", "no_u1"]}
    assert said(*swept(one, other, unset)) == [
        "set in 2 of 7 runs: control_step_s=0.02, duration_s=0.1",
        "set in 4 of 7 runs (charge): control_step_s=0.02, mismatch.command_delay_s=0.02",
    ]
    assert said(*swept(idle, unset)) == [
        "set in 1 of 3 runs (literal): control_step_s=0.02, duration_s=0.1, "
        "mismatch.leader_acceleration=unknown",
        "set in 1 of 3 runs (no_u1): control_step_s=0.02, duration_s=0.1",
    ]
    alone = swept(one)
    sweep_report.write(*alone, tmp_path)
    before = (tmp_path / "report.md").read_text().partition("## Failures")[0]
    assert said(*alone) == ["set: control_step_s=0.02, duration_s=0.1"]
    assert "\n- set: control_step_s=0.02, duration_s=0.1\n" in before


def test_a_run_without_data_or_that_stopped_has_failed_and_a_vacuous_one_counts_neither_way(make_trace):
    """Four runs: safe because of the barrier, safe without it, stopped while safe, without any data."""
    d, rate, u_c = np.full((4, 40, 2), 1.0), np.zeros((4, 40, 2)), np.zeros((4, 40, 2))
    d[0, 20:, 0], rate[0, 20, 0], u_c[0, 20, 0] = 0.3, -1.0, 1.0
    front = np.zeros((4, 40, 3, 2))
    front[:, :, 0, 0], front[:, :, 2, 0] = 1.6, 3.2
    d[2, 20:] = np.nan
    d[3] = np.nan
    trace = make_trace(
        runs=4,
        distance_m=d,
        distance_rate_mps=rate,
        sensed_distance_m=d,
        front_m=front,
        u_c_mps2=u_c,
        stops=[Stop(2, 0.2, "ego", "off"), Stop(3, 0.0, "ego", "off")],
    )
    found = rows(trace, judge(trace, np.array([[0.1, 1.0], *[[1.0, 1.0]] * 3])))
    assert [row["outcome"] for row in found] == [PASSED, EMPTY, FAILED, FAILED]
    assert [row["min_distance_m"] for row in found] == [0.3, 1.0, 1.0, None]
    rate = tally.failure_rate(found)
    assert (rate.count, rate.of) == (2, 3)
    assert tally.worst(found)[0] is found[3]


def test_a_laws_own_hypotheses_are_those_of_its_signals_and_those_that_are_asked_of_it_alone():
    def broken_s(plant, *keys):
        trace = mjmerge.simulate(mjmerge.load("charge", ["duration_s=3", *keys]), plant)
        (row,) = rows(trace, judge(trace))
        return row["own_broken_s"]

    assert broken_s("bicycle") == 0
    assert broken_s("bicycle", "mismatch.command_delay_s=0.17") > 0  # its loop does not stand that
    assert broken_s("double_integrator", "duration_s=6", "law.kind=cbf_qp") > 0  # somebody charges
    assert broken_s("double_integrator", "law.kind=nominal") is None


def test_shards_are_of_much_the_same_size_and_bounded_in_ticks(file):
    block = {"scenarios": ["paper"], "plants": ["double_integrator"], "seeds": 70}
    assert [len(s.at) for s in shards(campaign.plan({"blocks": [block]}))] == [35, 35]
    long = block | {"set": {"duration_s": 1000}}
    assert max(len(s.at) for s in shards(campaign.plan({"blocks": [long]}))) * 100_001 <= 300_000


@given(
    st.lists(st.integers(1, 9), min_size=1, max_size=4),
    st.integers(1, 5),
    st.sampled_from([10, 10_000, 200_000]),
)
def test_two_shards_of_a_batch_are_simulated_at_once_unless_somebody_would_wait_for_it(sizes, workers, ticks):
    batches = [SimpleNamespace(scenario=SimpleNamespace(ticks=ticks)) for _ in sizes]
    every = [
        Shard(number, (number,), (SimpleNamespace(batch=batch),))
        for number, batch in enumerate(
            batch for batch, n in zip(batches, sizes, strict=True) for _ in range(n)
        )
    ]
    made = dealt(every, workers)
    assert sorted(shard.number for some in made for shard in some) == [shard.number for shard in every]
    assert all(len({id(shard.cases[0].batch) for shard in some}) == 1 for some in made)
    assert all(len(some) * ticks <= 300_000 or len(some) == 1 for some in made)
    assert max(map(len, made)) <= 2
    if len(sizes) == 1:
        assert longest(made, workers) == -(-sizes[0] // workers)
        if ticks == 10:  # as few as that leaves
            assert len(made) == sizes[0] - max(0, sizes[0] - -(-sizes[0] // (2 * workers)) * workers)
    else:
        assert longest(made, workers) <= longest([(shard,) for shard in every], workers) + 1


def longest(made, workers: int) -> int:
    """Shards that whoever does most has to do, where who is free takes the next."""
    busy = [0] * workers
    for some in made:
        busy[busy.index(min(busy))] += len(some)
    return max(busy)


def test_rows_are_the_same_bits_whether_shards_are_simulated_alone_or_two_at_once(
    file, tmp_path, monkeypatch
):
    plan = campaign.plan({"blocks": [{"scenarios": ["charge"], "set": {"duration_s": 0.2}, "seeds": 6}]})
    together = []
    monkeypatch.setattr(
        workers, "measure", lambda cases, *more: together.append(len(cases)) or measure(cases, *more)
    )
    two = sweep(plan, tmp_path / "two", together=2)
    monkeypatch.setattr(workers, "dealt", lambda some, _: [(shard,) for shard in some])
    alone = sweep(plan, tmp_path / "alone", together=2)
    assert together == [4, 2, 2, 2, 2]
    assert two.equals(alone)
    written = [sorted((tmp_path / name / SHARDS).iterdir()) for name in ("two", "alone")]
    assert [f.read_bytes() for f in written[0]] == [f.read_bytes() for f in written[1]]
    assert len(written[0]) == 3
