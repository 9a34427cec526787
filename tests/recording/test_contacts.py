"""A contact is seen: who, where, when and how fast, for long enough; and it follows from the numbers."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjmerge.record import FORMATS, Recording
from mjmerge.record.contacts import NOTHING, SEEN_S, TOUCHED, Contacts, place, states
from mjmerge.record.mcap.reader import mcap_drawn
from mjmerge.record.posed import Posing
from mjmerge.record.read import read
from mjmerge.record.rerun.reader import rrd_batches
from mjmerge.record.scene import Scene
from mjmerge.review.compare import Side, recording_of_both
from mjmerge.review.poses import header, touched
from mjmerge.review.recover import recover
from mjmerge.review.verify import verify
from mjmerge.roster import roster
from mjmerge.run import run
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.load import load
from mjmerge.simulation.log import TickBlock
from mjmerge.simulation.loop import simulate
from mjmerge.verdict.metrics import JOIN_S, collisions, events
from mjmerge.verdict.phases import phases
from tests.recording import rewrite
from tests.recording.test_forgery import STANDS

THREE = roster(2)
SHEETS = car_sheets(load("charge"))
STEP_S = 0.01


def block(touches: np.ndarray, fast: np.ndarray, first: int = 0) -> TickBlock:
    """Ticks in which pairs of cars in a row touch, (T, P), at some speed or none."""
    count = len(touches)
    front_m = np.tile([[0.0, 0.0], [0.58, 0.0], [-0.58, 0.0]], (count, 1, 1))
    columns = {
        "clearance_m": np.where(touches, -0.001, 1.0),
        "contact_impulse_n_s": np.where(touches & fast, 1.0, 0.0),
        "contact_speed_mps": np.where(touches & fast, 2.0, 0.0),
        "front_m": front_m,
        "heading_rad": np.zeros((count, 3)),
    }
    ticks = np.arange(first, first + count)
    return TickBlock(ticks, ticks * STEP_S, columns, np.empty((count, 0)))


def part(of: TickBlock, start: int, end: int) -> TickBlock:
    columns = {name: values[start:end] for name, values in of.columns.items()}
    return TickBlock(of.ticks[start:end], of.time_s[start:end], columns, of.qpos[start:end])


def onsets(touching: np.ndarray) -> list[int]:
    """Ticks at which one pair begins to touch, tick by tick: breaks of less than ``JOIN_S`` are none."""
    found, last = [], None
    for k in np.flatnonzero(touching).tolist():
        if last is None or k - last - 1 >= round(JOIN_S / STEP_S):
            found.append(k)
        last = k
    return found


@given(st.data())
def test_every_contact_has_a_mark_at_its_first_tick_however_blocks_are_cut(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 120))
    runs = st.lists(st.tuples(st.integers(0, 119), st.integers(1, 8)), max_size=4)
    touches = np.zeros((count, 3), bool)
    for i in range(3):
        for start, length in data.draw(runs):
            touches[start : start + length, i] = True
    fast = np.random.default_rng(data.draw(st.integers(0, 9))).random(touches.shape) < 0.5
    whole = block(touches, fast)
    cuts = sorted({0, count, *data.draw(st.lists(st.integers(0, count), max_size=5))})
    watch = Contacts(THREE, SHEETS, STEP_S)
    each = [watch.add(part(whole, a, b)) for a, b in pairwise(cuts)]
    marks, ago_s = [m for some, _ in each for m in some], np.concatenate([ago for _, ago in each])
    once, ago_at_once_s = Contacts(THREE, SHEETS, STEP_S).add(whole)
    assert list(map(str, marks)) == list(map(str, once))
    assert np.array_equal(ago_s, ago_at_once_s)
    for i, (a, b) in enumerate(THREE.pairs):
        mine = [m for m in marks if (m.collision.a, m.collision.b) == (THREE.cars[a], THREE.cars[b])]
        last = {round(m.collision.time_s / STEP_S): m.collision.speed_mps for m in mine}
        begun = onsets(touches[:, i])
        assert sorted(last) == begun
        assert len({m.number for m in mine}) == len(begun)
        for first, end in pairwise([*begun, count]):
            assert (last[first] == 2.0) == bool((touches & fast)[first:end, i].any())
    for j in range(2):
        pairs = [i for i, pair in enumerate(THREE.pairs) if j + 1 in pair]
        seen = np.flatnonzero(touches[:, pairs].any(axis=1))
        for k in range(count):
            before = seen[seen <= k]
            assert ago_s[k, j] == (pytest.approx((k - before[-1]) * STEP_S) if before.size else np.inf)


@pytest.mark.parametrize(("pause", "marks"), [(29, 1), (30, 2)])
def test_a_break_of_less_than_a_moment_is_the_same_contact(pause: int, marks: int) -> None:
    assert round(JOIN_S / STEP_S) == 30
    touches = np.zeros((80, 3), bool)
    touches[[10, 11 + pause], 0] = True
    found, _ = Contacts(THREE, SHEETS, STEP_S).add(block(touches, touches))
    assert [mark.number for mark in found] == [*range(1, marks + 1)]


def test_a_speed_that_is_known_a_tick_later_is_added_to_the_mark() -> None:
    touches, fast = np.zeros((20, 3), bool), np.zeros((20, 3), bool)
    touches[5:9, 0], fast[7:9, 0] = True, True
    found, _ = Contacts(THREE, SHEETS, STEP_S).add(block(touches, fast))
    assert [mark.collision.sentence for mark in found] == [
        "the ego hits vehicle_1 at 0.05 s",
        "the ego hits vehicle_1 at 0.05 s at 2.00 m/s",
    ]
    assert [mark.time_ns for mark in found] == [50_000_000, 70_000_000]


@pytest.mark.parametrize(
    ("front_m", "heading_rad", "there_m"),
    [
        ([[0.0, 0.0], [0.28, 0.265]], [0.0, np.pi / 2], [0.125, 0.0]),  # nose into a side
        ([[0.0, 0.0], [0.58, 0.0]], [0.0, 0.0], [0.125, 0.0]),  # bumper to bumper
        ([[0.0, 0.0], [0.0, 0.31]], [0.0, 0.0], [-0.165, 0.155]),  # side by side
        ([[0.0, 0.0], [0.57, 0.30]], [0.0, 0.0], [0.12, 0.15]),  # corner in corner
    ],
)
def test_the_mark_is_where_the_bodies_meet(front_m, heading_rad, there_m) -> None:
    sheets = [SHEETS[0].model_copy(update={"length_m": 0.58, "width_m": 0.31, "front_overhang_m": 0.125})] * 2
    found = place(np.array(front_m), np.array(heading_rad), sheets)
    assert found == pytest.approx(there_m, abs=0.011)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3), st.floats(0.2, 0.6), st.floats(-0.3, 0.3))
def test_the_mark_moves_and_turns_with_the_cars(x, y, turn, ahead, aside) -> None:
    front_m, heading_rad = np.array([[0.0, 0.0], [ahead, aside]]), np.array([0.1, 0.9])
    c, s = np.cos(turn), np.sin(turn)
    move = np.array([[c, -s], [s, c]])
    there_m = place(front_m, heading_rad, SHEETS[:2])
    moved_m = place(front_m @ move.T + [x, y], heading_rad + turn, SHEETS[:2])
    assert moved_m == pytest.approx(move @ there_m + [x, y], abs=1e-6)
    swapped_m = place(front_m[::-1], heading_rad[::-1], SHEETS[:2])
    assert swapped_m == pytest.approx(there_m, abs=1e-9)


@pytest.fixture(scope="module")
def crash(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ego stands, and is driven into."""
    folder = tmp_path_factory.mktemp("crash")
    assert run(load("paper", ["duration_s=0.8", *STANDS]), "mujoco", folder=folder).failures == []
    return folder


