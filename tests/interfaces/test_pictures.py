"""docs/pictures.py makes every picture that a page shows, no other, and says when a command fails."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

from mjmerge.cli import main

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def pictures() -> ModuleType:
    spec = importlib.util.spec_from_file_location("pictures", DOCS / "pictures.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["pictures"] = module  # dataclasses look for it
    spec.loader.exec_module(module)
    return module


def of_kind(names) -> set[str]:
    return {name for name in names if name.endswith((".png", ".gif", ".svg", ".jpg", ".webp"))}


def test_every_picture_that_a_page_shows_can_be_made_again_and_every_other_is_gone(pictures):
    pages = {page: page.read_text(encoding="utf-8") for page in (ROOT / "README.md", *DOCS.glob("*.md"))}
    shown = set()
    for page, text in pages.items():
        links = re.findall(r"!\[[^\]]*\]\(([^)\s]+)\)|<img[^>]+src=\"([^\"]+)\"", text)
        shown |= {(page.parent / (a or b)).resolve().relative_to(DOCS).as_posix() for a, b in links}
    made = [name for recipe in pictures.RECIPES.values() for name in recipe.files]
    there = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*") if path.is_file()}
    assert of_kind(made) == shown
    assert of_kind(there) == shown
    assert len(made) == len({*made}), "each is made in one way"


def test_a_picture_is_made_by_the_commands_of_its_recipe(pictures, tmp_path, monkeypatch, capsys):
    said = []

    def command(name, *words):
        short = ["--set", "duration_s=6"] if name == "run" else []
        with pytest.raises(SystemExit) as end:
            main([name, *map(str, words), *short])
        said.append(end.value.code)

    monkeypatch.setattr(pictures, "mjmerge", command)
    monkeypatch.setattr(sys, "argv", ["pictures.py", "finding", "--out", str(tmp_path)])
    pictures.main()
    assert said == [0, 1, 0], "the ideal holds, on cars it fails, and both are compared"
    assert [path.name for path in tmp_path.rglob("*.png")] == ["finding.png"]
    with (
        Image.open(tmp_path / "search" / "finding.png") as made,
        Image.open(DOCS / "search/finding.png") as kept,
    ):
        assert made.size == kept.size
    assert "finding: 1 files in" in capsys.readouterr().out


def test_a_command_that_fails_is_named(pictures):
    with pytest.raises(SystemExit, match="mjmerge run no-such-scenario ended with 2"):
        pictures.mjmerge("run", "no-such-scenario")


def test_the_list_has_every_picture_and_no_other_name_is_taken(pictures, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["pictures.py", "--list"])
    pictures.main()
    told = capsys.readouterr().out
    assert all(place in told for recipe in pictures.RECIPES.values() for place in recipe.files)
    monkeypatch.setattr(sys, "argv", ["pictures.py", "papre"])
    with pytest.raises(SystemExit):
        pictures.main()
    assert "no papre; there are paper, cars" in capsys.readouterr().err
