"""What is installed is what is in the checkout: models, scenarios, and a fast command line."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import mjmerge

ROOT = Path(__file__).parents[2]


BARE = {"PATH": "/nonexistent", "HOME": "/nonexistent"}
"""All that there is of an environment: no git, no compiler, no display, no home."""


def test_the_wheel_of_the_source_distribution_brings_models_and_scenarios_and_runs_anywhere(tmp_path):
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, timeout=120)
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    assert (tmp_path / "site" / "mjmerge" / "py.typed").is_file()
    code = (
        "import mjmerge, mjmerge.config.shipped as s; assert 'site' in mjmerge.__file__; "
        "from mjmerge.cli import main; print(len(s.scenarios()), len(s.models()), flush=True); "
        "main(['run', 'paper', '--duration', '0.1', '--out', 'there'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**BARE, "PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    cars = len(list((ROOT / "models").glob("*/datasheet.yaml")))
    assert done.stdout.startswith(f"{len(list((ROOT / 'scenarios').glob('*.yaml')))} {cars}\npaper on mujoco")
    assert {path.name for path in (tmp_path / "there").iterdir()} >= {"run.rrd", "run.mcap", "figure.png"}


def test_the_image_gets_what_the_wheel_is_made_of():
    let_in = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {*wheel["packages"], *wheel["force-include"], project["project"]["readme"], "pyproject.toml"}
    assert {*needed, *project["project"]["license-files"], "constraints.txt"} == let_in
    extras = re.search(r"/src\[([\w,]+)\]", (ROOT / "Dockerfile").read_text())[1].split(",")
    assert {*extras} <= {*project["project"]["optional-dependencies"]}


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
