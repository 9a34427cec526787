"""``mjmerge schema``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Schema:
    """Print the JSON Schema of scenarios, campaigns or cars' data sheets, for editors."""

    what: Annotated[Literal["scenario", "campaign", "datasheet"], tyro.conf.Positional] = "scenario"
    """Which kind of file."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.config.frozen import Frozen
        from mjmerge.scenario.load import json_schema
        from mjmerge.scenario.schema import Scenario
        from mjmerge.sweep.campaign import Campaign
        from mjmerge.vehicle.datasheet import DataSheet

        kinds: dict[str, type[Frozen]] = {"scenario": Scenario, "campaign": Campaign, "datasheet": DataSheet}
        print(json_schema(kinds[self.what]), end="")
        return 0
