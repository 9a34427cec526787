"""Our protobuf messages, generated from the trace's columns so that nothing drifts.

``LawState`` holds the columns about the law and the pair distances, ``CarState`` those that each car has. A
column with named components is a message of doubles: ``/law.distance_m.vehicle_1``,
``/car/ego.torque_n_m.front_left``. ``mjmerge_v1.proto`` beside this file is :func:`proto_text`, published.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

from mjmerge.record.manifest import SCHEMA_VERSION
from mjmerge.record.wire import Layout
from mjmerge.scenario import CARS
from mjmerge.trace import COLUMNS, NEIGHBOURS, PAIR_NAMES, WHEELS, XY, Array, Block, Column

PACKAGE = f"mjmerge.v{SCHEMA_VERSION}"
LAW_MESSAGE, CAR_MESSAGE = "LawState", "CarState"
LAW_TOPIC = "/law"

LAW_COLUMNS = tuple(c for c in COLUMNS if c.axes[:1] != (CARS,))
CAR_COLUMNS = tuple(c for c in COLUMNS if c.axes[:1] == (CARS,))
_GROUPS = {NEIGHBOURS: "Neighbours", PAIR_NAMES: "Pairs", WHEELS: "Wheels", XY: "Vector2"}


@dataclass(frozen=True)
class Field:
    """A field: a double, or a message of doubles.

    Attributes:
        name: of the field.
        doc: what it is.
        parts: names of its components; empty for a double.
    """

    name: str
    doc: str
    parts: tuple[str, ...] = ()

    @property
    def type_name(self) -> str:
        """As the .proto says it."""
        return _GROUPS[self.parts] if self.parts else "double"


def car_topic(car: str) -> str:
    """Topic of a car's ``CarState``."""
    return f"/car/{car}"


def _fields(columns: Sequence[Column], leading: int) -> tuple[Field, ...]:
    """Fields of a message; ``leading`` axes of the columns are spread over messages."""
    fields = [Field("time_s", "simulated time, s, exactly as simulated")]
    for c in columns:
        rest = c.axes[leading:]
        assert len(rest) <= 1, f"{c.name}: the messages have no place for two axes"
        fields.append(Field(c.name, f"{c.symbol}: {c.doc}", *rest))
    return tuple(fields)


MESSAGES: dict[str, tuple[Field, ...]] = {
    **{name: tuple(Field(part, "") for part in parts) for parts, name in _GROUPS.items()},
    LAW_MESSAGE: _fields(LAW_COLUMNS, 0),
    CAR_MESSAGE: _fields(CAR_COLUMNS, 1),
}


def layout(message: str) -> Layout:
    """How a message lies on the wire; its doubles are in the order of its fields."""
    out = Layout()
    for number, field in enumerate(MESSAGES[message], start=1):
        if field.parts:
            out.message(number, layout(field.type_name))
        else:
            out.double(number)
    return out


def law_rows(block: Block) -> Array:
    """What goes into each ``LawState`` of a block, in the order of the layout, (B, doubles)."""
    count = len(block.ticks)
    parts = (block.columns[c.name].reshape(count, -1) for c in LAW_COLUMNS)
    return np.hstack([block.time_s[:, None], *parts])


def car_rows(block: Block, car: str) -> Array:
    """What goes into each ``CarState`` of a car, in the order of the layout, (B, doubles)."""
    count, index = len(block.ticks), CARS.index(car)
    parts = (block.columns[c.name][:, index].reshape(count, -1) for c in CAR_COLUMNS)
    return np.hstack([block.time_s[:, None], *parts])


def descriptor_set() -> bytes:
    """The schema as MCAP wants it: a serialised ``FileDescriptorSet``."""
    file = FileDescriptorProto(name=f"mjmerge_v{SCHEMA_VERSION}.proto", package=PACKAGE, syntax="proto3")
    for name, fields in MESSAGES.items():
        message = file.message_type.add(name=name)
        for number, field in enumerate(fields, start=1):
            entry = message.field.add(name=field.name, number=number)
            entry.label = FieldDescriptorProto.LABEL_OPTIONAL
            if field.parts:
                entry.type = FieldDescriptorProto.TYPE_MESSAGE
                entry.type_name = f".{PACKAGE}.{field.type_name}"
            else:
                entry.type = FieldDescriptorProto.TYPE_DOUBLE
    data: bytes = FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)
    return data


def proto_text() -> str:
    """The schema as people read it: the text of ``mjmerge_v1.proto``."""
    lines = [
        "// What mjmerge records besides Foxglove's own messages. Generated from mjmerge.trace.COLUMNS.",
        f"// {LAW_TOPIC} carries {LAW_MESSAGE}, {car_topic('<car>')} carries {CAR_MESSAGE}; SI, road frame.",
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
