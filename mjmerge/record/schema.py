"""Our protobuf messages, generated from the trace's columns so that nothing drifts.

``LawState`` holds the columns about the law and the pair distances, ``CarState`` those that each car has. A
column with named components is a message of doubles: ``/law.distance_m.vehicle_1``,
``/car/ego.torque_n_m.front_left``. How many components there are follows from who is there: a :class:`Wire`
is the messages of one roster. ``SignalState`` holds what a law records of its own, and is there only where it
does. ``mjmerge_v2.proto`` beside this file is :func:`proto_text`, published: that of
an ego and two neighbours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

from mjmerge.record import content
from mjmerge.record.manifest import SCHEMA_VERSION, SCHEMA_VERSIONS
from mjmerge.record.mcap.wire import Layout
from mjmerge.roster import (
    EGO,
    PER_CAR,
    PER_NEIGHBOUR,
    PER_PAIR,
    PER_SENSED,
    WHEELS,
    XY,
    Axis,
    Roster,
    along,
    roster,
    slot,
)
from mjmerge.simulation.log import TickBlock
from mjmerge.simulation.trace import COLUMNS, Column
from mjmerge.state import Array

LAW_MESSAGE, CAR_MESSAGE, TOLD_MESSAGE, SIGNAL_MESSAGE = "LawState", "CarState", "ToldState", "SignalState"
LAW_TOPIC, TOLD_TOPIC, SIGNAL_TOPIC = "/law", "/told", "/signals"
_CAR_TOPIC = "/car/"

LAW_COLUMNS = tuple(c for c in COLUMNS if c.axes[:1] != (PER_CAR,) and not c.told)
CAR_COLUMNS = tuple(c for c in COLUMNS if c.axes[:1] == (PER_CAR,) and not c.told)
TOLD_COLUMNS = tuple(c for c in COLUMNS if c.told)
"""Of what the ego was told, where that was not the truth."""
_GROUPS: dict[tuple[Axis, ...], str] = {
    (PER_NEIGHBOUR,): "Neighbours",
    (PER_PAIR,): "Pairs",
    (WHEELS,): "Wheels",
    (XY,): "Vector2",
    (PER_CAR, XY): "CarVectors",
}
_SENSED: tuple[Axis, ...] = (PER_SENSED,)
_GROUP_OF_SENSED = "NeighboursAndEnd"
"""Of signals of a law that is told of the end of the ego's lane; only where there are such."""


def package(version: int = SCHEMA_VERSION) -> str:
    """Where our messages are."""
    return f"mjmerge.v{version}"


PACKAGE = package()


@dataclass(frozen=True)
class Field:
    """A field: a double, or a message of doubles.

    Attributes:
        name: of the field.
        doc: what it is.
        axes: names of its components, axis by axis; none for a double.
        type_name: as the .proto says it.
    """

    name: str
    doc: str
    axes: tuple[tuple[str, ...], ...] = ()
    type_name: str = "double"

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of all its doubles: ``x``, or ``ego.x``; empty for a double."""
        return tuple(".".join(names) for names in product(*self.axes)) if self.axes else ()


def car_topic(car: str) -> str:
    """Topic of a car's ``CarState``."""
    return f"{_CAR_TOPIC}{car}"


def message_of(topic: str) -> str | None:
    """Which of our messages a topic carries, whoever is there; ``None`` if it is none of ours."""
    car = topic.removeprefix(_CAR_TOPIC) if topic.startswith(_CAR_TOPIC) else ""
    if car == EGO or slot(car) is not None:
        return CAR_MESSAGE
    return {LAW_TOPIC: LAW_MESSAGE, TOLD_TOPIC: TOLD_MESSAGE, SIGNAL_TOPIC: SIGNAL_MESSAGE}.get(topic)


def names_of(message: str) -> tuple[str, ...]:
    """What a message of ours is called in files, in every version that is read."""
    return tuple(f"{package(version)}.{message}" for version in SCHEMA_VERSIONS)


