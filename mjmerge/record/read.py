"""Recordings back into columns, through readers that share nothing with the writers of MCAP."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from mjmerge.record import schema
from mjmerge.scenario import CARS
from mjmerge.trace import COLUMNS, Array


def read_mcap(path: Path) -> dict[str, Array]:
    """Columns of an MCAP recording.

    Args:
        path: a file that was closed; a partial one after an abort is, too.

    Returns:
        Each column of ``COLUMNS`` by name, (T, ...), and ``time_s``, (T,).
    """
    rows: dict[str, list[list[float]]] = defaultdict(list)
    topics = {schema.LAW_TOPIC: schema.LAW_MESSAGE}
    topics |= {schema.car_topic(car): schema.CAR_MESSAGE for car in CARS}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(topics=list(topics)):
            fields = schema.MESSAGES[topics[channel.topic]]
            rows[channel.topic].append(_numbers(message, fields))
    law = np.array(rows[schema.LAW_TOPIC])
    cars = np.stack([np.array(rows[schema.car_topic(car)]) for car in CARS], axis=1)
    columns = {"time_s": law[:, 0]}
    for values, declared, leading in ((law, schema.LAW_COLUMNS, 0), (cars, schema.CAR_COLUMNS, 1)):
        at = 1
        for c in declared:
            size = int(np.prod(c.shape[leading:]))
            columns[c.name] = values[..., at : at + size].reshape(len(values), *c.shape)
            at += size
    return columns


def _numbers(message: object, fields: tuple[schema.Field, ...]) -> list[float]:
    """All doubles of a message, in the order of its fields."""
    numbers: list[float] = []
    for field in fields:
        value = getattr(message, field.name)
        numbers += [getattr(value, part) for part in field.parts] if field.parts else [value]
    return numbers


def read_rrd(path: Path) -> dict[str, Array]:
    """Columns of a Rerun recording.

    Args:
        path: a recording; a partial one will do.

    Returns:
        Each column of ``COLUMNS`` by name, (T, ...), and ``time_s``, (T,).
    """
    import rerun.chunk as rc

    from mjmerge.record.rerun import TIME_ENTITY, series

    chunks: dict[str, list[tuple[Array, Array]]] = defaultdict(list)
    for chunk in rc.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if {"step", "Scalars:scalars"} <= set(batch.schema.names):
            steps = batch["step"].to_numpy()
            values = batch["Scalars:scalars"].flatten().to_numpy().reshape(len(steps), -1)
            chunks[chunk.entity_path].append((steps, values))
    entities = {}
    for entity, parts in chunks.items():
        order = np.argsort(np.concatenate([steps for steps, _ in parts]))
        entities[entity] = np.concatenate([values for _, values in parts])[order]

    time_s = entities[TIME_ENTITY][:, 0]
    columns = {"time_s": time_s}
    for c in COLUMNS:
        columns[c.name] = np.empty((len(time_s), *c.shape))
        for entity, index in series(c):
            part = columns[c.name][index]
            part[...] = entities[entity].reshape(part.shape)
    return columns
