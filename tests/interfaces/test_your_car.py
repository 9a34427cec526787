"""docs/your-car.md, step by step: from the published car to an accepted one, with what is said on the way."""

import re
from pathlib import Path

import pytest

from mjmerge.config import shipped
from mjmerge.errors import ModelError
from mjmerge.proving.identify import identify
from mjmerge.scenario.load import load
from mjmerge.starts.make import make
from mjmerge.world.checks.parts import NUMBERS, names
from mjmerge.world.compose import build, single

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "your-car.md").read_text(encoding="utf-8")
STEPS = re.findall(
    r"<!-- (replace|datasheet|says) -->\n```\w+\n(.*?)```(?:\n<!-- with -->\n```xml\n(.*?)```)?", PAGE, re.S
)


def said(folder):
    """What a car is refused for."""
    with pytest.raises(ModelError) as error:
        single(str(folder))
    return str(error.value)


@pytest.fixture(scope="module")
def buggy(tmp_path_factory):
    """The folder after all steps; what the page quotes on the way is what is said."""
    folder = make("car", "buggy", tmp_path_factory.mktemp("docs"))
    car = folder / "buggy.xml"
    car.write_text((DOCS / "your-car" / "published.xml").read_text())
    for what, old, new in STEPS:
        text = car.read_text()
        if what == "datasheet":
            (folder / "datasheet.yaml").write_text(old)
        elif what == "replace":
            assert old[:-1] in text, old
            car.write_text(text.replace(old, new) if old in text else text.replace(old[:-1], new[:-1]))
        else:
            found = said(folder).replace(f"{folder.parent}/", "")
            for line in old.splitlines():
                assert line in found
    return folder


def test_the_steps_end_with_a_car_that_is_accepted(buggy):
    found = identify(str(buggy))
    assert [row for row in found.table if row.passed is False] == []


def test_the_folder_beside_the_page_is_what_the_steps_make(buggy):
    kept = DOCS / "your-car" / "buggy"
    assert {p.name for p in kept.iterdir()} == {"buggy.xml", "datasheet.yaml", "parts.xml"}
    for file in kept.iterdir():
        assert file.read_text() == (buggy / file.name).read_text()


def test_every_step_of_the_page_is_found():
    assert len([what for what, _, _ in STEPS if what == "replace"]) == PAGE.count("<!-- replace -->")
    assert len([what for what, _, _ in STEPS if what == "says"]) == PAGE.count("<!-- says -->") == 2


def test_the_merge_is_driven_with_it(buggy):
    scenario = load("paper", [f"models.ego={buggy}", "duration_s=1"])
    assert build(scenario).sheets[0].mass_kg == 3


def test_every_name_of_the_contract_is_on_the_page():
    shared = (shipped.folder("models") / "parts" / "car.xml").read_text()
    for _, name in names("all"):
        corner = re.sub(r"_(front|rear)_(left|right)$", "_", name)
        assert f"`{name}`" in PAGE or f"`{corner}" in PAGE or f'name="{name}"' in shared
    assert all(f"`{name}`" in PAGE for name in NUMBERS)
