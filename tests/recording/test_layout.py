"""What is plotted and drawn exists, is coloured by what it says, and comes from the declarations."""

from __future__ import annotations

import json
from functools import reduce
from operator import getitem
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.errors import OutputError
from mjmerge.record import Header, Keep, plots, schema
from mjmerge.record.contacts import CLEAR, DISC_RGBA, shade
from mjmerge.record.mcap import foxglove as foxglove_layout
from mjmerge.record.posed import Posing, join
from mjmerge.record.rerun import arrow
from mjmerge.record.rerun.side_by_side import ShownSide, write_comparison
from mjmerge.record.scene import TARGET, Scene
from mjmerge.roster import roster
from mjmerge.run import selected
from mjmerge.scenario.load import load
from mjmerge.simulation.log import BLOCK_S, block_ticks
from mjmerge.world.compose import build

from .conftest import MakeBlocks
from .test_recording import columns

WIRE = schema.Wire(roster())
NEVER_S = np.array([[np.inf]])


@pytest.fixture(scope="module")
def scene() -> Scene:
    scenario = load("paper")
    return Scene(build(scenario).drawn, scenario.law.r_m)


def test_every_plotted_field_is_in_its_message(scene: Scene) -> None:
    for plot in plots.everything(load("paper"), scene.paint):
        for line in plot.lines:
            message = schema.LAW_MESSAGE if line.topic == schema.LAW_TOPIC else schema.CAR_MESSAGE
            fields = {f.name: f.parts for f in WIRE.messages[message]}
            name, _, part = line.field.partition(".")
            assert part in (fields[name] or ("",)), line


def test_the_published_foxglove_layout_is_current(scene: Scene) -> None:
    text = foxglove_layout.text(load("paper"), scene.paint)
    assert foxglove_layout.FILE.read_text(encoding="utf-8") == text, "write it to foxglove_layout.FILE"
    assert "/law.distance_m.vehicle_2" in text
    json.loads(text)


@given(st.integers(1, 70), st.integers(0, 2**32 - 1))
def test_messages_as_arrow_come_back_bit_for_bit(count: int, seed: int) -> None:
    doubles = WIRE.layout(schema.CAR_MESSAGE).doubles
    bits = np.random.default_rng(seed).integers(0, 2**64, (count, doubles), np.uint64)
    rows = bits.view(np.float64)  # NaN of all kinds among them
    (column,) = arrow.structs(WIRE, schema.CAR_MESSAGE, rows)
    array = column.as_arrow_array()
    assert arrow.numbers(WIRE, array, schema.CAR_MESSAGE).tobytes() == rows.tobytes()
    message = array[count - 1].as_py()[0]
    for at, field in enumerate(f.name for f in WIRE.messages[schema.CAR_MESSAGE] if not f.parts):
        assert field in message, at
    front = reduce(getitem, ("front_m", "y"), message)
    names = [f"{f.name}.{p}" for f in WIRE.messages[schema.CAR_MESSAGE] for p in f.parts or ("",)]
    assert np.array_equal(front, rows[-1, names.index("front_m.y")], equal_nan=True)


def test_a_damaged_array_is_refused() -> None:
    ends = np.array([0, 1], np.int32)
    damaged = pa.ListArray.from_arrays(pa.array(ends), pa.array([1.0]))
    ends[1] = 99  # behind its back: Arrow looks at the same memory
    with pytest.raises(ValueError, match="offset"):
        arrow.numbers(WIRE, damaged, schema.CAR_MESSAGE)


@pytest.mark.parametrize("r_m", [0.6, 6.0])
def test_a_disc_is_red_inside_amber_at_half_of_r_and_green_from_r_on(r_m: float) -> None:
    distance_m = r_m * np.array([[-0.2], [0.0], [0.5], [1.0], [9.0]])
    red, green, blue, _ = DISC_RGBA[shade(distance_m, r_m, np.full((5, 1), np.inf))[:, 0]].T
    assert (red > 3 * green).tolist() == [True, True, False, False, False]
    assert (green > 2 * red).tolist() == [False, False, False, True, True]
    assert red[2] > green[2] > 3 * blue[2]


