"""Recordings of before there could be more than two neighbours are read as they always were.

``schema_1/`` holds 0.05 s of ``charge`` with noisy positions, by the last version that wrote schema 1.
"""

from __future__ import annotations

import lzma
import shutil
from pathlib import Path

import numpy as np
import pytest

from mjmerge.record.read import read
from mjmerge.review.convert import flat
from mjmerge.review.recover import recover
from mjmerge.review.replay import replay
from mjmerge.review.verify import verify
from mjmerge.roster import roster
from mjmerge.simulation.trace import COLUMNS
from mjmerge.versions import versions

OLD = Path(__file__).parent / "schema_1"
KINDS = ("mcap", "rrd")


@pytest.fixture(params=KINDS)
def old(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / f"run.{request.param}"
    with lzma.open(OLD / f"{path.name}.xz") as packed, path.open("wb") as out:
        shutil.copyfileobj(packed, out)
    return path


def test_it_says_its_version_and_has_an_ego_and_two_neighbours(old: Path) -> None:
    found = read(old)
    assert found.schema_version == 1
    assert found.roster == roster(2)
    assert "cars" not in found.manifest
    trace = found.trace()
    for column in COLUMNS:
        assert getattr(trace, column.name).shape == (1, 6, *column.shape(roster(2)))
    assert not np.isnan(trace.sensed_front_m).any()


def test_it_verifies(old: Path) -> None:
    found = verify(old)
    assert [check for check in found.checks if check.right is False] == []
    (schema,) = (check for check in found.checks if check.name == "schema")
    assert schema.says == "version 1"


def test_it_runs_again_to_the_same_bits(old: Path) -> None:
    here, then = versions(), read(old).manifest["versions"]
    found = replay(old)
    if all(here[name] == then[name] for name in ("mujoco", "numpy")):
        assert found.same
    else:
        assert not found.other_world


def test_it_is_a_table_under_the_same_names(old: Path) -> None:
    names = flat(read(old))
    assert {"distance_m.vehicle_2", "clearance_m.vehicle_1_vehicle_2", "front_m.ego.x"} <= names.keys()


def test_what_was_cut_off_is_recovered(old: Path, tmp_path: Path) -> None:
    cut = tmp_path / f"run{old.suffix}.partial"
    data = old.read_bytes()
    cut.write_bytes(data[: int(0.98 * len(data))])
    out = tmp_path / f"recovered{old.suffix}"
    recover(cut, out)
    again = read(out)
    assert again.roster == roster(2)
    assert len(again.ticks)
