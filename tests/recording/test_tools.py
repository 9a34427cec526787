"""Replay, compare, recover, convert and video: from the command line, on real recordings."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from mjmerge.cli import main
from mjmerge.record.read import read
from mjmerge.record.scene import Scene
from mjmerge.review import video
from mjmerge.review.convert import flat
from mjmerge.review.poses import header, poses
from mjmerge.roster import roster
from mjmerge.run import run
from mjmerge.scenario.load import load
from mjmerge.simulation.trace import COLUMNS
from tests.recording.test_forgery import STANDS

KINDS = ("mcap", "rrd")


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    made = {}
    for plant in ("mujoco", "double_integrator"):
        made[plant] = tmp_path_factory.mktemp(plant)
        run(load("charge", ["duration_s=1.3"]), plant, folder=made[plant])
    return made


@pytest.fixture
def mjmerge(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return int(stop.value.code or 0), out, err

    return call


@pytest.mark.parametrize("kind", KINDS)
def test_verify_ends_with_0_1_or_2(mjmerge, folders, tmp_path, kind) -> None:
    good = folders["mujoco"] / f"run.{kind}"
    code, out, _ = mjmerge("verify", good)
    assert code == 0
    assert "WRONG" not in out
    cut = tmp_path / f"cut.{kind}"
    cut.write_bytes(good.read_bytes()[:-1000])
    code, out, _ = mjmerge("verify", cut, "--json")
    assert code == 1
    assert out.count("\n") == 1
    found = json.loads(out)
    assert not found["right"]
    assert [c["name"] for c in found["checks"] if c["right"] is False] == ["file"]
    code, out, err = mjmerge("verify", folders["mujoco"] / "summary.json")
    assert (code, out) == (2, "")
    assert "neither a Rerun nor an MCAP recording" in err


def test_a_run_folder_stands_for_its_recording(mjmerge, folders) -> None:
    code, out, _ = mjmerge("verify", folders["mujoco"], "--json")
    assert code == 0
    assert json.loads(out)["file"].endswith("run.mcap")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("plant", ["mujoco", "double_integrator"])
def test_replay_gives_the_same_bits_with_any_number_of_threads(mjmerge, folders, plant, kind) -> None:
    code, out, _ = mjmerge("replay", folders[plant] / f"run.{kind}", "--threads", "1")
    assert code == 0
    assert "same, bit for bit: 131 ticks" in out


def test_replay_of_an_unfinished_file_compares_what_there_is(mjmerge, folders, tmp_path) -> None:
    cut = tmp_path / "run.mcap.partial"
    data = (folders["double_integrator"] / "run.mcap").read_bytes()
    cut.write_bytes(data[: int(0.7 * len(data))])
    assert not read(cut).finished
    code, out, _ = mjmerge("replay", cut)
    assert code == 0
    assert "as far as it goes" in out


def test_replay_names_what_differs_and_which_versions_do(mjmerge, folders, monkeypatch) -> None:
    monkeypatch.setattr("mjmerge.review.replay.versions", lambda: {"mujoco": "9.9"})
    recorded = read(folders["double_integrator"] / "run.mcap")
    other = recorded.scenario().model_copy(update={"duration_s": 1.3})
    other = other.model_copy(update={"law": other.law.model_copy(update={"k_v": 2.1})})
    monkeypatch.setattr("mjmerge.record.read.Recorded.scenario", lambda *_, **__: other)
    code, out, _ = mjmerge("replay", recorded.path, "--json")
    found = json.loads(out)
    assert code == 1
    assert not found["same"]
    assert found["differences"][0]["column"] == "u_n_mps2"
    assert found["differences"][0]["first_s"] < 0.03  # at t = 0 there is no velocity error yet
    assert any(line.startswith("mujoco") and "9.9 now" in line for line in found["other_versions"])


def test_replay_of_nothing_ends_with_2(mjmerge, tmp_path) -> None:
    (tmp_path / "x.rrd").write_bytes(b"RRF2")
    assert mjmerge("replay", tmp_path / "x.rrd")[0] == 2
    assert mjmerge("replay", "no-such-run")[0] == 2


@pytest.mark.parametrize("kind", KINDS)
def test_recover_keeps_every_number_and_says_incomplete(mjmerge, folders, tmp_path, kind) -> None:
    cut = tmp_path / f"run.{kind}.partial"
    whole = (folders["double_integrator"] / f"run.{kind}").read_bytes()
    cut.write_bytes(whole[:-20])
    code, out, _ = mjmerge("recover", cut)
    made = tmp_path / f"run.recovered.{kind}"
    assert code == 0
    assert str(made) in out
    assert mjmerge("verify", made)[0] == 0
    before, after = read(cut), read(made)
    for column in COLUMNS:
        assert after.columns[column.name].tobytes() == before.columns[column.name].tobytes()
    assert after.manifest["versions"] == before.manifest["versions"]
    code, _, err = mjmerge("recover", cut)
    assert code == 2
    assert "nothing is overwritten" in err
    assert mjmerge("recover", made)[0] == 2  # is whole


@pytest.mark.parametrize("kind", KINDS)
def test_poses_that_were_cut_off_are_carried_on_with_the_cars(folders, kind) -> None:
    found = read(folders["mujoco"] / f"run.{kind}")
    about = header(found)
    scene = Scene(about.model, about.scenario.law.r_m)
    rows = np.arange(0, 131, 4)
    pos_m, _ = poses(found, about, scene, rows)
    pos_b, quat_b = poses(found, about, scene, rows + 1)  # no poses at these ticks
    step_m = np.abs(pos_b - pos_m).max()
    assert 0.01 < step_m < 0.05  # at about 2 m/s, one tick further
    np.testing.assert_allclose(np.linalg.norm(quat_b, axis=-1), 1, atol=1e-6)
    chassis = [f.name.startswith("ego/") for f in scene.frames].index(True)
    ahead = found.columns["front_m"][rows + 1, 0] - pos_b[:, chassis, :2]
    before = found.columns["front_m"][rows, 0] - pos_m[:, chassis, :2]
    np.testing.assert_allclose(np.linalg.norm(ahead, axis=1), np.linalg.norm(before, axis=1), atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_tables_hold_every_number_under_a_name_with_its_unit(mjmerge, folders, tmp_path, kind) -> None:
    shutil.copy(folders["mujoco"] / f"run.{kind}", tmp_path / f"run.{kind}")
    code, out, _ = mjmerge("convert", tmp_path / f"run.{kind}", "--csv", "--parquet")
    assert code == 0
    assert out.split() == [str(tmp_path / "run.csv"), str(tmp_path / "run.parquet")]
    found = read(tmp_path / f"run.{kind}")
    tables = (
        pd.read_csv(tmp_path / "run.csv"),
        pd.read_parquet(tmp_path / "run.parquet"),
    )
    for table in tables:
        assert next(iter(table)) == "time_s"
        assert len(table) == len(found.ticks)
        for name, values in flat(found).items():
            assert np.array_equal(table[name].to_numpy(), values, equal_nan=True), name
    assert {"opinion", "distance_m.vehicle_2", "front_m.ego.x", "torque_n_m.vehicle_1.rear_left"} <= set(
        tables[0]
    )
    assert len(list(tables[0])) == 1 + sum(int(np.prod(c.shape(roster()))) for c in COLUMNS)
    about = pq.read_schema(tmp_path / "run.parquet").metadata
    assert json.loads(about[b"mjmerge.manifest"])["plant"] == "mujoco"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["convert", "{run}"], "--csv, --parquet or both"),
        (["convert", "{run}", "--csv", "--parquet", "--out", "x"], "--out names one file"),
        (["convert", "{run}", "--csv", "--out", "no/such/folder/x.csv"], "cannot write"),
        (["convert", "nothing", "--csv"], "no recording of that name"),
        (["compare", "{run}", "nothing"], "no recording of that name"),
        (["video", "{run}", "--fps", "0"], "--fps"),
        (["replay", "{run}", "--threads", "-1"], "--threads"),
    ],
)
def test_bad_input_ends_with_2_and_says_what_to_do(mjmerge, folders, arguments, says) -> None:
    code, out, err = mjmerge(*(a.format(run=folders["mujoco"]) for a in arguments))
    assert (code, out) == (2, "")
    assert says in err


def test_compare_says_how_far_two_runs_are_apart_and_when(mjmerge, folders, tmp_path) -> None:
    a, b = folders["double_integrator"] / "run.mcap", folders["mujoco"] / "run.rrd"
    code, out, _ = mjmerge("compare", a, b, "--out", "both", "--json")
    assert code == 0
    found = json.loads(out)
    d = [read(path).columns["distance_m"][:, 0] for path in (a, b)]
    off = np.abs(d[1] - d[0])
    assert found["differences"]["d_1"]["most"] == off.max()
    assert found["differences"]["d_1"]["time_s"] == pytest.approx(0.01 * off.argmax())
    assert not found["identical"]
    assert sorted(p.name for p in (tmp_path / "both").iterdir()) == ["compare.rrd", "figure.png"]
    assert (tmp_path / "both" / "figure.png").read_bytes().startswith(b"\x89PNG")
    code, out, _ = mjmerge("compare", a, b)
    assert code == 0
    assert "furthest apart" in out
    assert (tmp_path / "compared" / "compare.rrd").stat().st_size > 10_000
    code, _, err = mjmerge("verify", tmp_path / "compared" / "compare.rrd")
    assert code == 2
    assert "several runs" in err


def test_compare_of_the_same_run_in_two_formats_is_identical(mjmerge, folders) -> None:
    code, out, _ = mjmerge("compare", *(folders["mujoco"] / f"run.{kind}" for kind in KINDS))
    assert code == 0
    assert "the same, bit for bit" in out


@pytest.mark.parametrize("kind", KINDS)
def test_a_video_shows_the_run_in_h264(mjmerge, folders, tmp_path, kind) -> None:
    av = pytest.importorskip("av")
    hit = kind == "rrd"
    if hit:  # the ego stands, and is driven into
        run(load("paper", ["duration_s=1.3", *STANDS]), "mujoco", folder=tmp_path, replace=True)
    else:
        shutil.copy(folders["mujoco"] / f"run.{kind}", tmp_path / f"run.{kind}")
    camera = {"mcap": "chase", "rrd": "overhead"}[kind]
    code, out, err = mjmerge("video", tmp_path / f"run.{kind}", "--camera", camera, "--fps", "5")
    if code == 2 and "apt-get install" in err:
        pytest.skip("neither EGL nor OSMesa (Debian: libegl1 libegl-mesa0 libgl1-mesa-dri)")
    assert code == 0, err
    assert "drawn with" in out
    with av.open(str(tmp_path / "run.mp4")) as file:
        stream = file.streams.video[0]
        assert stream.codec_context.name == "h264"
        pictures = [f.to_ndarray(format="rgb24") for f in file.decode(video=0)]
    assert len(pictures) == 7  # 1.3 s at 5 a second
    title, below = pictures[0][:32], pictures[0][32:]
    assert (title > 240).mean() > 0.7  # letters on white, over all of it
    assert (title < 60).sum() > 500
    scene, plots = below[:, :832].astype(int), below[:, 832:]
    red, green, blue = scene[..., 0], scene[..., 1], scene[..., 2]
    assert ((green > red + 70) & (green > blue + 40)).sum() > 200  # the ego is green
    assert ((blue > red + 40) & (blue > green + 20)).sum() > 100  # Vehicle 1 is blue
    assert (plots > 240).mean() > 0.7  # lines on white
    assert np.abs(pictures[-1].astype(int) - pictures[0]).max() > 100
    reds = [((p[200:, :832, 0] > 200) & (p[200:, :832, 1:] < 40).all(axis=-1)).sum() for p in pictures]
    assert reds[0] < 500
    assert (reds[-1] > 5000) == hit, "the disc of a car that was hit"


def test_without_a_way_to_draw_the_advice_names_packages(mjmerge, folders, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(video, "_BACKENDS", ("glx-that-is-not-there",))
    shutil.copy(folders["mujoco"] / "run.mcap", tmp_path / "run.mcap")
    code, _, err = mjmerge("video", tmp_path / "run.mcap")
    assert code == 2
    assert "libosmesa6" in err
    assert [p.name for p in tmp_path.iterdir()] == ["run.mcap"]


def test_without_pyav_the_extra_is_named(mjmerge, folders, monkeypatch) -> None:
    monkeypatch.setattr(video, "find_spec", lambda _: None)
    code, _, err = mjmerge("video", folders["mujoco"])
    assert code == 2
    assert "mjmerge[video]" in err


def test_video_is_not_imported_before_it_is_used() -> None:
    code = (
        "import mjmerge.review.video, sys; print([m for m in ('av', 'mujoco.renderer') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr
