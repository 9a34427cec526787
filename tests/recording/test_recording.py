"""What is read back is what was recorded, bit for bit; and whatever a recorder does, the run goes on."""

from __future__ import annotations

import gc
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import mjmerge.record.schema
from mjmerge.record import (
    FORMATS,
    Event,
    Header,
    Outcome,
    Recorder,
    Recording,
    git_revision,
    open_mcap,
    plots,
)
from mjmerge.record.read import read, read_mcap, read_rrd
from mjmerge.record.rerun import reader
from mjmerge.record.scene import Scene
from mjmerge.record.schema import proto_text
from mjmerge.review.view import write_view
from mjmerge.roster import roster
from mjmerge.run import run as run_scenario
from mjmerge.scenario.load import load
from mjmerge.simulation.log import TickBlock
from mjmerge.simulation.trace import COLUMNS
from mjmerge.state import Array

from .conftest import MakeBlocks
from .viewer import rerun_cli

CARS = roster().cars

OUTCOME = Outcome(
    [Event(0.0, "info", "", "start"), Event(0.02, "warning", "ego", "torque clipped")],
    "held",
    {"min_distance_m": {"vehicle_1": 0.5, "vehicle_2": 0.1}, "merged_at_s": None},
)


def record(
    folder: Path, header: Header, blocks: list[TickBlock], factories: dict[str, object] | None = None
) -> Recording:
    with Recording(folder, header, factories or FORMATS) as recording:
        for block in blocks:
            recording.write(block)
        recording.close(OUTCOME)
    return recording


def columns(blocks: list[TickBlock]) -> dict[str, Array]:
    whole = {c.name: np.concatenate([b.columns[c.name] for b in blocks]) for c in COLUMNS}
    return whole | {"time_s": np.concatenate([b.time_s for b in blocks])}


def assert_same(read: dict[str, Array], blocks: list[TickBlock]) -> None:
    expected = columns(blocks)
    assert read.keys() == expected.keys()
    for name, values in expected.items():
        assert read[name].shape == values.shape, name
        assert np.ascontiguousarray(read[name]).tobytes() == values.tobytes(), name


