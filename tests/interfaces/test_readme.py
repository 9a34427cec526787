"""README and pages: what they show comes of its runs; commands, files, links are there; numbers are right."""

import json
import re
import shlex
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import tyro

import mjmerge
from mjmerge.cli import COMMANDS as EVERY
from mjmerge.cli import command, main
from mjmerge.cli.taken import options
from mjmerge.config import shipped
from mjmerge.config.document import parse
from mjmerge.drivers import kinds
from mjmerge.gate.gate import TOLERANCE_M
from mjmerge.record.attached import MOST_MEMORY_BYTES, MOST_SECONDS
from mjmerge.roster import MOST_CARS
from mjmerge.run import run as run_scenario
from mjmerge.sweep.campaign import plan
from mjmerge.sweep.plan import MISMATCH

ROOT = Path(__file__).parents[2]
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")))
}
README, RUNNING, SCENARIOS, CAMPAIGNS, PYTHON, SEARCH = (
    PAGES[name]
    for name in (
        "README.md",
        *(f"docs/{name}.md" for name in ("running", "scenarios", "campaigns", "python", "search")),
    )
)
ONE_SCREEN = 80
NAVIGATION = {*re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))}
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


def table(text, head):
    """Rows of the table that begins so, each a list of cells."""
    lines = text[text.index(head) :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def blocks(text, language):
    """Code blocks of a language, one after the other."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands():
    """Every command of ours in a sentence; tests/interfaces/test_site.py has those in blocks."""
    spoken = [line for text in PAGES.values() for line in re.findall(r"(?<!`)`(mjmerge [^`\n]+)`(?!`)", text)]
    return [*dict.fromkeys(tuple(shlex.split(line)) for line in spoken)]


COMMANDS = commands()


def claim(line):
    """What is said after the line of a command."""
    return re.search(rf"^{re.escape(line)} +# (.*)$", RUNNING + CAMPAIGNS, re.MULTILINE)[1]


@cache
def ran(*arguments):
    """What comes of a run on the command line that records nothing."""
    words = tyro.cli(command("run"), args=[*arguments, "--no-record"])
    return run_scenario(mjmerge.load(words.scenario, words.set_), words.plant)


def same(cell, value, digits):
    assert cell == f"{value:.{digits}f} m"


def says(cell, found):
    """The verdict of a row: its word, whether beyond the hypotheses, the floor, and what it quotes."""
    assert cell.startswith(found["verdict"])
    assert ("below the floor" in cell) == (found["verdict"] == "held" and not found["floor_held"])
    assert ("beyond its hypotheses" in cell) == ("beyond its hypotheses" in found["reason"])
    for quoted in re.findall(r"the ego hits [^,|]+|after '[^']+' broke", cell):
        assert quoted.strip() in found["reason"]


CHARGE_ROWS = table(README, "| `charge` | min d_1")
LARGE_ROWS = table(RUNNING, "| `mujoco`, 25 m/s |")


def test_every_row_of_charge_is_known():
    assert [row[0] for row in CHARGE_ROWS] == list(CHARGE)


@pytest.mark.parametrize("row", CHARGE_ROWS, ids=lambda row: row[0])
def test_a_row_of_charge_is_what_comes_of_its_run(row):
    name, d_1, d_2, verdict = row
    found = ran("charge", *CHARGE[name]).summary
    same(d_1, found["min_distance_m"]["vehicle_1"], 3)
    same(d_2, found["min_distance_m"]["vehicle_2"], 3)
    says(verdict, found)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("row", LARGE_ROWS, ids=lambda row: row[0])
def test_a_row_at_full_size_is_what_comes_of_its_run(row):
    name, _, gains, d_1, d_2, clearance, asked, verdict = row
    done = ran(name.strip("`"))
    found, u = done.summary, done.trace.u_mps2[0, :, 0]
    same(d_1, found["min_distance_m"]["vehicle_1"], 2)
    same(d_2, found["min_distance_m"]["vehicle_2"], 2)
    same(clearance.replace("-0.00", "0.00"), abs(round(found["min_clearance_m"], 2)), 2)
    assert asked == f"{np.nanmax(np.hypot(*u.T)):.1f} m/s^2"
    published = mjmerge.load("paper").law.k_p
    assert (done.trace.scenario.law.k_p == published) == (gains == "published")
    says(verdict, found)


def test_most_of_that_is_scale():
    said = re.search(r"the double integrator keeps ([\d.]+ m) and ([\d.]+ m) on `highway`", RUNNING)
    for cell, name in zip(said.groups(), ("highway", "highway_paper_gains"), strict=True):
        trace = mjmerge.simulate(mjmerge.load(name), "double_integrator")
        same(cell, trace.min_distance_m.min(), 2)


def test_what_breaks_it_breaks_when_it_says(capsys):
    for line in (
        "mjmerge run paper --set law.k_o=0",
        "mjmerge run leader_brakes --set law.k_o=0 --plant double_integrator",
    ):
        done = ran(*shlex.split(line)[2:])
        said_s = float(re.search(r"d_2 < 0 at ([\d.]+) s", claim(line))[1])
        first_s = done.trace.time_s[np.argmax(done.trace.distance_m[0, :, 1] < 0)]
        assert done.trace.min_distance_m[0, 1] < 0 < done.trace.min_distance_m[0, 0]
        assert abs(first_s - said_s) <= 0.05
        assert done.exit_code == 1
    assert claim("mjmerge run paper --set law.k_o=0").endswith("exit code 1")


def test_charge_and_blocked_are_as_they_are_told():
    said = claim("mjmerge run charge")
    hardest = np.abs(ran("charge", "--plant", "double_integrator").trace.u_mps2[0, :, 2]).max()
    assert f"at up to {hardest:.1f} m/s^2: {ran('charge').summary['verdict']}" in said
    better = ran("charge", "--set", "mismatch.tyres=ideal").summary["min_distance_m"]["vehicle_1"]
    better -= ran("charge").summary["min_distance_m"]["vehicle_1"]
    ideal = claim("mjmerge run charge --set mismatch.tyres=ideal")
    assert ideal.endswith(f"{100 * better:.0f} cm better")
    for line in ("friction=0.2", "command_delay_s=0.2"):
        hit = re.search(r"hits (Vehicle \d)", claim(f"mjmerge run charge --set mismatch.{line}"))[1]
        collided = ran("charge", "--set", f"mismatch.{line}").summary["collisions"][0]
        assert collided["b"] == hit.lower().replace(" ", "_")
    assert f'"{ran("blocked").summary["verdict"]}"' in claim("mjmerge run blocked")


def test_what_is_without_effect_is_refused_with_the_plants_that_have_it(capsys):
    (line,) = re.findall(r"`(mjmerge run [^`]*)` is refused", RUNNING)
    with pytest.raises(SystemExit) as stop:
        main([*shlex.split(line)[1:], "--no-record"])
    assert stop.value.code == 2
    assert "mujoco" in capsys.readouterr().err


def test_the_first_run_prints_what_is_shown(capsys):
    """Line by line, but for how fast it was; ``mjmerge run paper`` records, which changes no number."""
    shown = re.search(r"```\n(paper on mujoco.*?)\nlook at it", RUNNING, re.DOTALL).group(1)
    with pytest.raises(SystemExit):
        main(["run", "paper", "--no-record"])
    printed = " ".join(capsys.readouterr().out.split())
    for line in shown.splitlines():
        assert " ".join(line.split()) in printed


def test_the_lines_of_python_run_and_shapes_are_as_they_say():
    """In 0.2 s of simulated time, of twelve."""
    (code,) = blocks(PYTHON, "python")
    names: dict[str, object] = {}
    short = code.replace('"mismatch.friction=0.4"', '"mismatch.friction=0.4", "duration_s=0.2"')
    exec(short, names)
    shapes = re.findall(r"^trace\.(\w+)  # .*: \((.*)\)$", code, re.MULTILINE)
    assert [name for name, _ in shapes] == ["distance_m", "opinion", "front_m"]
    for name, shape in shapes:
        assert str(getattr(names["trace"], name).shape) == f"({shape.replace('1201', '21')})"


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_is_one_with_its_options(words):
    if len(words) == 2:  # its name alone, in a sentence
        assert words[1] in EVERY
        return
    tyro.cli(command(words[1]), args=words[2:])


def test_every_option_that_is_told_of_is_one():
    """But for pages about working on mjmerge, which have options of scripts, too."""
    pages = [text for name, text in PAGES.items() if name not in ("CONTRIBUTING.md", "docs/architecture.md")]
    told = {*re.findall(r"`(--[a-z][\w-]*)", "".join(pages))}
    every = {flag for name in EVERY for option in options(command(name)) for flag in option.flags}
    assert told
    assert told <= {*every, "--version"}


@pytest.mark.parametrize(
    "text", blocks(SCENARIOS + CAMPAIGNS + SEARCH, "yaml"), ids=lambda text: text.splitlines()[0]
)
def test_every_file_that_is_shown_can_be_read(text):
    shown = parse(text).value
    if "blocks" in shown:
        assert len(plan(shown).cases) > 100
        return
    base = parse(shipped.scenarios()["charge"].read_text(encoding="utf-8")).value
    scenario = mjmerge.load(shown if "description" in shown else base | {"law": {**base["law"]}} | shown)
    assert {*shown} <= {*type(scenario).model_fields}


def test_the_scenario_that_is_shown_runs_and_keeps_its_floor(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (text,) = [block for block in blocks(SCENARIOS, "yaml") if "A short merge behind" in block]
    Path("my_merge.yaml").write_text(text)
    with pytest.raises(SystemExit) as stop:
        main(["run", "my_merge.yaml", "--plant", "bicycle", "--no-record", "--json"])
    assert stop.value.code is None or stop.value.code == 0
    assert json.loads(capsys.readouterr().out)["floor_held"]


def test_campaigns_have_as_many_runs_and_axes_as_they_say():
    core, many = plan("mismatch_core"), plan("random_1000")
    laws = {case.batch.scenario.law.label for case in core.cases}
    said = re.search(r"three levels, two laws: (\d+) runs", claim("mjmerge sweep mismatch_core"))
    assert len(laws) == 2
    assert int(said[1]) == len(core.cases)
    axes = [axis for axis in many.axes if axis.startswith(MISMATCH)]
    assert f"{len(axes)} axes at once, a thousand" in claim("mjmerge sweep random_1000")
    assert len(many.cases) == 1000


def test_the_kinds_of_drivers_and_who_can_lead():
    assert sorted(row[0].strip("`") for row in table(SCENARIOS, "| kind | what")) == sorted(kinds())
    said = re.search(r"list drivers`\): (.*?) can lead; (.*?) follow the car ahead", SCENARIOS, re.DOTALL)
    for names, lead in zip(said.groups(), (True, False), strict=True):
        assert {*re.findall(r"`(\w+)`", names)} == {n for n, cls in kinds().items() if cls.can_lead is lead}


def test_the_events_that_are_shown_are_those_of_the_run():
    pattern = r"`platoon_8_small`[^`]*the events of its recording:\n\n```\n(.*?)```"
    block = re.search(pattern, SCENARIOS, re.DOTALL)[1]
    happened = mjmerge.events(mjmerge.simulate(mjmerge.load("platoon_8_small")))
    shown = [e for e in happened if e.car == "ego" and e.text.startswith(("chooses", "merged"))]
    lines = [f"{e.time_s:.2f} s  {e.car}   {e.text}" for e in shown]
    assert lines == [line.strip() for line in block.splitlines()]


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSION = PROJECT["version"]
NUMBERS = {
    r"Python (3\.\d+ or 3\.\d+);": lambda: " or ".join(
        line.rpartition(" ")[2] for line in PROJECT["classifiers"] if "Python :: 3." in line
    ),
    r"Three cars are there: (.*?)\.": lambda: (
        "`rc` (1/10, the default), `sedan` and `van`"
        if sorted(shipped.models()) == ["rc", "sedan", "van"] and mjmerge.load("paper").models.ego == "rc"
        else ""
    ),
    r"numbered on, up to (\d+):": lambda: str(MOST_CARS - 1),
    r"measured before, to ([\d.]+) mm \|": lambda: f"{1e3 * TOLERANCE_M:g}",
    r"of its own with (\d+ s and \d+ GB)": lambda: f"{MOST_SECONDS} s and {MOST_MEMORY_BYTES >> 30} GB",
    r"([\d.]+) m for `rc`": lambda: f"{mjmerge.load('paper').r_m:g}",
    r"([\d.]+) m for `sedan`": lambda: f"{mjmerge.load('highway').r_m:g}",
}
"""Numbers and names in sentences, and where they are from."""


@pytest.mark.parametrize("pattern", NUMBERS)
def test_a_number_in_a_sentence_is_the_codes(pattern):
    (said,) = {said for text in PAGES.values() for said in re.findall(pattern, text)}
    assert said == NUMBERS[pattern]()


def test_the_readme_is_one_screen():
    assert len(README.splitlines()) <= ONE_SCREEN


def test_ci_does_what_the_readme_says():
    ran = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    run_it, work_on_it = (block.strip().split(" && ") for block in blocks(README, "sh"))
    make, install, test = work_on_it
    assert f"{make} && {install}\n" in ran
    assert f" {test}\n" in ran
    assert run_it == [make, install.replace("-e '.[dev]'", "."), ".venv/bin/mjmerge run paper"]


def test_every_extra_is_in_the_table_of_extras():
    named = {row[0].strip("`") for row in table(PAGES["docs/start.md"], "| extra | brings")}
    assert named == {*PROJECT["optional-dependencies"]}


def test_the_version_is_the_same_wherever_it_stands():
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1] == VERSION
    assert re.findall(r"^## \[?([\d.]+)", changes, re.MULTILINE)[0] == VERSION


def anchors(text):
    """Names of the headings of a page, as forges make them."""
    heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("name", PAGES)
def test_every_link_and_file_of_a_page_is_there(name):
    """From the README without the site; pages also lead to pages that only the site has."""
    links = re.findall(r"\]\((?![a-z]+:)([^)#]*)(?:#([^)]*))?\)", PAGES[name])
    for path in re.findall(r"`((?:mjmerge|scenarios|models|docs|examples|tests)/[\w./]*)`", PAGES[name]):
        assert (ROOT / path).exists(), path
    for path, anchor in links:
        if "/" in name and path in NAVIGATION:
            continue
        there = (ROOT / name).parent / path if path else ROOT / name
        assert there.exists(), path
        if anchor:
            assert anchor in anchors(there.read_text(encoding="utf-8")), f"{path}#{anchor}"
