"""Damaged recordings by the hundred: seeded, and aware of what the bytes are."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mjmerge.record.read import read
from tests.recording import rewrite

Rng = np.random.Generator
Damage = Callable[[Path, Path, Rng], None]
_RECORD, _FRAME = struct.Struct("<BQ"), struct.Struct("<QQ")
_HOSTILE = (0, 1, 2**16, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
_ODD: tuple[Any, ...] = (
    None, True, 0, -1, 5, 1e300, float("nan"), 2**70, "", "abc", "x" * 10_000, [], [5], [[]], {}, {"a": 1},
    [[[[[[[[[[[[[[[[[[[[[[[[[0]]]]]]]]]]]]]]]]]]]]]]]]], "\x00", "../../etc/passwd",
)  # fmt: skip


def flips(source: Path, target: Path, rng: Rng) -> None:
    """Some bits are another."""
    data = bytearray(source.read_bytes())
    for at in rng.integers(0, len(data), rng.integers(1, 9)):
        data[at] ^= 1 << int(rng.integers(8))
    target.write_bytes(data)


def bytes_replaced(source: Path, target: Path, rng: Rng) -> None:
    """A stretch of bytes is something else."""
    data = bytearray(source.read_bytes())
    at, length = int(rng.integers(len(data))), int(rng.integers(1, 200))
    data[at : at + length] = rng.bytes(int(rng.integers(0, 200)))
    target.write_bytes(data)


def truncated(source: Path, target: Path, rng: Rng) -> None:
    """The end is missing, or the beginning."""
    data = source.read_bytes()
    at = int(rng.integers(len(data)))
    target.write_bytes(data[:at] if rng.random() < 0.9 else data[at:])


def parts(data: bytes, kind: str) -> list[tuple[int, int]]:
    """Where the records of an MCAP, or the frames of an .rrd, begin and end."""
    found, at = [], 8 if kind == "mcap" else 12
    head = _RECORD if kind == "mcap" else _FRAME
    while at + head.size <= len(data):
        tag, length = head.unpack_from(data, at)
        end = at + head.size + length
        if end > len(data):
            break
        found.append((at, end))
        at = end
        if kind == "rrd" and tag == 0:
            break
    return found


def moved(source: Path, target: Path, rng: Rng) -> None:
    """Records stand elsewhere, twice, or not at all."""
    data, kind = source.read_bytes(), source.suffix[1:]
    there = parts(data, kind)
    pieces = [data[a:b] for a, b in there]
    i, j = (int(k) for k in rng.integers(0, len(pieces), 2))
    match int(rng.integers(3)):
        case 0:
            pieces.insert(j, pieces.pop(i))
        case 1:
            pieces.insert(j, pieces[i])
        case _:
            del pieces[i]
    target.write_bytes(data[: there[0][0]] + b"".join(pieces) + data[there[-1][1] :])


def hostile(source: Path, target: Path, rng: Rng) -> None:
    """A length or a count in the file is one that nobody could mean."""
    data, kind = bytearray(source.read_bytes()), source.suffix[1:]
    start, end = parts(bytes(data), kind)[int(rng.integers(len(parts(bytes(data), kind))))]
    value = int(rng.choice(np.array(_HOSTILE, dtype=object)))
    if rng.random() < 0.4:
        at = start + (1 if kind == "mcap" else 8)
    else:
        at = int(rng.integers(start, max(start + 1, end - 8)))
    data[at : at + 8] = struct.pack("<Q", value)
    target.write_bytes(data[: source.stat().st_size])


def garbled(source: Path, target: Path, rng: Rng) -> None:
    """The container is right, with right checksums, and some of what is in it is not."""
    often = float(rng.choice([0.002, 0.05, 1.0]))

    def change(data: bytes) -> bytes:
        if rng.random() > often or not data:
            return data
        new = bytearray(data)
        for at in rng.integers(0, len(new), rng.integers(1, 4)):
            new[at] = int(rng.integers(256))
        return bytes(new)

    if source.suffix == ".mcap":
        topics = ["/law", "/car/ego", "/car/vehicle_1", "/car/vehicle_2", "/tf", "/scene", "/log", "/phases"]
        which = str(rng.choice(topics))
        rewrite.mcap(source, target, edit=lambda topic, data: change(data) if topic == which else data)
        return
    _edited(source, target, rng)


def left_out(source: Path, target: Path, rng: Rng) -> None:
    """Some of what is in it is not, in a container that is right."""
    again = rewrite.mcap if source.suffix == ".mcap" else rewrite.rrd
    share = float(rng.choice([0.02, 0.3]))
    gone: dict[str, bool] = {}
    again(source, target, keep=lambda name: gone.setdefault(name, bool(rng.random() > share)))


def _edited(source: Path, target: Path, rng: Rng) -> None:
    """An .rrd in which the rows of one entity are fewer, doubled, or another's."""
    import pyarrow as pa

    entities: dict[str, int] = {}
    rewrite.rrd(source, target, keep=lambda name: entities.setdefault(name, 1) > 0)
    which = str(rng.choice(sorted(entities)))
    how = int(rng.integers(3))

    def edit(entity: str, batch: pa.RecordBatch) -> pa.RecordBatch:
        if entity != which:
            return batch
        if how == 0:
            return batch.slice(0, max(1, batch.num_rows // 2))
        order = rng.permutation(batch.num_rows)
        at = int(rng.integers(batch.num_columns))
        column = batch.column(at).take(pa.array(order))
        return batch.set_column(at, batch.schema.field(at), column)

    target.unlink()
    rewrite.rrd(source, target, edit=edit)


def wrong_types(source: Path, target: Path, rng: Rng) -> None:
    """Something in the manifest, the summary, or a text is of another type."""
    name = str(rng.choice(["manifest.json", "summary.json", "scenario.yaml", "world.xml"]))
    found = read(source)
    if name.endswith(".json"):
        value: Any = json.loads(json.dumps(found.manifest if name == "manifest.json" else found.summary))
        holder = value
        while True:
            key = rng.choice(list(holder)) if isinstance(holder, dict) else int(rng.integers(len(holder)))
            inner = holder[key]
            if not inner or not isinstance(inner, dict | list) or rng.random() < 0.5:
                break
            holder = inner
        holder[key] = _ODD[int(rng.integers(len(_ODD)))]
        text = json.dumps(value)
    else:
        text = found.scenario_yaml if name == "scenario.yaml" else found.world_xml
        at, length = int(rng.integers(len(text))), int(rng.integers(0, 30))
        text = text[:at] + str(_ODD[int(rng.integers(len(_ODD)))]) + text[at + length :]
    if source.suffix == ".mcap":
        rewrite.mcap(source, target, attachments={name: text.encode("utf-8", "replace")})
        return
    where = {
        "manifest.json": ("/__properties/run", "manifest"),
        "summary.json": ("/__properties/outcome", "summary"),
        "scenario.yaml": ("/run/scenario", "TextDocument:text"),
        "world.xml": ("/run/world", "TextDocument:text"),
    }[name]

    def edit(entity: str, batch: Any) -> Any:
        there = entity == where[0] and where[1] in batch.schema.names
        return rewrite.with_text(batch, where[1], lambda _: text) if there else batch

    rewrite.rrd(source, target, edit=edit)


DAMAGES: dict[str, Damage] = {
    "flips": flips,
    "bytes replaced": bytes_replaced,
    "truncated": truncated,
    "moved": moved,
    "hostile": hostile,
    "garbled": garbled,
    "left out": left_out,
    "wrong types": wrong_types,
}
"""What is done to a recording, by name."""
