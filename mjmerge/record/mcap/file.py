"""An MCAP file, record by record, with nothing taken on trust.

Sizes are held against bounds before anything is unpacked, and what a file says twice (checksums, indexes,
statistics, the summary section) is held against what is there. Chunks, an index and a summary are optional in
MCAP; what is there must be right.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK_BYTES = 32 * 2**20
"""Of a chunk, unpacked: ours are 256 KiB, other writers' a few MiB."""
UNPACKED_BYTES, UNPACKED_RATIO = 32 * 2**20, 40
"""All chunks together unpack to no more than the first, and the second times the size of the file."""
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_END_BYTES = 8 + 8 + 4  # of a footer
_MOST_FLAWS = 20


class DamagedError(ValueError):
    """What keeps a file from being read any further."""


class TooLargeError(DamagedError):
    """A size that a file declares and must not have; nothing was unpacked."""


@dataclass(frozen=True)
class Message:
    """A message, not decoded.

    Attributes:
        channel: id of its channel.
        time_ns: its log time.
        published_ns: its publish time.
        data: its bytes.
    """

    channel: int
    time_ns: int
    published_ns: int
    data: bytes


@dataclass
class McapFile:
    """One file while it is read: iterate over :meth:`read`.

    Attributes:
        path: the file.
        finished: whether the end was reached that the format wants.
        fault: why reading ended before; empty if it did not.
        flaws: where the file contradicts itself, in words.
    """

    path: Path
    finished: bool = False
    fault: str = ""
    flaws: list[str] = field(default_factory=list)

    def read(self) -> Iterator[Any]:
        """Schemas, channels, messages, attachments and metadata in the order of the file.

        Up to the end, or to what cannot be read: then ``fault`` says why.

        Raises:
            TooLargeError: something in it would unpack to more than may be.
        """
        try:
            with self.path.open("rb") as file:
                yield from _Walk(file, self.path.stat().st_size, self)
        except TooLargeError:
            raise
        except DamagedError as damage:
            self.fault = str(damage)
        except OSError as error:
            self.fault = error.strerror or str(error)

    def flaw(self, what: str) -> None:
        """Notes a contradiction."""
        if len(self.flaws) < _MOST_FLAWS and what not in self.flaws:
            self.flaws.append(what)


