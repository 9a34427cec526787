"""On a Ray cluster, with losses and stops: the bits of one process. Only with ``--long``, where Ray is."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import TypeVar

import pytest
from ray.cluster_utils import Cluster

from mjmerge.errors import MjmergeError
from mjmerge.search.kept import SAMPLED
from mjmerge.sweep import campaign, ray
from mjmerge.sweep.folder import SHARDS, TABLE
from mjmerge.sweep.sweep import sweep

pytestmark = pytest.mark.filterwarnings("ignore")

Seen = TypeVar("Seen")
BLOCK = {
    "scenarios": ["charge"],
    "plants": ["mujoco"],
    "set": {"duration_s": 3},
    "grid": {"law.k_o": [0.5, 0.6, 0.7, 0.8, 0.9, 1, 1.1, 1.2], "mismatch.friction": [0.5, 0.9]},
    "seeds": 2,
}
SWEEP = ["sweep", "c.yaml"]
LATE = (
    "search={axes: {mismatch.command_delay_s: {uniform: [0.0, 0.3]}}, neighbours: {vehicle_2: {changes: 1, "
    "acceleration_mps2: 7.5, gap_m: [1.7, 3.6]}}}"
)
SEARCHES = {
    "subset": "probability charge --plant bicycle --budget 370 --below 0.3",
    "montecarlo": "probability charge --plant bicycle --budget 300 --below 0.3 --method montecarlo",
    "falsify": "falsify charge --plant bicycle --budget 64 --seed 1 --findings 1 --no-record",
    "harden": "harden charge --plant bicycle --budget 32 --tries 3 --rounds 1 --fresh 1 "
    "--key law.k_o=0.5:4 --key actuation.inverse=measured,commanded",
}
KEYS = ["--set", "duration_s=8", "--set", "control_step_s=0.05", "--set", LATE]


@pytest.fixture(scope="module")
def nodes() -> Iterator[Cluster]:
    """A cluster with one node of two processors."""
    found = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
    yield found
    found.shutdown()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> bytes:
    """The table of the campaign."""
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "c.yaml").write_text(json.dumps({"blocks": [BLOCK]}))
    sweep(campaign.plan(folder / "c.yaml"), folder / "out")
    return (folder / "out" / TABLE).read_bytes()


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    (tmp_path / "c.yaml").write_text(json.dumps({"blocks": [BLOCK]}))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def command(words: list[str], out: str, *more: str) -> subprocess.Popen:
    """A command of its own session, which says its object to ``<out>.json``, and else to ``<out>.txt``."""

    def listens() -> None:  # what starts in the background ignores it
        signal.signal(signal.SIGINT, signal.default_int_handler)

    with Path(f"{out}.json").open("w") as said, Path(f"{out}.txt").open("w") as told:
        return subprocess.Popen(
            [sys.executable, "-m", "mjmerge", *words, "--json", "--out", out, *more],
            stdout=said,
            stderr=told,
            preexec_fn=listens,
            start_new_session=True,
        )


def on(cluster: Cluster) -> tuple[str, ...]:
    return ("--engine", "ray", "--address", cluster.address)


def said(out: str) -> dict:
    return {**json.loads(Path(f"{out}.json").read_text().replace(f"{out}/", "out/")), "out": None}


def kept(out: str) -> dict[str, bytes]:
    """Every file of a search; margins as one list, however they came."""
    folder = Path(out)
    found = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    found[SAMPLED] = found.get(SAMPLED, b"").replace(b"]\n[", b", ")
    own = [(f"{out}/".encode(), b"out/"), (f'"out": "{out}"'.encode(), b'"out": "out"')]
    for name, (mine, any_) in product(found, own):
        found[name] = found[name].replace(mine, any_)
    return found


def processes() -> Iterator[tuple[int, int, int, str]]:
    """Number, parent, session and command of each process there is."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent, _, session, *_ = stat.read_text().rpartition(")")[2].split()
            if state != "Z":
                words = (stat.parent / "cmdline").read_text(errors="replace").replace("\0", " ")
                yield int(stat.parent.name), int(parent), int(session), words
        except OSError:
            continue


def busy(node) -> list[int]:
    """Workers of a node that are at a task."""
    raylet = node.all_processes["raylet"][0].process.pid
    return [
        pid for pid, parent, _, words in processes() if parent == raylet and words.startswith("ray::_task")
    ]


