"""The composed world: what was asked for is what MuJoCo compiled."""

import pkgutil
import shutil

import mujoco
import numpy as np
import pytest
from matplotlib.colors import to_hex

from mjmerge.config import shipped
from mjmerge.errors import ModelError
from mjmerge.figures.style import COLOURS
from mjmerge.roster import WHEELS, roster
from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.load import load
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.state import G_MPS2
from mjmerge.vehicle.actuation import ackermann
from mjmerge.world.checks.parts import DRIVE, DRIVEN, STEER
from mjmerge.world.compose import build, compose
from mjmerge.world.model import IMPRATIO

CARS = roster().cars
TYRES = [f"tyre_{wheel}" for wheel in WHEELS]


@pytest.fixture(scope="module")
def world():
    return build(load("paper"))


def test_an_option_that_the_composition_loses_is_an_error_and_not_another_physics(monkeypatch):
    composed = "mjmerge.world.compose.mjcf.RootElement.to_xml_string"
    text = pkgutil.resolve_name(composed)
    lose = lambda root, **more: text(root, **more).replace('cone="elliptic"', "")  # noqa: E731
    monkeypatch.setattr(composed, lose)
    with pytest.raises(ModelError, match="the compiled world's option cone is 0, not 1"):
        compose({"ego": "rc"})


def test_options_reach_the_compiled_model():
    model = build(load("paper", ["physics_step_s=0.002"])).model
    assert model.opt.timestep == 0.002
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.opt.impratio == IMPRATIO
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_AUTORESET


def test_a_world_that_is_built_again_is_that_world_and_not_what_somebody_made_of_it():
    first = build(load("charge"))
    friction = first.model.pair_friction.copy()
    first.model.pair_friction[:] = 0.1
    again = build(load("charge"))
    assert again.xml == first.xml
    assert again.model.pair_friction == pytest.approx(friction, abs=0)
    assert build(load("charge", ["mismatch.friction=0.5"])).model.pair_friction[0, 0] == 0.5
    assert build(load("charge", ["duration_s=99"])).xml != first.xml  # a longer road


def test_a_car_that_has_changed_since_is_read_again(tmp_path, monkeypatch):
    for kind in ("models", "scenarios"):
        shutil.copytree(shipped.folder(kind), tmp_path / kind)
    monkeypatch.setattr(shipped, "folder", lambda kind: tmp_path / kind)
    built = build(load("charge")).drawn
    file = tmp_path / "models" / "parts" / "car.xml"
    file.write_text(file.read_text().replace('rgba=".13 .13 .14 1"', 'rgba=".5 .5 .5 1"'))
    assert not np.array_equal(build(load("charge")).drawn.mat_rgba, built.mat_rgba)


def test_what_is_only_drawn_is_in_no_step_of_the_physics_and_changes_none_of_its_bits(altered_car):
    hub = '<inertial pos="0 0 0" mass="0.04" diaginertia="1e-5 1e-5 1e-5"/>'
    drawn_mass = altered_car((hub, '<geom type="sphere" size="0.02" mass="0.04"/>'))
    world = compose({"ego": str(drawn_mass), "vehicle_1": "sedan", "vehicle_2": "van"})
    touching = {"road"} | {f"{car}/{part}" for car in CARS for part in ("hull", *TYRES)}
    assert {world.model.geom(i).name for i in range(world.model.ngeom)} == touching
    assert world.drawn.ngeom > 5 * world.model.ngeom
    assert world.drawn.nmat > world.model.nmat == 0
    ends = []
    for model in (world.model, world.drawn):
        data = mujoco.MjData(model)
        data.ctrl[:] = np.linspace(-0.1, 0.3, model.nu)
        mujoco.mj_step(model, data, 500)
        ends.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
    assert np.abs(ends[0]).max() > 0.1
    assert ends[0].tobytes() == ends[1].tobytes()


