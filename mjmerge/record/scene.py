"""What is drawn of the composed world, and where it is tick by tick; the same for every recorder.

Drawn are the geoms of groups 0 to 2 (group 3 is for collisions); around each neighbour's front axle the disc
of radius r that the ego's front axle must stay out of, coloured by d_j over r; where the nominal law wants
the ego, its ghost. Sizes come from the geometry and from r, so that every scale is drawn alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjmerge.record.contacts import CLEAR, DISC_RGBA
from mjmerge.roster import EGO, slot
from mjmerge.simulation.log import TickBlock
from mjmerge.state import Array

Kind = Literal["box", "ellipsoid", "cylinder", "capsule", "mesh"]
_DRAWN_GROUPS = (0, 1, 2)
TARGET, CAMERA = "law/target", "camera/ego"
DRAWN_EVERY_S = 0.04
"""Poses are for the eye: this often, and as float32; the numbers are at every tick, as they are."""
_GHOST_ALPHA = 0.25
_UNBOUNDED_M = 500.0
"""Half the side of the square that an endless plane is drawn as, around the ego."""
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
        name: of the MuJoCo body, ``ego/chassis``, or one of ours, which do not turn: ``axles/<car>``,
            ``law/target``, and ``camera/ego``, which goes along the road with the ego but not sideways, and
            takes the ground with it, so that no run drives off it.
        shapes: what is drawn of it.
        label: what is written above it, if anything.
        neighbour: whose disc it is, as an index into d_j; ``None`` if it is no disc.
    """

    name: str
    shapes: tuple[Shape, ...] = ()
    label: str = ""
    neighbour: int | None = None

    def faded(self, alpha: float) -> Frame:
        """The same as a ghost: seen through, unlabelled, and without a target and a ground of its own."""
        shapes = () if self.name in (TARGET, CAMERA) else self.shapes
        seen_through = tuple(replace(s, rgba=np.array([*s.rgba[:3], alpha])) for s in shapes)
        return replace(self, shapes=seen_through, label="")


class Scene:
    """The drawing of one world.

    Attributes:
        fixed: what never moves, in world axes.
        frames: what moves.
        cars: who is in it, in the order of their columns.
        paint: colour of each car, 0 to 1, by the car's name.
        r_m: radius of the safety discs, m.
        label_m: how high above their frames labels are written, m.
    """

    def __init__(self, model: mujoco.MjModel, r_m: float) -> None:
        """Args: the composed world; radius of the safety discs, m."""
        self._model = model
        self.r_m = r_m
        self.cars = cars_in(model)
        self.paint = {car: np.asarray(model.material(f"{car}/paint").rgba, float) for car in self.cars}
        self._data = data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        drawn = [g for g in range(model.ngeom) if model.geom_group[g] in _DRAWN_GROUPS]
        drawn = [g for g in drawn if int(model.geom_type[g]) in _KINDS and _rgba(model, g)[3] > 0]
        still = [g for g in drawn if model.body_weldid[model.geom_bodyid[g]] == 0]
        ground = [g for g in still if _endless(model, g)]
        self.fixed, endless = (
            tuple(_shape(model, g, data.geom_xpos[g], _quat(data.geom_xmat[g])) for g in some)
            for some in ([g for g in still if g not in ground], ground)
        )
        shapes: dict[int, list[Shape]] = {}
        for g in sorted(set(drawn) - set(still)):
            shape = _shape(model, g, model.geom_pos[g], model.geom_quat[g])
            shapes.setdefault(int(model.geom_bodyid[g]), []).append(shape)
        self._bodies = np.array(sorted(shapes), np.intp)
        bodies = [Frame(model.body(b).name or f"body_{b}", tuple(shapes[b])) for b in self._bodies]
        ghost = tuple(
            _ghost(model, data, g)
            for b, f in zip(self._bodies, bodies, strict=True)
            if f.name.startswith("ego/")
            for g in drawn
            if model.geom_bodyid[g] == b
        )
        self.label_m = _height_m(data, model, drawn) + 0.15 * r_m
        self.frames = (*bodies, *self._discs(r_m), Frame(TARGET, ghost), Frame(CAMERA, endless))

    def _discs(self, r_m: float) -> Iterator[Frame]:
        """The front axles, with the neighbours' discs."""
        for j, car in enumerate(self.cars, start=-1):
            disc = () if j < 0 else (_disc(r_m),)
            yield Frame(f"axles/{car}", disc, car.replace("_", " "), None if j < 0 else j)

    def showing(self, fixed: tuple[Shape, ...], frames: Iterable[Frame]) -> Scene:
        """The same scene, drawn in another way."""
        other = copy(self)
        other.fixed, other.frames = fixed, tuple(frames)
        return other

    def drawn(self, block: TickBlock, control_step_s: float) -> NDArray[np.intp]:
        """Which ticks of a block are drawn, (D,)."""
        every = max(1, round(DRAWN_EVERY_S / control_step_s))
        return np.flatnonzero(block.ticks % every == 0)

    def poses(self, block: TickBlock, ticks: NDArray[np.intp]) -> tuple[Array, Array]:
        """Where the frames are at some ticks of a block.

        Args:
            block: the ticks and their columns.
            ticks: which of them, (D,).

        Returns:
            Origins, m, (D, F, 3), and orientations, w x y z, (D, F, 4), rounded to float32.
        """
        count, bodies = len(ticks), len(self._bodies)
        pos_m = np.zeros((count, len(self.frames), 3))
        quat = np.zeros((count, len(self.frames), 4))
        quat[..., 0] = 1.0
        model, data = self._model, self._data
        qpos, xpos, xquat = data.qpos, data.xpos, data.xquat
        each_pos_m, each_quat = np.empty((count, *xpos.shape)), np.empty((count, *xquat.shape))
        for k, tick in enumerate(ticks.tolist()):
            qpos[:] = block.qpos[tick]
            mujoco.mj_kinematics(model, data)
            each_pos_m[k], each_quat[k] = xpos, xquat
        pos_m[:, :bodies], quat[:, :bodies] = each_pos_m[:, self._bodies], each_quat[:, self._bodies]
        pos_m[:, bodies : bodies + len(self.cars), :2] = block.columns["front_m"][ticks]
        pos_m[:, -2, :2] = aim_m(block.columns)[ticks]
        pos_m[:, -1, 0] = block.columns["front_m"][ticks, 0, 0]
        return pos_m.astype(np.float32).astype(float), quat.astype(np.float32).astype(float)


