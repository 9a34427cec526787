"""What is installed is what is in the checkout: models, scenarios, and a fast command line."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import mjmerge

ROOT = Path(__file__).parents[2]


def test_the_wheel_brings_models_and_scenarios_and_runs_anywhere(tmp_path):
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, timeout=120)
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    assert (tmp_path / "site" / "mjmerge" / "py.typed").is_file()
    code = (
        "import mjmerge, mjmerge.config.shipped as s; assert 'site' in mjmerge.__file__; "
        "t = mjmerge.simulate(mjmerge.load('paper', ['duration_s=0.1']), 'mujoco'); "
        "print(len(s.scenarios()), len(s.models()), t.distance_m.shape)"
    )
    env = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stdout.split(" ", 2)[:1] == [str(len(list((ROOT / "scenarios").glob("*.yaml"))))], done.stderr
    assert "(1, 11, 2)" in done.stdout


def test_constraints_pin_every_dependency_and_name_no_host():
    text = (ROOT / "constraints.txt").read_text()
    pinned = {line.split("==")[0].lower().replace("_", "-") for line in text.splitlines() if "==" in line}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [d for extra in project["optional-dependencies"].values() for d in extra]
    wanted = project["dependencies"] + [d for d in extras if not d.startswith("mjmerge[")]
    names = {d.split(">")[0].split("=")[0].split("<")[0].strip().lower().replace("_", "-") for d in wanted}
    assert names <= pinned
    assert "://" not in text
    assert mjmerge.__all__
