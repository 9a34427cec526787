"""Car models: a bad one is refused by name, with what is expected, before anything runs."""

import shutil

import pytest

from mjmerge.config import shipped
from mjmerge.errors import ModelError, ScenarioError
from mjmerge.scenario.load import load
from mjmerge.world.compose import build, single

NAMES = sorted(shipped.models())


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
    text = (shipped.models()[name] / f"{name}.xml").read_text()
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
    text = (shipped.models()[name] / f"{name}.xml").read_text()
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
    text = (shipped.models()["rc"] / "rc.xml").read_text()
    old = without(text, f'<body name="{body}"', "mass=")
    start = text.index(old) + len(old)
    mass = text[start : start + text[start + 1 :].index('"') + 2]
    said = refused(car((old + mass, old + '"0"')))
    assert f"body '{body}' has a mass of 0; expected above 0 kg" in said


@pytest.mark.parametrize("name", NAMES)
def test_tyres_that_are_not_spheres_are_refused_with_the_reason(car, name):
    text = (shipped.models()[name] / f"{name}.xml").read_text()
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
    shutil.copy(shipped.models()["rc"] / "datasheet.yaml", folder)
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


def test_a_folder_without_a_data_sheet_says_what_writes_one(altered_car):
    folder = altered_car()
    (folder / "datasheet.yaml").unlink()
    with pytest.raises(ScenarioError, match=r"own: no datasheet\.yaml in it.*mjmerge new car") as error:
        load("paper", [f"models.ego={folder}"])
    assert len(error.value.problems) == 1


def test_a_car_given_by_its_file_is_told_to_give_the_folder(altered_car):
    folder = altered_car()
    with pytest.raises(ModelError, match=r"own\.xml is a file; a car model is given by its folder, .*own$"):
        single(str(folder / "own.xml"))


def test_an_mjcf_that_has_not_the_name_of_its_folder_is_named(altered_car):
    folder = altered_car()
    (folder / "own.xml").rename(folder / "car.xml")
    assert "own.xml is missing: a car's MJCF has the name of its folder; rename car.xml" in refused(
        load("paper", [f"models.ego={folder}"])
    )


def test_a_robot_arm_is_refused_in_one_line_that_says_where_the_contract_is(altered_car):
    folder = altered_car()
    (folder / "own.xml").write_text(
        """<mujoco model="arm"><worldbody><body name="base"><joint name="lift"/><geom size=".1"/>
        <body name="link"><joint name="bend"/><geom size=".1"/></body></body></worldbody>
        <actuator><motor name="lifts" joint="lift"/></actuator></mujoco>"""
    )
    said = refused(load("paper", [f"models.ego={folder}"]))
    assert "\n" not in said
    assert "not a car that mjmerge can drive: 44 of the 44 names that every car has are missing" in said
    assert "bodies base, link, 2 joints and 1 actuators" in said
    assert "docs/your-car.md" in said


def test_a_long_list_of_missing_names_is_one_line_kind_by_kind(altered_car):
    folder = altered_car(
        ('"tyre_rear_', '"tyre_back_'),
        ('"drive_rear_', '"drive_back_'),
        ('"front_axle"', '"axle_one"'),
        ('"hull"', '"bumper"'),
        ('"drag_area_m2"', '"cda"'),
        shared=[('"paint"', '"lacquer"'), ('"brake_', '"stop_'), ('"front_axle"', '"axle_one"')],
    )
    said = refused(load("paper", [f"models.ego={folder}"]))
    first = said.splitlines()[0]
    assert "geom hull, tyre_rear_left, tyre_rear_right;" in first
    assert "actuator drive_rear_left, drive_rear_right, brake_front_left" in first
    assert "are missing; docs/your-car.md says what each is" in first


def test_what_four_wheels_have_in_common_is_one_line(altered_car):
    folder = altered_car(('axis="0 1 0"', 'axis="0 1 0" damping="1"'))
    said = refused(load("paper", [f"models.ego={folder}"]))
    assert said.count("has a damping") == 1
    assert "(so is spin_front_right, spin_rear_left, spin_rear_right)" in said


def test_four_steered_wheels_are_refused_with_the_two_that_steer(altered_car):
    hub = '<body name="hub_rear_left" pos="-0.17145 0.1325 0">'
    joint = '<joint name="steer_rear_left" class="steer"/>'
    folder = altered_car((hub, hub + joint))
    assert (
        "steer_rear_left is between the chassis and wheel_rear_left: only the front wheels steer"
        in refused(load("paper", [f"models.ego={folder}"]))
    )


def test_a_servo_of_a_rear_wheel_is_refused_in_one_line(altered_car):
    motor = '<motor name="drive_rear_left"'
    servos = "".join(
        f'<position name="steer_rear_{s}" joint="spin_rear_{s}" class="steer"/>' for s in ("left", "right")
    )
    (line,) = refused(load("paper", [f"models.ego={altered_car((motor, servos + motor))}"])).splitlines()
    assert "only the front wheels of a car steer; remove it, and its joint (so is steer_rear_right)" in line


def test_spin_and_steer_on_one_body_say_that_the_hub_is_missing(altered_car):
    steer = '<joint name="steer_front_left" class="steer"/>'
    wheel = '<joint name="spin_front_left" class="spin"/>'
    folder = altered_car((f"        {steer}\n", ""), (wheel, steer + wheel))
    assert "joint steer_front_left is on wheel_front_left itself; expected on a body of its own" in refused(
        load("paper", [f"models.ego={folder}"])
    )
