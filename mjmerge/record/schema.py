"""Our protobuf messages, generated from the trace's columns so that nothing drifts.

``LawState`` holds the columns about the law and the pair distances, ``CarState`` those that each car has. A
column with named components is a message of doubles: ``/law.distance_m.vehicle_1``,
``/car/ego.torque_n_m.front_left``. ``mjmerge_v1.proto`` beside this file is :func:`proto_text`, published.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

from mjmerge.record.manifest import SCHEMA_VERSION
from mjmerge.record.mcap.wire import Layout
from mjmerge.roster import CARS, NEIGHBOURS, PAIR_NAMES, WHEELS, XY
from mjmerge.simulation.log import Block
from mjmerge.simulation.trace import COLUMNS, Column
from mjmerge.state import Array

PACKAGE = f"mjmerge.v{SCHEMA_VERSION}"
LAW_MESSAGE, CAR_MESSAGE, TOLD_MESSAGE = "LawState", "CarState", "ToldState"
LAW_TOPIC, TOLD_TOPIC = "/law", "/told"

LAW_COLUMNS = tuple(c for c in COLUMNS if c.axes[:1] != (CARS,) and not c.told)
CAR_COLUMNS = tuple(c for c in COLUMNS if c.axes[:1] == (CARS,) and not c.told)
TOLD_COLUMNS = tuple(c for c in COLUMNS if c.told)
"""Of what the ego was told, where that was not the truth."""
_GROUPS: dict[tuple[tuple[str, ...], ...], str] = {
    (NEIGHBOURS,): "Neighbours",
    (PAIR_NAMES,): "Pairs",
    (WHEELS,): "Wheels",
    (XY,): "Vector2",
    (CARS, XY): "CarVectors",
}


@dataclass(frozen=True)
class Field:
    """A field: a double, or a message of doubles.

    Attributes:
        name: of the field.
        doc: what it is.
        axes: names of its components, axis by axis; none for a double.
    """

    name: str
    doc: str
    axes: tuple[tuple[str, ...], ...] = ()

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of all its doubles: ``x``, or ``ego.x``; empty for a double."""
        return tuple(".".join(names) for names in product(*self.axes)) if self.axes else ()

    @property
    def type_name(self) -> str:
        """As the .proto says it."""
        return _GROUPS[self.axes] if self.axes else "double"


def kinds(*, told: bool = True) -> dict[str, str]:
    """The topics that carry our messages, and which; ``told`` for a run whose ego is not told the truth."""
    found = {LAW_TOPIC: LAW_MESSAGE} | {car_topic(car): CAR_MESSAGE for car in CARS}
    return found | {TOLD_TOPIC: TOLD_MESSAGE} if told else found


def car_topic(car: str) -> str:
    """Topic of a car's ``CarState``."""
    return f"/car/{car}"


def _fields(columns: Sequence[Column], leading: int) -> tuple[Field, ...]:
    """Fields of a message; ``leading`` axes of the columns are spread over messages."""
    fields = [Field("time_s", "simulated time, s, exactly as simulated")]
    return (*fields, *(Field(c.name, f"{c.symbol}: {c.doc}", c.axes[leading:]) for c in columns))


MESSAGES: dict[str, tuple[Field, ...]] = {
    **{name: tuple(Field(part, "", axes[1:]) for part in axes[0]) for axes, name in _GROUPS.items()},
    LAW_MESSAGE: _fields(LAW_COLUMNS, 0),
    CAR_MESSAGE: _fields(CAR_COLUMNS, 1),
    TOLD_MESSAGE: _fields(TOLD_COLUMNS, 0),
}


def layout(message: str) -> Layout:
    """How a message lies on the wire; its doubles are in the order of its fields."""
    out = Layout()
    for number, field in enumerate(MESSAGES[message], start=1):
        if field.axes:
            out.message(number, layout(field.type_name))
        else:
            out.double(number)
    return out


def rows(block: Block, topic: str) -> Array:
    """What goes into each message of a topic of a block, in the order of its layout, (B, doubles)."""
    count = len(block.ticks)
    car = next((index for index, name in enumerate(CARS) if topic == car_topic(name)), None)
    if car is None:
        columns = LAW_COLUMNS if topic == LAW_TOPIC else TOLD_COLUMNS
        parts = [block.columns[c.name].reshape(count, -1) for c in columns]
    else:
        parts = [block.columns[c.name][:, car].reshape(count, -1) for c in CAR_COLUMNS]
    return np.hstack([block.time_s[:, None], *parts])


def descriptor_set() -> bytes:
    """The schema as MCAP wants it: a serialised ``FileDescriptorSet``."""
    file = FileDescriptorProto(name=f"mjmerge_v{SCHEMA_VERSION}.proto", package=PACKAGE, syntax="proto3")
    for name, fields in MESSAGES.items():
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


def proto_text() -> str:
    """The schema as people read it: the text of ``mjmerge_v1.proto``."""
    lines = [
        "// What mjmerge records besides Foxglove's own messages. Generated from the columns of its trace.",
        f"// {LAW_TOPIC} carries {LAW_MESSAGE}, {car_topic('<car>')} carries {CAR_MESSAGE}; SI, road frame.",
        f"// {TOLD_TOPIC} carries {TOLD_MESSAGE}, where the ego was not told the truth.",
        "",
        'syntax = "proto3";',
        "",
        f"package {PACKAGE};",
    ]
    for name, fields in MESSAGES.items():
        lines += ["", f"message {name} {{"]
        for number, field in enumerate(fields, start=1):
            comment = f"  // {field.doc}" if field.doc else ""
            lines.append(f"  {field.type_name} {field.name} = {number};{comment}")
        lines.append("}")
    return "\n".join(lines) + "\n"
