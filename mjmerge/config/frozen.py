"""The one base of everything that is read from a file: frozen, strict, nothing extra, nothing infinite."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, PydanticKnownError

from mjmerge.config.meanings import meanings
from mjmerge.roster import MOST_CARS, neighbour, slot

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]


class Frozen(BaseModel):
    """A frozen pydantic model that refuses extra keys, NaN, infinities and silent conversions."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
    )

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """See pydantic; with what the keys mean."""
        schema = handler(core)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for name, meaning in meanings(cls).items():
            properties.get(name, {}).setdefault("description", meaning)
        return schema


def _further(name: str) -> str:
    """The name of a car that a section does not declare."""
    number = slot(name)
    if number is None:
        raise PydanticKnownError("extra_forbidden")
    if number > MOST_CARS - 2:
        raise PydanticCustomError("too_many", "must be at most {most}", {"most": neighbour(MOST_CARS - 2)})
    return name


Further = Annotated[str, AfterValidator(_further)]
"""Key of a further car: ``vehicle_3`` and so on."""


def _by_pattern(schema: dict[str, Any]) -> None:
    """Says in a JSON schema which further keys there may be."""
    schema["patternProperties"] = {"^vehicle_[1-9][0-9]*$": schema.pop("additionalProperties")}
    schema["additionalProperties"] = False


class PerCar(Frozen):
    """A section with a key for each car: the first two neighbours', and as many more as there are.

    A subclass says what those are, as ``vehicle_1`` is: ``__pydantic_extra__: dict[Further, CarStart]``.
    """

    model_config = ConfigDict(extra="allow", json_schema_extra=_by_pattern)

    @property
    def further(self) -> dict[str, Any]:
        """What the keys of further cars say."""
        return dict(self.model_extra or {})
