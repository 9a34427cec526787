"""What is in an MCAP, finished or not, through a reader that shares nothing with the writer of MCAP.

A file that was cut off or damaged is read up to the first record that cannot be.
"""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from google.protobuf.message import DecodeError
from mcap.records import Attachment, Channel, Metadata, Schema

from mjmerge.record import content
from mjmerge.record.content import ContentError
from mjmerge.record.contents import Found
from mjmerge.record.manifest import EXPLANATION, SCHEMA_VERSIONS
from mjmerge.record.mcap.file import McapFile, Message
from mjmerge.state import NS_PER_S

if TYPE_CHECKING:
    from mjmerge.record.schema import Field

_LATEST_NS = 2**62
"""No time in a file that can be read is later."""
_MOST_FOREIGN = 20_000
"""Messages of another layout than ours that are decoded one by one; other writers keep the layout."""
TEXTS = ("scenario.yaml", "world.xml", "manifest.json", "summary.json", EXPLANATION, "foxglove.json")
"""The attachments of a recording; of why it fails there is one only where somebody asked."""
_DRAWN = {
    "/tf": "foxglove.FrameTransforms",
    "/scene": "foxglove.SceneUpdate",
    "/log": "foxglove.Log",
    "/phases": "foxglove.Log",
}
LOOK, _CLOUD = "/look/", "foxglove.PointCloud"
"""How the topics of points begin, and what they hold; see ``clouds.py``."""
Decode = Callable[[bytes], Any]


def mcap_messages(path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """Time, ns, and content of every message of a topic, as far as the file can be read."""
    channels = _Channels(Found())
    for record in McapFile(path).read():
        match record:
            case Schema() | Channel():
                channels.add(record)
            case Message() if channels.topic(record) == topic:
                try:
                    yield record.time_ns, channels.decoded(record)
                except DecodeError:
                    return


def mcap_drawn(path: Path) -> Iterator[tuple[str, int, Any]]:
    """Topic, time, ns, and content of every message that is shown, as far as the file can be read."""
    channels = _Channels(Found())
    for record in McapFile(path).read():
        match record:
            case Schema() | Channel():
                channels.add(record)
            case Message() if (topic := channels.topic(record)) and topic.startswith((*_DRAWN, LOOK)):
                try:
                    yield topic, record.time_ns, channels.decoded(record)
                except DecodeError:
                    return


@contextmanager
def sound(path: Path) -> Iterator[Path]:
    """An MCAP that other readers can be given: the file, or a copy of what in it can be read.

    They take for granted what a damaged file says of its sizes, and may take the process down.
    """
    from mcap.writer import Writer

    found, file = Found(), McapFile(path)
    channels = _Channels(found)
    for record in file.read():
        _look(found, channels, record)
    if file.finished and not (file.fault or file.flaws or found.flaws):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "sound.mcap"
        with copy.open("wb") as out:
            writer, given, channels = Writer(out), {}, _Channels(Found())
            writer.start()
            for record in McapFile(path).read():
                if not _look(Found(), channels, record):
                    continue
                if record.channel not in given:
                    topic, schema = channels.described(record)
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                    given[record.channel] = writer.register_channel(topic, "protobuf", number)
                writer.add_message(given[record.channel], record.time_ns, record.data, record.published_ns)
            writer.finish()
        yield copy


def _look(found: Found, channels: _Channels, record: Any) -> bool:
    """Takes note of schemas and channels; whether a message can be decoded, which is a flaw if not."""
    if isinstance(record, Schema | Channel):
        channels.add(record)
    if not isinstance(record, Message) or channels.topic(record) is None:
        return False
    if record.time_ns > _LATEST_NS:
        found.flaws.append(f"a message of the time {record.time_ns} ns")
        return False
    try:
        message = channels.decoded(record)
        if channels.topic(record) in ("/log", "/phases"):
            type(message).Level.Name(message.level)
    except (DecodeError, ValueError) as error:
        found.flaws.append(str(error))
        return False
    if channels.topic(record) != "/scene" and not _complete(message):
        found.flaws.append(f"{channels.topic(record)} has a message that lacks a part")
        return False
    return True


def _complete(message: Any) -> bool:
    """Whether a message has all the messages that are to be in it."""
    for field in message.DESCRIPTOR.fields:
        if field.message_type is None:
            continue
        value = getattr(message, field.name)
        if field.is_repeated:
            if not all(map(_complete, value)):
                return False
        elif not (message.HasField(field.name) and _complete(value)):
            return False
    return True


class _Channels:
    """Which channel carries what."""

    def __init__(self, found: Found) -> None:
        from mcap_protobuf.decoder import DecoderFactory

        from mjmerge.record import schema

        self._found, self._factory = found, DecoderFactory()
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, str] = {}
        self._decoders: dict[int, Decode] = {}
        self._described: dict[int, Schema] = {}
        self._ours = schema

    def add(self, record: Schema | Channel) -> None:
        """Takes note of a schema or a channel; what it cannot be is a flaw, and its messages are left."""
        if isinstance(record, Schema):
            self._schemas.setdefault(record.id, record)
            return
        described = self._schemas.get(record.schema_id)
        if record.id in self._topics or described is None:
            if described is None:
                self._found.flaws.append(f"{record.topic[:80]} has no schema")
            return
        message = self._ours.message_of(record.topic)
        drawn = (_DRAWN[record.topic],) if record.topic in _DRAWN else ()
        drawn += (_CLOUD,) * record.topic.startswith(LOOK)
        wanted = self._ours.names_of(message) if message else drawn
        if not wanted:
            self._found.flaws.append(f"{record.topic[:80]!r} is no topic of a recording")
        elif {record.message_encoding, described.encoding} != {"protobuf"} or described.name not in wanted:
            self._found.flaws.append(f"{record.topic} holds {described.name[:80]!r}, not {wanted[-1]}")
        else:
            try:
                decode = self._factory.decoder_for(record.message_encoding, described)
            except Exception:  # whatever protobuf makes of a descriptor that is none
                decode = None
            if decode is None:
                self._found.flaws.append(f"the schema of {record.topic} cannot be read")
            else:
                self._topics[record.id], self._decoders[record.id] = record.topic, decode
                self._described[record.id] = described

    def topic(self, message: Message) -> str | None:
        """Topic of a message; ``None`` of one that nobody can read."""
        return self._topics.get(message.channel)

    def described(self, message: Message) -> tuple[str, Schema]:
        """Topic and schema of a message that can be read."""
        return self._topics[message.channel], self._described[message.channel]

    def decoded(self, message: Message) -> Any:
        """A message.

        Raises:
            DecodeError: it is damaged.
        """
        try:
            return self._decoders[message.channel](message.data)
        except (ValueError, TypeError, RecursionError) as error:
            raise DecodeError(str(error)) from error


