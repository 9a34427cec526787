"""Cars and discs as points: the one thing in three dimensions that Rerun draws of an MCAP by itself.

It knows no ``SceneUpdate``, and makes a 3D view of an MCAP only where there are points. So each car and each
disc has a cloud of points at t = 0, fixed to its frame, which ``/tf`` moves. The clouds show where the cars
are and how they are turned, no more: their wheels are left out, and their discs keep their colour.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
from foxglove import messages as fox

from mjmerge.record.mcap.reader import LOOK
from mjmerge.record.scene import Frame, Scene, Shape
from mjmerge.state import Array

_ALONG, _AROUND = 13, 72
"""Points along an edge of a box, and around a circle."""
_DISC_RGB = np.array([0.85, 0.85, 0.85])
_NUMBER = fox.PackedElementFieldNumericType
_FIELDS = [
    *(fox.PackedElementField(name=n, offset=4 * i, type=_NUMBER.Float32) for i, n in enumerate("xyz")),
    *(
        fox.PackedElementField(name=n, offset=12 + i, type=_NUMBER.Uint8)
        for i, n in enumerate(("red", "green", "blue", "alpha"))
    ),
]
_POINT = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)])


def clouds(scene: Scene) -> Iterator[tuple[str, fox.PointCloud]]:
    """Topic and points of each car's largest part, and of each disc."""
    for car in scene.cars:
        parts = [frame for frame in scene.frames if frame.name.startswith(f"{car}/") and frame.shapes]
        if parts:
            yield LOOK + car, _cloud(max(parts, key=_size))
    for frame in scene.frames:
        if frame.neighbour is not None:
            yield f"{LOOK}disc_of_{scene.cars[1 + frame.neighbour]}", _cloud(frame)


def _size(frame: Frame) -> float:
    """Of the largest box of a frame, or whatever else it has, m^3."""
    return max(float(shape.half_size_m.prod()) * (shape.kind != "mesh") for shape in frame.shapes)


@cache
def _box() -> Array:
    """Points on the edges of a cube from -1 to 1, (K, 3)."""
    t, a, b = np.meshgrid(np.linspace(-1, 1, _ALONG), [-1, 1], [-1, 1])
    along = np.stack([t.ravel(), a.ravel(), b.ravel()], axis=-1)
    return np.concatenate([np.roll(along, k, axis=-1) for k in range(3)])


@cache
def _ring() -> Array:
    """Points on a circle of radius 1 around z, (K, 3)."""
    turn = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    return np.stack([np.cos(turn), np.sin(turn), np.zeros(_AROUND)], axis=-1)


def _cloud(frame: Frame) -> fox.PointCloud:
    """The edges of a frame's shapes."""
    disc = frame.neighbour is not None
    each = [(_points(shape), _DISC_RGB if disc else shape.rgba[:3]) for shape in frame.shapes]
    points = np.zeros(sum(len(some) for some, _ in each), _POINT)
    points["xyz"] = np.concatenate([some for some, _ in each])
    points["rgba"][:, :3] = np.concatenate([np.tile(255 * rgb, (len(some), 1)) for some, rgb in each]).round()
    points["rgba"][:, 3] = 255
    return fox.PointCloud(
        timestamp=fox.Timestamp(0, 0),
        frame_id=frame.name,
        pose=fox.Pose(position=fox.Vector3(), orientation=fox.Quaternion(w=1.0)),
        point_stride=_POINT.itemsize,
        fields=_FIELDS,
        data=points.tobytes(),
    )


def _points(shape: Shape) -> Array:
    """Points on the edges of a shape, in the axes of its frame, m, (K, 3)."""
    match shape.kind:
        case "box":
            own = _box()
        case "mesh":
            own = shape.vertices_m
        case "ellipsoid":
            own = _ring()
        case _:
            own = np.concatenate([_ring() + np.array([0.0, 0.0, z]) for z in (-1.0, 1.0)])
    w, x, y, z = shape.quat
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    found: Array = shape.pos_m + (own * shape.half_size_m) @ turned.T
    return found
