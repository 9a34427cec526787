"""Ticks with all that is drawn of them: what every recorder gets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjmerge.record.contacts import Contacts, Mark, shade
from mjmerge.record.scene import Scene
from mjmerge.simulation.log import TickBlock
from mjmerge.state import Array, nanoseconds

if TYPE_CHECKING:
    from mjmerge.record.recording import Header
    from mjmerge.record.schema import Wire


@dataclass(frozen=True)
class PosedBlock:
    """A block of consecutive ticks, and where everything that is drawn was at some of them.

    Attributes:
        wire: the messages that they become.
        block: the ticks and their columns.
        time_ns: simulated time from the tick index, ns, (B,).
        drawn: which ticks of the block are drawn, (D,).
        pos_m: origins of ``Scene.frames`` in the world, m, (D, F, 3).
        quat: their orientations, w x y z, (D, F, 4).
        shades: colour of each neighbour's disc, see :func:`~mjmerge.record.contacts.shade`, (D, C-1).
        marks: of the contacts that begin.
    """

    wire: Wire
    block: TickBlock
    time_ns: NDArray[np.int64]
    drawn: NDArray[np.intp]
    pos_m: Array
    quat: Array
    shades: NDArray[np.int64]
    marks: tuple[Mark, ...]

    @cached_property
    def rows(self) -> dict[str, Array]:
        """What goes into the messages of each topic, (B, doubles); made once, for all formats."""
        return self.wire.rows(self.block)


class Posing:
    """Adds what is drawn to the consecutive blocks of one run."""

    def __init__(self, header: Header, scene: Scene) -> None:
        """Args: what is known of the run; what is drawn."""
        self._scene, self._wire, self._step_s = scene, header.wire, header.control_step_s
        self._contacts = Contacts(header.scenario.roster, header.sheets, header.control_step_s)

    def block(self, block: TickBlock) -> PosedBlock:
        """The next ticks."""
        drawn = self._scene.drawn(block, self._step_s)
        return self.at(block, drawn, *self._scene.poses(block, drawn))

    def at(self, block: TickBlock, drawn: NDArray[np.intp], pos_m: Array, quat: Array) -> PosedBlock:
        """The next ticks, where poses are known; the arguments are those of :class:`PosedBlock`."""
        marks, ago_s = self._contacts.add(block)
        shades = shade(block.columns["distance_m"][drawn], self._scene.r_m, ago_s[drawn])
        time_ns = nanoseconds(block.ticks * self._step_s)
        return PosedBlock(self._wire, block, time_ns, drawn, pos_m, quat, shades, tuple(marks))


def join(parts: Sequence[PosedBlock]) -> PosedBlock:
    """Consecutive blocks as one; without ``qpos``, which nobody needs any more."""
    starts = np.cumsum([0, *(len(p.time_ns) for p in parts[:-1])])
    block = TickBlock(
        ticks=np.concatenate([p.block.ticks for p in parts]),
        time_s=np.concatenate([p.block.time_s for p in parts]),
        columns={
            name: np.concatenate([p.block.columns[name] for p in parts]) for name in parts[0].block.columns
        },
        qpos=np.empty((sum(len(p.time_ns) for p in parts), 0)),
    )
    return PosedBlock(
        parts[0].wire,
        block,
        np.concatenate([p.time_ns for p in parts]),
        np.concatenate([start + p.drawn for start, p in zip(starts, parts, strict=True)]),
        np.concatenate([p.pos_m for p in parts]),
        np.concatenate([p.quat for p in parts]),
        np.concatenate([p.shades for p in parts]),
        tuple(mark for p in parts for mark in p.marks),
    )
