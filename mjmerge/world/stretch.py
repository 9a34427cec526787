"""Cars of a composed world at another length and width: what a body of the same mass would be, drawn out.

Positions are stretched along and across the car, and so are its shapes and how its mass lies; what is part of
a wheel keeps its shape and its inertia, and heights, masses, springs and actuators stay. So the hull, the
axles and the centre of mass are where :meth:`mjmerge.vehicle.datasheet.DataSheet.stretched` says, and the car
stands on its springs as before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import numpy as np

from mjmerge.roster import WHEELS
from mjmerge.state import Array

Ways = Mapping[str, tuple[float, float]]
"""Factors along and across each car that is stretched, by its name."""


def stretched(xml: str, ways: Ways) -> str:
    """The text of a world in which some cars are longer or wider.

    Args:
        xml: a world that names no file, its cars along x.
        ways: by how much.
    """
    flat = mujoco.MjSpec.from_string(xml)
    flat.compile()
    spec = mujoco.MjSpec.from_string(flat.to_xml())  # without frames, so that places are those in a body
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for car, (along, across) in ways.items():
        _stretch(spec, model, data, car, np.diag([along, across, 1.0]))
    spec.compile()
    text: str = spec.to_xml()
    return text


def _stretch(
    spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData, car: str, stretch: Array
) -> None:
    """Stretches one car; ``stretch`` is (3, 3), in the frame of the car."""
    frame = spec.body(f"{car}/")
    wheels = {id_ for wheel in WHEELS for id_ in _ids(spec.body(f"{car}/hub_{wheel}"))}
    done: set[str] = set()
    for body in _below(frame):
        at = body.parent.id
        body.pos = _own(data, at, stretch) @ body.pos
        mine = _own(data, body.id, stretch)
        _weigh(body, model, mine, turns=body.id in wheels)
        for part in (*body.joints, *body.sites, *body.cameras, *body.lights):
            part.pos = mine @ part.pos
        for geom in body.geoms:
            geom.pos = mine @ geom.pos
            if not np.isnan(geom.fromto[0]):
                geom.fromto = np.concatenate([mine @ geom.fromto[:3], mine @ geom.fromto[3:]])
            elif body.id not in wheels:
                _draw_out(
                    spec, geom, np.linalg.norm(stretch @ data.geom(geom.id).xmat.reshape(3, 3), axis=0), done
                )


def _below(body: Any) -> Iterator[Any]:
    """All bodies below one."""
    for child in body.bodies:
        yield child
        yield from _below(child)


def _ids(body: Any) -> list[int]:
    """Of a body and of all below it."""
    return [body.id, *(one.id for one in _below(body))]


def _own(data: mujoco.MjData, body: int, stretch: Array) -> Array:
    """A stretch in the frame of a body, (3, 3)."""
    turn = data.xmat[body].reshape(3, 3)
    found: Array = turn.T @ stretch @ turn
    return found


def _weigh(body: Any, model: mujoco.MjModel, stretch: Array, *, turns: bool) -> None:
    """Gives a body the mass that it has, stretched where it lies; a wheel's own inertia stays."""
    if model.body_mass[body.id] <= 0:
        return
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body.id])
    axes = turn.reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[body.id]) @ axes.T
    if not turns:
        moments = stretch @ (np.trace(inertia) / 2 * np.eye(3) - inertia) @ stretch
        inertia = np.trace(moments) * np.eye(3) - moments
    body.explicitinertial = True
    body.mass = model.body_mass[body.id]
    body.ipos = stretch @ model.body_ipos[body.id]
    body.iquat, body.inertia = (1, 0, 0, 0), (0, 0, 0)
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _draw_out(spec: mujoco.MjSpec, geom: Any, by: Array, done: set[str]) -> None:
    """Stretches a shape along its own axes, (3,); what is round stays round."""
    if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
        if geom.meshname not in done:
            mesh = spec.mesh(geom.meshname)
            mesh.scale = mesh.scale * by
            done.add(geom.meshname)
    elif geom.type in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        geom.size = geom.size * by
    elif geom.type in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        geom.size = geom.size * (1, by[2], 1)
