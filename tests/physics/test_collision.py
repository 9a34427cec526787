"""Cars that hit each other: what one loses, the other gains."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjmerge.world.compose import compose

CHASSIS = ("ego/chassis", "vehicle_1/chassis")


def momentum(model, data):
    """Of both cars, along x and y, and about the vertical through the origin."""
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    total = np.zeros(3)
    for name in CHASSIS:
        body = model.body(name)
        p = body.subtreemass[0] * data.subtree_linvel[body.id]
        total[:2] += p[:2]
        total[2] += np.cross(data.subtree_com[body.id], p)[2] + data.subtree_angmom[body.id][2]
    return total


def test_momentum_of_free_cars_is_conserved_in_a_collision(car):
    """One runs into the other's rear corner on a road without grip: they bounce, spin, and lose nothing."""
    world = compose({"ego": car, "vehicle_1": car}, friction=1e-9, tyres="ideal", physics_step_s=0.0005)
    model, data, sheet = world.model, mujoco.MjData(world.model), world.sheets[0]
    ahead, aside = 1.05 * sheet.length_m, 0.5 * sheet.width_m
    speed = np.sqrt(9.81 * sheet.wheelbase_m)
    still = np.zeros((1, 2))
    front = np.array([[[0.0, 0.0], [ahead, aside]]])
    data.qpos[:] = world.qpos(front, still, np.zeros((1, 2, 2)), still)[0]
    data.qvel[:] = world.qvel(np.array([[speed, 0.0]]))[0]
    before = momentum(model, data)
    struck, duration = False, 0.25 * sheet.length_m / speed
    for _ in range(round(duration / model.opt.timestep)):
        mujoco.mj_step(model, data)
        names = [{model.geom(g).name for g in contact.geom} for contact in data.contact]
        struck |= {"ego/hull", "vehicle_1/hull"} in names
    assert struck
    after = momentum(model, data)
    assert data.qvel[model.joint("vehicle_1/free/").dofadr[0]] > 0.2 * speed
    assert abs(data.qvel[model.joint("vehicle_1/free/").dofadr[0] + 5]) > 0.01 * speed / sheet.length_m
    size = np.array([before[0], before[0], before[0] * sheet.length_m])
    assert after / size == pytest.approx(before / size, abs=1e-6)
