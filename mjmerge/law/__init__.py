"""Laws, one file or folder per kind: what the ego asks of its car, from what it senses.

Add a kind by adding a file here with one subclass of :class:`Law` whose ``kind`` is a ``Literal``; it is
found by itself, and its fields become keys of a scenario's section ``law``. A law of one's own needs no place
here: a scenario names it as ``kind: mine.py:Name``, see ``outside.py``. The paper's is in
``opinion_dynamics``, one file per part; what each named reading of it is for stands in :data:`VARIANTS`.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, TypeGuard, Union

from pydantic import Field, PlainSerializer, WrapValidator

from mjmerge.config.doors import OrOutside, as_mapping, from_outside
from mjmerge.errors import MjmergeError
from mjmerge.law.asked import decided, remembered
from mjmerge.law.base import Decision, Flow, Law, Memory, Signal, lacking
from mjmerge.law.function import Seen, each_run
from mjmerge.law.opinion_dynamics.law import OpinionDynamics
from mjmerge.law.opinion_dynamics.variants import VARIANTS
from mjmerge.law.outside import AbsentLaw, let_in
from mjmerge.law.sensed import Geometry, Sensed, geometry
from mjmerge.law.several import Laws

__all__ = [
    "VARIANTS",
    "AbsentLaw",
    "Decision",
    "Flow",
    "Geometry",
    "Law",
    "Laws",
    "Memory",
    "OpinionDynamics",
    "Seen",
    "Sensed",
    "Signal",
    "decided",
    "each_run",
    "geometry",
    "is_paper",
    "kinds",
    "lacking",
    "of_paper",
    "remembered",
    "union",
]


def is_paper(law: Law) -> TypeGuard[OpinionDynamics]:
    """Whether it is the paper's law itself: what somebody derives from it is a law of their own."""
    return isinstance(law, OpinionDynamics) and not from_outside(law.kind)


def of_paper(law: Law) -> OpinionDynamics:
    """The paper's law.

    Raises:
        MjmergeError: it is another.
    """
    if not isinstance(law, OpinionDynamics):
        raise MjmergeError(f"this is about the paper's law, opinion_dynamics, and the law is {law.label}")
    return law


def kinds() -> Mapping[str, type[Law]]:
    """Every kind of law in this folder, by name; the paper's first."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    found = {OpinionDynamics.model_fields["kind"].default: OpinionDynamics}
    ours = [cls for cls in _below(Law) if cls.__module__.startswith(f"{__name__}.")]
    named = {cls: cls.model_fields["kind"].default for cls in ours}
    shipped = {
        kind: cls for cls, kind in named.items() if isinstance(kind, str) and cls.decide is not Law.decide
    }
    return found | dict(sorted(shipped.items()))


def _below(cls: type[Any]) -> Iterator[type[Law]]:
    for sub in cls.__subclasses__():
        yield sub
        yield from _below(sub)


def union() -> Any:
    """The pydantic type "any law, told apart by its ``kind``"; those from outside by its colon."""
    shipped: Any = Annotated[Union[tuple(kinds().values())], Field(discriminator="kind")]  # noqa: UP007
    return Annotated[shipped, WrapValidator(let_in), PlainSerializer(as_mapping), OrOutside("law")]
