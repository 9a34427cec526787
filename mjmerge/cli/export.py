"""``mjmerge export``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from mjmerge.cli.options import Overrides, ScenarioName, unsaid
from mjmerge.outputs import put_new


@dataclass(frozen=True)
class Export:
    """Print the composed MJCF world of a scenario, or write it to a file."""

    scenario: ScenarioName
    """Name of a shipped scenario, or the path of a YAML file."""
    set_: Overrides = ()
    """Any scenario key; repeatable."""
    out: Annotated[Path | None, unsaid("FILE")] = None
    """File to write; standard output by default."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.scenario.load import load

        scenario = load(self.scenario, self.set_)

        from mjmerge.world.compose import build  # what is wrong with a scenario is said before

        xml = build(scenario).xml
        if self.out is None:
            print(xml)
            return 0
        put_new(self.out, xml)
        return 0
