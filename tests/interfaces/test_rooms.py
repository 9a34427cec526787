"""The house stands: rooms import downwards only, nothing goes in a circle, and the page about it is true."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import mjmerge

PACKAGE = Path(mjmerge.__file__).parent
PAGE = (Path(__file__).parents[2] / "docs" / "architecture.md").read_text(encoding="utf-8")
MOST_ROOT_FILES = 10


def modules() -> dict[str, Path]:
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def imports(path: Path) -> Iterator[str]:
    """The modules of this package that one imports, at its top or later, but for types alone."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in typing:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and (node.module or "") in MODULES:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in MODULES else str(node.module)


ARROWS = {name: {*imports(path)} - {name} for name, path in MODULES.items()}


def room(module: str) -> str:
    return module.split(".")[1] if "." in module else "__init__"


def test_imports_go_down_the_list_of_the_page_only_and_every_room_is_on_it():
    listed = re.search(r"<!-- rooms -->\n```\n(.*?)```", PAGE, re.DOTALL).group(1)
    order = [name for line in listed.splitlines() for name in re.findall(r"[\w]+", line.partition("  ")[0])]
    assert sorted(order) == sorted({room(module) for module in MODULES})
    floor = {name: i for i, name in enumerate(order)}
    up = [(a, b) for a, ends in ARROWS.items() for b in ends if floor[room(b)] > floor[room(a)]]
    assert up == []


def test_no_module_imports_itself_by_way_of_others():
    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        ways = [*ARROWS[start]]
        while ways:
            if (module := ways.pop()) not in seen:
                seen.add(module)
                ways += ARROWS[module]
        return seen

    assert [name for name in MODULES if name in reached(name)] == []


def test_few_files_stand_loose_at_the_root():
    assert len([p for p in PACKAGE.iterdir() if p.is_file()]) <= MOST_ROOT_FILES


def test_every_file_that_the_page_names_is_there():
    named = re.findall(r"`((?:mjmerge|tests|models|scenarios|docs)/[\w./-]*)`", PAGE)
    assert named
    assert [name for name in named if not (PACKAGE.parent / name).exists()] == []
