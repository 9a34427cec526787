"""A car's file speaks of the car alone, and the car is what its data sheet says; all else is refused."""

import re
import shutil

import pytest

from mjmerge.config import shipped
from mjmerge.errors import ModelError
from mjmerge.proving.identify import identify
from mjmerge.roster import roster
from mjmerge.scenario.load import load
from mjmerge.world.compose import build, compose, single

CARS = roster().cars

WORLDBODY = "<worldbody>"
CHASSIS = '<body name="chassis" pos="0 0 0.055">'
HULL = '<geom name="hull" class="hull"'
HUB = '<body name="hub_front_left" pos="0.15875 0.1325 0">'
REAR_HUB = '<body name="hub_rear_left" pos="-0.17145 0.1325 0">'
TYRE = '<geom name="tyre_front_left" class="tyre"'
SPIN = '<joint type="hinge" axis="0 1 0"'
STEER = '<joint type="hinge" axis="0 0 1"'
MOTOR = '<motor ctrlrange="-0.53 0.53"/>'
SERVO = '<position kp="5"'
MOTORS = "  <actuator>\n    <motor"
SIZE = 'size="0.29 0.155 0.055"'


def refused(model):
    """What is said of a car that is refused."""
    with pytest.raises(ModelError) as error:
        single(str(model))
    return str(error.value)


def line_of(folder, text):
    """``own.xml:7``, where a text stands."""
    return f"own.xml:{(folder / 'own.xml').read_text().partition(text)[0].count(chr(10)) + 1}"


SECTIONS = {
    "gravity": '<option gravity="0 0 -1.62"/>',
    "iterations": '<option noslip_iterations="5"/>',
    "air": '<option density="1.2" viscosity="2e-5" wind="0 3 0"/>',
    "override": '<option o_solref="0.1 1"/>',
    "flag": '<option><flag contact="disable"/></option>',
    "enabled flag": '<option><flag energy="enable"/></option>',
    "the world's own step": '<option timestep="0.001"/>',
    "size": '<size njmax="5000"/>',
    "statistic": '<statistic meaninertia="1e6"/>',
    "quality": '<visual><quality shadowsize="0"/></visual>',
    "stiffness of pictures": '<visual><map znear="0.5"/></visual>',
    "exclude": '<contact><exclude body1="chassis" body2="wheel_front_left"/></contact>',
    "pair": '<contact><pair geom1="hull" geom2="tyre_front_left"/></contact>',
    "keyframe": '<keyframe><key name="home" ctrl="1"/></keyframe>',
    "weld": '<equality><weld body1="chassis"/></equality>',
    "linkage": '<equality><joint joint1="steer_front_left" joint2="steer_front_right"/></equality>',
    "tendon": '<tendon><fixed name="t"><joint joint="spin_rear_left" coef="1"/></fixed></tendon>',
    "settotalmass": '<compiler settotalmass="100"/>',
    "boundmass": '<compiler boundmass="1"/>',
    "balanceinertia": '<compiler balanceinertia="true"/>',
    "inertiafromgeom": '<compiler inertiafromgeom="true"/>',
    "eulerseq": '<compiler eulerseq="ZYX"/>',
    "fusestatic": '<compiler fusestatic="true"/>',
    "unlimited": '<compiler autolimits="false"/>',
    "degrees": '<compiler angle="degree"/>',
    "lengthrange": '<compiler><lengthrange timestep="0.1"/></compiler>',
    "plugin": '<extension><plugin plugin="mujoco.pid"/></extension>',
    "text": '<custom><text name="note" data="fast"/></custom>',
    "number": '<custom><numeric name="power_limit" data="3"/></custom>',
    "skybox": '<asset><texture type="skybox" builtin="gradient" width="8" height="8"/></asset>',
    "floor": '<worldbody><geom name="floor" type="plane" size="1 1 1"/></worldbody>',
    "lamp post": '<worldbody><light name="lamp" pos="0 0 3"/></worldbody>',
    "view": '<worldbody><camera name="view" pos="0 0 3"/></worldbody>',
    "second body": '<worldbody><body name="cone" pos="3 0 0"/></worldbody>',
    "throttle": '<actuator><motor name="throttle" joint="spin_rear_left"/></actuator>',
    "clock": '<sensor><clock name="clock"/></sensor>',
    "delayed motor": '<default><default class="late"><motor delay="0.2" nsample="9"/></default></default>',
}