@given(st.floats(-1, 3), st.floats(-1, 3))
def test_a_disc_is_no_greener_where_the_ego_is_nearer(a: float, b: float) -> None:
    near, far = sorted((a, b))
    shades = [int(shade(np.array([[d_m]]), 1.0, NEVER_S)[0, 0]) for d_m in (near, far)]
    assert shades[0] <= shades[1]
    assert (shades[0] == 0) == (near <= 0), "red means inside, and nothing else"


def test_what_is_not_known_is_no_alarm() -> None:
    assert shade(np.array([[np.nan]]), 1.0, NEVER_S) == CLEAR


@pytest.mark.parametrize("step_s", [0.001, 0.01, 0.03, 0.1, 0.5, 1.0])
def test_a_block_loses_no_more_than_half_a_second(step_s: float) -> None:
    ticks = block_ticks(step_s)
    assert ticks == 1 or ticks * step_s <= BLOCK_S + 1e-9
    assert (ticks + 1) * step_s > BLOCK_S


def test_the_ghost_is_the_ego_on_the_road(scene: Scene) -> None:
    frames = {f.name: f for f in scene.frames}
    ego = [s for name, f in frames.items() if name.startswith("ego/") for s in f.shapes]
    ghost = frames[TARGET].shapes
    assert [s.kind for s in ghost] == [s.kind for s in ego]
    assert all(s.rgba[3] < 0.5 for s in ghost)
    wheels = [s for s in ghost if s.kind == "cylinder"]
    assert min(s.pos_m[2] - s.half_size_m[0] for s in wheels) == pytest.approx(0, abs=0.02)


def test_joined_blocks_are_the_whole_run(header: Header, make_blocks: MakeBlocks) -> None:
    blocks = make_blocks(3, 50, 1, 8)
    scene = Scene(header.model, 0.6)
    posing = Posing(header, scene)
    whole = join([posing.block(b) for b in blocks])
    for name, values in columns(blocks).items():
        told = whole.block.time_s if name == "time_s" else whole.block.columns[name]
        assert told.tobytes() == values.tobytes(), name
    assert whole.block.ticks[whole.drawn].tolist() == list(range(0, 62, 4))
    assert whole.pos_m.shape[:2] == whole.quat.shape[:2] == (16, len(scene.frames))
    (block,) = make_blocks(62)
    at_once = Posing(header, scene).block(block)
    assert np.array_equal(whole.shades, at_once.shades)
    assert [str(mark) for mark in whole.marks] == [str(mark) for mark in at_once.marks]
    assert whole.marks


class Judged:
    def __init__(self, floor_held: bool) -> None:
        self.floor_held = floor_held


def test_worst_median_and_three_violations_are_selected(make_trace) -> None:
    least = np.array([0.3, -0.1, 0.5, 0.04, 0.2, -0.2, 0.01, 0.02])
    trace = make_trace(ticks=3, runs=8, distance_m=least[:, None, None])
    found = selected(trace, [Judged(d >= 0.05) for d in least])
    assert found == {"run": 5, "median": 7, "violation-1": 1, "violation-6": 6, "violation-3": 3}


def test_a_comparison_is_not_written_over_a_file(
    tmp_path: Path, header: Header, make_blocks: MakeBlocks
) -> None:
    keep = Keep(header)
    for block in make_blocks(20, 5):
        keep.write(block)
    sides = [ShownSide(label, header, keep.posed(), None) for label in ("ideal", "ideal")]
    write_comparison(tmp_path / "c.rrd", sides)
    assert [p.name for p in tmp_path.iterdir()] == ["c.rrd"]
    with pytest.raises(OutputError, match="not overwritten"):
        write_comparison(tmp_path / "c.rrd", sides)
