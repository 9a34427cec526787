"""A world whose cars bring files says the same without them."""

from __future__ import annotations

import struct
import zlib

import mujoco
import numpy as np
import pytest

from mjmerge.errors import ModelError
from mjmerge.record.attached import refusal
from mjmerge.world.contained import contained

OBJ = b"v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def png() -> bytes:
    """A picture of one pixel."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0)
    body = zlib.compress(b"\0\xff\0\0")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


ASSETS = {"a.obj": OBJ, "b.png": png()}
WORLD = """
<mujoco>
  <default><default class="small"><mesh scale=".1 .1 -.1"/></default></default>
  <asset>
    <mesh name="one" file="a.obj"/>
    <mesh name="two" class="small" file="a.obj" refpos="1 2 3" refquat=".7 .7 0 0"/>
    <mesh name="three" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>
    <texture name="paint" type="2d" file="b.png"/>
    <texture name="sky" type="skybox" builtin="flat" width="8" height="8"/>
    <material name="painted" texture="paint" rgba=".1 .2 .3 1"/>
  </asset>
  <worldbody>
    <body pos="0 0 9"><freejoint/>
      <geom type="mesh" mesh="one" material="painted" pos="1 2 3" euler="10 20 30"/>
      <geom type="mesh" mesh="two" mass="0" contype="0" conaffinity="0"/>
      <geom type="mesh" mesh="three"/>
    </body>
  </worldbody>
</mujoco>"""


def corners(model: mujoco.MjModel) -> list[np.ndarray]:
    """Where every mesh's vertices are in the world, sorted, by geom."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    for g in range(model.ngeom):
        m = model.geom_dataid[g]
        at = model.mesh_vertadr[m]
        points = model.mesh_vert[at : at + model.mesh_vertnum[m]] @ data.geom_xmat[g].reshape(3, 3).T
        points = points + data.geom_xpos[g]
        found.append(points[np.lexsort(np.round(points, 5).T)])
    return found


def test_meshes_stand_where_their_files_put_them_and_weigh_the_same():
    text = contained(WORLD, ASSETS)
    assert refusal(text) == ""  # a recording may hold it
    before, after = mujoco.MjModel.from_xml_string(WORLD, ASSETS), mujoco.MjModel.from_xml_string(text)
    for one, other in zip(corners(before), corners(after), strict=True):
        assert other == pytest.approx(one, abs=1e-5)
    assert after.body_mass == pytest.approx(before.body_mass, rel=1e-5)
    assert after.body_inertia == pytest.approx(before.body_inertia, rel=1e-4)


def test_what_had_a_picture_has_its_colour_and_other_textures_stay():
    model = mujoco.MjModel.from_xml_string(contained(WORLD, ASSETS))
    assert model.mat("painted").rgba == pytest.approx([0.1, 0.2, 0.3, 1])
    assert [model.tex(i).name for i in range(model.ntex)] == ["sky"]


def test_a_world_without_files_stays_as_it_is():
    assert contained("<mujoco/>", {}) == "<mujoco/>"


def test_what_cannot_be_written_out_is_refused():
    field = '<asset><hfield name="hill" file="b.png" size="1 1 1 1"/></asset>'
    ground = '<worldbody><geom type="hfield" hfield="hill"/></worldbody>'
    with pytest.raises(ModelError, match="the <hfield> 'hill' is a file"):
        contained(f"<mujoco>{field}{ground}</mujoco>", ASSETS)


def test_meshes_that_are_too_large_for_a_recording_are_refused_with_the_bound(monkeypatch):
    monkeypatch.setattr("mjmerge.world.contained.MOST_BYTES", 1000)
    with pytest.raises(ModelError, match="give the car meshes with fewer vertices"):
        contained(WORLD, ASSETS)