@pytest.mark.parametrize("section", SECTIONS.values(), ids=SECTIONS)
def test_what_a_cars_file_says_of_the_world_is_refused_with_its_line_and_what_to_do(altered_car, section):
    folder = altered_car(("  <worldbody>", f"  {section}\n  <worldbody>"))
    said = refused(folder)
    tag = re.findall(r"<(\w+)", section)[-1 if "<option><" in section or "<visual><" in section else 0]
    assert line_of(folder, section) in said
    assert f"<{tag}" in said or any(f"<{inner}" in said for inner in re.findall(r"<(\w+)", section))
    assert any(what in said for what in ("remove it", "write angle"))


IN_BODIES = {
    "free joint": (CHASSIS, f'{CHASSIS}<freejoint name="root"/>', "the world gives a car its free joint"),
    "free joint by type": (CHASSIS, f'{CHASSIS}<joint type="free"/>', "the world gives a car its free joint"),
    "joint of the chassis": (
        CHASSIS,
        f'{CHASSIS}<joint name="heave" type="slide"/>',
        "the chassis has no joint",
    ),
    "headlight": (CHASSIS, f'{CHASSIS}<light name="beam" pos="0.3 0 0"/>', "lights are the world's"),
    "weightless": (CHASSIS, CHASSIS[:-1] + ' gravcomp="1">', 'gravcomp="1": gravity moves all of a car'),
    "mocap": (CHASSIS, CHASSIS[:-1] + ' mocap="true">', 'mocap="true": gravity moves all of a car'),
}


@pytest.mark.parametrize(("old", "new", "says"), IN_BODIES.values(), ids=IN_BODIES)
def test_what_only_a_world_has_is_refused_inside_the_car_too(altered_car, old, new, says):
    folder = altered_car((old, new))
    said = refused(folder)
    assert line_of(folder, old[:20]) in said
    assert says in said


