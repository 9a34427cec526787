"""Physical cars at another length and width: what is stretched, what stays, and what a plate would weigh."""

from itertools import product

import mujoco
import numpy as np
import pytest

from mjmerge.plant import STRETCH
from mjmerge.scenario.cars import data_sheet
from mjmerge.world.checks import controls, frame, joints, sizes
from mjmerge.world.checks.car import Car
from mjmerge.world.compose import compose
from mjmerge.world.stretch import stretched

DIGITS = 5e-6  # MuJoCo writes six of them
BY = (1 / STRETCH, 1.0, STRETCH)
WAYS = [(along, across) for along, across in product(BY, BY) if 1 / STRETCH <= across / along <= STRETCH]


@pytest.mark.parametrize("model", ["sedan", "rc"])
@pytest.mark.parametrize(("along", "across"), WAYS)
def test_a_stretched_car_is_as_its_stretched_sheet_says_and_another_beside_it_as_before(model, along, across):
    sheet = data_sheet(model)
    size = ("ego", along * sheet.length_m, across * sheet.width_m)
    world = compose({"ego": model, "vehicle_1": model}, sizes=[size])
    assert world.sheets == (sheet.stretched(*size[1:]), sheet)
    for car, own in zip(world.cars, world.sheets, strict=True):
        one = Car(world.model, car, own, stretched=car == "ego")
        assert [f for check in (frame, joints, controls, sizes) for f in check.findings(one)] == []


def standing(world):
    """Height of each chassis and the forces under the wheels after a second, (C,) and (C, 4)."""
    model = world.model
    data = mujoco.MjData(model)
    for c, car in enumerate(world.cars):
        data.qpos[model.joint(f"{car}/free/").qposadr[0] + 1] = 5.0 * c  # side by side
    for _ in range(1000):
        mujoco.mj_step(model, data)
    high = [data.body(f"{car}/chassis").xpos[2] for car in world.cars]
    force = np.zeros(6)
    under = {}
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        under[model.geom(int(max(data.contact[i].geom))).name] = force[0]
    return (
        high,
        sorted(round(f, 1) for name, f in under.items() if name.startswith("ego")),
        sorted(round(f, 1) for name, f in under.items() if name.startswith("vehicle_1")),
    )


def test_it_stands_on_its_wheels_as_before():
    world = compose({"ego": "sedan", "vehicle_1": "sedan"}, sizes=[("ego", 6.0, 1.5)])
    high, ego, other = standing(world)
    assert high[0] == pytest.approx(high[1], abs=1e-5)
    assert len(ego) == 4
    assert ego == pytest.approx(other, rel=1e-3)


TOY = """
<mujoco><worldbody><body name="car/"><freejoint/><body name="car/chassis" pos="0.1 0 0.3" {turn}>
  <geom type="box" size="{box}" pos="{at}" mass="3"/>
  {hubs}
</body></body></worldbody></mujoco>"""
HUBS = "".join(
    f'<body name="car/hub_{name}" pos="{{x}} {{y}} 0"><geom type="cylinder" size="0.1 0.02" mass="1" '
    'euler="90 0 0"/></body>'
    for name in ("front_left", "front_right", "rear_left", "rear_right")
)


def toy(along=1.0, across=1.0):
    """A plate on wheels, its sides stretched by hand."""
    box = f"{0.5 * along} {0.2 * across} 0.1"
    at = f"{0.05 * along} {0.02 * across} 0.04"
    return TOY.format(
        box=box, at=at, turn="", hubs=HUBS.replace("{x}", str(0.3 * along)).replace("{y}", str(0.2 * across))
    ).replace('pos="0.1 0 0.3"', f'pos="{0.1 * along} 0 0.3"')


def inertia(model, body):
    """In the frame of a body, kg m^2, (3, 3)."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    axes = turn.reshape(3, 3)
    return axes @ np.diag(model.body_inertia[body]) @ axes.T


@pytest.mark.parametrize(("along", "across"), [(1.0, 1.0), (1.4, 1.0), (0.8, 1.3)])
def test_mass_is_stretched_as_that_of_a_box_that_is_made_longer_and_wheels_stay_round(along, across):
    found = mujoco.MjModel.from_xml_string(stretched(toy(), {"car": (along, across)}))
    asked = mujoco.MjModel.from_xml_string(toy(along, across))
    for name in ("body_mass", "body_ipos", "body_pos", "geom_size", "geom_pos"):
        assert getattr(found, name) == pytest.approx(getattr(asked, name), rel=DIGITS, abs=1e-9), name
    for body in range(found.nbody):
        assert inertia(found, body) == pytest.approx(inertia(asked, body), rel=DIGITS, abs=1e-9)


def test_a_part_that_is_turned_is_stretched_along_the_car():
    turned = toy().replace('pos="0.1 0 0.3" ', 'pos="0.1 0 0.3" euler="0 0 90"')
    assert 'euler="0 0 90"' in turned
    found = mujoco.MjModel.from_xml_string(stretched(turned, {"car": (2.0, 1.0)}))
    hull = found.geom_size[0]
    assert hull == pytest.approx([0.5, 0.4, 0.1])  # its own y lies along the car
    assert found.geom_pos[0] == pytest.approx([0.05, 0.04, 0.04])
