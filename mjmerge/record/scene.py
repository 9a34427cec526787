"""What is drawn of the composed world, and where it is tick by tick; the same for every recorder.

Drawn are the geoms of groups 0 to 2 (group 3 is for collisions), the target of the law, and the front axles:
around each neighbour's the disc of radius r that the ego's front axle must stay out of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmerge.scenario import CARS
from mjmerge.trace import Array, Block

Kind = Literal["box", "ellipsoid", "cylinder", "capsule", "mesh"]
_DRAWN_GROUPS = (0, 1, 2)
_UNBOUNDED_M = 500.0
"""Half the side of the square that an infinite plane is drawn as."""
_PLANE_M = 0.001
_KINDS: dict[int, Kind] = {
    mujoco.mjtGeom.mjGEOM_PLANE: "box",
    mujoco.mjtGeom.mjGEOM_BOX: "box",
    mujoco.mjtGeom.mjGEOM_SPHERE: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ellipsoid",
    mujoco.mjtGeom.mjGEOM_CYLINDER: "cylinder",
    mujoco.mjtGeom.mjGEOM_CAPSULE: "capsule",
    mujoco.mjtGeom.mjGEOM_MESH: "mesh",
}


@dataclass(frozen=True)
class Shape:
    """Something solid, in the axes of its frame.

    Attributes:
        kind: what it is.
        half_size_m: half its extent along its own x, y, z, m, (3,). Cylinders and capsules stand along z, and
            a capsule's z counts its straight part only. Of a mesh: ones.
        pos_m: its centre, m, (3,).
        quat: its orientation, w x y z, (4,).
        rgba: its colour, 0 to 1, (4,).
        vertices_m: corners of a mesh, m, (V, 3); empty for all others.
        triangles: indices into them, (M, 3).
    """

    kind: Kind
    half_size_m: Array
    pos_m: Array
    quat: Array
    rgba: Array
    vertices_m: Array
    triangles: NDArray[np.int32]

    @property
    def axis(self) -> Array:
        """Its z axis in the axes of its frame, (3,)."""
        w, x, y, z = self.quat
        return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


@dataclass(frozen=True)
class Frame:
    """Something that moves, with what is fixed to it.

    Attributes:
        name: of the MuJoCo body, ``ego/chassis``, or one of ours: ``axles/<car>``, ``law/target``, and
            ``camera/ego``, which goes along the road with the ego but neither sideways nor around.
        shapes: what is drawn of it.
        label: what is written above it, if anything.
    """

    name: str
    shapes: tuple[Shape, ...] = ()
    label: str = ""


class Scene:
    """The drawing of one world.

    Attributes:
        fixed: what never moves, in world axes.
        frames: what moves.
        paint: colour of each car, 0 to 1, by the car's name.
        label_m: how high above their frames labels are written, m.
    """

    def __init__(self, model: mujoco.MjModel, r_m: float) -> None:
        """Args: the composed world; radius of the safety discs, m."""
        self._model = model
        self.label_m = 0.5 * r_m
        self.paint = {car: np.asarray(model.material(f"{car}/paint").rgba, float) for car in CARS}
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        drawn = [g for g in range(model.ngeom) if model.geom_group[g] in _DRAWN_GROUPS]
        drawn = [g for g in drawn if int(model.geom_type[g]) in _KINDS and _rgba(model, g)[3] > 0]
        still = [g for g in drawn if model.body_weldid[model.geom_bodyid[g]] == 0]
        self.fixed = tuple(_shape(model, g, data.geom_xpos[g], _quat(data.geom_xmat[g])) for g in still)
        shapes: dict[int, list[Shape]] = {}
        for g in sorted(set(drawn) - set(still)):
            shape = _shape(model, g, model.geom_pos[g], model.geom_quat[g])
            shapes.setdefault(int(model.geom_bodyid[g]), []).append(shape)
        self._bodies = np.array(sorted(shapes), np.intp)
        bodies = (Frame(model.body(b).name or f"body_{b}", tuple(shapes[b])) for b in self._bodies)
        self.frames = (*bodies, *self._points(r_m))

    def _points(self, r_m: float) -> list[Frame]:
        """Front axles, target and camera, sized after the safety margin."""
        ego = self.paint["ego"]
        marks = {"ego": _round("cylinder", (0.02 * r_m, 0.02 * r_m, 0.2 * r_m), 0.2 * r_m, ego, 1.0)}
        for car in CARS[1:]:
            marks[car] = _round("cylinder", (r_m, r_m, 0.002 * r_m), 0.006 * r_m, self.paint[car], 0.3)
        target = _round("ellipsoid", (0.08 * r_m,) * 3, 0.08 * r_m, ego, 0.5)
        axles = [Frame(f"axles/{car}", (marks[car],), car.replace("_", " ")) for car in CARS]
        return [*axles, Frame("law/target", (target,)), Frame("camera/ego")]

    def poses(self, block: Block) -> tuple[Array, Array]:
        """Where the frames are: origins, m, (B, F, 3), and orientations, w x y z, (B, F, 4)."""
        count, bodies = len(block.ticks), len(self._bodies)
        pos_m = np.zeros((count, len(self.frames), 3))
        quat = np.zeros((count, len(self.frames), 4))
        quat[..., 0] = 1.0
        data = mujoco.MjData(self._model)
        for k in range(count):
            data.qpos = block.qpos[k]
            mujoco.mj_kinematics(self._model, data)
            pos_m[k, :bodies] = data.xpos[self._bodies]
            quat[k, :bodies] = data.xquat[self._bodies]
        axles, half = slice(bodies, bodies + len(CARS)), block.columns["heading_rad"] / 2
        pos_m[:, axles, :2] = block.columns["front_m"]
        quat[:, axles, 0], quat[:, axles, 3] = np.cos(half), np.sin(half)
        pos_m[:, -2, :2] = block.columns["target_m"]
        pos_m[:, -1, 0] = block.columns["front_m"][:, 0, 0]
        return pos_m, quat


def _quat(matrix: Array) -> Array:
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, matrix)
    return quat


def _rgba(model: mujoco.MjModel, geom: int) -> Array:
    """Colour of a geom: its material's, if it has one."""
    material = model.geom_matid[geom]
    return np.array(model.geom_rgba[geom] if material < 0 else model.mat_rgba[material], float)