def gather_mcap(path: Path) -> Found:
    """What is in an MCAP, as far as it can be read.

    Raises:
        ContentError: what it says of itself cannot be.
    """
    from mjmerge.record import schema

    found, file = Found(), McapFile(path)
    channels = _Channels(found)
    rows: dict[str, tuple[list[int], list[Message]]] = defaultdict(lambda: ([], []))
    metadata: set[str] = set()
    for record in file.read():
        match record:
            case Schema() | Channel():
                channels.add(record)
            case Attachment():
                _attach(found, record)
            case Metadata():
                if record.name in metadata:
                    found.flaws.append(f"several metadata called {record.name[:80]!r}")
                metadata.add(record.name)
                _note(found, record)
            case Message():
                topic = channels.topic(record)
                if topic is None:
                    continue
                if record.time_ns != record.published_ns or record.time_ns > _LATEST_NS:
                    found.flaws.append(f"{topic} has a message of the time {record.time_ns} ns")
                    continue
                if schema.message_of(topic):
                    rows[topic][0].append(record.time_ns)
                    rows[topic][1].append(record)
                else:
                    _say(found, topic, record, channels)
    found.finished, found.fault = file.finished, file.fault
    found.flaws += file.flaws
    if "manifest.json" in found.texts:
        found.manifest = content.manifest_of(found.texts["manifest.json"])
    if found.schema_version in SCHEMA_VERSIONS:
        _number(found, rows, channels)
    return found


def _attach(found: Found, record: Attachment) -> None:
    if record.name in found.texts:
        found.flaws.append(f"several attachments called {record.name}")
    elif record.name in TEXTS:
        found.texts[record.name] = content.decoded(record.data, record.name)


def _note(found: Found, record: Metadata) -> None:
    """Takes what metadata say."""
    try:
        if record.name == "mjmerge":
            found.schema_version = content.version_of(record.metadata["schema_version"])
        elif record.name == "outcome":
            found.verdict = record.metadata["verdict"]
        elif record.name == "sha256":
            found.sha256 = record.metadata
    except KeyError as error:
        raise ContentError(f"its metadata {record.name} have no {error.args[0]}") from error
    found.properties[record.name] = record.metadata


def _say(found: Found, topic: str, message: Message, channels: _Channels) -> None:
    """Takes an event, or a change of state, and looks whether a drawing can be read."""
    try:
        log = channels.decoded(message)
        if topic not in ("/log", "/phases"):
            return
        if topic == "/phases":
            subject, _, state = log.message.partition(": ")
            if log.name:  # before drawing 2
                subject, state = log.name, log.message
            found.states.append((message.time_ns, subject, state))
            return
        level = type(log).Level.Name(log.level).lower()
    except (DecodeError, ValueError, AttributeError):
        found.flaws.append(f"{topic} has a damaged message at {message.time_ns / NS_PER_S:g} s")
        return
    found.said.append((message.time_ns, level, f"{log.name}: {log.message}" if log.name else log.message))


def _number(
    found: Found,
    rows: dict[str, tuple[list[int], list[Message]]],
    channels: _Channels,
) -> None:
    """Turns the messages that hold our numbers into series."""
    from mjmerge.record import schema

    step_ns = found.manifest.get("control_step_s", 1.0) * NS_PER_S
    wire = schema.Wire.of(found.manifest)
    for topic, (times, messages) in rows.items():
        kind = schema.message_of(topic) or ""
        if kind not in wire.messages:
            found.flaws.append(f"{topic} in it, and the run has none")
            continue
        values = wire.layout(kind).decode([m.data for m in messages])
        if values is None:
            leaves = attrgetter(*_leaves(wire.messages[kind]))
            try:
                if len(messages) > _MOST_FOREIGN:
                    raise DecodeError
                values = np.array([leaves(channels.decoded(m)) for m in messages], np.float64)
            except (DecodeError, AttributeError, TypeError, ValueError):
                found.flaws.append(f"{topic} has messages that cannot be decoded")
                continue
        time_ns = np.array(times, np.int64)
        ticks = np.rint(time_ns / step_ns).astype(np.int64)
        found.series[topic] = ticks, time_ns, values
    found.complete()


def _leaves(fields: tuple[Field, ...]) -> list[str]:
    """Dotted names of all doubles of a message, in the order of its fields."""
    return [f"{f.name}.{part}" if part else f.name for f in fields for part in f.parts or ("",)]