def rrd(path: Path) -> dict[str, list[tuple[int, pa.RecordBatch]]]:
    found: dict[str, list[pa.RecordBatch]] = {}
    for entity, batch in rrd_batches(path):
        found.setdefault(entity, []).append(batch)
    return found


def texts(batches: list[pa.RecordBatch], name: str) -> list[str]:
    return [text for b in batches if name in b.schema.names for (text,) in b[name].to_pylist()]


def test_a_recording_shows_who_was_hit_when_where_and_how_fast(crash: Path) -> None:
    trace = read(crash / "run.rrd").run()
    (hit,) = collisions(trace)
    shown = rrd(crash / "run.rrd")
    assert texts(shown["/world/contact_1/label"], "Points3D:labels") == [hit.sentence]
    assert "/world/contact_2" not in shown
    assert texts(shown["/contact"], "StateChange:state") == [NOTHING, "the ego hits vehicle_2"]
    (known,) = (
        b["StateConfiguration:values"].to_pylist()[0]
        for b in shown["/contact"]
        if "StateConfiguration:values" in b.schema.names
    )
    assert known == states(trace.roster)
    (batch,) = shown["/world/contact_1"]
    ((foot_m, _),) = batch["LineStrips3D:strips"].to_pylist()[0]
    k = round(hit.time_s / STEP_S)
    bodies_m = trace.front_m[0, k, [0, 2]].mean(axis=0)
    assert np.hypot(*(np.array(foot_m[:2]) - bodies_m)) < 0.4  # a car is 0.58 m long
    drawn = [message for topic, _, message in mcap_drawn(crash / "run.mcap") if topic == "/scene"]
    pins = [e for message in drawn for e in message.entities if e.id == "contact/1"]
    assert [t.text for e in pins for t in e.texts][-1] == hit.sentence
    assert not any(e.lifetime.ToNanoseconds() for e in pins), "it stays"