def aim_m(columns: Mapping[str, Array]) -> Array:
    """Where the ghost is, m, (T, 2): at the law's target; at the ego itself under a law that has none."""
    target: Array = columns["target_m"]
    return np.where(np.isnan(target), columns["front_m"][:, 0], target)


def cars_in(model: mujoco.MjModel) -> tuple[str, ...]:
    """The cars of a composed world, in its order: what has paint under the name of one."""
    names = [model.material(m).name for m in range(model.nmat)]
    painted = [name.removesuffix("/paint") for name in names if name.endswith("/paint")]
    return tuple(car for car in painted if car == EGO or slot(car) is not None)


def _height_m(data: mujoco.MjData, model: mujoco.MjModel, drawn: list[int]) -> float:
    """How high what moves reaches, at most, m."""
    moving = [g for g in drawn if model.body_weldid[model.geom_bodyid[g]] != 0]
    return max((float(data.geom_xpos[g, 2] + model.geom_rbound[g]) for g in moving), default=0.0)


def _ghost(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Shape:
    """A geom of the standing ego, seen from the road below its front axle, and through."""
    axle_m = data.site("ego/front_axle").xpos * [1, 1, 0]
    shape = _shape(model, geom, data.geom_xpos[geom] - axle_m, _quat(data.geom_xmat[geom]))
    return replace(shape, rgba=np.array([*(0.5 + 0.5 * shape.rgba[:3]), _GHOST_ALPHA]))


def _endless(model: mujoco.MjModel, geom: int) -> bool:
    """Whether a geom is a plane without an end."""
    return bool(model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE and not model.geom_size[geom, :2].all())


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


def _disc(r_m: float) -> Shape:
    """A safety disc, a little above the road's markings."""
    return Shape(
        "cylinder",
        np.array([r_m, r_m, 0.002 * r_m]),
        np.array([0, 0, 0.006 * r_m]),
        np.array([1.0, 0, 0, 0]),
        DISC_RGBA[CLEAR],
        np.empty((0, 3)),
        np.empty((0, 3), np.int32),
    )
