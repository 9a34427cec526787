"""The frames of a Rerun recording, walked without Rerun: whether it is whole, and what it would unpack to.

Rerun's reader refuses a file that was cut off, and takes what a damaged one says of its sizes for granted: it
gets whole frames of sizes that are within bounds.
"""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from mjmerge.record.mcap.file import TooLargeError

HEADER_BYTES, FRAME = 12, struct.Struct("<QQ")
"""Of the file; of a frame: its kind and its length."""
END = 0
"""Kind of the frame that ends the messages."""
_ARROW_KIND, _SIZE_FIELD = 2, 3
LARGEST_FRAME_BYTES = 128 * 2**20
"""Of a frame, unpacked: 4096 ticks of a car have 2 MiB."""
UNPACKED_BYTES, UNPACKED_RATIO = 64 * 2**20, 60
"""All frames together unpack to no more than the first, and the second times the size of the file."""
_HEAD_BYTES = 4096  # of a frame, within which it says its size
_TAIL_BYTES, _TAIL_MAGIC = 32, b"RRF2FOOT"


@contextmanager
def whole_frames(path: Path) -> Iterator[tuple[Path, bool, str]]:
    """A Rerun recording without the frame it was cut off in; Rerun itself refuses such a file.

    Yields:
        The file, or a temporary copy up to its last whole frame; whether it is finished; what is wrong.

    Raises:
        TooLargeError: a frame would unpack to more than may be.
    """
    size, at, kind = path.stat().st_size, HEADER_BYTES, -1
    room = UNPACKED_BYTES + UNPACKED_RATIO * size
    with path.open("rb") as file:
        while at + FRAME.size <= size:
            file.seek(at)
            kind, length = FRAME.unpack(file.read(FRAME.size))
            if at + FRAME.size + length > size or kind == END:
                break
            if kind == _ARROW_KIND:
                unpacked = _unpacked_bytes(file.read(min(length, _HEAD_BYTES)))
                room -= unpacked
                if unpacked > LARGEST_FRAME_BYTES or room < 0:
                    raise TooLargeError(
                        f"a frame would unpack to {unpacked / 2**20:.3g} MiB; one may have "
                        f"{LARGEST_FRAME_BYTES // 2**20} MiB, and all of them {UNPACKED_RATIO} times the "
                        "file's size"
                    )
            at += FRAME.size + length
        finished = kind == END and at + FRAME.size < size and _has_footer(file, size)
        if finished or at == size:
            yield path, finished, "" if finished else "it ends without a footer"
            return
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / "whole.rrd"
            file.seek(0)
            with copy.open("wb") as out:
                left = at
                while part := file.read(min(left, 2**20)):
                    out.write(part)
                    left -= len(part)
            yield copy, False, f"it ends within a frame, {size - at} bytes after the last whole one"


def _has_footer(file: BinaryIO, size: int) -> bool:
    """Whether the file ends with what points to its footer."""
    file.seek(size - _TAIL_BYTES)
    tail = file.read()
    at, length = struct.unpack_from("<QQ", tail)
    return tail[-12:-4] == _TAIL_MAGIC and at + length + _TAIL_BYTES == size


def _unpacked_bytes(head: bytes) -> int:
    """What a frame says that its data unpack to: a field of the protobuf message that it begins with."""
    at = 0
    try:
        while at < len(head):
            tag, at = _varint(head, at)
            if tag & 7 == 0:
                value, at = _varint(head, at)
                if tag >> 3 == _SIZE_FIELD:
                    return value
            elif tag & 7 == 2:
                length, at = _varint(head, at)
                at += length
            else:
                break
    except IndexError:
        pass
    return 0


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number as protobuf writes it, and where the next begins."""
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80 or shift > 63:
            return value, at