def wait_until(there: Callable[[], Seen], within_s: float = 120.0) -> Seen:
    """What there is, as soon as there is something."""
    until = time.monotonic() + within_s
    while not (found := there()):
        assert time.monotonic() < until
        time.sleep(0.01)
    return found


def meddled_with(process: subprocess.Popen, nodes: Cluster) -> None:
    """Kills a worker of the first node, then takes the other away, each in mid-work."""
    os.kill(wait_until(lambda: busy(nodes.head_node))[0], signal.SIGKILL)
    other = nodes.list_all_nodes()[-1]
    wait_until(lambda: busy(other))
    nodes.remove_node(other, allow_graceful=False)
    assert process.poll() is None


def lost(out: str) -> int:
    """How often work was lost, as the command says."""
    (line,) = [line for line in Path(f"{out}.txt").read_text().splitlines() if "work was lost" in line]
    return int(line.split()[7])


def test_a_worker_killed_and_a_node_removed_in_mid_sweep_change_no_byte(nodes, place, undisturbed):
    nodes.add_node(num_cpus=2)
    process = command(SWEEP, "ray", *on(nodes))
    meddled_with(process, nodes)
    assert process.wait(300) == 0
    assert lost("ray") >= 2
    assert said("ray")["runs"] == 32
    assert Path("ray", TABLE).read_bytes() == undisturbed


def test_a_node_that_has_just_left_is_not_waited_for_and_no_error(nodes, place, undisturbed):
    other = nodes.add_node(num_cpus=2)
    nodes.wait_for_nodes()
    nodes.remove_node(other, allow_graceful=False)  # the cluster notices in some seconds
    assert command(SWEEP, "ray", *on(nodes)).wait(300) == 0, Path("ray.txt").read_text()
    assert Path("ray", TABLE).read_bytes() == undisturbed


@pytest.mark.parametrize("name", SEARCHES)
def test_so_do_searches_and_estimates_whoever_does_the_work(name, nodes, place):
    words = [*SEARCHES[name].split(), *KEYS]
    nodes.add_node(num_cpus=2)
    process = command(words, "ray", *on(nodes))
    meddled_with(process, nodes)
    codes = {process.wait(300)}
    assert lost("ray") >= 1  # their tasks are short: the node's may have been done
    for out, workers in (("one", "1"), ("processes", "2")):
        codes.add(command(words, out, "--workers", workers).wait(300))
        assert said(out) == said("ray")
        assert kept(out) == kept("ray")
    assert len(codes) == 1


DEADLY = """
import os, pathlib, signal
def in_ray():
    return pathlib.Path("/proc/self/cmdline").read_bytes().startswith(b"ray::_task")
def deadly_m(trace):
    "Kills its worker with seed 1, m."
    if in_ray() and 1 in trace.seeds:
        os.kill(os.getpid(), signal.SIGKILL)
    return trace.distance_m[:, 0, 0]
def law(seen, memory, dt, *, guarded=True):
    if in_ray():
        os.kill(os.getpid(), signal.SIGKILL)
    return 0 * seen.p
"""


def test_what_kills_every_worker_is_named_and_a_sweep_has_all_other_rows(nodes, place):
    Path("mine.py").write_text(DEADLY)
    keys = {"duration_s": 0.2, "metrics": ["mine.py:deadly_m"]}
    block = BLOCK | {"plants": ["double_integrator"], "set": keys, "grid": {}}
    Path("c.yaml").write_text(json.dumps({"blocks": [block]}))
    assert command(SWEEP, "ray", *on(nodes)).wait(300) == 3
    found = said("ray")
    assert (found["runs"], [one["run"] for one in found["lost"]]) == (1, [1])
    assert command(SWEEP, "ray", "--workers", "2").wait(300) == 0  # elsewhere they do not kill
    words = ["falsify", "charge", "--plant", "bicycle", "--budget", "2", "--set", "duration_s=1"]
    words += ["--set", "law={kind: 'mine.py:law'}"]
    assert command(words, "search", *on(nodes)).wait(300) == 3
    assert Path("search.json").read_text() == ""
    assert "a run kills the worker that is at it, 4 times of 4" in Path("search.txt").read_text()
    assert "charge with seed " in Path("search.txt").read_text()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