@dataclass(frozen=True)
class Wire:
    """The messages of the cars that are there, of the law's own signals, and of what the ego was told.

    Attributes:
        roster: who is there.
        signals: what not every run records.
        told: whether the ego is not told the truth.
    """

    roster: Roster
    signals: tuple[Column, ...] = ()
    told: bool = False

    @classmethod
    def of(cls, manifest: Mapping[str, Any]) -> Wire:
        """Those of a recording, by its manifest."""
        told = manifest.get("sensing") == "recorded"
        return cls(content.roster_of(manifest), content.own_columns(manifest), told)

    @property
    def kinds(self) -> dict[str, str]:
        """The topics that carry our messages, and which."""
        found = {LAW_TOPIC: LAW_MESSAGE} | {car_topic(car): CAR_MESSAGE for car in self.roster.cars}
        found |= {SIGNAL_TOPIC: SIGNAL_MESSAGE} if self.signals else {}
        return found | {TOLD_TOPIC: TOLD_MESSAGE} if self.told else found

    @property
    def messages(self) -> dict[str, tuple[Field, ...]]:
        """The fields of every message, in order."""
        found = _messages(self.roster)
        if any(column.axes == _SENSED for column in self.signals):
            (names,) = along(_SENSED, self.roster)
            found = found | {_GROUP_OF_SENSED: tuple(Field(name, "") for name in names)}
        return found | {SIGNAL_MESSAGE: _fields(self.signals, 0, self.roster)} if self.signals else found

    def layout(self, message: str) -> Layout:
        """How a message lies on the wire; its doubles are in the order of its fields."""
        out = Layout()
        for number, field in enumerate(self.messages[message], start=1):
            if field.axes:
                out.message(number, self.layout(field.type_name))
            else:
                out.double(number)
        return out

    def rows(self, block: TickBlock) -> dict[str, Array]:
        """What goes into the messages of each topic, in the order of its layout, (B, doubles)."""
        count, cars = len(block.ticks), self.roster.cars
        time_s = block.time_s[:, None]

        def flat(columns: Sequence[Column]) -> Array:
            return np.concatenate([time_s, *(block.columns[c.name].reshape(count, -1) for c in columns)], 1)

        each = [block.columns[c.name].reshape(count, len(cars), -1) for c in CAR_COLUMNS]
        both = np.concatenate([np.broadcast_to(time_s[:, None], (count, len(cars), 1)), *each], 2)
        found = {LAW_TOPIC: flat(LAW_COLUMNS)} | {car_topic(car): both[:, c] for c, car in enumerate(cars)}
        found |= {SIGNAL_TOPIC: flat(self.signals)} if self.signals else {}
        return found | {TOLD_TOPIC: flat(TOLD_COLUMNS)} if self.told else found

    def descriptor_set(self) -> bytes:
        """The schema as MCAP wants it: a serialised ``FileDescriptorSet``."""
        file = FileDescriptorProto(name=f"mjmerge_v{SCHEMA_VERSION}.proto", package=PACKAGE, syntax="proto3")
        for name, fields in self.messages.items():
            message = file.message_type.add(name=name)
            for number, field in enumerate(fields, start=1):
                entry = message.field.add(name=field.name, number=number)
                entry.label = FieldDescriptorProto.LABEL_OPTIONAL
                if field.axes:
                    entry.type = FieldDescriptorProto.TYPE_MESSAGE
                    entry.type_name = f".{PACKAGE}.{field.type_name}"
                else:
                    entry.type = FieldDescriptorProto.TYPE_DOUBLE
        data: bytes = FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)
        return data


@cache
def _messages(there: Roster) -> dict[str, tuple[Field, ...]]:
    groups: dict[str, tuple[Field, ...]] = {}
    for axes, name in _GROUPS.items():
        first, *rest = along(axes, there)
        inner = _GROUPS[axes[1:]] if rest else "double"
        groups[name] = tuple(Field(part, "", tuple(rest), inner) for part in first)
    parts = ((LAW_MESSAGE, LAW_COLUMNS, 0), (CAR_MESSAGE, CAR_COLUMNS, 1), (TOLD_MESSAGE, TOLD_COLUMNS, 0))
    return groups | {name: _fields(columns, leading, there) for name, columns, leading in parts}


def _fields(columns: Sequence[Column], leading: int, there: Roster) -> tuple[Field, ...]:
    """Fields of a message; ``leading`` axes of the columns are spread over messages."""
    fields = [Field("time_s", "simulated time, s, exactly as simulated")]
    for c in columns:
        axes = c.axes[leading:]
        type_name = _GROUP_OF_SENSED if axes == _SENSED else _GROUPS[axes] if axes else "double"
        fields.append(Field(c.name, f"{c.symbol}: {c.doc}", along(axes, there), type_name))
    return tuple(fields)


def proto_text() -> str:
    """The schema as people read it: the text of ``mjmerge_v2.proto``."""
    lines = [
        "// What mjmerge records besides Foxglove's own messages. Generated from the columns of its trace.",
        f"// {LAW_TOPIC} carries {LAW_MESSAGE}, {car_topic('<car>')} carries {CAR_MESSAGE}; SI, road frame.",
        f"// {TOLD_TOPIC} carries {TOLD_MESSAGE}, where the ego was not told the truth.",
        f"// {SIGNAL_TOPIC} carries {SIGNAL_MESSAGE}, of a law that records more: its fields are that law's.",
        "// This is for two neighbours; with more, Neighbours, Pairs and CarVectors have more fields.",
        "",
        'syntax = "proto3";',
        "",
        f"package {PACKAGE};",
    ]
    for name, fields in Wire(roster()).messages.items():
        lines += ["", f"message {name} {{"]
        for number, field in enumerate(fields, start=1):
            comment = f"  // {field.doc}" if field.doc else ""
            lines.append(f"  {field.type_name} {field.name} = {number};{comment}")
        lines.append("}")
    return "\n".join(lines) + "\n"