@given(sizes=st.lists(st.integers(1, 9), min_size=1, max_size=4), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_every_column_comes_back_bit_for_bit(header, make_blocks: MakeBlocks, sizes, seed) -> None:
    blocks = make_blocks(*sizes, seed=seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = record(folder, header, blocks)
        assert recording.failures == []
        assert sorted(p.name for p in folder.iterdir()) == sorted(FORMATS)
        assert_same(read_mcap(folder / "run.mcap"), blocks)
        assert_same(read_rrd(folder / "run.rrd"), blocks)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, header: Header, make_blocks: MakeBlocks) -> Path:
    folder = tmp_path_factory.mktemp("run")
    assert record(folder, header, make_blocks(5, 3)).failures == []
    return folder


@pytest.mark.parametrize(
    ("arguments", "name"), [(("rrd", "verify"), "run.rrd"), (("mcap", "check"), "run.mcap")]
)
def test_rerun_accepts_the_files(run: Path, arguments, name) -> None:
    done = subprocess.run([rerun_cli(), *arguments, run / name], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_what_tries_whether_rerun_survives_a_file_reads_all_of_it(run: Path, monkeypatch) -> None:
    really = subprocess.run

    def strictly(command: list[str], **more) -> subprocess.CompletedProcess[bytes]:  # errors are not let pass
        code = command[2].replace("contextlib.suppress(Exception)", "contextlib.nullcontext()")
        assert code != command[2]
        return really([*command[:2], f"{code}\nassert table(chunk).num_rows", *command[3:]], **more)

    monkeypatch.setattr(reader.subprocess, "run", strictly)
    assert reader.survives(run / "run.rrd")


def test_mcap_bytes_follow_from_the_run(tmp_path: Path, header: Header, make_blocks: MakeBlocks) -> None:
    digests = []
    for seed in (1, 1, 2):
        folder = tmp_path / str(len(digests))
        folder.mkdir()
        record(folder, header, make_blocks(4, 4, seed=seed), {"run.mcap": open_mcap})
        digests.append(hashlib.sha256((folder / "run.mcap").read_bytes()).hexdigest())
    assert digests[0] == digests[1] != digests[2]


def test_mcap_holds_where_it_comes_from_and_how_it_ended(run: Path, header: Header) -> None:
    with (run / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        attached = {a.name: a.data.decode() for a in reader.iter_attachments()}
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        log = [message for *_, message in reader.iter_decoded_messages(topics=["/log"])]
        messages = list(reader.iter_messages())
    assert attached["scenario.yaml"] == header.scenario_yaml
    assert attached["world.xml"] == header.world_xml
    assert json.loads(attached["manifest.json"])["seed"] == 7
    assert json.loads(attached["summary.json"]) == OUTCOME.summary
    assert metadata["outcome"] == {"verdict": "held"}
    assert metadata["versions"] == dict(header.versions)
    assert [m.message for m in log] == [f"{e.car}: {e.text}" if e.car else e.text for e in OUTCOME.events]
    assert all(m.log_time == m.publish_time for _, _, m in messages)
    law_ns = [m.log_time for _, channel, m in messages if channel.topic == "/law"]
    assert law_ns == [10_000_000 * k for k in range(8)]


def test_mcap_poses_are_those_of_mujoco_25_times_a_second(
    tmp_path: Path, header: Header, make_blocks: MakeBlocks
) -> None:
    blocks = make_blocks(50, 12)
    run = tmp_path
    record(run, header, blocks, {"run.mcap": open_mcap})
    data = mujoco.MjData(header.model)
    with (run / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = [message for *_, message in reader.iter_decoded_messages(topics=["/tf"])]
    assert len(decoded) == 16
    for k, message in zip(range(0, 62, 4), decoded, strict=True):
        data.qpos = np.concatenate([b.qpos for b in blocks])[k]
        mujoco.mj_kinematics(header.model, data)
        transforms = {t.child_frame_id: t for t in message.transforms}
        for name in ("ego/", "vehicle_2/wheel"):
            t, body = transforms[name], data.body(name)
            assert (t.translation.x, t.translation.y, t.translation.z) == tuple(np.float32(body.xpos))
            assert (t.rotation.w, t.rotation.x, t.rotation.y, t.rotation.z) == tuple(np.float32(body.xquat))
            assert t.parent_frame_id == "world"
            assert t.timestamp.ToNanoseconds() == 10_000_000 * k
        axle = transforms["axles/ego"].translation
        assert [axle.x, axle.y] == np.float32(columns(blocks)["front_m"][k, 0]).tolist()


def test_every_drawn_geom_is_in_the_scene_and_no_hull(header: Header) -> None:
    scene = Scene(header.model, r_m=0.6)
    kinds = {f.name: [s.kind for s in f.shapes] for f in scene.frames}
    assert [s.kind for s in scene.fixed] == ["box"]
    assert kinds["camera/ego"] == ["box"], "the ground goes along: no run drives off it"
    for car in CARS:
        assert kinds[f"{car}/"] == ["box"]
        assert kinds[f"{car}/wheel"] == ["cylinder", "capsule", "ellipsoid", "mesh"]


def test_every_view_shows_something_that_exists(run: Path, header: Header) -> None:
    import rerun.chunk as rc

    from mjmerge.record.rerun.layout import blueprint

    have = {chunk.entity_path for chunk in rc.RrdReader(run / "run.rrd").stream()}

    def check(part) -> int:
        children = getattr(part, "contents", None)
        if hasattr(part, "origin"):
            wanted = [part.origin] if isinstance(children, str) or not children else [part.origin, *children]
            for path in wanted:
                stem = str(path).replace("$origin", str(part.origin)).removesuffix("/**")
                assert stem == "/" or any(p == stem or p.startswith(stem + "/") for p in have), path
            return 1
        return sum(check(child) for child in children)

    paint = Scene(header.model, 0.6).paint
    assert check(blueprint(header.scenario, paint, header.plant).root_container) > 8


def test_what_plots_are_read_against_has_its_name_and_colour(run: Path, header: Header) -> None:
    import rerun.chunk as rc

    paint = Scene(header.model, 0.6).paint
    told = {
        chunk.entity_path: chunk.to_record_batch()["SeriesLines:names"][0].as_py()
        for chunk in rc.RrdReader(run / "run.rrd").stream()
        if "SeriesLines:names" in chunk.to_record_batch().schema.names
    }
    wanted = plots.levels(plots.everything(header.scenario, paint))
    assert {entity: told.get(entity) for entity in wanted} == {e: [v.label] for e, v in wanted.items()}


def test_published_schema_is_current() -> None:
    published = Path(mjmerge.record.schema.__file__).with_name("mjmerge_v2.proto")
    assert published.read_text() == proto_text(), "write proto_text() to it"


class Broken:
    """A recorder that fails where it is told to."""

    def __init__(self, where: str, error: BaseException) -> None:
        self._where, self._error = where, error
        self._fail("open")

    def _fail(self, here: str) -> None:
        if here == self._where:
            raise self._error

    def write(self, _: object) -> None:
        self._fail("write")

    def close(self, _: object) -> None:
        self._fail("close")

    def abort(self) -> None:
        self._fail("abort")


class Panic(BaseException):
    """Like what a writer made of Rust raises."""


@pytest.mark.parametrize("where", ["open", "write", "close"])
@pytest.mark.parametrize("error", [OSError("no space left"), Panic("no space left")])
def test_a_broken_recorder_is_reported_and_stops_nobody(
    tmp_path: Path, header: Header, make_blocks: MakeBlocks, where, error
) -> None:
    def factory(path, header, scene) -> Recorder:
        return Broken(where, error)

    blocks = make_blocks(3, 3)
    recording = record(tmp_path, header, blocks, {"bad": factory, "run.mcap": open_mcap})
    assert recording.failures == ["bad: no space left"]
    assert recording.files == [tmp_path / "run.mcap"]
    assert_same(read_mcap(tmp_path / "run.mcap"), blocks)


def test_a_full_disk_ends_recordings_readably(
    tmp_path: Path, header: Header, make_blocks: MakeBlocks, monkeypatch
) -> None:
    blocks = make_blocks(3, 3)
    with Recording(tmp_path, header, FORMATS) as recording:
        recording.write(blocks[0])
        monkeypatch.setattr("mjmerge.record.recording._SPARE_BYTES", 2**80)
        recording.write(blocks[1])
        recording.close(OUTCOME)
    assert [f.split(":")[0] for f in recording.failures] == list(FORMATS)
    assert_same(read_mcap(tmp_path / "run.mcap.partial"), blocks[:1])
    assert_same(read_rrd(tmp_path / "run.rrd.partial"), blocks[:1])


def test_a_recording_says_what_it_is_of_before_its_first_tick(tmp_path: Path, header: Header) -> None:
    with Recording(tmp_path, header, FORMATS):
        found = read(shutil.copy(tmp_path / "run.rrd.partial", tmp_path / "copy.rrd"))
        assert found.scenario_yaml == header.scenario_yaml
        assert len(found.ticks) == 0


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_interrupted_run_leaves_readable_partial_files(
    tmp_path: Path, header: Header, make_blocks: MakeBlocks, error
) -> None:
    blocks = make_blocks(3, 4)
    recording = Recording(tmp_path, header, FORMATS)

    def run() -> None:
        with recording:
            for block in blocks:
                recording.write(block)
            raise error

    with pytest.raises(error):
        run()
    assert recording.failures == recording.files == []
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.mcap.partial", "run.rrd.partial"]
    assert_same(read_mcap(tmp_path / "run.mcap.partial"), blocks)
    assert_same(read_rrd(tmp_path / "run.rrd.partial"), blocks)


@pytest.mark.parametrize("suffix", ["", ".partial"])
def test_recordings_are_not_overwritten(
    tmp_path: Path, header: Header, make_blocks: MakeBlocks, suffix
) -> None:
    for name in FORMATS:
        (tmp_path / f"{name}{suffix}").write_text("precious")
    recording = record(tmp_path, header, make_blocks(2))
    assert len(recording.failures) == 2
    assert all("not overwritten" in failure for failure in recording.failures)
    assert {p.read_text() for p in tmp_path.iterdir()} == {"precious"}


def test_rerun_switched_off_is_a_failure(tmp_path: Path) -> None:
    code = """
import sys; from pathlib import Path; sys.path.insert(0, sys.argv[2])
import conftest, mujoco
from mjmerge.scenario.cars import car_sheets
from mjmerge.record import Header, Outcome, Recording, open_rrd
model = mujoco.MjModel.from_xml_string(conftest.WORLD_XML)
header = Header(conftest.SCENARIO, "", "mujoco", 0, model, "", {}, .01,
                tuple(car_sheets(conftest.SCENARIO)))
with Recording(Path(sys.argv[1]), header, {"run.rrd": open_rrd}) as recording:
    recording.close(Outcome([], "held", {}))
print(recording.failures, recording.files)
"""
    done = subprocess.run(
        [sys.executable, "-c", code, tmp_path, Path(__file__).parent],
        env=os.environ | {"RERUN": "off", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert "run.rrd: nothing was written" in done.stdout, done.stderr
    assert list(tmp_path.iterdir()) == []


def test_nothing_heavy_is_imported_before_it_is_used() -> None:
    code = (
        "import mjmerge.record, sys; print([m for m in ('rerun', 'foxglove', 'google') if m in sys.modules])"
    )
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr


def test_git_revision_is_of_this_checkout_or_none() -> None:
    revision = git_revision()
    assert revision is None or len(revision) >= 12


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="counts threads as Linux does")
def test_recordings_comparisons_and_views_that_are_over_leave_no_thread_and_no_file_open(tmp_path) -> None:
    """Two runs in a folder have run.rrd, run.mcap, median.rrd and compare.rrd."""
    scenario = load("charge", ["duration_s=0.1", "mismatch.neighbour_position_noise_m=0.01"])

    def open_after(k: int) -> tuple[int, int]:
        run_scenario(scenario, "bicycle", runs=2, folder=tmp_path / str(k))
        write_view(tmp_path / str(k) / "run.mcap", tmp_path / str(k) / "view.rrd")
        gc.collect()
        return len([*Path("/proc/self/task").iterdir()]), len([*Path("/proc/self/fd").iterdir()])

    first, second, *_, last = [open_after(k) for k in range(6)]
    assert last <= max(first, second)
    assert last[1] <= max(first[1], second[1])
