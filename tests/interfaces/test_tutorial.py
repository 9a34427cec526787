"""docs/tutorial.md, step by step: every command is run, in order, and says what the page shows."""

from __future__ import annotations

import io
import re
import shlex
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from mjmerge.cli import main

TEXT = (Path(__file__).parents[2] / "docs" / "tutorial.md").read_text(encoding="utf-8")
STEPS = re.findall(r"^(?:<!-- ([^\n]+) -->\n)?```(\w+)\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
"""What stands above each block, its language, its text."""
COMMANDS = re.findall(r"^\$ (.*)\n((?:(?!\$ |```).*\n)*)", TEXT, re.MULTILINE)
"""Each command, and what is shown below it."""


def plain(text: str) -> str:
    return " ".join(text.split())


def edit(where: str, new: str) -> None:
    """Changes a file as is said above a block."""
    name, place = where.split(", ")
    lines = Path(name).read_text().splitlines(keepends=True)
    place, _, line = place.partition(": ")
    (at,) = [i for i, there in enumerate(lines) if there.strip().startswith(line)] if line else [len(lines)]
    lines[at : at + (place == "in place of")] = [new]
    Path(name).write_text("".join(lines))


def call(command: str) -> tuple[str, int]:
    """What a command prints, and its exit code."""
    said = io.StringIO()
    program, *arguments = shlex.split(command)
    assert program == "mjmerge"
    with redirect_stdout(said), redirect_stderr(said), pytest.raises(SystemExit) as end:
        main(arguments)
    return said.getvalue(), int(end.value.code or 0)


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What each command said, after all edits above it; one that fails is followed by ``echo $?``."""
    answers, code = [], 0
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("tutorial"))
        patch.setenv("COLUMNS", "80")
        for where, language, block in STEPS:
            if where.startswith("my_merge.yaml"):
                edit(where, block)
            for command in re.findall(r"^\$ (.*)$", block, re.MULTILINE) if language == "console" else ():
                if command == "echo $?":
                    answer, code = str(code), 0
                else:
                    assert code == 0, f"the command above {command!r} ended with {code}, which is not shown"
                    answer, code = call(command)
                answers.append(answer)
        yield answers


@pytest.mark.parametrize("number", range(len(COMMANDS)), ids=lambda i: COMMANDS[i][0])
def test_a_command_says_what_is_shown_below_it(number, said):
    rest = plain(said[number])
    for part in filter(None, map(plain, re.split(r"^\.\.\.$", COMMANDS[number][1], flags=re.MULTILINE))):
        before, found, rest = rest.partition(part)
        assert found == part, before


def test_what_is_not_run_opens_a_window():
    others = [block for _, language, block in STEPS if language == "sh"]
    assert others == ["mjmerge view runs/charge-mujoco-0\n"]


@pytest.mark.parametrize("forge", ["github", "gitlab"])
def test_the_jobs_for_ci_check_the_scenario_of_the_page_and_leave_their_report(forge, said):
    (block,) = [block for where, _, block in STEPS if where == forge]
    job = YAML(typ="safe").load(block)
    steps = job["jobs"]["gate"]["steps"] if forge == "github" else job["gate"]["script"]
    lines = [step.get("run", "") if isinstance(step, dict) else step for step in steps]
    (check,) = [line for line in lines if line.startswith("mjmerge ")]
    _, code = call(f"{check} --only ideal")
    assert code == 0
    assert "my_merge" in Path("gate.xml").read_text()
    Path("gate.xml").unlink()
    assert "gate.xml" in block.replace(check, "")
