"""Nothing heavy is imported before it is needed: what may be, is listed here by name."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated

import pytest
from pydantic import BaseModel, Field

import mjmerge
from mjmerge.cli import main
from mjmerge.config import shipped
from mjmerge.config.frozen import Frozen
from mjmerge.config.meanings import meanings

COMMAND = {"mjmerge", "tyro", "docstring_parser", "typing_extensions", "typeguard", "ruamel"}
PRINTING = {"rich"}
SCHEMA = {"numpy", "pydantic", "pydantic_core", "annotated_types", "typing_inspection"}
"""A scenario is read into it; laws and drivers are part of it, and they count in arrays."""

MAY_LOAD = {
    "import mjmerge": {"mjmerge"},
    "from mjmerge.cli import main; main(['--help'])": COMMAND,
    "from mjmerge.cli import main; main(['list', 'scenarios'])": COMMAND | PRINTING,
    "from mjmerge.cli import main; main(['list'])": COMMAND | PRINTING | SCHEMA,
    "from mjmerge.cli import main; main(['run', 'bad.yaml'])": COMMAND | SCHEMA,
    "from mjmerge.cli import main; main(['sweep', 'bad.yaml'])": COMMAND | SCHEMA,
    "from mjmerge import load, simulate; simulate(load('paper', ['duration_s=0.1']), 'bicycle')": {
        *("mjmerge", "ruamel", "typing_extensions"),
        *SCHEMA,
        "cython_runtime",  # numpy's random numbers
    },
}
"""Packages from elsewhere, by what is done."""
REPORT = """
names = {name.partition(".")[0] for name in {*sys.modules} - before}
print(*(name for name in names - {*sys.stdlib_module_names} if name[0] != "_"), file=sys.stderr)
"""


def after(code: str, folder: Path, report: str) -> set[str]:
    """What a process of its own says that it has loaded after some code, however that ends."""
    whole = f"import sys\nbefore = {{*sys.modules}}\ntry:\n    {code}\nexcept SystemExit:\n    pass\n{report}"
    done = subprocess.run(
        [sys.executable, "-c", whole],
        cwd=folder,
        env={name: value for name, value in os.environ.items() if name != "COVERAGE_PROCESS_START"},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return {*done.stderr.splitlines()[-1].split()}


@pytest.mark.parametrize("code", MAY_LOAD)
def test_what_is_not_needed_is_not_imported(code, tmp_path):
    (tmp_path / "bad.yaml").write_text("initial: {ego: {speed_mps: fast}}\nlaw: {kind: nosuch}\n")
    too_many = after(code, tmp_path, REPORT) - MAY_LOAD[code]
    assert too_many == set()


@pytest.mark.parametrize("outside", [False, True])
def test_a_recorded_run_leaves_pandas_out_unless_code_from_outside_may_want_it(tmp_path, outside):
    pytest.importorskip("pandas")
    text = shipped.scenarios()["charge"].read_text(encoding="utf-8")
    own = "\nmetrics: ['mine.py:zero']\n" if outside else ""
    (tmp_path / "mine.yaml").write_text(text.replace("duration_s: 12", "duration_s: 0.1") + own)
    (tmp_path / "mine.py").write_text("def zero(trace):\n    return 0 * trace.min_distance_m[:, 0]\n")
    run = "main(['run', 'mine.yaml', '--plant', 'bicycle', '--out', 'out'])"
    report = """
print("pandas" in sys.modules, file=sys.stderr)
import pyarrow
assert len(pyarrow.table({"a": [1.0]}).to_pandas()) == 1
"""
    done = after(f"sys.argv[0] = 'mjmerge'; from mjmerge.cli import main; {run}", tmp_path, report)
    assert done == {str(outside)}
    assert (tmp_path / "out" / "run.rrd").exists()


def test_importing_the_package_loads_nothing_of_it_but_what_an_interrupt_does(tmp_path):
    report = "print(*(name for name in sys.modules if name.startswith('mjmerge')), file=sys.stderr)"
    assert after("import mjmerge", tmp_path, report) == {"mjmerge", "mjmerge.interrupts"}


def test_every_name_of_the_face_is_what_a_type_checker_takes_it_for():
    tree = ast.parse(Path(mjmerge.__file__).read_text(encoding="utf-8"))
    (typing,) = (node for node in tree.body if isinstance(node, ast.If))
    said = {alias.name: node.module for node in typing.body for alias in node.names}
    assert sorted(said) == sorted(mjmerge.__all__)
    for name, module in said.items():
        assert getattr(mjmerge, name) is getattr(import_module(module), name)
    assert {*mjmerge.__all__} <= {*dir(mjmerge)}
    with pytest.raises(AttributeError, match="'mjmerge' has no attribute 'simulat'"):
        mjmerge.simulat  # noqa: B018


@pytest.mark.parametrize(
    ("arguments", "once", "also"),
    [
        (["run", "paper", "--seed", "x"], "Error parsing --seed", "of the first run"),
        (["run", "paper", "--sead", "3"], "options: --sead", "of the first run"),
        (["run"], "Missing from", "mjmerge run --help"),
        (["runn"], "no command called 'runn'", "did you mean 'run'?"),
    ],
)
def test_a_mistake_on_the_command_line_is_said_once_and_by_its_own_command(arguments, once, also, capsys):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    out, err = capsys.readouterr()
    assert (end.value.code, out) == (2, "")
    assert err.count(once) == 1
    assert also in err


class Base(Frozen):
    """Some keys."""

    said: float = 1.0
    """Over
    two lines."""
    silent: float = 2.0
    again: float = 3.0
    """Of the base."""
    lost: float = 4.0
    """Not where it is declared again without."""


class Below(Base):
    """More."""

    again: float = 5.0
    """Of the subclass."""
    lost: float = 6.0
    own: Annotated[float, Field(gt=0, description="Said by the field.")] = 7.0
    """Not this."""

    def method(self) -> float:
        """Not a key."""
        return 0.0


class TheirBase(BaseModel, use_attribute_docstrings=True):
    """What pydantic makes of the same."""

    said: float = 1.0
    """Over
    two lines."""
    silent: float = 2.0
    again: float = 3.0
    """Of the base."""
    lost: float = 4.0
    """Not where it is declared again without."""


class Theirs(TheirBase):
    """More."""

    again: float = 5.0
    """Of the subclass."""
    lost: float = 6.0
    own: Annotated[float, Field(gt=0, description="Said by the field.")] = 7.0
    """Not this."""


def test_what_a_key_means_is_what_pydantic_reads_when_it_makes_the_class():
    theirs = {name: field.description for name, field in Theirs.model_fields.items() if field.description}
    assert meanings(Below) == theirs
    assert {*theirs} == {"said", "again", "own"}
    schema, expected = Below.model_json_schema(), Theirs.model_json_schema()
    assert {n: p.get("description") for n, p in schema["properties"].items()} == {
        n: p.get("description") for n, p in expected["properties"].items()
    }


def test_a_class_without_a_source_has_keys_without_meaning():
    made = type("Made", (Frozen,), {"__annotations__": {"key": float}, "__module__": __name__})
    assert meanings(made) == {}
