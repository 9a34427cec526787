"""What docs/extending.md shows is what works."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from mjmerge import load, simulate
from mjmerge.cli import main
from mjmerge.config import shipped

TEXT = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")


def block(name: str) -> str:
    return re.search(rf"<!-- {name} -->\n```\w+\n(.*?)```", TEXT, re.DOTALL).group(1)


@pytest.mark.parametrize("kind", ["law", "driver", "metric"])
def test_every_example_of_the_page_runs_with_the_command_below_it(kind, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = block(kind)
    (name,) = re.findall(r'^"""(\w+\.py)"""', code)
    (tmp_path / name).write_text(code)
    (line,) = re.findall(rf"^\$ (mjmerge run .*{name}.*)$", TEXT, re.MULTILINE)
    with pytest.raises(SystemExit) as end:
        main([*shlex.split(line)[1:], "--plant", "bicycle", "--set", "duration_s=2", "--no-record"])
    assert end.value.code in (0, 1), capsys.readouterr().err


def test_the_metric_of_the_page_measures_what_it_says_and_its_bounds_are_held(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("headway.py").write_text(block("metric"))
    text = shipped.scenarios()["charge"].read_text(encoding="utf-8").partition("\nexpect:")[0]
    Path("mine.yaml").write_text(f"{text}\n{block('bounds')}")
    with pytest.raises(SystemExit) as end:
        main(["run", "mine.yaml", "--plant", "bicycle", "--no-record", "--json"])
    assert end.value.code == 0
    found = json.loads(capsys.readouterr().out)
    trace = simulate(load("charge"), "bicycle")
    behind = trace.front_m[0, :, 0] - trace.front_m[0, :, 2]
    there = (np.abs(behind[:, 1]) < 0.6) & (behind[:, 0] > 0)
    least = (behind[there, 0] / trace.speed_mps[0, there, 2]).min()
    assert found["metrics"] == {"headway_s": least}
    assert 0.2 < least < 3
    main_of = ["check", "mine.yaml", "--update"]
    for arguments, code in ((main_of, 0), (main_of[:2], 0)):
        with pytest.raises(SystemExit) as end:
            main(arguments)
        assert end.value.code == code, capsys.readouterr().out
