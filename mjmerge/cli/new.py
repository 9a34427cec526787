"""``mjmerge new``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mjmerge.cli.options import Flag


@dataclass(frozen=True)
class New:
    """Write a working, commented start of a car (a folder), law, driver, metric, scenario or campaign."""

    what: Annotated[Literal["car", "law", "driver", "metric", "scenario", "campaign"], tyro.conf.Positional]
    """What to begin."""
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")]
    """What to call it: a letter, then letters, digits, _ and -."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path()
    """Folder to write it into; by default the current one. Nothing is ever overwritten."""
    json: Flag = False
    """Print one JSON object and nothing else on standard output."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.starts.make import KINDS, make

        made = make(self.what, self.name, self.out)
        then = KINDS[self.what].then(str(made) if made.is_absolute() else f"./{made}", self.name)
        if self.json:
            files = sorted(map(str, made.iterdir())) if made.is_dir() else [str(made)]
            print(
                json.dumps(
                    {"kind": self.what, "name": self.name, "path": str(made), "files": files, "next": then}
                )
            )
            return 0
        print(f"wrote {made}; as it stands, it can be used:")
        for command in then:
            print(f"  {command}")
        return 0
