"""``mjmerge schema``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Schema:
    """Print the JSON Schema of scenario or campaign files, for editors."""

    what: Annotated[Literal["scenario", "campaign"], tyro.conf.Positional] = "scenario"
    """Which kind of file."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.campaign import Campaign
        from mjmerge.loader import json_schema
        from mjmerge.scenario import Scenario

        print(json_schema(Scenario if self.what == "scenario" else Campaign), end="")
        return 0