class _Walk:
    """From the first record to the last, once."""

    def __init__(self, file: BinaryIO, size: int, about: McapFile) -> None:
        self._file, self._size, self._about = file, size, about
        self._room = UNPACKED_BYTES + UNPACKED_RATIO * size
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._messages: Counter[int] = Counter()
        self._first_ns, self._last_ns = 2**64, 0
        self._chunks: dict[int, _Chunk] = {}
        self._open: _Chunk | None = None
        self._attached: dict[int, tuple[int, records.Attachment]] = {}
        self._metadata: dict[int, tuple[int, records.Metadata]] = {}
        self._crc = 0
        self._summary: _Summary | None = None

    def __iter__(self) -> Iterator[Any]:
        magic = self._take(len(MAGIC))
        if magic != MAGIC:
            raise DamagedError("it does not begin as an MCAP does")
        self._crc = zlib.crc32(magic)
        while not self._about.finished:
            at = self._file.tell()
            head = self._take(_HEAD.size)
            opcode, length = _HEAD.unpack(head)
            if length > self._size - self._file.tell():
                raise DamagedError("it ends within a record")
            before = self._crc
            content = self._take(length)
            self._crc = zlib.crc32(content, zlib.crc32(head, before))
            try:
                yield from self._record(at, opcode, content, before)
            except DamagedError:
                raise
            except (EndOfFile, struct.error, ValueError, OverflowError) as error:  # also of text that is none
                raise DamagedError(f"a damaged record at byte {at}") from error

    def _take(self, count: int) -> bytes:
        data = self._file.read(count)
        if len(data) < count:
            raise DamagedError("it ends within a record")
        return data

    def _record(self, at: int, opcode: int, content: bytes, before: int) -> Iterator[Any]:
        """What one record of the file holds."""
        length = _HEAD.size + len(content)
        if self._summary is not None:
            self._finish(at, opcode, content)
            return
        if opcode != Opcode.MESSAGE_INDEX:
            self._open = None
        stream = ReadDataStream(BytesIO(content))
        match opcode:
            case Opcode.CHUNK:
                yield from self._chunk(at, length, records.Chunk.read(stream))
            case Opcode.MESSAGE_INDEX:
                self._index(records.MessageIndex.read(stream), length)
            case Opcode.ATTACHMENT:
                attachment = records.Attachment.read(stream)
                (crc,) = struct.unpack_from("<I", content, len(content) - 4)
                if crc and crc != zlib.crc32(content[:-4]):
                    self._about.flaw(f"the checksum of the attachment {attachment.name} is wrong")
                self._attached[at] = length, attachment
                yield attachment
            case Opcode.METADATA:
                metadata = records.Metadata.read(stream)
                self._metadata[at] = length, metadata
                yield metadata
            case Opcode.DATA_END:
                (crc,) = struct.unpack_from("<I", content)
                if crc and crc != before:
                    self._about.flaw("the checksum of its data is wrong")
                self._summary = _Summary(at + length)
            case Opcode.HEADER:
                records.Header.read(stream)
            case Opcode.FOOTER:
                raise DamagedError("its data have no end")
            case _:
                yield from self._plain(opcode, content, None, 0)

    def _plain(self, opcode: int, content: bytes, chunk: _Chunk | None, at: int) -> Iterator[Any]:
        """What may stand in a chunk or outside of one."""
        if opcode == Opcode.MESSAGE:
            channel, _, time_ns, published_ns = _MESSAGE.unpack_from(content)
            self._messages[channel] += 1
            self._first_ns, self._last_ns = min(self._first_ns, time_ns), max(self._last_ns, time_ns)
            if channel not in self._channels:
                self._about.flaw(f"messages of a channel {channel} that it does not describe")
            if chunk is not None:
                chunk.entries[channel].append((time_ns, at))
            yield Message(channel, time_ns, published_ns, content[_MESSAGE.size :])
        elif opcode == Opcode.SCHEMA:
            schema = records.Schema.read(ReadDataStream(BytesIO(content)))
            if self._schemas.setdefault(schema.id, schema) != schema:
                self._about.flaw(f"two schemas of the number {schema.id}")
            yield schema
        elif opcode == Opcode.CHANNEL:
            described = records.Channel.read(ReadDataStream(BytesIO(content)))
            known = self._channels.setdefault(described.id, described)
            if known != described:
                self._about.flaw(f"two channels of the number {described.id}")
            elif sum(c.topic == described.topic for c in self._channels.values()) > 1:
                self._about.flaw(f"several channels of the topic {described.topic}")
            yield described

    def _chunk(self, at: int, length: int, chunk: records.Chunk) -> Iterator[Any]:
        """The records in a chunk."""
        data = self._unpacked(chunk)
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise DamagedError("the checksum of a chunk is wrong")
        mine = self._open = self._chunks[at] = _Chunk(at, length, chunk)
        place = 0
        while place < len(data):
            if place + _HEAD.size > len(data):
                raise DamagedError("a chunk ends within a record")
            opcode, size = _HEAD.unpack_from(data, place)
            end = place + _HEAD.size + size
            if end > len(data):
                raise DamagedError("a chunk ends within a record")
            yield from self._plain(opcode, data[place + _HEAD.size : end], mine, place)
            place = end
        times = [time_ns for entries in mine.entries.values() for time_ns, _ in entries]
        if times and (min(times), max(times)) != (chunk.message_start_time, chunk.message_end_time):
            self._about.flaw("a chunk says other times than its messages have")

    def _unpacked(self, chunk: records.Chunk) -> bytes:
        """A chunk's records; refused by the size that it declares, and never larger than that."""
        size = chunk.uncompressed_size
        self._room -= size
        if size > LARGEST_CHUNK_BYTES or self._room < 0:
            raise TooLargeError(
                f"a chunk would unpack to {size / 2**20:.3g} MiB; a chunk may have "
                f"{LARGEST_CHUNK_BYTES // 2**20} MiB, and all of them {UNPACKED_RATIO} times the file's size"
            )
        data = _decompressed(chunk.compression, chunk.data, size)
        if len(data) != size:
            raise DamagedError(f"a chunk has {len(data)} bytes, and says {size}")
        return data

    def _index(self, index: records.MessageIndex, length: int) -> None:
        """An index of a channel's messages in the chunk before it."""
        if self._open is None:
            self._about.flaw("an index of messages without a chunk")
            return
        entries = self._open.entries.get(index.channel_id, [])
        if sorted(index.records) != sorted(entries):
            self._about.flaw("the index of a chunk is not that of its messages")
        self._open.index_at[index.channel_id] = self._file.tell() - length
        self._open.index_length += length

    def _finish(self, at: int, opcode: int, content: bytes) -> None:
        """A record of the summary section, or the footer."""
        summary = self._summary
        assert summary is not None, "the data have ended"
        if opcode != Opcode.FOOTER:
            summary.add(at, opcode, content)
            return
        footer = records.Footer.read(ReadDataStream(BytesIO(content)))
        for flaw in self._contradictions(summary, footer):
            self._about.flaw(flaw)
        if footer.summary_crc:
            start = footer.summary_start or at
            self._file.seek(start)
            data = self._file.read(at + _HEAD.size + 16 - start) if start <= at else b""
            if zlib.crc32(data) != footer.summary_crc:
                self._about.flaw("the checksum of its summary section is wrong")
            self._file.seek(at + _HEAD.size + len(content))
        if self._take(len(MAGIC)) != MAGIC or self._file.tell() != self._size:
            raise DamagedError("it does not end as an MCAP does")
        self._about.finished = True

    def _contradictions(self, summary: _Summary, footer: records.Footer) -> Iterator[str]:
        """Where the summary section is not a summary of the file."""
        if footer.summary_start != (summary.start if summary.records else 0):
            yield "its footer says another place of the summary section"
        if summary.unreadable:
            yield "its summary section is damaged"
        groups = summary.groups()
        offsets, _ = groups.get(Opcode.SUMMARY_OFFSET, (0, 0))
        if footer.summary_offset_start not in (0, offsets):
            yield "its footer says another place of the summary's offsets"
        for offset in summary.of(Opcode.SUMMARY_OFFSET, records.SummaryOffset):
            if offset.group_length and groups.get(offset.group_opcode) != (
                offset.group_start,
                offset.group_length,
            ):
                yield "an offset in its summary points elsewhere"
        for kind, there, repeated in (
            ("schemas", self._schemas, summary.of(Opcode.SCHEMA, records.Schema)),
            ("channels", self._channels, summary.of(Opcode.CHANNEL, records.Channel)),
        ):
            if repeated and {one.id: one for one in repeated} != there:
                yield f"the {kind} in its summary are others"
        chunks = summary.of(Opcode.CHUNK_INDEX, records.ChunkIndex)
        if chunks and chunks != [c.index() for c in self._chunks.values()]:
            yield "the index of its chunks is wrong"
        if any(c.index_at and c.index_at.keys() != c.entries.keys() for c in self._chunks.values()):
            yield "the index of a chunk lacks a channel"
        attached = summary.of(Opcode.ATTACHMENT_INDEX, records.AttachmentIndex)
        if attached and attached != [
            records.AttachmentIndex(
                start, length, a.log_time, a.create_time, len(a.data), a.name, a.media_type
            )
            for start, (length, a) in self._attached.items()
        ]:
            yield "the index of its attachments is wrong"
        metadata = summary.of(Opcode.METADATA_INDEX, records.MetadataIndex)
        if metadata and metadata != [
            records.MetadataIndex(start, length, m.name) for start, (length, m) in self._metadata.items()
        ]:
            yield "the index of its metadata is wrong"
        for counted in summary.of(Opcode.STATISTICS, records.Statistics):
            if counted != self._statistics(counted):
                yield "its statistics are not those of the file"

    def _statistics(self, like: records.Statistics) -> records.Statistics:
        """What there is in the file, counted; channels without a message may be listed or not."""
        some = bool(self._messages)
        counts = {c: self._messages[c] for c in self._messages.keys() | like.channel_message_counts.keys()}
        return records.Statistics(
            attachment_count=len(self._attached),
            channel_count=len(self._channels),
            channel_message_counts=counts,
            chunk_count=len(self._chunks),
            message_count=self._messages.total(),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns if some else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


class _Chunk:
    """A chunk as it is, to hold its index against."""

    def __init__(self, at: int, length: int, chunk: records.Chunk) -> None:
        self.at, self.length = at, length
        self.compression, self.packed_bytes = chunk.compression, len(chunk.data)
        self.unpacked_bytes = chunk.uncompressed_size
        self.start_ns, self.end_ns = chunk.message_start_time, chunk.message_end_time
        self.entries: dict[int, list[tuple[int, int]]] = defaultdict(list)
        self.index_at: dict[int, int] = {}
        self.index_length = 0

    def index(self) -> records.ChunkIndex:
        """What its index must say."""
        return records.ChunkIndex(
            chunk_length=self.length,
            chunk_start_offset=self.at,
            compression=self.compression,
            compressed_size=self.packed_bytes,
            message_end_time=self.end_ns,
            message_index_length=self.index_length,
            message_index_offsets=self.index_at,
            message_start_time=self.start_ns,
            uncompressed_size=self.unpacked_bytes,
        )


class _Summary:
    """The records of the summary section."""

    def __init__(self, start: int) -> None:
        self.start = start
        self.records: list[tuple[int, int, int]] = []
        self.unreadable = False
        self._contents: dict[int, list[bytes]] = defaultdict(list)

    def add(self, at: int, opcode: int, content: bytes) -> None:
        self.records.append((opcode, at, _HEAD.size + len(content)))
        self._contents[opcode].append(content)

    def groups(self) -> dict[int, tuple[int, int]]:
        """Where the records of each kind begin, and how long they are together."""
        found: dict[int, tuple[int, int]] = {}
        for opcode, at, length in self.records:
            start, before = found.get(opcode, (at, 0))
            found[opcode] = start, before + length
        return found

    def of(self, opcode: int, kind: Any) -> list[Any]:
        """The records of a kind."""
        try:
            return [kind.read(ReadDataStream(BytesIO(content))) for content in self._contents[opcode]]
        except (EndOfFile, struct.error, ValueError, OverflowError):
            self.unreadable = True
            return []


def _decompressed(compression: str, data: bytes, size: int) -> bytes:
    """The bytes of a chunk, ``size`` of them, or as many as there are if they are fewer."""
    match compression:
        case "":
            return data
        case "zstd":
            import zstandard

            try:
                with zstandard.ZstdDecompressor().stream_reader(BytesIO(data)) as unpacked:
                    return unpacked.read(size + 1)
            except zstandard.ZstdError as error:
                raise DamagedError("a chunk does not unpack") from error
        case "lz4":
            from lz4.frame import LZ4FrameDecompressor

            try:
                out: bytes = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
            except RuntimeError as error:
                raise DamagedError("a chunk does not unpack") from error
            return out
    raise DamagedError(f"a chunk is packed in a way that is not MCAP's: {compression[:20]!r}")
