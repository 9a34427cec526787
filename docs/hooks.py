"""What mkdocs.yml asks for beyond docs/: pages that follow from the code, links that lead out, formulas.

:func:`pages` needs no mkdocs: tests read it.
"""

from __future__ import annotations

import html
import io
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import redirect_stdout, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

import mjmerge
from mjmerge.cli import COMMANDS, main

ROOT = Path(__file__).parents[1]
TOP = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Documents beside docs/, and what their pages are called."""
DEEPER = (
    "mjmerge.law.Law",
    "mjmerge.law.Seen",
    "mjmerge.law.Sensed",
    "mjmerge.law.each_run",
    "mjmerge.drivers.Driver",
    "mjmerge.scenario.mismatch.Mismatch",
    "mjmerge.record.read.read",
    "mjmerge.sweep.sweep.sweep",
    "mjmerge.sweep.workers.Workers",
    "mjmerge.errors",
)
"""What documents and examples use that is not at the top."""


# pages ---------------------------------------------------------------------------------------------------


def pages() -> dict[str, str]:
    """Every page that is not a file of docs/: its Markdown, by its path."""
    from mjmerge.scenario.schema import Scenario
    from mjmerge.sweep.campaign import Campaign
    from mjmerge.vehicle.datasheet import DataSheet

    return {
        **{to: _from_top((ROOT / name).read_text(encoding="utf-8")) for name, to in TOP.items()},
        "examples.md": _examples(),
        "cli.md": _commands(),
        "scenario.md": _keys("Scenario", Scenario),
        "campaign.md": _keys("Campaign", Campaign),
        "datasheet.md": _keys("Data sheet", DataSheet),
        **{f"api/{name}.md": _name(name) for name in mjmerge.__all__},
        "api/deeper.md": "# Deeper\n\n" + "\n".join(_docstring(name, level=2) for name in DEEPER),
    }


def _examples() -> str:
    parts = [
        "# Examples\n\nShort scripts on the Python API, in `examples/`. The tests run them as they stand.\n"
    ]
    for path in sorted((ROOT / "examples").glob("*.py")):
        parts.append(f"## `{path.name}`\n\n```python\n{path.read_text(encoding='utf-8')}```\n")
    return "\n".join(parts)


def _commands() -> str:
    """What each command says to ``--help``."""
    exits = "[under Running a merge](running.md#exit-codes)"
    parts = [f"# Command line\n\nWhat `mjmerge COMMAND --help` says. Exit codes are {exits}.\n"]
    for name in COMMANDS:
        said = io.StringIO()
        with redirect_stdout(said), suppress(SystemExit), patch.dict(os.environ, COLUMNS="88", NO_COLOR="1"):
            main([name, "--help"])
        parts.append(f"## `mjmerge {name}`\n\n```text\n{said.getvalue().strip()}\n```\n")
    return "\n".join(parts)


def _docstring(path: str, level: int = 1) -> str:
    return f"::: {path}\n    options: {{heading_level: {level}}}\n"


def _name(name: str) -> str:
    """The page of a name of the face; that of a trace has its columns, too."""
    text = f"---\ntitle: {name}\n---\n\n{_docstring(f'mjmerge.{name}')}"
    if name == "Trace":
        from mjmerge.roster import roster
        from mjmerge.simulation.trace import COLUMNS

        text += "\n## Columns\n\nFor N simulations, T ticks and three cars. Units are in the names.\n\n"
        text += "| column | shape | symbol | what it is |\n|---|---|---|---|\n"
        for column in COLUMNS:
            shape = ", ".join(("N", "T", *map(str, column.shape(roster()))))
            text += f"| `{column.name}` | ({shape}) | {column.symbol} | {column.doc} |\n"
    return text


# the keys of a file, from its JSON schema ----------------------------------------------------------------

Schema = Mapping[str, Any]


def _keys(title: str, model: Any) -> str:
    """What a kind of file may say: a table for each of its sections, in the order of a file."""
    from mjmerge.scenario.load import json_schema

    root = json.loads(json_schema(model))
    of = root.get("$defs", {})
    parts = [f"# {title}\n\n{_prose(root)}\n\n{_table(root, of)}"]
    for path, name, section in _sections(root, of, "", set()):
        parts.append(f"## `{path}` {{ #{name} }}\n\n{_prose(section)}\n\n{_table(section, of)}")
    return "\n".join(parts)


def _sections(node: Schema, of: Schema, path: str, seen: set[str]) -> Iterator[tuple[str, str, Schema]]:
    """Each section that is named in a schema, once: where it first stands in a file, its name, its schema."""
    if name := node.get("$ref", "").rpartition("/")[2]:
        if name in seen:
            return
        seen.add(name)
        node = _flat(of[name])
        kind = node["properties"].get("kind", {}).get("const")
        yield (f"{path} (kind: {kind})" if kind else path), name, node
    for child in node.get("patternProperties", {}).values():
        yield from _sections(child, of, f"{path}.vehicle_N", seen)
    for key, child in node.get("properties", {}).items():
        yield from _sections(child, of, f"{path}.{key}" if path else key, seen)
    for child in (*node.get("anyOf", ()), *node.get("oneOf", ())):
        yield from _sections(child, of, path, seen)
    for word, more in (("items", "[]"), ("additionalProperties", ".NAME")):
        if isinstance(child := node.get(word), dict):
            yield from _sections(child, of, path + more, seen)


def _flat(node: Schema) -> Schema:
    """A section that is one of several, by which keys are there, as one with all of them."""
    if "properties" in node:
        return node
    either = node["anyOf"]
    return {
        "description": node.get("description", either[0].get("description", "")),
        "properties": {key: value for one in either for key, value in one["properties"].items()},
        "required": set.intersection(*(set(one.get("required", ())) for one in either)),
    }


def _table(section: Schema, of: Schema) -> str:
    """Its keys: type, default, meaning, which may be that of the section that stands there."""
    lines = ["| key | type | default | meaning |", "|---|---|---|---|"]
    keys = {**section.get("properties", {}), **section.get("patternProperties", {})}
    for key, node in keys.items():
        default = json.dumps(node["default"]) if "default" in node else ""
        said = "required" if key in section.get("required", ()) else f"`{default}`" if default else ""
        name = "vehicle_N" if key.startswith("^") else key
        said = "" if len(said) > 60 else said
        meaning = _prose(node) or _prose(of.get(node.get("$ref", "").rpartition("/")[2], {}))
        lines.append(f"| `{name}` | {_type(node)} | {said} | {meaning.replace('|', chr(92) + '|')} |")
    return "\n".join(lines) + "\n"


def _prose(node: Schema) -> str:
    return " ".join(node.get("description", "").split())


def _type(node: Schema) -> str:
    """What a value may be, in words."""
    if "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        return f"[{name}](#{name})"
    if "const" in node or "enum" in node:
        return ", ".join(f"`{value}`" for value in node.get("enum", [node.get("const")]))
    if either := (*node.get("anyOf", ()), *node.get("oneOf", ())):
        return " or ".join(dict.fromkeys(map(_type, either)))
    if "prefixItems" in node:
        return f"[{', '.join(map(_type, node['prefixItems']))}]"
    if node.get("type") == "array":
        return f"list of {_type(node.get('items', {}))}"
    if isinstance(inner := node.get("additionalProperties"), dict):
        return f"mapping to {_type(inner)}"
    return node.get("type", "anything") + "".join(
        f"{sign} {node[word]:g}" for word, sign in _BOUNDS.items() if word in node
    )


_BOUNDS = {"exclusiveMinimum": " above", "minimum": " from", "exclusiveMaximum": " below", "maximum": " to"}

# links ---------------------------------------------------------------------------------------------------

_OUT = re.compile(r"\]\(\.\./([^)#\s]+)")


def _from_top(text: str) -> str:
    """A document that stands beside docs/, with its links as they are from docs/."""
    text = re.sub(r"\]\(docs/", "](", text)
    return re.sub(rf"\]\(({'|'.join(map(re.escape, TOP))})", r"](../\1", text)


def _inward(text: str) -> str:
    """Links out of docs/ lead to pages: of a document of :data:`TOP`, or of a file's text."""
    return _OUT.sub(lambda found: f"]({TOP.get(found[1], f'source/{found[1]}.md')}", text)


