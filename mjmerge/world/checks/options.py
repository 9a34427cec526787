"""Whether a compiled world is what was composed: the world before its cars came, and its cars."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from mjmerge.roster import WHEELS

_NOTHING_OF = {
    "nexclude": "contact exclusions",
    "neq": "equalities",
    "ntendon": "tendons",
    "nkey": "keyframes",
    "nflex": "flexes",
    "nskin": "skins",
    "nplugin": "plugins",
    "nmocap": "mocap bodies",
    "ngravcomp": "bodies without weight",
}
"""Counts that are zero in every world."""
_GEOM = (
    *("type", "contype", "conaffinity", "condim", "priority", "size", "pos", "quat", "rgba", "group"),
    *("friction", "margin", "gap", "solref", "solimp", "solmix"),
)
"""What makes a geom of the road and its markings."""


def differences(
    model: mujoco.MjModel, before: mujoco.MjModel, asked: Mapping[str, float], cars: Sequence[str]
) -> Iterator[str]:
    """What of a compiled world is not as it was asked for, or not as it was before its cars came.

    Args:
        model: the world.
        before: the same without cars: all options, the picture and the road that are meant.
        asked: options that were asked for in words, which a composition might lose.
        cars: names of the cars.
    """
    for name, value in asked.items():
        yield from _same(f"option {name}", getattr(before.opt, name), value)
    for name in _values(before.opt):
        yield from _same(f"option {name}", getattr(model.opt, name), getattr(before.opt, name))
    for part in ("global_", "headlight", "map", "quality", "rgba", "scale"):
        mine, meant = getattr(model.vis, part), getattr(before.vis, part)
        for name in _values(meant):
            yield from _same(f"visual {part.strip('_')} {name}", getattr(mine, name), getattr(meant, name))
    for name in ("extent", "center"):
        yield from _same(f"statistic {name}", getattr(model.stat, name), getattr(before.stat, name))
    for name in _GEOM:
        mine, meant = getattr(model, f"geom_{name}"), getattr(before, f"geom_{name}")
        for i, value in enumerate(meant):  # what stands still comes first in both
            if not np.array_equal(mine[i], value):
                yield from _same(f"{before.geom(i).name}'s {name}", mine[i], value)
    yield from _same("number of lights", model.nlight, before.nlight)
    yield from _same("number of contact pairs", model.npair, len(cars) * len(WHEELS))
    for count, what in _NOTHING_OF.items():
        if number := int(getattr(model, count)):
            yield f"the compiled world has {number} {what}; expected none"
    for i in range(model.npair):
        pair = model.pair(i)
        for name, value in (("dim", 3), ("margin", 0), ("gap", 0)):
            yield from _same(f"contact {pair.name}'s {name}", getattr(pair, name), value)


def _values(part: object) -> list[str]:
    """Names of the numbers that a struct of MuJoCo holds."""
    return [
        n
        for n in dir(part)
        if not n.startswith("_") and isinstance(getattr(part, n), int | float | np.ndarray)
    ]


def _same(what: str, mine: Any, meant: Any) -> Iterator[str]:
    if not np.array_equal(np.ravel(mine), np.ravel(meant)):
        yield f"the compiled world's {what} is {_text(mine)}, not {_text(meant)}"


def _text(value: Any) -> str:
    return " ".join(f"{float(v):g}" for v in np.ravel(value))
