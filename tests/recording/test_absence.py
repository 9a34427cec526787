"""What is not in a recording, or cannot be, is never called right: exit code 1, or 2 and one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mjmerge.errors import MjmergeError, UnreadableError
from mjmerge.record.read import read
from mjmerge.review.compare import Side
from mjmerge.review.replay import replay
from mjmerge.review.verify import Verified, verify
from mjmerge.run import run
from mjmerge.scenario.load import load
from tests.recording import rewrite


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that touches: its verdict is worth hiding."""
    folder = tmp_path_factory.mktemp("run")
    stands = ["initial.ego.front_m=[-0.9, 0.0]", "initial.ego.speed_mps=0.0", "law.k_o=0", "law.k_p=0"]
    run(load("paper", ["duration_s=1.0", *stands, "law.k_v=0"]), "double_integrator", folder=folder)
    return folder


def wrong(found: Verified) -> dict[str, str]:
    return {check.name: check.says for check in found.checks if check.right is False}


def test_rewritten_by_other_writers_it_stays_right(folder: Path, tmp_path: Path) -> None:
    mcap = folder / "run.mcap"
    assert verify(rewrite.mcap(mcap, tmp_path / "chunks.mcap")).right
    assert verify(rewrite.mcap(mcap, tmp_path / "unchunked.mcap", chunks=False)).right
    assert verify(rewrite.rrd(folder / "run.rrd", tmp_path / "again.rrd")).right


@pytest.mark.parametrize("topic", ["/law", "/car/ego", "/car/vehicle_2"])
def test_without_a_series_it_is_wrong_and_says_which(folder: Path, tmp_path: Path, topic: str) -> None:
    for kind, again in (("mcap", rewrite.mcap), ("rrd", rewrite.rrd)):
        found = verify(again(folder / f"run.{kind}", tmp_path / f"less.{kind}", keep=lambda t: t != topic))
        assert not found.right
        assert topic in wrong(found)["contents"]
        assert "without a whole tick" in wrong(found)["contents"]


@pytest.mark.parametrize("claim", ["held", "vacuous"])
@pytest.mark.parametrize("summary", [None, b"null", b"{}"])
def test_a_verdict_without_its_summary_is_wrong(
    folder: Path, tmp_path: Path, claim: str, summary: bytes | None
) -> None:
    path = rewrite.mcap(
        folder / "run.mcap",
        tmp_path / "claims.mcap",
        attachments={"summary.json": summary},
        metadata={"outcome": {"verdict": claim}},
    )
    found = verify(path)
    assert not found.right
    assert {"contents"} <= set(wrong(found)) or {"verdict", "summary"} <= set(wrong(found))
    assert found.verdict is not None
    assert found.verdict.verdict == "assumption broken"


@pytest.mark.parametrize("summary", ["null", "{}"])
def test_in_an_rrd_too(folder: Path, tmp_path: Path, summary: str) -> None:
    def edit(entity: str, batch: Any) -> Any:
        if entity != "/__properties/outcome":
            return batch
        batch = rewrite.with_text(batch, "summary", lambda _: summary)
        return rewrite.with_text(batch, "verdict", lambda _: "held")

    found = verify(rewrite.rrd(folder / "run.rrd", tmp_path / "claims.rrd", edit=edit))
    assert not found.right
    assert "verdict" in wrong(found)


@pytest.mark.parametrize("kind", ["mcap", "rrd"])
def test_a_verdict_without_fingerprints_is_wrong(folder: Path, tmp_path: Path, kind: str) -> None:
    def edit(entity: str, batch: Any) -> Any:
        outcome = entity == "/__properties/outcome"
        return rewrite.with_text(batch, "sha256", lambda _: "{}") if outcome else batch

    path = tmp_path / f"bare.{kind}"
    if kind == "mcap":
        rewrite.mcap(folder / "run.mcap", path, metadata={"sha256": None})
    else:
        rewrite.rrd(folder / "run.rrd", path, edit=edit)
    assert "fingerprints" in wrong(verify(path))


def test_times_outside_the_scenario_are_told(folder: Path, tmp_path: Path) -> None:
    shifted = rewrite.mcap(folder / "run.mcap", tmp_path / "shifted.mcap", shift_ns=1_700_000_000 * 10**9)
    found = verify(shifted)
    assert not found.right
    assert "1700000000.00 s" in wrong(found)["time"]
    for asked in (replay, lambda path: Side.of(read(path))):
        with pytest.raises(UnreadableError, match="none of its ticks is at a time of its scenario"):
            asked(shifted)


