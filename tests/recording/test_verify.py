"""``verify`` accepts what a run writes, and nothing that was changed since."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mjmerge.config import shipped
from mjmerge.errors import UnreadableError
from mjmerge.record.digest import digests
from mjmerge.record.read import Recorded, read
from mjmerge.review.poses import header
from mjmerge.review.replay import replay
from mjmerge.review.verify import Verified, verify
from mjmerge.run import run
from mjmerge.scenario.load import load
from mjmerge.state import Array
from tests.recording import rewrite
from tests.recording.forge import Forger

KINDS = ("mcap", "rrd")

RUNS: dict[str, dict[str, Any]] = {
    "mujoco": {"scenario": "paper", "plant": "mujoco"},
    "bicycle": {"scenario": "charge", "plant": "bicycle"},
    "points": {"scenario": "flips", "plant": "double_integrator", "seed": 3},
    "continuous": {"scenario": "charge", "plant": "bicycle", "continuous": True},
    "no barrier": {"scenario": "paper", "plant": "double_integrator", "set": ["law.k_o=0"]},
    "ran away": {"scenario": "paper", "plant": "double_integrator", "set": ["law.k_v=500"]},
    "gated": {"scenario": "blocked", "plant": "double_integrator", "set": ["law.variant=gated"]},
    "noisy": {
        "scenario": "charge",
        "plant": "mujoco",
        "set": ["mismatch.neighbour_position_noise_m=0.01", "mismatch.sensing_delay_s=0.02"],
    },
    "on ice": {
        "scenario": "charge",
        "plant": "mujoco",
        "set": ["mismatch.friction=0.1", "mismatch.steer_offset_rad=-0.05"],
    },
    "touched in continuous time": {
        "scenario": "paper",
        "plant": "double_integrator",
        "continuous": True,
        "set": [
            "initial.ego.front_m=[-0.9, 0.0]",
            "initial.ego.speed_mps=0.0",
            "law.k_o=0.001",
            "law.k_p=0",
            "law.k_v=0",
        ],
    },
}


def record(folder: Path, name: str, duration_s: float = 1.2, models: str = "models.size=1.0") -> Path:
    given = dict(RUNS[name])
    overrides = [f"duration_s={duration_s}", models, *given.pop("set", ())]
    run(load(given.pop("scenario"), overrides), given.pop("plant"), folder=folder, **given)
    return folder


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    folders: dict[str, Path] = {}

    def of(name: str) -> Path:
        if name not in folders:
            folders[name] = record(tmp_path_factory.mktemp("run"), name)
        return folders[name]

    return of


def wrong(found: Verified) -> set[str]:
    return {check.name for check in found.checks if check.right is False}


@pytest.mark.thinned(3)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", RUNS)
def test_what_a_run_writes_is_right(recorded, name: str, kind: str) -> None:
    found = verify(recorded(name) / f"run.{kind}")
    assert found.right, found.checks
    assert found.verdict is not None
    assert found.verdict.verdict == found.recorded.verdict


def test_the_runs_are_as_different_as_they_are_called(recorded) -> None:
    def read_(name: str) -> Recorded:
        return read(recorded(name) / "run.mcap")

    assert read_("ran away").summary["stops"]
    assert read_("touched in continuous time").summary["stops"][0]["touched"]
    assert len(read_("ran away").ticks) < 121
    assert np.isnan(read_("points").columns["clearance_m"]).all()
    assert read_("continuous").manifest["continuous"]


def test_shipped_scenarios_are_recorded_rightly(tmp_path: Path, long: bool) -> None:
    """Of all of them with ``--long``; else of those that differ most, in size, cars and road."""
    few = {
        "paper": KINDS,
        "highway": KINDS,
        "stop_and_go": ("rrd",),
        "ramp": ("mcap",),
        "platoon_8": ("mcap",),
    }
    for name, kinds in dict.fromkeys(shipped.scenarios(), KINDS).items() if long else few.items():
        folder = tmp_path / name
        run(load(name, ["duration_s=0.6"]), "mujoco", folder=folder)
        assert all(verify(folder / f"run.{kind}").right for kind in kinds), name


def test_a_car_that_spins_on_ice_moves_as_a_car_can(tmp_path: Path) -> None:
    run(load("charge", ["mismatch.friction=0.2"]), "mujoco", folder=tmp_path)
    found = verify(tmp_path / "run.mcap")
    spins_radps = np.diff(found.recorded.columns["heading_rad"][:, 2]) / found.recorded.step_s
    assert np.abs(spins_radps).max() > 5
    assert found.right, found.checks


@pytest.mark.parametrize("kind", KINDS)
def test_the_worst_of_many_runs_is_right_too(tmp_path: Path, kind: str) -> None:
    run(load("flips", ["duration_s=0.5"]), "double_integrator", runs=3, folder=tmp_path)
    assert verify(tmp_path / f"run.{kind}").right


@pytest.fixture(scope="module", params=KINDS)
def forger(request, recorded) -> Forger:
    return Forger(recorded("mujoco") / f"run.{request.param}")


def unchanged(columns: Mapping[str, Array]) -> None:
    pass


def test_what_is_written_again_unchanged_is_right(forger: Forger, tmp_path: Path) -> None:
    assert verify(forger.write(tmp_path, unchanged)).right


@pytest.mark.thinned(5)
@pytest.mark.parametrize(("tick", "car", "axis"), [(0, 0, 0), (57, 1, 1), (119, 2, 0)])
@pytest.mark.parametrize("by_m", [-1e-6, 1e-6])
def test_one_position_changed_by_a_micrometre_is_found(
    forger: Forger, tmp_path: Path, tick: int, car: int, axis: int, by_m: float
) -> None:
    def change(columns: dict[str, Array]) -> None:
        columns["front_m"][tick, car, axis] += by_m

    found = verify(forger.write(tmp_path, change))
    assert "fingerprints" in wrong(found)
    assert wrong(found) & {"distances", "law"}
    assert "front_m" in next(c.says for c in found.checks if c.name == "fingerprints")
    marks = digests({"time_s": forger.found.columns["time_s"], **forger.columns(change)}, forger.found.texts)
    found = verify(forger.write(tmp_path, change, digests=marks))
    assert "fingerprints" not in wrong(found)
    assert wrong(found) & {"distances", "law"}


@pytest.mark.parametrize("column", ["opinion", "mu", "u_n_mps2", "u_c_mps2", "weight", "velocity_mps"])
def test_other_numbers_are_held_against_the_law(forger: Forger, tmp_path: Path, column: str) -> None:
    def change(columns: dict[str, Array]) -> None:
        columns[column].flat[columns[column].size // 2] += 1e-6

    assert wrong(verify(forger.write(tmp_path, change))) & {"law", "opinion", "distances"}


@pytest.mark.parametrize("verdict", ["vacuous", "held", "refuted", "incomplete"])
def test_a_swapped_verdict_is_found(forger: Forger, tmp_path: Path, verdict: str) -> None:
    found = verify(forger.write(tmp_path, unchanged, verdict=verdict))
    assert wrong(found) == (set() if verdict == forger.true.verdict else {"verdict"})


def test_a_prettier_margin_is_found(forger: Forger, tmp_path: Path) -> None:
    margins = {**forger.true.summary, "min_distance_m": {"vehicle_1": 1.4, "vehicle_2": 0.9}}
    found = verify(forger.write(tmp_path, unchanged, summary=margins))
    assert wrong(found) == {"margins"}
    assert "min_distance_m.vehicle_1" in next(c.says for c in found.checks if c.name == "margins")


def test_an_event_kept_quiet_is_found(forger: Forger, tmp_path: Path) -> None:
    assert wrong(verify(forger.write(tmp_path, unchanged, events=()))) == {"events"}


@pytest.mark.parametrize("tick", [0, 57, 120])
def test_a_removed_tick_is_found(forger: Forger, tmp_path: Path, tick: int) -> None:
    keep = np.arange(len(forger.found.ticks)) != tick
    block = forger.block.block
    thinned = replace(
        block,
        ticks=block.ticks[keep],
        time_s=block.time_s[keep],
        columns={name: values[keep] for name, values in block.columns.items()},
        qpos=block.qpos[keep],
    )
    drawn = forger.block.drawn[forger.block.drawn < 50]
    short = replace(
        forger.block,
        block=thinned,
        time_ns=forger.block.time_ns[keep],
        drawn=drawn,
        pos_m=forger.block.pos_m[: len(drawn)],
        quat=forger.block.quat[: len(drawn)],
    )
    found = verify(forger.store(tmp_path, short, forger.true))
    assert "fingerprints" in wrong(found)
    assert wrong(found) & {"time", "length"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_another_schema_is_named(recorded, monkeypatch, kind: str) -> None:
    room = {"mcap": "mcap", "rrd": "rerun"}[kind]
    monkeypatch.setattr(f"mjmerge.record.{room}.reader.SCHEMA_VERSIONS", (98, 99))
    monkeypatch.setattr("mjmerge.review.verify.SCHEMA_VERSIONS", (98, 99))
    found = verify(recorded("points") / f"run.{kind}")
    assert wrong(found) == {"schema"}
    assert "99" in found.checks[-1].says


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("part", [0.0, 0.003, 0.1, 0.4, 0.8, 0.9999])
def test_a_truncated_file_is_found_and_said_to_be_unfinished(
    recorded, tmp_path: Path, part: float, kind: str
) -> None:
    data = (recorded("points") / f"run.{kind}").read_bytes()
    cut = tmp_path / f"cut.{kind}"
    cut.write_bytes(data[: int(part * len(data))])
    try:
        found = verify(cut)
    except UnreadableError:
        assert part < 0.5  # not even what the run was
    else:
        assert "file" in wrong(found)
        assert "unfinished" in found.checks[0].says


@pytest.mark.parametrize("content", [b"", b"a scenario?\n", b"\x89MCAP0\r\n", b"RRF2"])
def test_what_is_no_recording_is_unreadable(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "what.mcap"
    path.write_bytes(content)
    with pytest.raises(UnreadableError, match=r"what\.mcap"):
        verify(path)


@pytest.mark.thinned(5)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", ["renamed", "edited", "gone"])
def test_a_truthful_recording_stays_right_whatever_becomes_of_its_models(
    tmp_path: Path, kind: str, change: str
) -> None:
    models = tmp_path / "models"
    shutil.copytree(shipped.folder("models"), models)
    mine = (models / "rc").rename(models / "mine")
    (mine / "rc.xml").rename(mine / "mine.xml")
    folder = record(tmp_path / "run", "bicycle", models=f"models.ego={mine}")
    if change == "renamed":
        mine.rename(models / "yours")
    elif change == "gone":
        shutil.rmtree(models)
    else:
        sheet = (mine / "datasheet.yaml").read_text()
        edited = re.sub(r"(?m)^(steer_limit_rad|wheelbase_m):.*", r"\1: 0.123", sheet)
        assert edited != sheet
        (mine / "datasheet.yaml").write_text(edited)
    assert verify(folder / f"run.{kind}").right


@pytest.mark.parametrize("change", ["gone", "edited"])
def test_a_car_of_ones_own_is_replayed_from_the_attached_world_and_sheet(tmp_path: Path, change: str) -> None:
    models = tmp_path / "models"
    shutil.copytree(shipped.folder("models"), models)
    mine = (models / "rc").rename(models / "mine")
    (mine / "rc.xml").rename(mine / "mine.xml")
    folder = record(tmp_path / "run", "mujoco", 0.4, models=f"models.ego={mine}")
    if change == "gone":
        shutil.rmtree(models)
    else:
        mjcf = (mine / "mine.xml").read_text()
        (mine / "mine.xml").write_text(mjcf.replace('rgba="', 'rgba="0', 1))
        sheet = (mine / "datasheet.yaml").read_text()
        edited = re.sub(r"(?m)^steer_limit_rad:.*", "steer_limit_rad: 0.5", sheet)
        (mine / "datasheet.yaml").write_text(edited)
    again = replay(folder / "run.mcap")
    assert again.same
    assert again.other_world is (None if change == "gone" else True)
    assert "attached" in again.lines()[-1]


def test_a_shipped_world_that_was_changed_is_a_contradiction(recorded, tmp_path: Path) -> None:
    world = read(recorded("mujoco") / "run.mcap").world_xml
    other = world.replace("0.16 0.62 0.33", "0.83 0.62 0.33", 1)
    assert other != world
    path = rewrite.mcap(
        recorded("mujoco") / "run.mcap", tmp_path / "red.mcap", attachments={"world.xml": other.encode()}
    )
    assert {"fingerprints", "drawing"} <= wrong(verify(path))
    again = replay(path)
    assert again.differences == ()
    assert not again.same


def test_what_does_not_follow_from_the_file_is_listed(recorded) -> None:
    last = verify(recorded("points") / "run.mcap").checks[-1]
    assert (last.name, last.right) == ("not derived", None)
    assert "how hard contacts were" in last.says
    assert "replay" in last.says


def test_a_car_with_a_mesh_in_a_file_is_recorded_with_its_vertices(tmp_path: Path) -> None:
    models = tmp_path / "models"
    shutil.copytree(shipped.folder("models"), models)
    mine = (models / "rc").rename(models / "mine")
    corners = np.array([[0.1, 0, 0.1], [0.2, 0, 0.1], [0.1, 0.07, 0.1], [0.1, 0, 0.16]], np.float32)
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    triangles = [
        np.concatenate([np.zeros(3), corners[list(f)].ravel()]).astype("<f4").tobytes() for f in faces
    ]
    stl = bytes(80) + len(faces).to_bytes(4, "little") + b"".join(t + b"\0\0" for t in triangles)
    (mine / "spoiler.stl").write_bytes(stl)
    mjcf = (mine / "rc.xml").read_text()
    at = mjcf.rindex("<", 0, mjcf.index('name="body"'))
    mjcf = mjcf[:at] + '<geom type="mesh" mesh="spoiler" material="paint"/>' + mjcf[at:]
    asset = '<asset><mesh name="spoiler" file="spoiler.stl"/></asset>'
    mjcf = mjcf.replace("<worldbody>", f"{asset}<worldbody>", 1)
    (mine / "rc.xml").unlink()
    (mine / "mine.xml").write_text(mjcf)
    folder = record(tmp_path / "run", "mujoco", 0.3, models=f"models.ego={mine}")
    shutil.rmtree(models)
    found = read(folder / "run.mcap")
    assert "file=" not in found.world_xml
    mesh = header(found).model.mesh("ego/spoiler")
    assert (mesh.vertnum[0], mesh.facenum[0]) == (4, 4)
    for kind in KINDS:
        assert verify(folder / f"run.{kind}").right
    assert replay(folder / "run.mcap").same
