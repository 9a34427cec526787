"""Recordings written again with something left out or changed, by other writers than ours."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
from mcap.reader import make_reader
from mcap.writer import Writer

import mjmerge.record.rerun.recorder  # noqa: F401  # Rerun is found once ours is imported

Edit = Callable[[str, bytes], bytes]


def mcap(
    source: Path,
    target: Path,
    *,
    keep: Callable[[str], bool] = lambda _: True,
    chunks: bool = True,
    shift_ns: int = 0,
    attachments: Mapping[str, bytes | None] | None = None,
    metadata: Mapping[str, dict[str, str] | None] | None = None,
    edit: Edit = lambda _, data: data,
    encoding: Callable[[str], str] = lambda _: "protobuf",
) -> Path:
    """An MCAP, through MCAP's own package: its index, checksums and summary section are right."""
    with source.open("rb") as old, target.open("wb") as new:
        reader, writer = make_reader(old), Writer(new, use_chunking=chunks)
        writer.start()
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, m in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if not keep(channel.topic):
                continue
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, encoding(channel.topic), schemas[schema.id], channel.metadata
                )
            at = m.log_time + shift_ns
            writer.add_message(channels[channel.id], at, edit(channel.topic, m.data), at, m.sequence)
        for a in reader.iter_attachments():
            data = (attachments or {}).get(a.name, a.data)
            if data is not None:
                writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, data)
        for note in reader.iter_metadata():
            said = (metadata or {}).get(note.name, note.metadata)
            if said is not None:
                writer.add_metadata(note.name, said)
        writer.finish()
    return target


def rrd(
    source: Path,
    target: Path,
    *,
    keep: Callable[[str], bool] = lambda _: True,
    edit: Callable[[str, pa.RecordBatch], pa.RecordBatch] | None = None,
) -> Path:
    """A Rerun recording, through Rerun's own reader and writer."""
    import rerun.chunk as rc

    def changed(chunk: Any) -> list[Any]:
        assert edit is not None
        batch = chunk.to_record_batch()
        new = edit(chunk.entity_path, batch)
        return [chunk] if new is batch else rc.Chunk.from_record_batch(new)

    stream = rc.RrdReader(source).stream()
    chunks = [c for c in stream if keep(c.entity_path)]
    if edit is not None:
        chunks = [new for chunk in chunks for new in changed(chunk)]
    rc.LazyChunkStream.from_iter(chunks).write_rrd(target, application_id="mjmerge_run", recording_id="again")
    return target


def with_text(batch: pa.RecordBatch, name: str, change: Callable[[str], str | None]) -> pa.RecordBatch:
    """A batch of one row whose text ``name`` is changed."""
    at = batch.schema.get_field_index(name)
    new = change(batch[name][0].as_py()[0])
    return batch.set_column(at, batch.schema.field(at), pa.array([[new]], batch.schema.field(at).type))
