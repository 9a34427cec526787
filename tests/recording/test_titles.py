"""Whatever shows a run says what ran: its scenario, plant and seed, every mismatch, and all that was set."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from mjmerge.record.read import read
from mjmerge.record.report import finished, unfinished
from mjmerge.record.rerun.reader import rrd_batches
from mjmerge.review.captions import title
from mjmerge.review.compare import Side, figure, labels, recording_of_both
from mjmerge.review.compare import table as both
from mjmerge.review.poses import outcome
from mjmerge.review.verify import verify
from mjmerge.review.view import write_view
from mjmerge.run import run
from mjmerge.scenario.load import load
from mjmerge.scenario.ran import beneath, ran
from mjmerge.search.explain import explain
from tests.recording.forge import Forger

SET = ["duration_s=0.3", "law.k_o=0.4", "mismatch.command_delay_s=0.02"]
SAID = ("mismatch: command_delay_s 0.02", "set: duration_s=0.3, law.k_o=0.4")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("titles")
    assert run(load("charge", SET), "bicycle", folder=made).failures == []
    return made


def texts(path: Path) -> str:
    """All that a Rerun recording says in words."""
    return "\n".join(
        str(batch[name].to_pylist())
        for _, batch in rrd_batches(path)
        for name in batch.schema.names
        if name in ("TextDocument:text", "RecordingInfo:name")
    )


@pytest.mark.parametrize("kind", ["mcap", "rrd"])
def test_a_recording_remembers_what_was_set(folder: Path, kind: str) -> None:
    found = read(folder / f"run.{kind}")
    said = ran(found.scenario(), "bicycle", 0)
    assert said == ["charge on bicycle, seed 0", *SAID]
    assert verify(folder / f"run.{kind}").right
    with_nothing = load("charge", ["duration_s=0.3"]).settled()
    assert "set" in found.manifest
    assert ran(with_nothing, "bicycle")[1:] == ["set: duration_s=0.3"]
    assert beneath(load("charge"), "bicycle") == []


def test_the_name_and_the_report_of_a_recording_say_it(folder: Path, tmp_path: Path) -> None:
    write_view(folder / "run.mcap", tmp_path / "view.rrd")
    for path in (folder / "run.rrd", tmp_path / "view.rrd"):
        said = texts(path)
        assert f"charge on bicycle, seed 0; {SAID[0]}; {SAID[1]}" in said  # the name
        assert f"**{SAID[0]}; {SAID[1]}**" in said  # the report
    one = Forger(folder / "run.mcap")
    for report in (unfinished(one.about), finished(one.about, one.true)):
        assert report.startswith(f"### charge on bicycle, seed 0\n\n**{SAID[0]}; {SAID[1]}**\n")


def test_a_comparison_says_it_of_each_side(folder: Path, tmp_path: Path) -> None:
    run(load("charge", ["duration_s=0.3"]), "bicycle", folder=tmp_path / "as_it_is")
    sides = [Side.of(read(at / "run.mcap")) for at in (folder, tmp_path / "as_it_is")]
    recording_of_both(*sides, tmp_path / "both.rrd")
    said = texts(tmp_path / "both.rrd")
    assert "### charge: mismatch.command_delay_s=0.02, law.k_o=0.4 and as it is\\n" in said
    assert "| mismatch | command_delay_s 0.02 | - |" in said
    assert "| set | duration_s=0.3, law.k_o=0.4 | duration_s=0.3 |" in said
    rows = {cells[0]: cells[1:3] for cells in zip(*(c._cells for c in both(*sides).columns), strict=True)}
    assert rows["mismatch"] == ("command_delay_s 0.02", "-")


def side(folder: Path, *said: str, plant: str = "bicycle", at: str = "run.mcap") -> Side:
    """The run of a folder as if it had been given this, in another file."""
    one, mismatch = Side.of(read(folder / "run.mcap")), load("charge", said).mismatch
    scenario = load("charge", [text for text in said if not text.startswith("mismatch.")])
    trace = replace(one.trace, scenario=scenario, mismatch=(mismatch,), plant=plant)
    return replace(one, trace=trace, recorded=replace(one.recorded, path=Path(at)))


def test_runs_that_are_compared_are_called_by_what_is_different_of_them(folder: Path) -> None:
    icy, slow, short = "mismatch.friction=0.5", "law.k_o=0.4", "duration_s=0.3"
    as_it_is, other = side(folder), side(folder, icy)
    assert labels(as_it_is, other) == ("as it is", icy)
    assert labels(side(folder, short), side(folder, icy, slow, short)) == ("as it is", f"{icy}, {slow}")
    assert labels(side(folder, icy), side(folder, "mismatch.friction=0.7")) == (icy, "mismatch.friction=0.7")
    assert labels(as_it_is, side(folder, slow), other) == ("as it is", slow, icy)
    on = "charge on bicycle, seed 0"
    ideal = side(folder, icy, plant="mujoco")
    assert labels(as_it_is, ideal) == (on, "charge on mujoco, seed 0")
    assert labels(as_it_is, other, ideal) == (
        f"{on}, as it is", f"{on}, {icy}", f"charge on mujoco, seed 0, {icy}",
    )  # fmt: skip


def test_runs_that_differ_in_nothing_that_is_said_are_called_by_their_files(folder: Path) -> None:
    a, b = side(folder, at="a/run.mcap"), side(folder, at="b/run.mcap")
    assert labels(a, b) == ("A: a/run.mcap", "B: b/run.mcap")
    assert labels(a, a) == ("A: a/run.mcap", "B: a/run.mcap")
    assert labels(a, b, side(folder, "law.k_o=0.4", at="c"))[2] == "C: c"


def test_whatever_is_compared_has_a_name_of_its_own(folder: Path) -> None:
    said = ((), ("mismatch.friction=0.5",), ("mismatch.friction=0.5", "law.k_o=0.4"), ("law.kind=mpc",))
    sides = [side(folder, *one, plant=plant, at="run") for one in said for plant in ("bicycle", "mujoco")]
    for many in (2, 3):
        for some in product(sides, repeat=many):
            names = labels(*some)
            assert len({*names}) == len(names) == many


def test_the_title_of_a_comparison_says_nothing_twice(folder: Path, tmp_path: Path, monkeypatch) -> None:
    heads: list[tuple[str, ...]] = []
    monkeypatch.setattr("mjmerge.figures.runs.head", lambda _, *lines: heads.append(lines))
    figure(side(folder), side(folder, "mismatch.friction=0.5"), tmp_path / "1.png")
    figure(side(folder), side(folder), tmp_path / "2.png")
    on = "charge on bicycle, seed 0"
    assert heads[0] == (f"A: {on}", f"B: {on}; mismatch: friction 0.5")
    assert heads[1] == (f"A: run.mcap; {on}", f"B: run.mcap; {on}")


def test_a_video_has_it_above_the_picture_with_the_verdict_in_red_where_it_broke(folder: Path) -> None:
    about = Forger(folder / "run.mcap").about
    safe = title(about.ran, "held", {"floor_held": True}, 640)
    broken = title(about.ran, "refuted", {"reason": "the ego hits vehicle_1", "floor_held": False}, 640)
    assert safe.shape == broken.shape == (4 * 20 + 12, 640, 3)
    reds = [int((p[..., 0] > p[..., 1].astype(int) + 80).sum()) for p in (safe, broken)]
    assert reds[0] == 0
    assert reds[1] > 50
    bare = title(["charge on bicycle, seed 0"], "held", {}, 640)
    assert len(bare) < len(safe), "every line has its place"
    crowded = title([f"line {k}" for k in range(40)], "held", {}, 640)
    assert len(crowded) < 200
    assert np.array_equal(crowded[-26:], title(["line"], "held", {}, 640)[-26:]), "the verdict stays"


@pytest.mark.parametrize(
    "lie", ["law.k_o=0.5", "law.k_v=1000", "duration_s=12", "law.no_such_key=1", "law.variant=gated"]
)
def test_a_recording_that_says_something_else_was_set_is_found(
    folder: Path, tmp_path: Path, lie: str
) -> None:
    one = Forger(folder / "run.mcap")
    one.about = replace(one.about, scenario=one.about.scenario.recalling((lie,)))
    path = one.store(tmp_path, one.block, one.true)
    again = read(path)
    one.true = outcome(again, again.trace())
    found = verify(one.store(tmp_path, one.block, one.true))
    wrong = {check.name: check.says for check in found.checks if check.right is False}
    assert lie in wrong["manifest"]
    assert "fingerprints" not in wrong


def test_an_explanation_is_of_a_scenario_that_tells_what_was_set() -> None:
    found = explain(load("charge", SET), "bicycle")
    assert ran(found.scenario, "bicycle")[1:] == [*SAID]