@pytest.mark.parametrize("topic", ["/law", "/car/ego", "/tf", "/scene", "/log", "/phases"])
def test_a_channel_that_cannot_be_decoded_is_wrong(folder: Path, tmp_path: Path, topic: str) -> None:
    garbled = rewrite.mcap(
        folder / "run.mcap",
        tmp_path / "garbled.mcap",
        edit=lambda t, data: b"\xff" + data[1:] if t == topic else data,
    )
    assert not verify(garbled).right
    foreign = rewrite.mcap(
        folder / "run.mcap",
        tmp_path / "foreign.mcap",
        encoding=lambda t: "ros1" if t == topic else "protobuf",
    )
    found = verify(foreign)
    assert not found.right
    assert topic in wrong(found)["contents"]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("control_step_s", 0),
        ("control_step_s", "0.01"),
        ("control_step_s", 1e-300),
        ("seed", "abc"),
        ("seed", 2**64),
        ("seed", None),
        ("columns", 5),
        ("columns", [5]),
        ("versions", []),
        ("acceptance", {"rc": 5}),
        ("plant", "warp drive"),
        ("continuous", "no"),
        ("sheets", {}),
        ("sheets", {"ego": {}, "vehicle_1": {}, "vehicle_2": {}}),
        ("scenario", 5),
    ],
)
def test_a_manifest_of_wrong_types_is_unreadable_and_says_where(
    folder: Path, tmp_path: Path, key: str, value: Any
) -> None:
    manifest = read(folder / "run.mcap").manifest | {key: value}
    path = tmp_path / "manifest.mcap"
    rewrite.mcap(folder / "run.mcap", path, attachments={"manifest.json": json.dumps(manifest).encode()})
    with pytest.raises(UnreadableError, match=rf"manifest\.json: {key}"):
        verify(path)


@pytest.mark.parametrize("key", ["min_distance_m", "t_min_distance_s", "floor_m", "merged_at_s", "stops"])
def test_a_summary_of_wrong_types_is_unreadable_and_says_where(
    folder: Path, tmp_path: Path, key: str
) -> None:
    summary = dict(read(folder / "run.mcap").summary or {}) | {key: ["abc"]}
    path = tmp_path / "summary.mcap"
    rewrite.mcap(folder / "run.mcap", path, attachments={"summary.json": json.dumps(summary).encode()})
    with pytest.raises(UnreadableError, match=rf"summary\.json: {key}"):
        verify(path)


def test_a_world_that_lacks_an_actuator_is_not_run(tmp_path: Path) -> None:
    run(load("paper", ["duration_s=0.1"]), "mujoco", folder=tmp_path / "run")
    source = tmp_path / "run" / "run.mcap"
    world = read(source).world_xml.replace("ego/steer_front_right", "ego/steer_fr_nt_right").encode()
    path = rewrite.mcap(source, tmp_path / "lacks.mcap", attachments={"world.xml": world})
    with pytest.raises(MjmergeError, match="lacks something of ego"):
        replay(path)


@pytest.mark.parametrize("name", ["manifest.json", "summary.json"])
@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"[" * 200_000, "nested more than"),
        (b'{"a":' * 5000 + b"1" + b"}" * 5000, "nested more than"),
        (b"{]", "not JSON"),
        (b"\xff\xfe", "not text in UTF-8"),
        (b"[]", "not a mapping"),
        (b" " * 9_000_000, "may have 8 MiB"),
    ],
)
def test_json_that_is_none_is_unreadable(
    folder: Path, tmp_path: Path, name: str, text: bytes, says: str
) -> None:
    path = rewrite.mcap(folder / "run.mcap", tmp_path / "json.mcap", attachments={name: text})
    with pytest.raises(UnreadableError, match=says):
        verify(path)


def test_a_chunk_is_refused_by_the_size_that_it_declares(folder: Path, tmp_path: Path) -> None:
    data = bytearray((folder / "run.mcap").read_bytes())
    at = 8
    while data[at] != 6:  # a chunk: its length, two times, then what it unpacks to
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    data[at + 25 : at + 33] = (3 * 2**30).to_bytes(8, "little")
    path = tmp_path / "bomb.mcap"
    path.write_bytes(data)
    with pytest.raises(UnreadableError, match="a chunk may have 32 MiB"):
        verify(path)


def _footer(data: bytearray) -> int:
    return len(data) - 8 - 20


INDEX: dict[str, Callable[[bytearray], int]] = {
    "where the summary begins": lambda data: _footer(data),
    "its checksum": lambda data: _footer(data) + 16,
    "its last record": lambda data: _footer(data) - 9 - 1,
    "the statistics": lambda data: data.rindex(b"\x0b", 0, data.rindex(b"\x0a", 0, _footer(data)) - 9) + 9,
}


@pytest.mark.parametrize("what", INDEX)
def test_an_index_that_is_another_files_is_wrong(folder: Path, tmp_path: Path, what: str) -> None:
    data = bytearray((folder / "run.mcap").read_bytes())
    data[INDEX[what](data)] ^= 1
    path = tmp_path / "index.mcap"
    path.write_bytes(data)
    found = verify(path)
    assert not found.right
    assert "contents" in wrong(found) or "file" in wrong(found)


@pytest.mark.parametrize(
    "column",
    [
        {"name": []},
        {"name": {}},
        {},
        {"name": "x_m", "symbol": 1, "doc": "", "axes": []},
        {"name": "x_m", "symbol": "x", "doc": "", "axes": [["a", "b"]]},
        {"name": "/x", "symbol": "", "doc": "", "axes": []},
    ],
)
def test_a_column_that_no_law_can_record_is_told_whatever_stands_for_it(column):
    from mjmerge.record import content

    with pytest.raises(content.ContentError, match=r"manifest.json: columns: "):
        content.signals_of({"columns": [column]})


def test_of_a_file_without_its_manifest_no_signals_are_known():
    from mjmerge.record import content, schema

    assert content.signals_of({}) == ()
    assert schema.Wire.of({}).signals == ()
