"""What docs/recordings.md says is so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mjmerge.record import FORMATS, Header
from mjmerge.record.tables import fields, topics, unit
from mjmerge.simulation.trace import COLUMNS

from .conftest import MakeBlocks
from .test_recording import columns, record

DOC = Path(__file__).parents[2] / "docs" / "recordings.md"


@pytest.mark.parametrize(("name", "made"), [("fields", fields), ("topics", topics)])
def test_the_tables_are_those_of_the_declarations(name: str, made) -> None:
    (told,) = re.findall(rf"<!-- {name} -->\n(.*)<!-- /{name} -->", DOC.read_text(encoding="utf-8"), re.S)
    assert told == made()


def test_every_column_is_in_the_tables_with_its_unit() -> None:
    for c in COLUMNS:
        assert re.search(rf"^\| `{c.name}(\.{{[^}}]*}})*` \| {re.escape(unit(c.name))} ", fields(), re.M), (
            c.name
        )


def test_the_three_lines_for_pandas_load_a_recording(
    tmp_path: Path, header: Header, make_blocks: MakeBlocks, monkeypatch
) -> None:
    blocks = make_blocks(60, 7)
    record(tmp_path, header, blocks, {"run.rrd": FORMATS["run.rrd"]})
    (code,) = re.findall(r"```python\n(.*?)```", DOC.read_text(encoding="utf-8"), re.S)
    assert len([line for line in code.splitlines() if line]) == 3
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(code, names)
    d_2 = names["table"]["distance_m.vehicle_2"].to_numpy()
    assert d_2.tobytes() == columns(blocks)["distance_m"][:, 1].tobytes()


def test_every_picture_is_there() -> None:
    pictures = re.findall(r"!\[[^]]*\]\(([^)]*)\)", DOC.read_text(encoding="utf-8"))
    assert len(pictures) == 3
    assert all((DOC.parent / name).is_file() for name in pictures)