def _shape(model: mujoco.MjModel, geom: int, pos_m: Array, quat: Array) -> Shape:
    """A geom, placed."""
    kind = _KINDS[int(model.geom_type[geom])]
    size = np.array(model.geom_size[geom], float)
    pos = np.array(pos_m, float)
    vertices, triangles = np.empty((0, 3)), np.empty((0, 3), np.int32)
    match model.geom_type[geom]:
        case mujoco.mjtGeom.mjGEOM_PLANE:
            size = np.array([*np.where(size[:2] > 0, size[:2], _UNBOUNDED_M), _PLANE_M])
            pos[2] -= _PLANE_M  # its upper side is the plane
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            size = np.full(3, size[0])
        case mujoco.mjtGeom.mjGEOM_CYLINDER | mujoco.mjtGeom.mjGEOM_CAPSULE:
            size = size[[0, 0, 1]]
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.mesh(model.geom_dataid[geom])
            vertex, face = int(mesh.vertadr[0]), int(mesh.faceadr[0])
            vertices = np.array(model.mesh_vert[vertex : vertex + int(mesh.vertnum[0])], float)
            triangles = np.array(model.mesh_face[face : face + int(mesh.facenum[0])], np.int32)
            size = np.ones(3)
    return Shape(kind, size, pos, np.array(quat, float), _rgba(model, geom), vertices, triangles)


def _round(kind: Kind, half_size_m: tuple[float, ...], height_m: float, rgb: Array, alpha: float) -> Shape:
    """A mark of ours, ``height_m`` above the origin of its frame."""
    return Shape(
        kind,
        np.array(half_size_m),
        np.array([0, 0, height_m]),
        np.array([1.0, 0, 0, 0]),
        np.array([*rgb[:3], alpha]),
        np.empty((0, 3)),
        np.empty((0, 3), np.int32),
    )