PARTS = {
    "wheels that touch": (
        '<geom type="sphere"',
        '<geom type="sphere" contype="1" conaffinity="1"',
        "tyre_front_left on",
    ),
    "wing that touches": (
        '<geom name="wing"',
        '<geom name="wing" conaffinity="1"',
        "the geom wing on the body chassis",
    ),
    "nameless that touches": (
        '<geom class="rim"/>',
        '<geom class="rim" contype="2"/>',
        "a geom without a name on the",
    ),
    "hull of air": (HULL, f'{HULL} contype="0"', 'the geom hull on the body chassis has contype="0"'),
    "hull with priority": (HULL, f'{HULL} priority="1"', "priority of the hull is 1; expected MuJoCo's 0"),
    "wide hull": (HULL, f'{HULL} margin="0.1"', "margin of the hull is 0.1; expected MuJoCo's 0"),
    "soft hull": (HULL, f'{HULL} solref="0.5 1"', "solref of the hull is 0.5 1; expected MuJoCo's 0.02 1"),
    "slippery hull": (HULL, f'{HULL} condim="1"', "condim of the hull is 1; expected MuJoCo's 3"),
    "hull that decides": (HULL, f'{HULL} solmix="9"', "solmix of the hull is 9; expected MuJoCo's 1"),
    "tyre that reaches": (TYRE, f'{TYRE} margin="0.01"', "margin of tyre_front_left is not 0"),
    "round hull": (
        f"{HULL} {SIZE}",
        f'{HULL} type="ellipsoid" {SIZE}',
        "the hull is an ellipsoid; expected a box",
    ),
    "turned hull": (HULL, f'{HULL} euler="0 0 0.2"', "the hull is a box, turned; expected a box"),
    "hull beside": (
        'pos="-0.00625 0 0.03"',
        'pos="-0.00625 0.05 0.03"',
        "the middle of the hull is at y = 0.05 m",
    ),
    "hull behind": ('pos="-0.00625 0 0.03"', 'pos="-0.05 0 0.03"', "front_overhang_m: 0.125"),
    "hull in the road": (
        'pos="-0.00625 0 0.03"',
        'pos="-0.00625 0 -0.01"',
        "meets other cars and not the road",
    ),
    "hull above": ('pos="-0.00625 0 0.03"', 'pos="-0.00625 0 0.3"', "meets other cars and not the road"),
    "small hull": (
        SIZE,
        'size="0.029 0.0155 0.055"',
        "the length of the hull is 0.058 m; datasheet.yaml says length_m: 0.58",
    ),
    "narrow hull": (
        SIZE,
        'size="0.29 0.1 0.055"',
        "the width of the hull is 0.2 m; datasheet.yaml says width_m: 0.31",
    ),
    "turned car": (CHASSIS, CHASSIS[:-1] + ' euler="0 0 3.14159">', "at x = y = 0 and not turned"),
    "car elsewhere": (CHASSIS, CHASSIS.replace("0 0 0.055", "1 0 0.055"), "at x = y = 0 and not turned"),
    "car below": (
        CHASSIS,
        CHASSIS.replace("0 0 0.055", "0 0 0"),
        "the height of the middle of tyre_front_left is 0 m",
    ),
    "axle aside": (
        '"front_axle" pos="0.15875 0 0"',
        '"front_axle" pos="0.15875 0.1 0"',
        "0.1 m beside the middle",
    ),
    "axle turned": (
        '<site name="rear_axle"',
        '<site euler="0 0 0.1" name="rear_axle"',
        "site rear_axle is turned",
    ),
    "wheelbase": ('"front_axle" pos="0.15875 0 0"', '"front_axle" pos="0.2 0 0"', "wheelbase_m: 0.3302"),
    "wheel ahead": (
        HUB,
        HUB.replace("0.15875", "0.18"),
        "tyre_front_left is 0.02125 m ahead of the site front_axle",
    ),
    "track": (HUB, HUB.replace("0.1325", "0.15"), "track_m: 0.265, which makes 0.1325 m"),
    "big wheels": ('type="sphere" size="0.055"', 'type="sphere" size="0.06"', "wheel_radius_m: 0.055"),
    "steers the other way": (STEER, STEER.replace("0 0 1", "0 0 -1"), "about z; it turns the other way"),
    "drives backwards": (SPIN, SPIN.replace("0 1 0", "0 -1 0"), "about y; it turns the other way"),
    "toe": (HUB, HUB[:-1] + ' euler="0 0 0.2">', "joint spin_front_left is expected to be a hinge about y"),
    "axle beside the wheel": (
        SPIN,
        f'{SPIN} pos="0.02 0 0"',
        "spin_front_left does not go through the middle",
    ),
    "rolls hard": (SPIN, f'{SPIN} frictionloss="0.1"', "joint spin_front_left has a frictionloss; remove it"),
    "rolls in oil": (SPIN, f'{SPIN} damping="0.1"', "joint spin_front_left has a damping; remove it"),
    "wound up": (SPIN, f'{SPIN} stiffness="0.1"', "joint spin_front_left has a stiffness; remove it"),
    "half a turn": (SPIN, f'{SPIN} range="-3 3"', "joint spin_front_left has a range"),
    "steered from the start": (STEER, f'{STEER} ref="0.1"', "joint steer_front_left has a ref"),
    "sprung steering": (STEER, f'{STEER} stiffness="1"', "joint steer_front_left has a stiffness"),
    "steering that jams": (STEER, f'{STEER} actuatorfrcrange="-.1 .1"', "has an actuatorfrcrange"),
    "steered rear": (REAR_HUB, f'{REAR_HUB}<joint name="x" class="steer"/>', "only the front wheels steer"),
    "swinging arm": (
        REAR_HUB,
        f'{REAR_HUB}<joint name="x" axis="0 1 0"/>',
        "slide joints along z for a suspension",
    ),
    "brakes one way": ('forcerange="-1.12 1.12"', 'forcerange="-2 1.12"', "brake_front_left is 2 N·m"),
    "brakes that cannot lock": (
        'ctrlrange="0 5600"',
        'ctrlrange="0 0.5"',
        "to 1.12 or more, with which it locks",
    ),
    "sprung from below": ('range="-0.02 0.02"', 'range="0.01 0.02"', "is 0.01 to 0.02 m; expected around 0"),
    "sprung on three wheels": (
        '<joint name="suspension_rear_left" class="rear"/>',
        "",
        "wheel_rear_left has no suspension, and others have one",
    ),
    "springs at rest": ('springref="-0.01554"', "", "the car sinks by 0.00"),
    "no springs": ('stiffness="512" damping', 'stiffness="0" damping', "the springs push with"),
    "endless": ('mass="3.1"', 'mass="inf"', 'mass="inf"; expected finite numbers'),
    "no number": ('pos="0.15875 0 0"', 'pos="nan 0 0"', 'pos="nan 0 0"; expected finite numbers'),
    "larger than any number": ('mass="3.1"', 'mass="1e400"', "expected finite numbers"),
    "a group that is none": ('<geom name="wing"', '<geom group="inf" name="wing"', "expected finite numbers"),
    "an unknown class": (
        '<geom name="wing"',
        '<geom class="wing" name="wing"',
        "own.xml: XML Error: unknown default",
    ),
    "gear": (
        'joint="spin_rear_left" class="spin"',
        'joint="spin_rear_left" class="spin" gear="2"',
        "a gear of 2",
    ),
    "weak motors": (MOTOR, MOTOR.replace("0.53", "0.4"), "torque_limit_n_m: 0.53"),
    "motors without limit": (MOTOR, "<motor/>", "drive_front_left forwards is inf N·m"),
    "motors held back": (
        MOTOR,
        MOTOR[:-2] + ' forcerange="-.1 .1"/>',
        "drive_front_left forwards is 0.1 N·m",
    ),
    "servo that falls short": ('ctrlrange="-0.6 0.6"', 'ctrlrange="-0.3 0.3"', "steer_limit_rad: 0.4189"),
    "wheels that jam": (
        'range="-0.6 0.6" armature',
        'range="-0.3 0.3" armature',
        "the range of the joint steer_front_left",
    ),
    "brakes": (
        'forcerange="-1.12 1.12"',
        'forcerange="-2 2"',
        "brake_front_share: 0.7, which makes 1.12 N·m",
    ),
    "brakes that are told half": (
        '<damper kv="1" ctrlrange="0 5600"',
        '<damper kv="0.5" ctrlrange="0 5600"',
        'kv="1"',
    ),
    "heavy": (
        'mass="3.1"',
        'mass="5"',
        "the mass of all bodies is 5.64 kg; datasheet.yaml says mass_kg: 3.74",
    ),
    "nose-heavy": (
        '<inertial pos="0.0013 0 0.0229"',
        '<inertial pos="0.05 0 0.0229"',
        "com_behind_front_axle_m: 0.15875",
    ),
    "top-heavy": ('<inertial pos="0.0013 0 0.0229"', '<inertial pos="0.0013 0 0.1"', "com_height_m: 0.074"),
    "left-heavy": (
        '<inertial pos="0.0013 0 0.0229"',
        '<inertial pos="0.0013 0.02 0.0229"',
        "beside the middle",
    ),
    "sluggish": ('0.006 0.0175 0.0179"', '0.006 0.05 0.05"', "yaw_inertia_kg_m2: 0.047"),
    "flywheels": ('armature="2e-5"', 'armature="2e-3"', "rotating_mass_kg: 0.338"),
    "wheel out of balance": (
        '<inertial pos="0 0 0" mass="0.12"',
        '<inertial pos="0.01 0 0" mass="0.12"',
        "wheel_front_left is out of balance",
    ),
    "power": ('"power_limit_w" data="300"', '"power_limit_w" data="500"', "power_limit_w: 300"),
    "drag": ('"drag_area_m2" data="0.03"', '"drag_area_m2" data="0"', "drag_area_m2: 0.03"),
    "rolling": (
        '"rolling_resistance" data="0.02"',
        '"rolling_resistance" data="0.2"',
        "rolling_resistance: 0.02",
    ),
    "rate": (
        '"steer_rate_limit_radps" data="3.2"',
        '"steer_rate_limit_radps" data="9"',
        "steer_rate_limit_radps: 3.2",
    ),
    "tyres": ('data="94 101"', 'data="94 202"', "202 N/rad for the rear axle"),
    "no motor": (
        '"spin_limit_radps" data="364"',
        '"spin_limit_radps" data="0"',
        "the motors would never turn",
    ),
}


