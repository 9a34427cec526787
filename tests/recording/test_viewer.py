"""The layout works in the real viewer: no view has a complaint."""

from __future__ import annotations

from pathlib import Path

import pytest

from mjmerge.record import Header, Outcome, Recording, open_rrd

from .conftest import MakeBlocks
from .viewer import has_vulkan, open_headless


@pytest.mark.viewer
@pytest.mark.skipif(not has_vulkan(), reason="no Vulkan driver (Debian: mesa-vulkan-drivers)")
def test_all_views_are_content(tmp_path: Path, header: Header, make_blocks: MakeBlocks) -> None:
    with Recording(tmp_path, header, {"run.rrd": open_rrd}) as recording:
        for block in make_blocks(50, 50):
            recording.write(block)
        recording.close(Outcome([], "held", {}))
    picture = tmp_path / "view.png"
    assert open_headless(tmp_path / "run.rrd", picture, time_s=0.5) == []
    assert picture.stat().st_size > 10_000