@pytest.mark.parametrize("name", sorted(shipped.models()))
def test_the_mjcf_of_every_car_is_what_its_data_sheet_says(name):
    sheet = data_sheet(name)
    model = compose(dict.fromkeys(CARS, name)).model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for car in CARS:
        front, rear = (data.site(f"{car}/{axle}_axle").xpos for axle in ("front", "rear"))
        hull = model.geom(f"{car}/hull")
        centre = data.geom(f"{car}/hull").xpos
        tyres = {w: data.geom(f"{car}/tyre_{w}").xpos for w in WHEELS}
        assert front[0] - rear[0] == pytest.approx(sheet.wheelbase_m, abs=1e-9)
        for axle, at in (("front", front), ("rear", rear)):
            left, right = tyres[f"{axle}_left"], tyres[f"{axle}_right"]
            assert left[1] - right[1] == pytest.approx(sheet.track_m, abs=1e-9)
            assert (left + right) / 2 == pytest.approx(at, abs=1e-9)
        assert 2 * hull.size[0] == pytest.approx(sheet.length_m, abs=1e-9)
        assert 2 * hull.size[1] == pytest.approx(sheet.width_m, abs=1e-9)
        assert centre[0] + hull.size[0] - front[0] == pytest.approx(sheet.front_overhang_m, abs=1e-9)
        assert_numbers(model, data, car, sheet)
        assert model.body(f"{car}/chassis").subtreemass[0] == pytest.approx(sheet.mass_kg, rel=1e-9)
        for wheel in WHEELS:
            assert model.geom(f"{car}/tyre_{wheel}").size[0] == pytest.approx(sheet.wheel_radius_m, rel=1e-9)
        spinning = sum(model.dof_M0[model.joint(f"{car}/spin_{w}").dofadr[0]] for w in WHEELS)  # armature too
        assert spinning / sheet.wheel_radius_m**2 == pytest.approx(sheet.rotating_mass_kg, rel=2e-3)
        most = np.abs(ackermann(np.array(sheet.steer_limit_rad), sheet.wheelbase_m, sheet.track_m)).max()
        for steer in STEER:
            assert model.actuator(f"{car}/{steer}").ctrlrange[1] >= most


def assert_numbers(model, data, car, sheet):
    """Inertia, limits, resistances and tyres."""
    chassis = model.body(f"{car}/chassis")
    mass = data.subtree_com[chassis.id]
    front = data.site(f"{car}/front_axle").xpos
    assert front[0] - mass[0] == pytest.approx(sheet.com_behind_front_axle_m, abs=1e-4)
    assert mass[2] == pytest.approx(sheet.com_height_m, abs=1e-3)
    root = model.joint(f"{car}/free/").dofadr[0]
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    at = np.hypot(*(mass - data.xpos[chassis.id])[:2])
    yaw = full[root + 5, root + 5] - chassis.subtreemass[0] * at**2
    assert yaw == pytest.approx(sheet.yaw_inertia_kg_m2, rel=0.02)
    for name in ("power_limit_w", "drag_area_m2", "rolling_resistance", "steer_rate_limit_radps"):
        assert model.numeric(f"{car}/{name}").data[0] == getattr(sheet, name)
    tyres = sheet.cornering_stiffness_n_per_rad
    assert model.numeric(f"{car}/cornering_stiffness_n_per_rad").data.tolist() == [tyres.front, tyres.rear]
    for i, wheel in enumerate(WHEELS):
        brake = model.actuator(f"{car}/brake_{wheel}").forcerange[1]
        share = sheet.brake_front_share if i < 2 else 1 - sheet.brake_front_share
        assert brake == pytest.approx(sheet.brake_torque_limit_n_m * share / 2)
        if i in DRIVEN[sheet.drive]:
            motor = model.actuator(f"{car}/{DRIVE[i]}").ctrlrange
            assert motor == pytest.approx([-sheet.torque_limit_n_m, sheet.torque_limit_n_m])


def test_gravity_is_what_the_law_and_the_judges_take_it_for():
    assert build(load("paper")).model.opt.gravity.tolist() == [0, 0, -G_MPS2]


def test_figures_have_the_colours_of_the_cars_in_the_world():
    model = build(load("paper")).drawn
    for car in CARS:
        painted = model.material(f"{car}/paint").rgba
        assert to_hex(painted) == COLOURS[car]


def test_cars_stand_still_until_they_are_driven(world):
    """The tyres sink 0.25 mm into their contacts; along and across the road nothing moves."""
    scenario, model = load("paper"), world.model
    data = mujoco.MjData(model)
    front = np.array([[getattr(scenario.initial, car).front_m for car in CARS]])
    data.qpos[:] = world.qpos(front, np.zeros((1, 3)), np.zeros((1, 3, 2)), np.zeros((1, 3)))[0]
    mujoco.mj_step(model, data, 1500)
    mujoco.mj_forward(model, data)
    for c, car in enumerate(CARS):
        assert data.site(f"{car}/front_axle").xpos[:2] == pytest.approx(front[0, c], abs=1e-6)
        assert data.site(f"{car}/front_axle").xpos[2] == pytest.approx(
            data_sheet("rc").wheel_radius_m, abs=5e-4
        )
    assert np.abs(data.qvel).max() < 1e-5