@pytest.mark.parametrize(("old", "new", "says"), PARTS.values(), ids=PARTS)
def test_a_car_that_is_not_what_its_names_and_its_data_sheet_say_is_refused_with_both(
    altered_car, old, new, says
):
    assert says in refused(altered_car((old, new)))


SHARED = {
    "engine of its own": (
        '<general name="resistance"',
        '<general name="resistance" biastype="affine" biasprm="1"',
    ),
    "pushed sideways": ('gear="1 0 0 0 0 0"', 'gear="0 1 0 0 0 0"'),
    "sensor of another kind": ("<framelinvel", "<framepos"),
    "sensor of another place": (
        '<velocimeter name="rear_velocity" site="rear_axle"/>',
        '<velocimeter name="rear_velocity" site="front_axle"/>',
    ),
    "crossed steering": (
        'name="steer_left" joint="steer_front_left"',
        'name="steer_left" joint="steer_front_right"',
    ),
    "sensor that is cut off": ('<jointpos name="steer_left"', '<jointpos cutoff="0.1" name="steer_left"'),
    "late sensor": ('<jointpos name="steer_left"', '<jointpos delay="0.1" nsample="99" name="steer_left"'),
    "late servo": (
        '<position name="steer_front_left"',
        '<position delay="0.1" nsample="99" name="steer_front_left"',
    ),
    "crossed servo": (
        '"steer_front_left" joint="steer_front_left"',
        '"steer_front_left" joint="steer_front_right"',
    ),
    "another origin": (
        'objtype="site" objname="front_axle"/>\n    <framelin',
        'objtype="site" objname="front_axle" reftype="site" refname="rear_axle"/>\n    <framelin',
    ),
    "option": ("<default>", '<option gravity="0 0 -1.62"/><default>'),
    "no radians": (' angle="radian"', ""),
}


