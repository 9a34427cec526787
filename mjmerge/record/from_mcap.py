"""What is in an MCAP, finished or not, through a reader that shares nothing with the writer of MCAP.

A file that was cut off or damaged is read up to the first record that cannot be.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mjmerge.record.found import NS_PER_S, Found
from mjmerge.record.manifest import SCHEMA_VERSION
from mjmerge.scenario import CARS

if TYPE_CHECKING:
    from mjmerge.record.schema import Field


def _records(path: Path, found: Found) -> Iterator[Any]:
    """Records up to the end, or to the first that cannot be read."""
    from mcap.exceptions import EndOfFile
    from mcap.records import Footer
    from mcap.stream_reader import StreamReader

    with path.open("rb") as file:
        size = path.stat().st_size  # no record is larger: a length that was overwritten asks for no memory
        try:
            for record in StreamReader(file, validate_crcs=True, record_size_limit=size).records:
                found.finished |= isinstance(record, Footer)
                yield record
        except EndOfFile:
            found.finished, found.fault = False, "it ends within a record"
        except Exception as error:  # whatever the bytes of a damaged file lead to
            found.finished = False
            found.fault = str(error) or type(error).__name__


def mcap_messages(path: Path, topic: str) -> Iterator[tuple[int, Any]]:
    """Time, ns, and content of every message of a topic, as far as the file can be read."""
    from mcap.records import Channel, Message, Schema
    from mcap_protobuf.decoder import DecoderFactory

    decoders, schemas, decode = DecoderFactory(), {}, {}
    for record in _records(path, Found()):
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel() if record.topic == topic:
                decode[record.id] = decoders.decoder_for(
                    record.message_encoding, schemas.get(record.schema_id)
                )
            case Message() if decode.get(record.channel_id):
                yield record.log_time, decode[record.channel_id](record.data)


def gather_mcap(path: Path) -> Found:
    """What is in an MCAP, as far as it can be read."""
    from mcap.records import Attachment, Channel, Message, Metadata, Schema
    from mcap_protobuf.decoder import DecoderFactory

    from mjmerge.record import schema

    messages = {schema.LAW_TOPIC: schema.LAW_MESSAGE}
    messages |= {schema.car_topic(car): schema.CAR_MESSAGE for car in CARS}
    numbers = {topic: attrgetter(*_leaves(schema.MESSAGES[name])) for topic, name in messages.items()}
    found, decoders = Found(), DecoderFactory()
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, Callable[[bytes], Any]]] = {}
    rows: dict[str, tuple[list[int], list[Any]]] = defaultdict(lambda: ([], []))
    for record in _records(path, found):
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel():
                decode = decoders.decoder_for(record.message_encoding, schemas.get(record.schema_id))
                if decode is not None:
                    channels[record.id] = record.topic, decode
            case Attachment():
                found.texts[record.name] = record.data.decode()
            case Metadata(name="mjmerge"):
                found.schema_version = int(record.metadata["schema_version"])
            case Metadata(name="outcome"):
                found.verdict = record.metadata["verdict"]
            case Metadata(name="sha256"):
                found.sha256 = record.metadata
            case Message() if record.channel_id in channels and found.schema_version == SCHEMA_VERSION:
                topic, decode = channels[record.channel_id]
                if topic in numbers:
                    try:
                        values = numbers[topic](decode(record.data))
                    except Exception as error:
                        found.fault = f"{topic}: {error}"
                        continue
                    rows[topic][0].append(record.log_time)
                    rows[topic][1].append(values)
                elif topic == "/log":
                    log = decode(record.data)
                    level = type(log).Level.Name(log.level).lower()
                    text = f"{log.name}: {log.message}" if log.name else log.message
                    found.said.append((record.log_time, level, text))
                elif topic == "/phases":
                    log = decode(record.data)
                    found.states.append((record.log_time, log.name, log.message))
    found.manifest = json.loads(found.texts.get("manifest.json", "{}"))
    step_ns = found.manifest.get("control_step_s", 1.0) * NS_PER_S
    for topic, (times, lines) in rows.items():
        time_ns = np.array(times, np.int64)
        ticks = np.rint(time_ns / step_ns).astype(np.int64)
        found.series[topic] = ticks, time_ns, np.array(lines, np.float64)
    if found.series and len(found.series) < len(messages):
        found.series.clear()  # cut off within the first tick
    return found


def _leaves(fields: tuple[Field, ...]) -> list[str]:
    """Dotted names of all doubles of a message, in the order of its fields."""
    return [f"{f.name}.{part}" if part else f.name for f in fields for part in f.parts or ("",)]
