"""Drivers of the neighbours, one file per kind: what a neighbour intends, as an acceleration.

Add a kind by adding a file here with one subclass of :class:`Driver` whose ``kind`` is a ``Literal``;
it is found by itself, its fields become scenario keys, and ``mjmerge list drivers`` shows it. A kind of one's
own needs no place here: a scenario names it as ``kind: mine.py:Name``, see ``outside.py``.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from typing import Annotated, Any, Union

from pydantic import Field, PlainSerializer, WrapValidator

from mjmerge.config.doors import OrOutside, as_mapping
from mjmerge.drivers.base import Along, Driver
from mjmerge.drivers.outside import Absent, ask, let_in
from mjmerge.drivers.traffic import Traffic, ahead

__all__ = ["Absent", "Along", "Driver", "Traffic", "ahead", "ask", "kinds", "union"]


def kinds() -> Mapping[str, type[Driver]]:
    """Every driver kind in this folder, by name."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    ours = [cls for cls in Driver.__subclasses__() if cls.__module__.startswith(f"{__name__}.")]
    return {cls.model_fields["kind"].default: cls for cls in ours if cls is not Absent}


def union() -> Any:
    """The pydantic type "any driver, told apart by its ``kind``"; those from outside by its colon."""
    shipped: Any = Annotated[Union[tuple(kinds().values())], Field(discriminator="kind")]  # noqa: UP007
    return Annotated[shipped, WrapValidator(let_in), PlainSerializer(as_mapping), OrOutside("driver")]