def test_discs_are_red_from_the_contact_on_for_as_long_as_one_notices(crash: Path) -> None:
    assert SEEN_S >= 1
    found = read(crash / "run.mcap")
    _, shades = touched(found, 0.6)
    first = int(np.flatnonzero(found.run().touching_ego[0, :, 1])[0])
    assert (shades[first:, 1] == TOUCHED).all()
    assert (shades[:first, 1] != TOUCHED).all()
    assert (shades[:, 0] != TOUCHED).all(), "the other neighbour touched nobody"
    count = round((SEEN_S + 1) / STEP_S)
    touches = np.zeros((count, 3), bool)
    touches[10, 1] = True
    _, ago_s = Contacts(THREE, SHEETS, STEP_S).add(block(touches, touches))
    assert np.flatnonzero(ago_s[:, 1] <= SEEN_S).tolist() == [*range(10, 10 + round(SEEN_S / STEP_S) + 1)]


def test_what_touched_nobody_shows_no_contact(tmp_path: Path) -> None:
    run(load("charge", ["duration_s=0.2"]), "mujoco", folder=tmp_path / "r")
    shown = rrd(tmp_path / "r" / "run.rrd")
    assert texts(shown["/contact"], "StateChange:state") == [NOTHING]
    assert not [entity for entity in shown if entity.startswith("/world/contact")]


def _away(entity: str, batch: pa.RecordBatch) -> pa.RecordBatch:
    """The pin stands elsewhere."""
    if entity != "/world/contact_1" or "LineStrips3D:strips" not in batch.schema.names:
        return batch
    at = batch.schema.get_field_index("LineStrips3D:strips")
    ((strip,),) = batch.column(at).to_pylist()
    moved = [[[[x + 0.2, y, z] for x, y, z in strip]]]
    return batch.set_column(at, batch.schema.field(at), pa.array(moved, batch.schema.field(at).type))


def _slower(entity: str, batch: pa.RecordBatch) -> pa.RecordBatch:
    """The label says less."""
    if entity != "/world/contact_1/label":
        return batch
    return rewrite.with_text(batch, "Points3D:labels", lambda text: text.replace(" at ", " near ", 1))


def _nobody(entity: str, batch: pa.RecordBatch) -> pa.RecordBatch:
    """The phase says that nobody was hit."""
    if entity != "/contact" or "StateChange:state" not in batch.schema.names:
        return batch
    at = batch.schema.get_field_index("StateChange:state")
    calm = pa.array([[NOTHING]] * batch.num_rows, batch.schema.field(at).type)
    return batch.set_column(at, batch.schema.field(at), calm)


