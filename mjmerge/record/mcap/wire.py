"""Protobuf messages of constant length, encoded for a whole block at once.

Every number in our messages is a double or a time, so that all messages of a topic have the same length and
differ only in known places: one message is laid out, copied row by row, and filled in with numpy. That is ten
times faster than building messages one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjmerge.state import NS_PER_S, Array

_VARINT, _FIXED64, _BYTES = 0, 1, 2
_WIDTH = 5
"""Bytes of every number in a time: 35 bits. Protobuf allows more bytes than a number needs."""


def varint(value: int) -> bytes:
    """A non-negative number as protobuf writes it."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _tag(number: int, wire_type: int) -> bytes:
    return varint(number << 3 | wire_type)


class Layout:
    """One message: its bytes, and where in them the doubles and the times go, in the order of the calls."""

    def __init__(self) -> None:
        self._wire = bytearray()
        self._doubles: list[int] = []
        self._times: list[int] = []

    @property
    def doubles(self) -> int:
        """How many doubles the message has."""
        return len(self._doubles)

    def double(self, number: int) -> Layout:
        """Adds a double to be filled in; returns the layout."""
        self._wire += _tag(number, _FIXED64)
        self._doubles.append(len(self._wire))
        self._wire += bytes(8)
        return self

    def text(self, number: int, value: str) -> Layout:
        """Adds a constant string; returns the layout."""
        data = value.encode()
        self._wire += _tag(number, _BYTES) + varint(len(data)) + data
        return self

    def time(self, number: int) -> Layout:
        """Adds a ``google.protobuf.Timestamp`` to be filled in; returns the layout."""
        self._wire += _tag(number, _BYTES) + varint(2 * (1 + _WIDTH))
        for field in (1, 2):
            self._wire += _tag(field, _VARINT)
            self._times.append(len(self._wire))
            self._wire += bytes(_WIDTH)
        return self

    def message(self, number: int, inner: Layout) -> Layout:
        """Adds a message inside the message; returns the layout."""
        self._wire += _tag(number, _BYTES) + varint(len(inner._wire))
        start = len(self._wire)
        self._doubles += [start + at for at in inner._doubles]
        self._times += [start + at for at in inner._times]
        self._wire += inner._wire
        return self

    def decode(self, messages: Sequence[bytes]) -> Array | None:
        """The doubles of messages that are laid out like this one, (B, doubles); ``None`` if one is not."""
        size = len(self._wire)
        if self._times or any(len(message) != size for message in messages):
            return None
        rows = np.frombuffer(b"".join(messages), np.uint8).reshape(-1, size)
        at = np.add.outer(self._doubles, np.arange(8))
        rest = np.ones(size, bool)
        rest[at.ravel()] = False
        if (rows[:, rest] != np.frombuffer(bytes(self._wire), np.uint8)[rest]).any():
            return None
        values: Array = np.ascontiguousarray(rows[:, at]).view("<f8")[..., 0].astype(np.float64)
        return values

    def encode(self, doubles: Array, time_ns: NDArray[np.int64]) -> list[bytes]:
        """The messages of a block.

        Args:
            doubles: one row per message, (B, doubles in the message).
            time_ns: goes into every time of the message, ns, (B,).
        """
        blank, at_doubles, at_times = self._places
        rows = np.tile(blank, (len(doubles), 1))
        if self._doubles:
            values = np.ascontiguousarray(doubles, "<f8").view(np.uint8).reshape(*doubles.shape, 8)
            rows[:, at_doubles] = values
        if self._times:
            parts = np.stack(np.divmod(time_ns, NS_PER_S), axis=-1)[..., None]
            digits = parts >> (7 * np.arange(_WIDTH)) & 0x7F
            digits[..., :-1] |= 0x80
            rows[:, at_times] = np.tile(digits, (1, len(self._times) // 2, 1))
        data, size = rows.tobytes(), rows.shape[1]
        return [data[at : at + size] for at in range(0, len(data), size)]

    @cached_property
    def _places(self) -> tuple[NDArray[np.uint8], NDArray[np.intp], NDArray[np.intp]]:
        """The message with nothing filled in; where the bytes of doubles go, and of the numbers of times."""
        blank = np.frombuffer(bytes(self._wire), np.uint8)
        return blank, np.add.outer(self._doubles, np.arange(8)), np.add.outer(self._times, np.arange(_WIDTH))