@pytest.mark.parametrize(("old", "new"), SHARED.values(), ids=SHARED)
def test_a_car_is_refused_for_what_it_includes_with_the_included_file(altered_car, old, new):
    said = refused(altered_car(shared=[(old, new)]))
    assert "car.xml:" in said or "own.xml: no <compiler" in said


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("length_m: 0.58", "length_m: 5.8"),
        ("width_m: 0.31", "width_m: 0.2"),
        ("front_overhang_m: 0.125", "front_overhang_m: 0.2"),
        ("wheelbase_m: 0.3302", "wheelbase_m: 0.4"),
        ("track_m: 0.265", "track_m: 0.3"),
        ("wheel_radius_m: 0.055", "wheel_radius_m: 0.06"),
        ("mass_kg: 3.74", "mass_kg: 4"),
        ("rotating_mass_kg: 0.338", "rotating_mass_kg: 0"),
        ("com_behind_front_axle_m: 0.15875", "com_behind_front_axle_m: 0.1"),
        ("com_height_m: 0.074", "com_height_m: 0.1"),
        ("yaw_inertia_kg_m2: 0.047", "yaw_inertia_kg_m2: 0.06"),
        ("rear: 101.0", "rear: 90.0"),
        ("drag_area_m2: 0.03", "drag_area_m2: 0.04"),
        ("rolling_resistance: 0.02", "rolling_resistance: 0"),
        ("torque_limit_n_m: 0.53", "torque_limit_n_m: 0.6"),
        ("power_limit_w: 300", "power_limit_w: 200"),
        ("brake_torque_limit_n_m: 3.2", "brake_torque_limit_n_m: 4"),
        ("brake_front_share: 0.7", "brake_front_share: 0.5"),
        ("steer_limit_rad: 0.4189", "steer_limit_rad: 0.8"),
        ("steer_rate_limit_radps: 3.2", "steer_rate_limit_radps: 4"),
    ],
)
def test_a_data_sheet_that_is_not_the_cars_is_refused_with_its_number(altered_car, old, new):
    said = refused(altered_car(sheet=[(old, new)]))
    number = new.rpartition(" ")[2]
    assert f"{float(number):g}" in said
    assert "datasheet.yaml says" in said