def _pale(entity: str, batch: pa.RecordBatch) -> pa.RecordBatch:
    """No disc turns red."""
    if "Cylinders3D:colors" not in batch.schema.names or "vehicle_2" not in entity:
        return batch
    at = batch.schema.get_field_index("Cylinders3D:colors")
    first = batch.column(at).take(pa.array([0] * batch.num_rows))
    return batch.set_column(at, batch.schema.field(at), first)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("edit", [_away, _slower, _nobody, _pale])
def test_a_forged_mark_in_an_rrd_is_found(crash: Path, tmp_path: Path, edit: Callable) -> None:
    same = verify(rewrite.rrd(crash / "run.rrd", tmp_path / "same.rrd", edit=lambda _, batch: batch))
    forged = verify(rewrite.rrd(crash / "run.rrd", tmp_path / "forged.rrd", edit=edit))
    wrong = {check.name for check in forged.checks if check.right is False}
    assert wrong - {check.name for check in same.checks if check.right is False} == {"drawing"}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("gone", ["/world/contact_1", "/world/contact_1/label", "/contact"])
def test_a_mark_that_is_gone_from_an_rrd_is_missed(crash: Path, tmp_path: Path, gone: str) -> None:
    path = rewrite.rrd(crash / "run.rrd", tmp_path / "gone.rrd", keep=lambda entity: entity != gone)
    assert any("is not drawn" in check.says and gone in check.says for check in verify(path).checks)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("change", ["moved", "relabelled", "gone", "points"])
def test_a_forged_mark_in_an_mcap_is_found(crash: Path, tmp_path: Path, change: str) -> None:
    (mark, *_), _ = touched(read(crash / "run.mcap"), 0.6)
    x_m = mark.place_m[0]
    change_of: dict[str, Callable[[str, bytes], bytes]] = {
        "moved": lambda _, data: data.replace(struct.pack("<d", x_m), struct.pack("<d", x_m + 0.2)),
        "relabelled": lambda _, data: data.replace(b"the ego hits", b"the ego sees"),
        "gone": lambda topic, data: b"" if topic == "/scene" and b"contact/1" in data else data,
        "points": lambda topic, data: data[:-16] + bytes(16) if topic == "/look/ego" else data,
    }
    changed = 0

    def edit(topic: str, data: bytes) -> bytes:
        nonlocal changed
        new = change_of[change](topic, data) if topic in ("/scene", "/look/ego") else data
        changed += new != data
        return new

    found = verify(rewrite.mcap(crash / "run.mcap", tmp_path / "forged.mcap", edit=edit))
    assert changed
    assert [check.name for check in found.checks if check.right is False] == ["drawing"]


@pytest.mark.parametrize("kind", ["mcap", "rrd"])
def test_what_was_cut_off_after_a_contact_is_recovered_with_its_mark(
    crash: Path, tmp_path: Path, kind: str
) -> None:
    found = read(crash / f"run.{kind}")
    with Recording(tmp_path, header(found), {f"run.{kind}": FORMATS[f"run.{kind}"]}) as recording:
        again = simulate(found.scenario(), "mujoco", sink=recording)  # and is never closed
    out = tmp_path / f"recovered.{kind}"
    recover(tmp_path / f"run.{kind}.partial", out)
    assert verify(out).right
    (hit,) = collisions(again)
    if kind == "rrd":
        assert texts(rrd(out)["/world/contact_1/label"], "Points3D:labels") == [hit.sentence]
    else:
        drawn = [m for topic, _, m in mcap_drawn(out) if topic == "/scene"]
        assert [t.text for m in drawn for e in m.entities for t in e.texts][-1] == hit.sentence


