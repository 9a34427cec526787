"""The acceptance table of every car: driven as `mjmerge identify` drives it, held against physics.

Tolerances are the issue's. What is expected is computed here from the compiled model's own masses and
positions, not from the data sheet, wherever the two could differ.
"""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest

from mjmerge.config import shipped
from mjmerge.proving.identify import identify
from mjmerge.proving.manoeuvres import STEPS_G, Scale, brake, steer_ramp
from mjmerge.proving.readings import braking_distance_m, braking_mps2, peak_lateral_mps2, steering_beyond_rad
from mjmerge.state import G_MPS2
from mjmerge.vehicle.acceptance import FILE, acceptance
from mjmerge.vehicle.actuation import AIR_KG_PER_M3
from mjmerge.world.compose import single

LOW_GRIP = 0.4


@pytest.fixture(scope="module")
def found(car):
    return identify(car)


@pytest.fixture(scope="module")
def truth(world):
    """Mass and axle distances of the compiled car: m, l_f, l_r."""
    data = mujoco.MjData(world.model)
    mujoco.mj_forward(world.model, data)
    chassis = world.model.body("ego/chassis")
    com = data.subtree_com[chassis.id]
    front, rear = (data.site(f"ego/{axle}_axle").xpos for axle in ("front", "rear"))
    return float(chassis.subtreemass[0]), float(front[0] - com[0]), float(com[0] - rear[0])


@pytest.fixture(scope="module")
def icy(car):
    return single(car, friction=LOW_GRIP)


def test_the_wheels_carry_m_g_split_by_the_centre_of_mass(found, truth):
    mass, ahead, behind = truth
    assert found.loads_n.sum() == pytest.approx(mass * G_MPS2, rel=1e-4)
    share = behind / (ahead + behind)
    expected = mass * G_MPS2 / 2 * np.array([share, share, 1 - share, 1 - share])
    assert found.loads_n == pytest.approx(expected, rel=2e-3)


def test_the_suspension_rests_in_the_middle_of_its_travel(world):
    data = mujoco.MjData(world.model)
    mujoco.mj_step(world.model, data, round(2.0 / world.model.opt.timestep))
    for wheel in ("front_left", "front_right", "rear_left", "rear_right"):
        joint = world.model.joint(f"ego/suspension_{wheel}")
        assert abs(data.joint(f"ego/suspension_{wheel}").qpos[0]) < 0.1 * joint.range[1]


def test_at_rest_nothing_moves_a_micrometre_in_ten_seconds(found):
    still = found.still.between(2.0, np.inf)
    for of in (still.x_m, still.y_m, still.z_m):
        assert np.ptp(of[0]) < 1e-6


@pytest.mark.parametrize(("slope", "index"), [("up", 1), ("down", 2), ("across", 3)])
def test_a_parked_car_creeps_less_than_a_tenth_of_a_millimetre_a_second_on_ten_percent(found, slope, index):
    still = found.still.between(2.0, np.inf)
    way = np.hypot(still.x_m[index, -1] - still.x_m[index, 0], still.y_m[index, -1] - still.y_m[index, 0])
    assert way / (still.time_s[-1] - still.time_s[0]) < 1e-4


def test_the_braking_distance_is_v2_over_2_mu_g(found):
    v = found.braking.speed_mps[:, 0]
    assert braking_distance_m(found.braking) == pytest.approx(v**2 / (2 * G_MPS2), rel=0.05)
    assert braking_mps2(found.braking) == pytest.approx(G_MPS2, rel=0.05)


def test_on_ice_it_is_that_of_grip_and_road_load(icy, truth):
    """m v' = -(mu + c) m g - k v^2 has s = m/(2 k) ln(1 + k v^2/((mu + c) m g))."""
    mass, log = truth[0], brake(icy)
    grip_n = (LOW_GRIP + icy.number("rolling_resistance")[0]) * mass * G_MPS2
    drag = AIR_KG_PER_M3 / 2 * icy.number("drag_area_m2")[0]
    v = log.speed_mps[:, 0]
    assert braking_distance_m(log) == pytest.approx(
        mass / (2 * drag) * np.log1p(drag * v**2 / grip_n), rel=0.03
    )


@pytest.mark.parametrize("grip", ["dry", "icy"])
def test_the_peak_lateral_acceleration_is_mu_g(found, icy, grip):
    mu, log = (1.0, found.ramp) if grip == "dry" else (LOW_GRIP, steer_ramp(icy))
    assert peak_lateral_mps2(found.sheet, log).max() == pytest.approx(mu * G_MPS2, rel=0.05)


def test_a_torque_step_gives_the_acceleration_that_was_asked_for(found):
    log = found.steps.between(6 * Scale.of(found.sheet).time_s, np.inf)
    gained = (log.speed_mps[:, -1] - log.speed_mps[:, 0]) / (log.time_s[-1] - log.time_s[0])
    assert gained == pytest.approx(STEPS_G * G_MPS2, rel=0.01, abs=1e-3)


def test_the_understeer_gradient_is_that_of_the_axles(found, world, truth):
    """Traction out of it, and of the compiled car's own mass and stiffnesses."""
    mass, ahead, behind = truth
    front, rear = world.cornering_stiffness_n_per_rad()[0]
    length = ahead + behind
    expected = mass * (behind / front - ahead / rear) / length
    a = found.turns.lateral_mps2
    assert steering_beyond_rad(found.sheet, found.turns) @ a / (a @ a) == pytest.approx(expected, rel=0.05)


def test_identify_finds_nothing_amiss(found):
    assert [row for row in found.table if row.passed is False] == []
    assert sum(row.passed is True for row in found.table) >= 20


def test_what_is_stored_beside_the_model_is_of_this_car_and_passed(car, found):
    """Of a shipped car; after editing it: `mjmerge identify NAME --accept`."""
    folder = shipped.model_folder(car)
    stored = json.loads((folder / FILE).read_text(encoding="utf-8"))
    assert acceptance(folder).state == "passed"
    assert [row["name"] for row in stored["table"]] == [row.name for row in found.table]
