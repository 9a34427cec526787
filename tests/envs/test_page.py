"""What docs/environments.md shows is what works, and its tables are what the tasks declare."""

import re
from pathlib import Path

import pytest

from mjmerge.envs.make import merging, opposing
from mjmerge.envs.parts import told

TEXT = (Path(__file__).parents[2] / "docs" / "environments.md").read_text(encoding="utf-8")
TABLES = {
    "sees": merging().sees,
    "acceleration": merging().acts,
    "steering": merging(plant="bicycle", action="steering").acts,
    "adversary sees": opposing().sees,
    "adversary acts": opposing().acts,
}


@pytest.mark.parametrize("name", re.findall(r"<!-- ([\w ]+) -->\n```python", TEXT))
def test_every_example_of_the_page_runs(name, capsys):
    (code,) = re.findall(rf"<!-- {name} -->\n```python\n(.*?)```", TEXT, re.DOTALL)
    exec(compile(code, f"environments.md, {name}", "exec"), {})
    assert (capsys.readouterr().out != "") == ("print(" in code)


@pytest.mark.parametrize("name", TABLES)
def test_every_table_of_the_page_is_what_the_task_declares(name):
    (table,) = re.findall(rf"<!-- {name} -->\n(.*?)\n\n", TEXT, re.DOTALL)
    assert table == told(TABLES[name])
