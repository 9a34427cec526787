"""Parts of a sweep: in any order, at once, twice and apart they make one table; gaps and mixtures none."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.cli import main
from mjmerge.errors import MjmergeError, OutputError
from mjmerge.sweep import campaign
from mjmerge.sweep.folder import SHARDS, TABLE, write
from mjmerge.sweep.merge import merged
from mjmerge.sweep.parts import Part, ranges
from mjmerge.sweep.shards import Shard
from mjmerge.sweep.sweep import do_part, sweep
from mjmerge.sweep.workers import HERE

TEXT = """\
description: Three shards of two runs.
blocks:
  - scenarios: [paper]
    plants: [double_integrator]
    set: {duration_s: 0.2, control_step_s: 0.02}
    variants: [literal, gated, one_sided]
    seeds: 2
"""


@pytest.fixture
def plan(tmp_path, monkeypatch) -> campaign.Plan:
    monkeypatch.chdir(tmp_path)
    Path("c.yaml").write_text(TEXT)
    return campaign.plan("c.yaml")


@pytest.fixture
def whole(plan) -> bytes:
    sweep(plan, Path("whole"))
    return Path("whole", TABLE).read_bytes()


def command(capsys, *words) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stop:
        main(["sweep", "c.yaml", *map(str, words)])
    return (stop.value.code, *capsys.readouterr())


def apart(plan) -> list[Path]:
    for k in (1, 2, 3):
        do_part(plan, Path(f"p{k}"), Part(k, 3), HERE)
    return [Path(f"p{k}") for k in (1, 2, 3)]


@given(st.integers(1, 20), st.integers(0, 40))
def test_every_shard_is_of_one_part_and_a_part_knows_whose_the_others_are(of, count):
    shards = [Shard(number, (number,), ()) for number in range(count)]
    parts = [Part(k, of) for k in range(1, of + 1)]
    assert sorted(s.number for part in parts for s in part.among(shards)) == list(range(count))
    for part in parts:
        assert part.others(part.among(shards)) == ([part] if part.among(shards) else [])
        assert Part.parse(str(part)) == part


@pytest.mark.parametrize(
    "text", ["0/3", "4/3", "1/0", "0/0", "a/b", "1", "1/3/5", "-1/3", "1/ 3", "", "1.0/3"]
)
def test_what_is_no_part_is_refused_before_anything_is_read(text, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = command(capsys, f"--part={text}")
    assert (code, out) == (2, "")
    assert err.startswith("mjmerge: --part is ")
    assert not list(tmp_path.iterdir())


@given(st.sets(st.integers(0, 30)))
def test_numbers_in_a_row_are_written_as_one(numbers):
    said = []
    for text in filter(None, ranges(numbers).split(", ")):
        first, _, last = text.partition(" to ")
        said.append((int(first), int(last or first)))
    assert [n for first, last in said for n in range(first, last + 1)] == sorted(numbers)
    assert all(a[1] + 1 < b[0] for a, b in pairwise(said))


def test_parts_one_after_the_other_say_what_is_missing_and_the_last_makes_the_table(plan, whole, capsys):
    for order in ((1, 2, 3), (2, 3, 1)):
        found = [do_part(plan, Path("any", *map(str, order)), Part(k, 3), HERE).table for k in order]
        assert found[:2] == [None, None]
        assert Path("any", *map(str, order), TABLE).read_bytes() == whole
    for k, missing in ((3, [1, 2]), (1, [2]), (1, [2])):
        found = do_part(plan, Path("out"), Part(k, 3), HERE)
        assert (found.table, found.mine.num_rows) == (None, 2)
        assert Part(k, 3).others(found.missing) == [Part(one, 3) for one in missing]
    words = ("--out", "out", "--workers", 1, "--json")
    code, out, err = command(capsys, "--part", "1/3", *words)
    found = {"campaign": "c", "part": "1/3", "runs": 2, "missing": 2, "missing_parts": ["2/3"]}
    assert (code, err, json.loads(out)) == (0, "", found | {"lost": [], "out": "out"})
    assert not Path("out", TABLE).exists()
    code, out, err = command(capsys, "--part", "2/3", *words)
    assert (code, err, json.loads(out)["runs"]) == (0, "", 6)
    assert Path("out", TABLE).read_bytes() == whole
    assert Path("out/report.md").exists()
    assert not list(Path("out").rglob("*.partial"))


def test_parts_at_once_and_twice_make_the_same_table(plan, whole, long):
    parts = [Part(k, 3) for k in (2, 1, 3, 2, 1)]
    with ThreadPoolExecutor(len(parts)) as executor:
        found = list(executor.map(lambda part: do_part(plan, Path("out"), part, HERE), parts))
    assert any(one.table is not None for one in found)
    assert Path("out", TABLE).read_bytes() == whole
    if long:
        words = [sys.executable, "-m", "mjmerge", "sweep", "c.yaml", "--workers", "1", "--out", "jobs"]
        jobs = [subprocess.Popen([*words, "--part", f"{k}/3"], stdout=-3) for k in (3, 1, 2, 2, 3, 1)]
        assert [job.wait(120) for job in jobs] == [0] * 6
        assert Path("jobs", TABLE).read_bytes() == whole
        assert Path("jobs", "report.md").exists()
        assert not list(Path("jobs").rglob("*.partial"))


def test_of_more_parts_than_shards_one_runs_nothing_and_says_so(plan, capsys):
    code, out, _ = command(capsys, "--part", "4/9", "--out", "out")
    assert code == 0
    assert "0 runs; there are fewer shards than parts, and none is its own" in out
    assert "6 runs are missing, of parts 1/9, 2/9, 3/9" in out
    assert not list(Path("out", SHARDS).iterdir())


def test_parts_of_different_plans_do_not_share_a_folder(plan):
    do_part(plan, Path("out"), Part(1, 3), HERE)
    Path("c.yaml").write_text(TEXT.replace("gated", "z_floor"))
    with pytest.raises(OutputError, match="another campaign"):
        do_part(campaign.plan("c.yaml"), Path("out"), Part(2, 3), HERE)


def test_parts_in_folders_apart_are_made_one_with_the_same_bytes(plan, whole, capsys):
    folders = apart(plan)
    merged(plan, folders, Path("out"))
    assert Path("out", TABLE).read_bytes() == whole
    assert sweep(plan, Path("out")).num_rows == 6  # a sweep like any other
    code, out, err = command(capsys, "--merge", *folders[1:], "--out", folders[0], "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["runs"] == 6
    assert Path(folders[0], TABLE).read_bytes() == whole


def test_a_merge_with_gaps_is_refused_and_names_the_runs(plan, capsys):
    one, two, three = apart(plan)
    code, out, err = command(capsys, "--merge", one, three, "--out", "out")
    assert (code, out) == (2, "")
    assert "2 of 6 runs are in none of the folders: 2 to 3" in err
    shard = two / SHARDS / "000001.parquet"
    shard.write_bytes(shard.read_bytes()[:-1])
    code, _, err = command(capsys, "--merge", one, two, three, "--out", "out")
    assert code == 2
    assert f"{shard} is damaged" in err
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("campaign", "another campaign"),
        ("mjmerge's code", "another mjmerge's code"),
        ("mujoco", r"another version of mujoco (9.9, now"),
        ("shards", "another size of shards"),
    ],
)
def test_a_merge_of_mixtures_is_refused_and_says_in_what_they_differ(plan, capsys, key, said):
    folders = apart(plan)
    for folder in folders[:2]:
        of = json.loads((folder / "plan.json").read_text())
        (of["versions"] if key == "mujoco" else of)[key] = "9.9"
        (folder / "plan.json").write_text(json.dumps(of))
    code, _, err = command(capsys, "--merge", *folders, "nowhere", "--out", "out")
    assert code == 2
    lines = err.splitlines()
    assert [line.removeprefix("mjmerge: ").split()[0] for line in lines] == ["p1", "p2", "nowhere"]
    assert said in lines[0]
    assert "holds no sweep" in lines[2]
    assert not Path("out").exists()


def test_other_rows_of_the_same_runs_are_no_part_of_one_sweep(plan):
    folders = apart(plan)
    shutil.copytree(folders[1], "other")
    shard = Path("other", SHARDS, "000001.parquet")
    rows = pq.read_table(shard)
    column = rows.column_names.index("least_z")
    write(rows.set_column(column, "least_z", [[9.0, 9.0]]), shard)
    with pytest.raises(MjmergeError, match=r"p2 and other have other rows of the same runs: 2 to 3"):
        merged(plan, [*folders, Path("other")], Path("out"))


@pytest.mark.parametrize(
    "words",
    [
        ("--merge",),
        ("--merge", "a", "--part", "1/2"),
        ("--ladder", "--part", "1/2"),
        ("--ladder", "--merge", "a"),
    ],
)
def test_options_that_do_not_go_together_are_refused(plan, capsys, words):
    code, out, err = command(capsys, *words)
    assert (code, out) == (2, "")
    assert "--merge" in err


def test_a_file_that_another_swept_up_while_it_was_written_is_written_again(plan, whole, monkeypatch):
    replace, swept = Path.replace, []

    def late(path, target):
        if len(swept) < 3:
            swept.append(path)
            path.unlink()
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", late)
    table = pq.read_table(Path("whole", TABLE))
    write(table, Path("again.parquet"))
    assert len(swept) == 3
    assert pq.read_table("again.parquet").equals(table)
    assert [path.name for path in Path().glob("again*")] == ["again.parquet"]
