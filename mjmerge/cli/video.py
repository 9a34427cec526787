"""``mjmerge video``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mjmerge.cli.options import Count, RunPath, unsaid
from mjmerge.cli.progress import progress_bar
from mjmerge.errors import MjmergeError


@dataclass(frozen=True)
class Video:
    """Make an mp4 of a recording: the cars drawn by MuJoCo, opinion and distances beside them."""

    run: RunPath
    """A run folder, or a .mcap or .rrd file, finished or not."""
    camera: Literal["chase", "overhead"] = "chase"
    """From behind the ego, or from above."""
    speed: Annotated[float, tyro.conf.arg(metavar="FACTOR")] = 1.0
    """Simulated seconds per second of the video."""
    fps: Count = 30
    """Pictures per second."""
    out: Annotated[Path | None, unsaid("FILE")] = None
    """File to write; by default beside the recording, with the ending .mp4."""

    def __call__(self) -> int:
        """Run the command; return its exit code."""
        from mjmerge.record.read import recording
        from mjmerge.review.video import Options, video

        if not 0.01 <= self.speed <= 100 or not 1 <= self.fps <= 240:
            raise MjmergeError("--speed must be from 0.01 to 100, --fps from 1 to 240")
        path = recording(self.run)
        out = self.out or (path.with_suffix("") if path.suffix == ".partial" else path).with_suffix(".mp4")
        with progress_bar(1.0, "drawing") as progress:
            backend = video(path, out, Options(self.camera, self.fps, self.speed), progress)
        print(f"{out} (drawn with {backend})")
        return 0
