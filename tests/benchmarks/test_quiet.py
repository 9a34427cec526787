"""No benchmark measures on a busy machine without a word on it."""

from __future__ import annotations

import ast
import os
from pathlib import Path

import pytest

from tests.benchmarks import quiet

FILES = [
    path for path in Path(__file__).parent.glob("*.py") if path.name not in ("quiet.py", Path(__file__).name)
]


@pytest.mark.parametrize("anyway", [True, False])
def test_a_busy_machine_is_told_and_refused_but_for_those_who_insist(anyway, monkeypatch, capsys):
    monkeypatch.setattr(quiet, "anyway", anyway)
    monkeypatch.setattr(os, "getloadavg", lambda: (quiet.BUSY, 9.0, 9.0))
    quiet.look()
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(os, "getloadavg", lambda: (1.26, 0.0, 0.0))
    if anyway:
        quiet.look()
    else:
        with pytest.raises(SystemExit) as end:
            quiet.look()
        assert end.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "load 1.3: others are at work here" in err
    assert ("--anyway" in err) != anyway


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_benchmark_asks_before_anything_else(path):
    (main,) = [
        of for of in ast.parse(path.read_text()).body if isinstance(of, ast.FunctionDef) and of.name == "main"
    ]
    assert ast.unparse(main.body[1]) == "quiet.look()"  # after its docstring