def test_a_sheet_rounded_by_less_than_a_part_in_a_hundred_is_the_cars(altered_car):
    rounded = [
        ("wheelbase_m: 0.3302", "wheelbase_m: 0.33"),
        ("com_behind_front_axle_m: 0.15875", "com_behind_front_axle_m: 0.159"),
    ]
    assert single(str(altered_car(sheet=rounded))).model.nq


@pytest.mark.parametrize("role", CARS)
def test_a_car_is_refused_in_every_role_whoever_drives_beside_it(altered_car, role):
    folder = altered_car(("  <worldbody>", '  <option gravity="0 0 -1.62"/>\n  <worldbody>'))
    with pytest.raises(ModelError, match=r'own\.xml:\d+: <option gravity="0 0 -1\.62">'):
        build(load("paper", [f"models.{role}={folder}"]))


def test_everything_that_is_wrong_with_a_car_is_said_once_however_often_it_drives(altered_car):
    folder = altered_car((SIZE, 'size="0.029 0.0155 0.055"'), ('mass="3.1"', 'mass="5"'))
    with pytest.raises(ModelError) as error:
        build(load("paper", [f"models.{car}={folder}" for car in CARS]))
    said = str(error.value).splitlines()
    assert len(said) == len(set(said))
    for what in ("length_m", "width_m", "front_overhang_m", "mass_kg"):
        assert sum(f"datasheet.yaml says {what}:" in line for line in said) == 1


def test_identify_refuses_a_car_that_is_a_tenth_of_its_data_sheet(altered_car):
    with pytest.raises(ModelError, match="length of the hull is 0"):
        identify(str(altered_car((SIZE, 'size="0.029 0.0155 0.055"'))))


def test_an_option_without_a_word_in_it_says_nothing_and_is_let_by(altered_car):
    assert single(str(altered_car(("  <worldbody>", "  <option/><visual/>\n  <worldbody>")))).model.nq


@pytest.mark.parametrize("name", sorted(shipped.models()))
def test_the_shipped_cars_beside_each_other_change_nothing_of_the_world(name):
    model = compose({"ego": "rc", "vehicle_1": "sedan", "vehicle_2": name}).model
    assert model.opt.gravity.tolist() == [0, 0, -9.81]
    assert model.nexclude == model.neq == model.ntendon == model.nkey == 0


def test_a_file_that_includes_itself_is_refused(altered_car):
    folder = altered_car()
    parts = folder.parent / "parts" / "car.xml"
    parts.write_text(parts.read_text().replace("<default>", '<include file="../own/own.xml"/><default>', 1))
    assert "includes it" in refused(folder)


def test_a_copy_of_a_car_without_its_shared_parts_says_which_file_is_missing(altered_car):
    folder = altered_car()
    shutil.rmtree(folder.parent / "parts")
    said = refused(folder)
    assert "own.xml: includes" in said
    assert "parts/car.xml: cannot be read" in said
