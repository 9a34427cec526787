"""A new axis of mismatch needs its declaration and where it acts, and nothing else: tried on a copy."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DECLARED = '''\
    gravity: Annotated[
        Ratio,
        _road(
            changes="the weight of everything",
            rc=three(0.99, 0.9, 0.8),
            full=three(0.98, 0.9, 0.8),
            source="other planets",
        ),
    ] = 1.0
    """Gravity over that of the earth, 1."""
'''
ACTS = "    model.opt.gravity[:] *= m.gravity\n"
ROW = (
    "| `gravity` | 1 | 0.1 to 10 | 1 | the weight of everything | 0.99, 0.9, 0.8 | 0.98, 0.9, 0.8 "
    "| other planets |\n"
)
WRITES = (
    "tests/scenario/test_axes.py",
    "tests/scenario/test_load.py::test_the_committed_schema_is_the_current_one",
)
QUICK = (
    *WRITES,
    "tests/simulation/test_mismatch.py::test_the_mixes_leave_no_axis_out",
    "tests/interfaces/test_company.py::test_what_is_drawn_below_leaves_no_axis_out",
    "tests/scenario/test_effect.py::test_the_documentation_says_where_every_key_acts",
    "tests/scenario/test_effect.py::test_an_axis_changes_the_motion_exactly_where_it_says[gravity]",
    "tests/scenario/test_effect.py::test_levels_leave_out_the_axes_that_a_plant_has_not_and_say_which",
)
LONG = (
    "tests/scenario/test_axes.py", "tests/scenario/test_effect.py", "tests/scenario/test_load.py",
    "tests/simulation/test_mismatch.py", "tests/physics/test_mismatch.py",
    "tests/interfaces/test_company.py", "tests/search/test_breaking.py", "tests/sweep/test_campaign.py",
    "tests/verdict/test_verdicts_at_scale.py",
)  # fmt: skip


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """All of the repository that an axis could be in, with one more: two places of two files are other."""
    there = tmp_path_factory.mktemp("copy")
    for name in ("mjmerge", "tests", "scenarios", "models"):
        shutil.copytree(ROOT / name, there / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "docs", there / "docs", ignore=shutil.ignore_patterns("*.png", "*.pdf"))
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, there / name)
    insert(there / "mjmerge/scenario/mismatch.py", DECLARED, before="\n    # the air\n")
    insert(there / "mjmerge/plant/truth.py", ACTS, before="    _limit(world, model, m)\n")
    done = python(there, "pytest", "--write", *WRITES)
    assert done.returncode == 0, done.stdout
    return there


def insert(path: Path, text: str, before: str) -> None:
    head, mark, tail = path.read_text(encoding="utf-8").partition(before)
    assert tail
    path.write_text(head + text + mark + tail, encoding="utf-8")


def python(there: Path, module: str, *args: str) -> subprocess.CompletedProcess[str]:
    plain = ["-q", "-p", "no:cacheprovider"] if module == "pytest" else []
    environment = os.environ | {"PYTHONPATH": str(there)}
    command = [sys.executable, "-m", module, *plain, *args]
    return subprocess.run(
        command, cwd=there, env=environment, capture_output=True, text=True, timeout=3600, check=False
    )


def test_all_that_speaks_of_axes_has_it(copy):
    assert ROW in (copy / "docs/mismatch.md").read_text(encoding="utf-8")
    schema = json.loads((copy / "scenarios/schema.json").read_text(encoding="utf-8"))
    assert schema["$defs"]["Mismatch"]["properties"]["gravity"] == {
        "default": 1.0,
        "description": "Gravity over that of the earth, 1.",
        "maximum": 10,
        "minimum": 0.1,
        "title": "Gravity",
        "type": "number",
    }
    listed = json.loads(python(copy, "mjmerge", "list", "axes", "--json").stdout)["axes"]["gravity"]
    assert listed["levels"]["full"]["severe"] == {"gravity": 0.8}
    assert (listed["part"], listed["plants"]) == ("the road", ["mujoco"])
    short = ["--duration", "0.1", "--no-record", "--json"]
    vain = python(
        copy, "mjmerge", "run", "charge", "--plant", "bicycle", "--set", "mismatch.gravity=0.9", *short
    )
    assert vain.returncode == 2
    assert "mismatch.gravity: acts on mujoco only, not on bicycle" in vain.stderr
    wrong = python(copy, "mjmerge", "run", "charge", "--set", "mismatch.gravty=0.9", *short)
    assert "did you mean 'gravity'?" in wrong.stderr
    assert python(copy, "mjmerge", "run", "charge", "--set", "mismatch.gravity=0.9", *short).returncode == 0


def test_all_tests_of_axes_hold_with_it(copy, long):
    done = python(copy, "pytest", *(LONG if long else QUICK))
    assert done.returncode == 0, done.stdout