@pytest.mark.parametrize("where", ["here", "there"])
def test_stopped_in_mid_sweep_nothing_stays_and_it_goes_on_to_the_same_bytes(
    where, number, nodes, place, undisturbed, monkeypatch
):
    (place / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(place / "tmp"))
    monkeypatch.setenv("RAY_TMPDIR", "/tmp")  # its sockets have no room there
    more = on(nodes) if where == "there" else ("--engine", "ray", "--workers", "2")
    process = command(SWEEP, "out", *more)
    shards = Path("out", SHARDS)
    wait_until(lambda: len([*shards.glob("*.parquet")]) >= 2 or process.poll() is not None)
    process.send_signal(number)
    ends = {signal.SIGTERM: 143, signal.SIGINT: 130, signal.SIGKILL: -9}
    assert process.wait(60) == ends[number], Path("out.txt").read_text()
    kept = "mjmerge: interrupted; what is finished is kept; run it again to go on\n"
    assert Path("out.txt").read_text() == (kept if number == signal.SIGINT else "")
    assert Path("out.json").read_text() == ""
    assert not Path("out", TABLE).exists()
    if number != signal.SIGKILL:
        assert not [*Path("tmp").iterdir()]
    # of one that is killed, Ray's agents take a minute to notice
    wait_until(lambda: not [p for p in processes() if p[2] == process.pid], 150)
    wait_until(lambda: not busy(nodes.head_node), 30)
    done = {path.name: path.stat().st_mtime_ns for path in shards.glob("*.parquet")}
    assert 2 <= len(done) < 8
    assert command(SWEEP, "out", *more).wait(300) == 0
    assert Path("out", TABLE).read_bytes() == undisturbed
    assert {name: (shards / name).stat().st_mtime_ns for name in done} == done
    assert not [*Path("out").rglob("*.partial")]


def test_stopped_while_the_cluster_starts_it_waits_for_that_and_nothing_stays(place, monkeypatch):
    (place / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(place / "tmp"))
    monkeypatch.setenv("RAY_TMPDIR", "/tmp")  # its sockets have no room there
    process = command(SWEEP, "out", "--engine", "ray", "--workers", "2")
    wait_until(lambda: [p for p in processes() if p[2] == process.pid and "gcs_server" in p[3]], 30)
    process.terminate()
    assert process.wait(60) == 143
    assert Path("out.txt").read_text() == ""
    wait_until(lambda: not [p for p in processes() if p[2] == process.pid], 20)
    assert not [*Path("tmp").iterdir()]


def test_a_law_of_ones_own_travels_along_and_standard_output_is_one_object(place, monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")  # of another cluster, which nobody asked for
    Path("mine.py").write_text("def still(seen, memory, dt, *, guarded=True):\n    return 0 * seen.p\n")
    block = BLOCK | {"laws": [{"kind": "mine.py:still"}], "plants": ["bicycle"], "seeds": 1}
    block["grid"] = {"mismatch.command_delay_s": [0, 0.1]}
    Path("c.yaml").write_text(json.dumps({"blocks": [block]}))
    assert command(SWEEP, "ray", "--engine", "ray", "--workers", "2").wait(300) == 0
    assert said("ray")["runs"] == 2
    assert Path("ray.json").read_text().count("\n") == 1
    assert command(SWEEP, "one", "--workers", "1").wait(300) == 0
    assert Path("ray", TABLE).read_bytes() == Path("one", TABLE).read_bytes()


def test_a_node_that_computes_with_something_else_is_refused_before_anything_runs(nodes, monkeypatch):
    here = ray.computing()
    other = here | {"mjmerge's code": "edited", "versions": here["versions"] | {"numpy": "1.0"}}
    monkeypatch.setattr(ray, "computing", lambda: other)
    with pytest.raises(MjmergeError, match=r"would compute other rows: numpy .* another mjmerge's code"):
        ray.cluster(nodes.address, 0, 1)


@pytest.mark.parametrize("where", ["here", "there"])
def test_a_task_that_no_node_has_room_for_is_refused(where, nodes, place):
    more = on(nodes) if where == "there" else ("--engine", "ray")
    assert command(SWEEP, "out", *more, "--cpus", "64").wait(60) == 2
    assert "--cpus is 64; the largest node has " in Path("out.txt").read_text()
    assert not Path("out").exists()


def test_where_no_cluster_is_it_says_so_in_a_line(place):
    assert command(SWEEP, "out", "--engine", "ray", "--address", "127.0.0.1:1").wait(30) == 2
    (line,) = Path("out.txt").read_text().splitlines()
    assert line.startswith("mjmerge: no cluster at 127.0.0.1:1: ")
    assert Path("out.json").read_text() == ""
