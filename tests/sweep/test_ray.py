"""On a Ray cluster of two nodes, with losses: the rows of one process. Only with ``--long``, where Ray is."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from ray.cluster_utils import Cluster

from mjmerge.sweep import campaign
from mjmerge.sweep.folder import TABLE
from mjmerge.sweep.ray import cluster
from mjmerge.sweep.sweep import sweep
from mjmerge.sweep.workers import at_work

pytestmark = pytest.mark.filterwarnings("ignore")

BLOCK = {
    "scenarios": ["charge"],
    "plants": ["mujoco"],
    "set": {"duration_s": 3},
    "grid": {"law.k_o": [0.5, 0.6, 0.7, 0.8, 0.9, 1, 1.1, 1.2], "mismatch.friction": [0.5, 0.9]},
    "seeds": 2,
}


def busy() -> list[int]:
    """Workers of Ray that are at a task."""
    return [
        int(path.parent.name)
        for path in Path("/proc").glob("[0-9]*/cmdline")
        if path.exists() and path.read_bytes().startswith(b"ray::_do")
    ]


def test_a_worker_killed_and_a_node_removed_in_mid_sweep_change_no_byte(tmp_path):
    plan = campaign.plan({"blocks": [BLOCK]})
    nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
    other = nodes.add_node(num_cpus=2)
    todo = ["kill", "remove"]

    def disturb(done: float, before: int) -> None:
        del before
        if todo and done >= {"kill": 4, "remove": 8}[todo[0]] and busy():
            match todo.pop(0):
                case "kill":
                    os.kill(busy()[0], signal.SIGKILL)
                case "remove":
                    nodes.remove_node(other, allow_graceful=False)

    try:
        with at_work(cluster(nodes.address, 0, 1)) as team:
            assert team.count == 4
            sweep(plan, tmp_path / "ray", team=team, together=2, progress=disturb)
    finally:
        nodes.shutdown()
    assert not todo
    assert team.losses >= 2
    print(f"{team.losses} tasks were lost")
    sweep(plan, tmp_path / "one", together=2)
    assert (tmp_path / "ray" / TABLE).read_bytes() == (tmp_path / "one" / TABLE).read_bytes()


def test_standard_output_is_one_object_and_a_law_of_ones_own_travels_along(tmp_path):
    (tmp_path / "mine.py").write_text(
        "def still(seen, memory, dt, *, guarded=True):\n    return 0 * seen.p\n"
    )
    block = BLOCK | {"laws": [{"kind": "mine.py:still"}], "plants": ["bicycle"], "seeds": 1}
    block["grid"] = {"mismatch.command_delay_s": [0, 0.1]}
    (tmp_path / "c.yaml").write_text(json.dumps({"blocks": [block]}))
    words = [sys.executable, "-m", "mjmerge", "sweep", "c.yaml", "--json", "--out"]
    more = ["--engine", "ray", "--workers", "2"]
    found = subprocess.run([*words, "ray", *more], cwd=tmp_path, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert json.loads(found.stdout)["runs"] == 2
    subprocess.run([*words, "one", "--workers", "1"], cwd=tmp_path, check=True, capture_output=True)
    assert (tmp_path / "ray" / TABLE).read_bytes() == (tmp_path / "one" / TABLE).read_bytes()