def _linked(texts: Iterable[str]) -> dict[str, str]:
    """A page for each file beside docs/ that they link to, with its text."""
    names = {name for text in texts for name in _OUT.findall(text)} - set(TOP)
    return {
        f"source/{name}.md": f"# {name}\n\n````{_LANGUAGES[Path(name).suffix]}\n"
        f"{(ROOT / name).read_text(encoding='utf-8')}\n````\n"
        for name in sorted(names)
    }


_LANGUAGES = {".py": "python", ".yaml": "yaml", ".proto": "protobuf"}

# what mkdocs asks ----------------------------------------------------------------------------------------


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages, and those of the files that they link to."""
    from mkdocs.structure.files import File, InclusionLevel

    made = pages()
    kept = [path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md")]
    for path, text in made.items():
        files.append(File.generated(config, path, content=text))
    for path, text in _linked([*kept, *made.values()]).items():
        files.append(File.generated(config, path, content=text, inclusion=InclusionLevel.NOT_IN_NAV))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Mends the links of a page that lead out of docs/."""
    return markdown if "/" in page.file.src_uri else _inward(markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Formulas as MathML, which browsers draw without a script; the roles of docstrings as their names."""
    content = re.sub(r'<(span|div) class="arithmatex">(.*?)</\1>', _formula, content, flags=re.DOTALL)
    return re.sub(
        r":(?:class|func|meth|mod|data|attr):<code>~?(?:[\w.]+\.)?(\w+)</code>", r"<code>\1</code>", content
    )


def _formula(found: re.Match[str]) -> str:
    from latex2mathml.converter import convert

    tag, text = found.groups()
    display = "block" if tag == "div" else "inline"
    formula = convert(html.unescape(text).strip()[2:-2], display=display)
    return f'<{tag} class="arithmatex">{formula}</{tag}>'
