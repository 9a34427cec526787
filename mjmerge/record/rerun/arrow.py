"""Blocks as Arrow arrays, the way Rerun wants them, without a Python object per number.

Our messages become one struct per tick, with the nesting of the protobuf: ``/law`` holds
``mjmerge.v2.LawState:message``, which is also what Rerun makes of the MCAP. Everything else is an array of
vectors, nested as its archetype says. Rerun's own conversions take ten times as long.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from mjmerge.record import schema
from mjmerge.record.schema import Wire
from mjmerge.state import Array


class Ready:
    """A column that is an Arrow array already."""

    def __init__(self, descriptor: rr.ComponentDescriptor, values: pa.Array) -> None:
        self._descriptor, self._values = descriptor, values

    def component_descriptor(self) -> rr.ComponentDescriptor:
        """What Rerun calls it."""
        return self._descriptor

    def as_arrow_array(self) -> pa.Array:
        """Its values, a list per row."""
        return self._values


class Template:
    """The components of an archetype, to be filled with arrays."""

    def __init__(self, columns: rr.ComponentColumnList) -> None:
        """Args: an example of them."""
        self._kinds = [(c.component_descriptor(), c.as_arrow_array().type) for c in columns]

    def fill(self, *values: NDArray[Any]) -> list[Ready]:
        """Columns of B rows; each component is (B, instances, ...), in the order of the example."""
        return [Ready(d, _nested(v, kind)) for (d, kind), v in zip(self._kinds, values, strict=True)]


def _nested(values: NDArray[Any], kind: pa.DataType) -> pa.Array:
    """An array as nested lists, one level per axis; the last axis of vectors has a fixed size."""
    if pa.types.is_fixed_size_list(kind):
        flat = pa.array(np.ascontiguousarray(values).ravel(), kind.value_type)
        return pa.FixedSizeListArray.from_arrays(flat, type=kind)
    if pa.types.is_list(kind):
        rows, count = values.shape[:2]
        ends = pa.array(np.arange(0, rows * count + 1, count, dtype=np.int32))
        inner = _nested(values.reshape(rows * count, *values.shape[2:]), kind.value_type)
        return pa.ListArray.from_arrays(ends, inner, type=kind)
    return pa.array(np.ascontiguousarray(values), kind)


def component(message: str) -> str:
    """What Rerun calls one of our messages, in the .rrd as in the .mcap."""
    return f"{schema.PACKAGE}.{message}:message"


def component_in(names: Collection[str], message: str) -> str | None:
    """What it is called among a file's columns, in any version that is read; ``None`` if it is not there."""
    return next((c for n in schema.names_of(message) if (c := f"{n}:message") in names), None)


def structs(wire: Wire, message: str, rows: Array) -> list[Ready]:
    """A message per row; ``rows`` are (B, doubles), in the order of its layout."""
    record_schema, head = _head(wire, message, len(rows))
    body = np.ascontiguousarray(rows.T).tobytes()
    batch = pa.ipc.read_record_batch(pa.py_buffer(head + body), record_schema)
    descriptor = rr.ComponentDescriptor(component(message), archetype=f"{schema.PACKAGE}.{message}")
    return [Ready(descriptor, batch.column(0))]


def numbers(wire: Wire, values: pa.Array, message: str) -> Array:
    """The way back: all doubles of the messages, (B, doubles), in the order of its layout.

    Raises:
        ValueError: the array is damaged, or does not hold one such message per row.
    """
    values.validate(full=True)  # of a damaged file it may point anywhere
    if not pa.types.is_list(values.type) or values.type.value_type != _type(wire, message):
        raise ValueError(f"no column of {message}")
    if values.null_count or len(values.flatten()) != len(values) or (np.diff(values.offsets) != 1).any():
        raise ValueError(f"not one {message} per row")
    leaves: list[Array] = []

    def gather(array: pa.Array) -> None:
        if pa.types.is_struct(array.type):
            for part in array.flatten():
                gather(part)
        else:
            leaves.append(array.to_numpy(zero_copy_only=False))

    gather(values.flatten())
    return np.stack(leaves, axis=-1)


def _type(wire: Wire, message: str) -> pa.DataType:
    fields = wire.messages[message]
    return pa.struct([(f.name, _type(wire, f.type_name) if f.axes else pa.float64()) for f in fields])


@cache
def _head(wire: Wire, message: str, count: int) -> tuple[pa.Schema, bytes]:
    """How Arrow writes ``count`` messages, up to where the doubles follow, one after the other."""

    def zeros(kind: pa.DataType) -> pa.Array:
        if not pa.types.is_struct(kind):
            return pa.array(np.zeros(count))
        return pa.StructArray.from_arrays([zeros(f.type) for f in kind], fields=list(kind))

    ends = pa.array(np.arange(count + 1, dtype=np.int32))
    lists = pa.ListArray.from_arrays(ends, zeros(_type(wire, message)))
    batch = pa.RecordBatch.from_arrays([lists], names=[message])
    doubles = wire.layout(message).doubles
    return batch.schema, batch.serialize().to_pybytes()[: -8 * doubles * count]
