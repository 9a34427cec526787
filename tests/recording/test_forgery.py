"""Forgeries made with our own code: columns edited, and all that follows from them made anew.

``verify`` finds those that contradict physics, seeds, drivers or drawings; ``replay`` finds all of them. The
kinds that only ``replay`` finds are named in docs/recordings.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from mjmerge.record import FORMATS, Header, Recording, versions
from mjmerge.record.read import read
from mjmerge.review.poses import outcome
from mjmerge.review.replay import replay
from mjmerge.review.verify import verify
from mjmerge.run import run
from mjmerge.scenario.cars import car_sheets
from mjmerge.scenario.load import dump, load
from mjmerge.simulation.loop import simulate
from mjmerge.state import Array
from mjmerge.world.compose import build
from tests.recording import rewrite
from tests.recording.forge import Forger

STANDS = [
    "initial.ego.front_m=[-0.9, 0.0]",
    "initial.ego.speed_mps=0.0",
    "law.k_o=0",
    "law.k_p=0",
    "law.k_v=0",
]
RUNS = {
    "merge": ("mujoco", ["duration_s=1.6"]),
    "crash": ("mujoco", ["duration_s=0.8", *STANDS]),
    "noisy": ("bicycle", ["duration_s=0.8", "mismatch.neighbour_position_noise_m=0.02"]),
    "points": ("double_integrator", ["duration_s=0.8", *STANDS]),
}
Columns = dict[str, Array]


def bump(columns: Columns, height_m: float) -> Array:
    """A smooth way aside and back, m, (T,)."""
    count = len(columns["opinion"])
    return height_m * np.sin(np.pi * np.arange(count) / (count - 1)) ** 4


def aside(columns: Columns) -> None:
    """The ego keeps further away; its velocities are as they were."""
    columns["front_m"][:, 0, 1] += bump(columns, 0.3)


def aside_with_velocities(columns: Columns) -> None:
    """The same, and its velocities are those of the new path."""
    aside(columns)
    columns["velocity_mps"][:, 0, 1] += np.gradient(bump(columns, 0.3), 0.01)


def follower_brakes(columns: Columns) -> None:
    """Vehicle 2 leaves more room than its driver did, on a path that its velocities have."""
    back = 0.4 * bump(columns, 1.0)
    columns["front_m"][:, 2, 0] -= back
    columns["velocity_mps"][:, 2, 0] -= np.gradient(back, 0.01)
    columns["speed_mps"][:, 2] -= np.gradient(back, 0.01)


def more_clearance(columns: Columns) -> None:
    columns["clearance_m"] += 0.05


def no_contact(columns: Columns) -> None:
    columns["contact_impulse_n_s"][:] = 0
    columns["contact_speed_mps"][:] = 0
    columns["clearance_m"] = np.maximum(columns["clearance_m"], 1e-3)


def teleport(columns: Columns) -> None:
    columns["front_m"][40:, 0, 0] += 0.5


def turned(columns: Columns) -> None:
    columns["heading_rad"][:, 0] += bump(columns, 0.2)


def sure(columns: Columns) -> None:
    columns["opinion"][:] *= 1.5


def slow(columns: Columns) -> None:
    columns["velocity_mps"][20:] *= 0.9
    columns["speed_mps"][20:] *= 0.9


def sees_well(columns: Columns) -> None:
    columns["sensed_front_m"][:] = columns["front_m"]


def missed(columns: Columns) -> None:
    """A point passes the ego at another place: exact positions for its velocities."""
    columns["front_m"][:, 2, 1] += bump(columns, 1.0)
    columns["velocity_mps"][:, 2, 1] += np.gradient(bump(columns, 1.0), 0.01)


def nothing(columns: Columns) -> None:
    pass


def unsaturated(columns: Columns) -> None:
    columns["torque_clipped_n_m"][:] = 0
    columns["torque_n_m"] *= 1.02


@dataclass(frozen=True)
class Forgery:
    """Which run, what is changed before and after all that follows is made anew, and what finds it."""

    of: str
    change: Callable[[Columns], None]
    found_by: set[str]
    after: Callable[[Columns], None] | None = None


FORGERIES = {
    "the ego keeps further away": Forgery("merge", aside, {"motion"}),
    "with velocities to match": Forgery("merge", aside_with_velocities, {"motion", "bodies", "poses"}),
    "the follower leaves more room": Forgery("merge", follower_brakes, {"bodies", "motion"}),
    "more clearance": Forgery("merge", more_clearance, {"bodies"}),
    "no contact": Forgery("crash", no_contact, {"bodies"}),
    "a teleport": Forgery("merge", teleport, {"motion"}),
    "another heading": Forgery("merge", turned, {"law", "poses"}),
    "a surer opinion": Forgery("merge", sure, {"opinion", "start"}),
    "everybody slower": Forgery("merge", slow, {"motion"}),
    "no noise": Forgery("noisy", sees_well, {"sensing"}),
    "a miss": Forgery("points", missed, {"motion"}),
    "no saturation": Forgery("merge", nothing, {"law"}, unsaturated),
}


@pytest.fixture(scope="module")
def forger(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Forger]:
    made: dict[str, Path] = {}

    def of(name: str, kind: str) -> Forger:
        if name not in made:
            plant, overrides = RUNS[name]
            made[name] = tmp_path_factory.mktemp(name)
            run(load("paper", overrides), plant, folder=made[name])
        return Forger(made[name] / f"run.{kind}")

    return of


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", FORGERIES)
def test_a_consistent_forgery_is_found(forger, tmp_path: Path, name: str) -> None:
    forgery = FORGERIES[name]
    path = forger(forgery.of, "mcap").consistent(tmp_path, forgery.change, after=forgery.after)
    found = verify(path)
    wrong = {check.name for check in found.checks if check.right is False}
    assert "fingerprints" not in wrong
    assert "distances" not in wrong
    assert wrong & forgery.found_by, wrong
    assert not replay(path).same


@pytest.mark.parametrize("name", ["the ego keeps further away", "no contact"])
def test_in_an_rrd_too(forger, tmp_path: Path, name: str) -> None:
    forgery = FORGERIES[name]
    path = forger(forgery.of, "rrd").consistent(tmp_path, forgery.change, after=forgery.after)
    assert not verify(path).right
    assert not replay(path).same


@pytest.mark.parametrize("name", RUNS)
def test_without_a_change_it_is_right(forger, tmp_path: Path, name: str) -> None:
    path = forger(name, "mcap").consistent(tmp_path, nothing)
    assert [c for c in verify(path).checks if c.right is False] == []
    assert replay(path).same


def softer(columns: Columns) -> None:
    columns["contact_impulse_n_s"] *= 0.5


def test_how_hard_a_contact_was_only_replay_knows(forger, tmp_path: Path) -> None:
    path = forger("crash", "mcap").consistent(tmp_path, softer)
    assert verify(path).right
    assert not replay(path).same


def test_a_run_under_another_mismatch_than_it_says_only_replay_knows(tmp_path: Path) -> None:
    said = load("paper", ["duration_s=1.0"])
    done = load("paper", ["duration_s=1.0", "mismatch.load_kg=0.3"])
    world = build(said)
    sheets = tuple(car_sheets(said))
    header = Header(
        said, dump(said), "mujoco", 0, world.drawn, world.xml, versions(), said.control_step_s, sheets
    )
    with Recording(tmp_path, header, {"run.mcap": FORMATS["run.mcap"]}) as recording:
        simulate(done, "mujoco", world=build(done), sink=recording)
    found = read(tmp_path / "run.mcap.partial")
    (tmp_path / "whole").mkdir()
    with Recording(tmp_path / "whole", header, {"run.mcap": FORMATS["run.mcap"]}) as recording:
        simulate(done, "mujoco", world=build(done), sink=recording)
        recording.close(outcome(found, found.trace()))
    path = tmp_path / "whole" / "run.mcap"
    assert verify(path).right
    assert not replay(path).same


@pytest.mark.parametrize("topic", ["/tf", "/scene", "/log", "/phases"])
def test_what_foxglove_shows_is_checked(forger, tmp_path: Path, topic: str) -> None:
    first: dict[str, bytes] = {}

    def the_first_again(of: str, data: bytes) -> bytes:
        return first.setdefault(of, data) if of == topic else data

    source = forger("crash", "mcap").found.path
    found = verify(rewrite.mcap(source, tmp_path / "shown.mcap", edit=the_first_again))
    assert not found.right
    assert "drawing" in {check.name for check in found.checks if check.right is False}


@pytest.mark.parametrize(
    "component",
    [
        "Transform3D:translation",
        "Boxes3D:half_sizes",
        "Arrows3D:vectors",
        "Cylinders3D:colors",
        "TextLog:text",
    ],
)
def test_what_rerun_shows_is_checked(forger, tmp_path: Path, component: str) -> None:
    changed: list[str] = []

    def edit(entity: str, batch: pa.RecordBatch) -> pa.RecordBatch:
        if component not in batch.schema.names or batch.num_rows < 2 - ("half_sizes" in component) or changed:
            return batch
        at = batch.schema.get_field_index(component)
        values = batch.column(at)
        if batch.num_rows == 1:
            flat = values.flatten().flatten().to_numpy(zero_copy_only=False) * 2
            inner = pa.FixedSizeListArray.from_arrays(
                pa.array(flat, pa.float32()), type=values.type.value_type
            )
            new = pa.ListArray.from_arrays(values.offsets, inner, type=values.type)
        else:
            new = values.take(pa.array(np.arange(len(values))[::-1]))
        if new.equals(values):
            return batch
        changed.append(entity)
        return batch.set_column(at, batch.schema.field(at), new)

    source = forger("crash", "rrd").found.path
    found = verify(rewrite.rrd(source, tmp_path / "shown.rrd", edit=edit))
    assert changed
    assert {check.name for check in found.checks if check.right is False} & {"drawing", "poses", "events"}