def test_a_comparison_has_discs_phases_hypotheses_events_and_contacts_of_both(
    crash: Path, tmp_path: Path
) -> None:
    run(load("paper", ["duration_s=0.8", *STANDS]), "double_integrator", folder=tmp_path / "points")
    sides = [Side.of(read(folder / "run.mcap")) for folder in (tmp_path / "points", crash)]
    recording_of_both(*sides, tmp_path / "both.rrd")
    shown = rrd(tmp_path / "both.rrd")
    labels = ["paper_on_double_integrator_seed_0", "paper_on_mujoco_seed_0"]
    for label in labels:
        for entity in ("/phases/decision", "/phases/safety", "/hypotheses/ego_rolls", "/events"):
            assert f"{entity}/{label}" in shown, entity
        disc = shown[f"/world/{label}/axles/vehicle_2/cylinder"]
        colors = [b.num_rows for b in disc if "Cylinders3D:colors" in b.schema.names]
        assert sum(colors) > 1, "it changes"
        name = "Cylinders3D:fill_mode"
        fills = [b[name].to_pylist() for b in disc if name in b.schema.names]
        assert fills == [[[1]] if label == labels[0] else [[3]]], "said once: viewers take either of two"
    assert f"/contact/{labels[1]}" in shown
    assert f"/contact/{labels[0]}" not in shown, "points have no bodies"
    (label,) = texts(shown[f"/world/contact_1/{labels[1]}/label"], "Points3D:labels")
    (hit,) = collisions(sides[1].trace)
    assert label == f"paper on mujoco, seed 0: {hit.sentence}"
    for side, label in zip(sides, labels, strict=True):
        for subject in ("decision", "safety"):
            changes = [phase.state for phase in phases(side.trace) if phase.subject == subject]
            assert texts(shown[f"/phases/{subject}/{label}"], "StateChange:state") == changes
        said = texts(shown[f"/events/{label}"], "TextLog:text")
        assert len(said) >= len(events(side.trace))


def test_the_ground_is_under_the_ego_however_far_it_drives(crash: Path) -> None:
    found = read(crash / "run.mcap")
    about = header(found)
    scene = Scene(about.model, 0.6)
    (ground,) = [f for f in scene.frames if f.name == "camera/ego"]
    (slab,) = ground.shapes
    assert slab.half_size_m[0] > 100
    far = block(np.zeros((1, 3), bool), np.zeros((1, 3), bool))
    far.columns["front_m"][..., 0] += 1e5
    far.columns["target_m"] = far.columns["front_m"][:, 0]
    far.columns["distance_m"] = np.ones((1, 2))
    far = TickBlock(far.ticks, far.time_s, far.columns, np.array(about.model.qpos0)[None])
    posed = Posing(about, scene).block(far)
    assert posed.pos_m[0, scene.frames.index(ground), 0] == 1e5
    assert not [s for s in scene.fixed if s.half_size_m.min() > 100]


def test_cars_and_discs_are_points_that_move_with_them(crash: Path) -> None:
    found = read(crash / "run.mcap")
    sheets, shown = dict(zip(found.roster.cars, found.sheets(), strict=True)), {}
    for topic, time_ns, message in mcap_drawn(crash / "run.mcap"):
        if topic.startswith("/look/"):
            assert time_ns == 0
            shown[topic.removeprefix("/look/")] = message
    discs = {f"disc_of_{car}": f"axles/{car}" for car in found.roster.neighbours}
    assert {name: cloud.frame_id for name, cloud in shown.items()} == {
        **{car: f"{car}/chassis" for car in found.roster.cars},
        **discs,
    }
    for name, cloud in shown.items():
        bytes_ = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)
        points_m = np.ascontiguousarray(bytes_[:, :12]).view("<f4")
        if name in discs:
            assert np.hypot(*points_m[:, :2].T) == pytest.approx(0.6, abs=1e-6)
        else:
            size_m = np.ptp(points_m, axis=0)
            assert size_m[:2] == pytest.approx([sheets[name].length_m, sheets[name].width_m], rel=0.15)
            paint = bytes_[:, 12:15].mean(axis=0)
            assert int(paint.argmax()) == {"ego": 1, "vehicle_1": 2, "vehicle_2": 0}[name], "in its colour"
