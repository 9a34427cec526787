"""Cars that chance has changed: each is refused by file, or changes nothing of the world."""

import copy
import random

import numpy as np
import pytest
from lxml import etree

from mjmerge.errors import ModelError
from mjmerge.world.compose import compose

NUMBERS = ("", "nan", "inf", "1e400", "-1", "0", "0 0", "1 2 3", "1e-300", "1e300", "9" * 20, "0 0 1")
WORDS = ("a", "world", "chassis", "true", "hull", "mesh", "plane", "free", "ball", "radian", "../x", "ä")
ATTRIBUTES = (
    "pos euler quat size type mass class name axis range contype gravcomp mocap density joint site gear "
    "ctrlrange forcerange kp kv user childclass delay nsample margin condim ref springref springdamper "
    "stiffness damping group frictionloss armature data objtype objname cutoff material mesh hfield "
    "limited actrange dyntype biastype biasprm tendon body fromto diaginertia fullinertia file"
)
TAGS = (
    "geom body joint freejoint site camera light composite flexcomp plugin frame replicate attach option "
    "size compiler include default tendon equality custom numeric text motor general position inertial "
    "sensor asset mesh texture visual statistic keyframe contact deformable extension xyz"
)


def changed(text, chance):
    """A file with one to four of its elements gone, doubled, altered or new."""
    root = etree.fromstring(text.encode(), etree.XMLParser(remove_comments=True))
    for _ in range(chance.choice([1, 1, 1, 2, 4])):
        element, kind = chance.choice(list(root.iter())), chance.randrange(5)
        if kind == 0 and element is not root:
            element.getparent().remove(element)
        elif kind == 1 and element is not root:
            element.addnext(copy.deepcopy(element))
        elif kind == 2 and element.attrib:
            element.set(chance.choice(list(element.attrib)), chance.choice(NUMBERS + WORDS))
        elif kind == 3:
            element.set(chance.choice(ATTRIBUTES.split()), chance.choice(NUMBERS + WORDS))
        else:
            new = etree.SubElement(element, chance.choice(TAGS.split()))
            for _ in range(chance.randrange(3)):
                new.set(chance.choice(ATTRIBUTES.split()), chance.choice(NUMBERS + WORDS))
    return etree.tostring(root)


def options(model):
    """Everything that MuJoCo knows of how a world is simulated."""
    names = (n for n in dir(model.opt) if not n.startswith("_"))
    return {n: np.array(getattr(model.opt, n)).tolist() for n in names}


def attempt(folder):
    """What is said of a car, and the world that it is alone in, if nothing is."""
    try:
        return [], compose({"ego": str(folder)})
    except ModelError as error:
        return str(error).splitlines(), None


@pytest.fixture(scope="module")
def meant():
    return options(compose({"ego": "rc"}).model)


def test_a_car_that_chance_has_changed_is_refused_by_file_or_changes_nothing_of_the_world(
    altered_car, meant, long
):
    folder = altered_car()
    files = folder / "own.xml", folder.parent / "parts" / "car.xml"
    texts = [file.read_text() for file in files]
    accepted = 0
    for seed in range(3000 if long else 40):
        chance = random.Random(seed)
        for file, text in zip(files, texts, strict=True):
            file.write_text(text)
        which = int(chance.random() < 0.25)
        files[which].write_bytes(changed(texts[which], chance))
        said, world = attempt(folder)
        if world is None:
            assert all(".xml" in line for line in said), seed
        else:
            accepted += 1
            assert options(world.model) == meant, seed
    assert accepted > 0  # a lamp less is still a car
