"""The tables of the README are what comes of their runs."""

import json
import re
from pathlib import Path

import pytest

from mjmerge.cli import main

TEXT = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
CHARGE = {
    "`double_integrator` (the proof)": ["--plant", "double_integrator"],
    "`bicycle`": ["--plant", "bicycle"],
    "`mujoco`, tyres that do not slip": ["--set", "mismatch.tyres=ideal"],
    "`mujoco`, tyres with a cornering stiffness": [],
    "friction 0.6": ["--set", "mismatch.friction=0.6"],
    "friction 0.2": ["--set", "mismatch.friction=0.2"],
    "command delay 0.1 s": ["--set", "mismatch.command_delay_s=0.1"],
    "command delay 0.2 s": ["--set", "mismatch.command_delay_s=0.2"],
}
"""The rows of the table of ``charge``, and how each is run."""


def table(head):
    """Rows of the table that begins so, each a list of cells."""
    lines = TEXT[TEXT.index(head) :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def run(capsys, *arguments):
    with pytest.raises(SystemExit):
        main(["run", *arguments, "--no-record", "--json"])
    return json.loads(capsys.readouterr().out)


def same(cell, value, digits):
    assert cell == f"{value:.{digits}f} m"


def says(cell, found):
    """The verdict of a row: its word, whether beyond the hypotheses, the floor, and what it quotes."""
    assert cell.startswith(found["verdict"])
    assert ("below the floor" in cell) == (found["verdict"] == "held" and not found["floor_held"])
    assert ("beyond its hypotheses" in cell) == ("beyond its hypotheses" in found["reason"])
    for quoted in re.findall(r"the ego hits [^,|]+|after '[^']+' broke", cell):
        assert quoted.strip() in found["reason"]


CHARGE_ROWS = table("| `charge` | min d_1")
LARGE_ROWS = table("| `mujoco`, 25 m/s |")


def test_every_row_of_charge_is_known():
    assert [row[0] for row in CHARGE_ROWS] == list(CHARGE)


@pytest.mark.parametrize("row", CHARGE_ROWS, ids=lambda row: row[0])
def test_a_row_of_charge_is_what_comes_of_its_run(row, capsys):
    name, d_1, d_2, verdict = row
    found = run(capsys, "charge", *CHARGE[name])
    same(d_1, found["min_distance_m"]["vehicle_1"], 3)
    same(d_2, found["min_distance_m"]["vehicle_2"], 3)
    says(verdict, found)


@pytest.mark.parametrize("row", LARGE_ROWS, ids=lambda row: row[0])
def test_a_row_at_full_size_is_what_comes_of_its_run(row, capsys):
    name, _, _, d_1, d_2, clearance, _, verdict = row
    found = run(capsys, name.strip("`"))
    same(d_1, found["min_distance_m"]["vehicle_1"], 2)
    same(d_2, found["min_distance_m"]["vehicle_2"], 2)
    same(clearance.replace("-0.00", "0.00"), abs(round(found["min_clearance_m"], 2)), 2)
    says(verdict, found)


def test_the_first_run_prints_what_the_readme_shows(capsys):
    """Line by line, but for how fast it was; ``mjmerge run paper`` records, which changes no number."""
    shown = re.search(r"```\n(paper on mujoco.*?)\nlook at it", TEXT, re.DOTALL).group(1)
    with pytest.raises(SystemExit):
        main(["run", "paper", "--no-record"])
    printed = " ".join(capsys.readouterr().out.split())
    for line in shown.splitlines():
        assert " ".join(line.split()) in printed


def test_the_lines_of_python_run_and_shapes_are_as_they_say():
    """In 0.2 s of simulated time, of twelve."""
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    names: dict[str, object] = {}
    short = code.replace('"mismatch.friction=0.4"', '"mismatch.friction=0.4", "duration_s=0.2"')
    exec(short, names)
    shapes = re.findall(r"^trace\.(\w+)  # .*: \((.*)\)$", code, re.MULTILINE)
    assert [name for name, _ in shapes] == ["distance_m", "opinion", "front_m"]
    for name, shape in shapes:
        assert str(getattr(names["trace"], name).shape) == f"({shape.replace('1201', '21')})"
