"""The site has all there is, is built without a warning, and asks nobody; its commands are commands."""

from __future__ import annotations

import doctest
import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import fields
from functools import cache
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path

import pytest
from ruamel.yaml import YAML

import mjmerge
from mjmerge.cli import COMMANDS, main

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
KEPT = sorted(path.name for path in DOCS.glob("*.md"))


@cache
def made() -> dict[str, str]:
    """The pages that follow from the code."""
    spec = importlib.util.spec_from_file_location("hooks", DOCS / "hooks.py")
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    return hooks.pages()


def leaves(nav) -> list[str]:
    """Every page of a navigation."""
    if isinstance(nav, str):
        return [nav]
    return [page for part in (nav.values() if isinstance(nav, dict) else nav) for page in leaves(part)]


NAV = leaves(YAML(typ="safe").load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])


def test_every_page_is_in_the_navigation_once_and_nothing_else_is():
    assert sorted(NAV) == sorted([*KEPT, *made()])


def test_every_public_name_has_a_page_with_its_docstring():
    for name in mjmerge.__all__:
        assert f"::: mjmerge.{name}\n" in made()[f"api/{name}.md"]


def command_class(name: str) -> type:
    return getattr(import_module(f"mjmerge.cli.{name}"), name.capitalize())


def test_every_command_is_on_its_page_with_its_help():
    sections = re.split(r"^## `mjmerge (\w+)`$", made()["cli.md"], flags=re.MULTILINE)[1:]
    assert tuple(sections[::2]) == COMMANDS
    for name, said in zip(COMMANDS, sections[1::2], strict=True):
        assert f"usage: mjmerge {name} [-h]" in said
        options = (
            field.name for field in fields(command_class(name)) if field.name in ("json", "out", "plant")
        )
        assert all(f"--{option}" in said for option in options)


@pytest.mark.parametrize("kind", ["scenario", "campaign", "datasheet"])
def test_every_key_of_a_kind_of_file_is_on_its_page(kind, capsys):
    with pytest.raises(SystemExit):
        main(["schema", kind])
    schema, page = json.loads(capsys.readouterr().out), made()[f"{kind}.md"]
    sections = {"": schema, **schema.get("$defs", {})}
    for name, section in sections.items():
        text = page.partition(f"{{ #{name} }}" if name else "# ")[2].partition("\n## ")[0]
        for key, node in section.get("properties", {}).items():
            row = re.search(rf"^\| `{key}` \|.*$", text, re.MULTILINE)
            assert row, f"{name}.{key}"
            assert " ".join(node.get("description", "").split()).replace("|", "\\|") in row[0]


def blocks(page: str, languages: str) -> list[str]:
    """Text of the blocks of a page, or of the README, in one of the languages."""
    path = DOCS / page if page in KEPT else ROOT / page
    return re.findall(rf"^```(?:{languages})\n(.*?)^```", path.read_text(encoding="utf-8"), re.S | re.M)


LINE = re.compile(r"^(?:\$ |\.venv/bin/)?(mjmerge .+)$", re.MULTILINE)


@pytest.mark.parametrize("page", ["README.md", *KEPT])
def test_every_command_that_a_page_shows_is_one(page, monkeypatch, capsys):
    """With options that there are, and values that they take: it is read, not run."""
    for name in COMMANDS:
        monkeypatch.setattr(command_class(name), "__call__", lambda _: 0)
    for command in LINE.findall("\n".join(blocks(page, "sh|console|bash"))):
        with pytest.raises(SystemExit) as end:
            main(shlex.split(command, comments=True)[1:])
        assert end.value.code == 0, f"{command}\n{capsys.readouterr().err}"


@pytest.mark.parametrize("page", ["README.md", *KEPT])
def test_every_block_of_python_or_yaml_is_that(page):
    for code in blocks(page, "python"):
        compile(doctest.script_from_examples(code) if ">>> " in code else code, page, "exec")
    for text in blocks(page, "yaml"):
        assert YAML(typ="safe").load(text) is not None


class Page(HTMLParser):
    """What a page would ask for by itself, where it leads, and its text but for code."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.asked, self.links, self.names, self.text, self._code = [], [], set(), [], 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.names.add(found.get("id"))
        self._code += tag in ("pre", "script", "style")
        if tag == "a":
            self.links.append(found.get("href") or "")
        elif tag != "link" or found.get("rel") not in ("prev", "next", "canonical"):
            self.asked += [found[key] for key in ("src", "href", "data", "poster") if found.get(key)]

    def handle_endtag(self, tag):
        self._code -= tag in ("pre", "script", "style")

    def handle_data(self, data):
        if not self._code:
            self.text.append(data)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site: its folder, and each of its pages; without a warning."""
    pytest.importorskip("mkdocs", reason="pip install 'mjmerge[docs]'")
    out = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)]
    env = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(build, cwd=ROOT, env=env, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return out, {path: Page(path.read_text(encoding="utf-8")) for path in out.rglob("*.html")}


def test_the_site_has_every_page(site):
    out, pages = site
    for name in NAV:
        stem = name.removesuffix(".md")
        assert out / ("index.html" if stem == "index" else f"{stem}/index.html") in pages


def test_no_page_asks_another_host_for_anything(site):
    for path, page in site[1].items():
        assert [asked for asked in page.asked if re.match(r"[a-z]+:(?!image/)|//", asked)] == [], path
    for style in site[0].rglob("*.css"):
        assert not re.search(r"url\(\s*['\"]?(?:https?:)?//|@import", style.read_text(encoding="utf-8")), (
            style
        )


def test_every_link_within_the_site_leads_somewhere(site):
    out, pages = site
    for path, page in pages.items():
        for link in page.links:
            if re.match(r"[a-z]+:|$|#$", link):
                continue
            to, _, name = link.partition("#")
            there = (out / to[1:] if to.startswith("/") else path.parent / to).resolve() if to else path
            there = there / "index.html" if there.is_dir() else there
            assert there.exists(), f"{path}: {link}"
            assert not name or there not in pages or name in pages[there].names, f"{path}: {link}"


def test_no_page_shows_markup_for_what_it_means(site):
    for path, page in site[1].items():
        text = "".join(page.text)
        assert not re.search(r"^\s*\|.*\|\s*$|^- |\]\(|:(?:class|func|meth|data|mod):|\$\$", text, re.M), path
