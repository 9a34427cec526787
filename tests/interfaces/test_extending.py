"""What docs/extending.md shows is what works."""

import re
import shlex
from pathlib import Path

import pytest

from mjmerge.cli import main

TEXT = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")


def block(name: str) -> str:
    return re.search(rf"<!-- {name} -->\n```python\n(.*?)```", TEXT, re.DOTALL).group(1)


@pytest.mark.parametrize("kind", ["driver"])
def test_every_example_of_the_page_runs_with_the_command_below_it(kind, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = block(kind)
    (name,) = re.findall(r'^"""(\w+\.py)"""', code)
    (tmp_path / name).write_text(code)
    (line,) = re.findall(rf"^\$ (mjmerge run .*{name}.*)$", TEXT, re.MULTILINE)
    with pytest.raises(SystemExit) as end:
        main([*shlex.split(line)[1:], "--plant", "bicycle", "--set", "duration_s=2", "--no-record"])
    assert end.value.code in (0, 1), capsys.readouterr().err
