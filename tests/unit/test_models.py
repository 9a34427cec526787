"""Car models: a bad one is refused by name, with what is expected, before anything runs."""

import shutil

import pytest

from mjmerge import share
from mjmerge.errors import ModelError
from mjmerge.loader import load
from mjmerge.world import build

NAMES = sorted(share.models())


@pytest.fixture
def car(altered_car):
    """A scenario with a changed copy of a car as the ego."""
    return lambda *changes, **more: load("paper", [f"models.ego={altered_car(*changes, **more)}"])


def refused(scenario):
    """What is said of a scenario's models."""
    with pytest.raises(ModelError) as error:
        build(scenario)
    return str(error.value)


def test_an_unchanged_copy_of_a_car_elsewhere_is_a_car(car):
    assert build(car()).model.nq == build(load("paper")).model.nq


def without(text, begin, end):
    """What stands from one text to the end of another, to be cut out."""
    start = text.index(begin)
    return text[start : text.index(end, start) + len(end)]


@pytest.mark.parametrize("name", NAMES)
def test_a_missing_wheel_is_named(car, name):
    text = (share.models()[name] / f"{name}.xml").read_text()
    wheel = without(text, '<body name="wheel_rear_left">', "</body>")
    motor = '<motor name="drive_rear_left" joint="spin_rear_left" class="spin"/>'
    changes = [(wheel, "")] + ([(motor, "")] if motor in text else [])
    brake = '<damper name="brake_rear_left" joint="spin_rear_left" class="brake_rear"/>'
    said = refused(car(*changes, base=name, shared=[(brake, "")]))
    for missing in (
        "body called 'wheel_rear_left'",
        "geom called 'tyre_rear_left'",
        "joint called 'spin_rear_left'",
    ):
        assert f"own.xml: no {missing}" in said


@pytest.mark.parametrize("name", NAMES)
def test_a_renamed_joint_is_named_with_the_nearest_that_is_there(car, name):
    renamed = ('"spin_front_left"', '"spin_front_lft"')
    text = (share.models()[name] / f"{name}.xml").read_text()
    assert renamed[0] in text
    said = refused(car(renamed, base=name, shared=[renamed]))
    assert "own.xml: no joint called 'spin_front_left'; did you mean 'spin_front_lft'?" in said


def test_a_joint_that_the_actuators_miss_is_refused(car):
    assert "spin_front_l" in refused(car(('joint name="spin_front_left"', 'joint name="spin_front_lft"')))


def test_a_missing_steering_actuator_is_named(car):
    steer = '<position name="steer_front_left" joint="steer_front_left" class="steer"/>'
    assert "no actuator called 'steer_front_left'" in refused(car(shared=[(steer, "")]))


@pytest.mark.parametrize("body", ["chassis", "wheel_front_left", "hub_rear_right"])
def test_a_body_without_mass_is_named(car, body):
    text = (share.models()["rc"] / "rc.xml").read_text()
    old = without(text, f'<body name="{body}"', "mass=")
    start = text.index(old) + len(old)
    mass = text[start : start + text[start + 1 :].index('"') + 2]
    said = refused(car((old + mass, old + '"0"')))
    assert f"body '{body}' has a mass of 0.0; expected above 0 kg" in said


@pytest.mark.parametrize("name", NAMES)
def test_tyres_that_are_not_spheres_are_refused_with_the_reason(car, name):
    text = (share.models()[name] / f"{name}.xml").read_text()
    sphere = without(text, 'type="sphere" size="', '"')
    radius = without(text, sphere, '" group')
    said = refused(
        car((radius, radius.replace("sphere", "cylinder").replace('" group', ' 0.02" group')), base=name)
    )
    assert "tyre_front_left is a cylinder, not a sphere; expected a sphere of the wheel's radius" in said
    assert "scrub" in said


def test_a_missing_sensor_is_named(car):
    sensor = '<framezaxis name="up_axis" objtype="xbody" objname="chassis"/>'
    assert "no sensor called 'up_axis'" in refused(car(shared=[(sensor, "")]))


def test_everything_that_is_missing_is_named_at_once(car):
    renamed = [('site name="rear_axle"', 'site name="axle_behind"')]
    said = refused(
        car(
            *renamed,
            ('"drive_rear_left"', '"drive_back_left"'),
            ('geom name="hull"', 'geom name="box"'),
            shared=[('site="rear_axle"', 'site="axle_behind"')],
        )
    )
    for missing in ("site called 'rear_axle'", "actuator called 'drive_rear_left'", "geom called 'hull'"):
        assert missing in said


def test_a_motor_that_the_data_sheet_does_not_know_is_refused(car):
    motor = '<motor name="drive_front_left" joint="spin_front_left" class="spin"/>'
    more = motor + '\n<motor name="drive_rear_left" joint="spin_rear_left" class="spin"/>'
    assert "motor 'drive_rear_left', but datasheet.yaml says drive: front" in refused(
        car((motor, more), base="sedan")
    )


@pytest.mark.parametrize("number", ['name="power_limit_w" data="1 2"', 'name="power_limit_w" data="-3"'])
def test_a_number_that_is_none_is_named_with_what_is_expected(car, number):
    said = refused(car(('name="power_limit_w" data="300"', number)))
    assert "numeric 'power_limit_w'" in said
    assert "expected one number that is not negative" in said


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (('axis="0 1 0"', 'axis="0 0 1"'), "joint spin_front_left is expected to be a hinge about y"),
        (('pos="0.15875 0.1325 0"', 'pos="0.15875 -0.2 0"'), "tyre_front_left is on the wrong side"),
        (('pos="0.15875 0 0"', 'pos="-0.3 0 0"'), "front_axle is not ahead of rear_axle"),
        (
            (
                'name="drive_rear_left" joint="spin_rear_left"',
                'name="drive_rear_left" joint="spin_rear_right"',
            ),
            "actuator drive_rear_left acts on spin_rear_right; expected spin_rear_left",
        ),
    ],
    ids=["axis", "side", "axles", "actuator"],
)
def test_parts_in_the_wrong_place_are_named_with_where_they_are_expected(car, change, says):
    assert says in refused(car(change))


def test_a_model_without_its_mjcf_is_refused_with_the_file(tmp_path):
    folder = tmp_path / "own"
    folder.mkdir()
    shutil.copy(share.models()["rc"] / "datasheet.yaml", folder)
    assert "own.xml" in refused(load("paper", [f"models.ego={folder}"]))


@pytest.mark.parametrize(
    "change",
    [
        ("</mujoco>", ""),
        ('<site name="front_axle"', '<site nam="front_axle"'),
        ("<worldbody>", "<worldbdy>"),
        ('mass="3.1"', 'mass="heavy"'),
        ('joint="spin_rear_left"', 'joint="spin_behind"'),
        ('mass="3.1"', 'mass="-3.1"'),
        ("../parts/car.xml", "../parts/van.xml"),
    ],
    ids=["cut off", "misspelt attribute", "misspelt element", "no number", "dangling", "negative", "include"],
)
def test_an_mjcf_that_is_none_is_an_error_of_the_model_and_not_a_traceback(car, change):
    assert refused(car(change))


def test_a_step_that_the_tyres_cannot_follow_is_refused_with_the_longest():
    too_long = ["physics_step_s=0.005"]
    said = refused(load("paper", too_long))
    assert "physics_step_s is 0.005" in said
    assert "0.002 or less" in said
    assert build(load("paper", [*too_long, "mismatch.tyres=ideal"])).model.opt.timestep == 0.005
