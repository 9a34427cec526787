"""Drivers of the neighbours, one file per kind: what a neighbour intends, as an acceleration.

Add a kind by adding a file here with one subclass of :class:`Driver` whose ``kind`` is a ``Literal``;
it is found by itself, its fields become scenario keys, and ``mjmerge list drivers`` shows it.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from typing import Annotated, Any, Union

from pydantic import Field

from mjmerge.drivers.base import Along, Driver
from mjmerge.drivers.traffic import Traffic

__all__ = ["Along", "Driver", "Traffic", "kinds", "union"]


def kinds() -> Mapping[str, type[Driver]]:
    """Every driver kind in this folder, by name."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    return {cls.model_fields["kind"].default: cls for cls in Driver.__subclasses__()}


def union() -> Any:
    """The pydantic type "any driver, told apart by its ``kind``"."""
    return Annotated[Union[tuple(kinds().values())], Field(discriminator="kind")]  # noqa: UP007
