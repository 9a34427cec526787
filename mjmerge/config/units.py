"""What the unit at the end of a key's name says, and what a change of scale does to its value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic.fields import FieldInfo

from mjmerge.config.frozen import Frozen, PerCar

_Model = TypeVar("_Model", bound=Frozen)


@dataclass(frozen=True)
class Unit:
    """m^length s^time; annotates the keys that are the paper's letters and so have no unit in their names."""

    length: int
    time: int


_SUFFIXES = {
    "_per_s": ("1/s", Unit(0, -1)),  # before the shorter one that it ends with
    "_s": ("s", Unit(0, 1)),
    "_m": ("m", Unit(1, 0)),
    "_mps": ("m/s", Unit(1, -1)),
    "_mps2": ("m/s^2", Unit(1, -2)),
    "_rad": ("rad", Unit(0, 0)),
    "_radps": ("rad/s", Unit(0, -1)),
    "_kg": ("kg", None),
    "_n": ("N", None),
}
"""By the end of a name: how the unit is written, and what it is made of; ``None``: not changed by a scale."""


def written(name: str) -> str:
    """The unit at the end of a key's name as it is written in a table; 1 if there is none."""
    return next((symbol for suffix, (symbol, _) in _SUFFIXES.items() if name.endswith(suffix)), "1")


def unit(name: str, info: FieldInfo) -> Unit | None:
    """The unit of a key; ``None`` if it has none."""
    for declared in info.metadata:
        if isinstance(declared, Unit):
            return declared
    return _named(name)


def _named(name: str) -> Unit | None:
    """The unit at the end of a name; ``None`` if there is none."""
    return next((of for suffix, (_, of) in _SUFFIXES.items() if name.endswith(suffix)), None)


def rescaled(model: _Model, length: float, time: float, inherited: Unit | None = None) -> _Model:
    """The model with every value multiplied by what its unit becomes; not checked against its bounds.

    Args:
        model: what to rescale, with all that is in it.
        length: factor of lengths.
        time: factor of times.
        inherited: unit of the keys that have none of their own.
    """

    def times(value: Any, of: Unit | None) -> Any:
        if isinstance(value, Frozen):
            return rescaled(value, length, time, of)
        if isinstance(value, tuple):
            return tuple(times(item, of) for item in value)
        if isinstance(value, dict):
            forces = ("_n_s", "_n_m")  # do not follow from lengths and times alone
            return {k: times(item, None if k.endswith(forces) else _named(k)) for k, item in value.items()}
        if isinstance(value, float) and of is not None:
            return value * (length**of.length * time**of.time)
        return value

    fields = type(model).model_fields
    update = {
        name: times(getattr(model, name), unit(name, info) or inherited) for name, info in fields.items()
    }
    if isinstance(model, PerCar):
        update |= {name: times(value, inherited) for name, value in model.further.items()}
    return model.model_copy(update=update)