def test_cars_are_placed_with_their_front_axles_exactly_where_asked(world):
    rng = np.random.default_rng(1)
    model, data = world.model, mujoco.MjData(world.model)
    front, heading = rng.uniform(-50, 50, (20, 3, 2)), rng.uniform(-np.pi, np.pi, (20, 3))
    steer, spin = rng.uniform(-0.4, 0.4, (20, 3, 2)), rng.uniform(-3, 3, (20, 3))
    for i, qpos in enumerate(world.qpos(front, heading, steer, spin)):
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        for c, car in enumerate(CARS):
            forward = [np.cos(heading[i, c]), np.sin(heading[i, c]), 0]
            assert data.sensor(f"{car}/front_position").data[:2] == pytest.approx(front[i, c], abs=1e-12)
            assert data.sensor(f"{car}/forward_axis").data == pytest.approx(forward, abs=1e-12)
            assert data.sensor(f"{car}/steer_left").data[0] == steer[i, c, 0]
            assert data.sensor(f"{car}/steer_right").data[0] == steer[i, c, 1]
            assert data.joint(f"{car}/spin_rear_left").qpos[0] == spin[i, c]


def test_rolling_cars_neither_slip_nor_turn(world):
    model, data = world.model, mujoco.MjData(world.model)
    data.qvel[:] = world.qvel(np.array([[2.0, -1.0, 0.5]]))[0]
    mujoco.mj_forward(model, data)
    for car, speed in zip(CARS, (2.0, -1.0, 0.5), strict=True):
        assert data.sensor(f"{car}/front_velocity").data == pytest.approx([speed, 0, 0], abs=1e-12)
        for wheel in WHEELS:
            rim = data.joint(f"{car}/spin_{wheel}").qvel[0] * model.geom(f"{car}/tyre_{wheel}").size[0]
            assert rim == pytest.approx(speed)


def test_friction_reaches_all_twelve_tyres_and_only_them():
    model = build(load("paper", ["mismatch.friction=0.37"])).model
    pairs = {model.pair(i).name: model.pair_friction[i] for i in range(model.npair)}
    assert set(pairs) == {f"{car}_road_{wheel}" for car in CARS for wheel in WHEELS}
    for friction in pairs.values():
        assert friction[:2] == pytest.approx(0.37)


def test_no_tyre_touches_anything_but_the_road(world):
    model = world.model
    for car in CARS:
        for wheel in WHEELS:
            tyre = model.geom(f"{car}/tyre_{wheel}")
            assert tyre.contype[0] == tyre.conaffinity[0] == 0


def test_a_command_delay_reaches_the_egos_actuators_and_nobody_elses():
    model = build(load("paper", ["mismatch.command_delay_s=0.05"])).model
    for car in CARS:
        for name in DRIVE + STEER:
            delay_s = model.actuator_delay[model.actuator(f"{car}/{name}").id]
            assert delay_s == pytest.approx(0.0495 if car == "ego" else 0.0)  # mjmerge.vehicle.delay says why
    assert not build(load("paper")).model.actuator_delay.any()


def test_tyres_slip_in_a_world_if_they_do_in_any_simulation_in_whatever_order():
    too_long = load("paper", ["physics_step_s=0.005", "mismatch.tyres=ideal"])
    mixed = [Mismatch(tyres="ideal"), Mismatch(tyres="slip")]
    assert build(too_long, mixed[:1]).tyres == "ideal"
    assert {build(load("paper"), order).tyres for order in (mixed, mixed[::-1])} == {"slip"}
    for order in (mixed, mixed[::-1]):
        with pytest.raises(ModelError, match="tyres that slip need"):
            build(too_long, order)


def test_a_delayed_ego_does_nothing_until_the_delay_is_over_and_then_all_of_it():
    world = build(load("paper", ["mismatch.command_delay_s=0.05"]))
    model, data = world.model, mujoco.MjData(world.model)
    for car in CARS[:2]:
        for name in DRIVE:
            data.actuator(f"{car}/{name}").ctrl[0] = 0.1
    started = {}
    for step in range(100):
        mujoco.mj_step(model, data)
        for car in CARS[:2]:
            if abs(data.actuator(f"{car}/drive_rear_left").force[0] - 0.1) < 1e-12:
                started.setdefault(car, step)
    assert started["vehicle_1"] == 0
    assert started["ego"] == 50
