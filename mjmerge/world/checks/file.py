"""A car's MJCF as text: what may stand in it, and where everything in it stands.

A car that is attached to a world brings its options, flags, sizes and compiler settings with it, and the
whole world, with every other car, is then simulated by them. So a car's file may only speak of the car:
everything else is refused here, by file and line, with what to do about it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from os.path import normpath
from pathlib import Path
from typing import Any

from lxml import etree

from mjmerge.errors import ModelError, nearest
from mjmerge.roster import WHEELS
from mjmerge.world.checks.findings import Finding
from mjmerge.world.checks.parts import BRAKE, DRIVE, NUMBERS, RESISTANCE, SENSORS, STEER, STEERED

_WORLDS = {
    "option": "the scenario sets the world's options (physics_step_s; mismatch.grade_rad for a slope)",
    "size": "sizes are the world's",
    "statistic": "its values would be the whole world's",
    "visual": "how the scene is drawn is the world's business",
    "keyframe": "the scenario says where a car starts",
    "contact": "the world makes the contacts: hulls with hulls and the road, tyres with the road",
    "equality": "a car's joints are moved by its springs and actuators alone",
    "tendon": "give each driven wheel a motor of its own, and each steered wheel a servo",
    "deformable": "a car is made of rigid bodies",
    "extension": "plugins act on the whole world",
}
"""Sections that no car's file may fill, with the reason."""
_IN_BODIES = ("body", "geom", "site", "joint", "inertial", "camera")
_NOT_IN_BODIES = {
    "freejoint": "the world gives a car its free joint",
    "light": "lights are the world's",
    "plugin": "plugins act on the whole world",
}
_COMPILER = {"angle": "radian", "autolimits": "true", "coordinate": "local"}
"""Compiler settings that a car may make, each the world's own."""
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_DELAYS = ("delay", "nsample", "interval")
_OF_THE_WORLD = (
    "user",
    "plugin",
    "clock",
    "e_potential",
    "e_kinetic",
    "contact",
    "distance",
    "normal",
    "fromto",
    "rangefinder",
)
"""Sensors of more than a car."""
_ACTUATORS = (*DRIVE, *STEER, *BRAKE, RESISTANCE)
_REAR_STEERING = [f"steer_{wheel}" for wheel in WHEELS if wheel not in STEERED]
_REMOVE = "remove it"


@dataclass(frozen=True)
class Element:
    """An element of a car's file or of one that it includes.

    Attributes:
        tag: its own.
        attributes: as written.
        path: tags around it, from the section down, itself not among them.
        place: ``file:line``.
        within: name of the element that it stands in.
    """

    tag: str
    attributes: Mapping[str, str]
    path: tuple[str, ...]
    place: str
    within: str = ""

    @property
    def kind(self) -> str:
        """What it is a kind of: an actuator or a sensor, whatever its tag, or its tag."""
        return self.path[0] if self.path and self.path[0] in ("actuator", "sensor") else self.tag

    @property
    def name(self) -> str:
        """Its name, or nothing."""
        return self.attributes.get("name", "")

    @property
    def said(self) -> str:
        """It, as it might stand in the file, without most of its attributes."""
        return f'<{self.tag} name="{self.name}">' if self.name else f"<{self.tag}>"


@dataclass(frozen=True)
class CarFile:
    """A car's MJCF and everything that it includes, element by element.

    Attributes:
        path: of the car's own file.
        elements: all of them, those of included files in place of their includes.
    """

    path: Path
    elements: tuple[Element, ...]

    @classmethod
    def of(cls, folder: Path) -> CarFile:
        """The file of a car by its folder, which has the same name.

        Raises:
            ModelError: it is not there, or cannot be read.
        """
        path = folder / f"{folder.name}.xml"
        if path.is_file():
            return cls.read(path)
        others = " or ".join(sorted(p.name for p in folder.glob("*.xml")))
        if others:
            raise ModelError(f"{path} is missing: a car's MJCF has the name of its folder; rename {others}")
        raise ModelError(f"{path} is missing: `mjmerge new car NAME` writes a folder with all of a car")

    @classmethod
    def read(cls, path: Path) -> CarFile:
        """All elements of a file.

        Raises:
            ModelError: it cannot be read, or includes itself.
        """
        return cls(path, tuple(_elements(path, ())))

    def place(self, kind: str, name: str) -> str:
        """``file:line`` of what has that kind and name, or the file."""
        element = self.named(kind).get(name)
        return element.place if element else str(self.path)

    def named(self, kind: str) -> dict[str, Element]:
        """What is of that kind and has a name, defaults aside."""
        return {e.name: e for e in self.elements if e.kind == kind and e.name and e.path[:1] != ("default",)}

    def findings(self) -> Iterator[Finding]:
        """Everything in it that speaks of more than the car, each with its place and what to do."""
        if not any(e.tag == "compiler" and "angle" in e.attributes for e in self.elements):
            yield Finding(
                "compiler",
                "",
                'no <compiler angle="radian"/>: without it MuJoCo reads every angle in degrees; add it, and '
                "give all angles in radians",
                str(self.path),
            )
        absent = {
            "actuator": [name for name in _ACTUATORS if name not in self.named("actuator")],
            "numeric": [name for name in NUMBERS if name not in self.named("numeric")],
        }
        for element in self.elements:
            for message in (*_infinite(element), *_problems(element, absent)):
                yield Finding(element.kind, element.name, message, element.place)


def _elements(file: Path, above: tuple[Path, ...]) -> Iterator[Element]:
    if file.resolve() in above:
        raise ModelError(f"{above[-1]}: includes {file}, which includes it; remove one of the two")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True, remove_pis=True)
    try:
        root = etree.fromstring(file.read_bytes(), parser)
    except OSError as error:
        by = f"{above[-1]}: includes " if above else ""
        raise ModelError(f"{by}{file}: cannot be read: {error.strerror or error}") from error
    except etree.XMLSyntaxError as error:
        raise ModelError(f"{file}:{error.lineno or 1}: not XML: {error.msg}") from error
    if root.getroottree().docinfo.internalDTD is not None:
        raise ModelError(f"{file}: a document type definition; remove it: MJCF has none")
    for child in root:
        if child.tag == "include":
            yield from _elements(
                Path(normpath(file.parent / child.get("file", ""))), (*above, file.resolve())
            )
        else:
            yield from _inside(child, (), file)


def _inside(element: Any, path: tuple[str, ...], file: Path) -> Iterator[Element]:
    if not isinstance(element.tag, str):
        return  # an entity that was not resolved
    within = element.getparent().get("name", "") if path else ""
    yield Element(element.tag, dict(element.attrib), path, f"{file}:{element.sourceline}", within)
    for child in element:
        yield from _inside(child, (*path, element.tag), file)


def _problems(e: Element, absent: Mapping[str, list[str]]) -> Iterator[str]:
    """What of one element speaks of more than the car."""
    section = e.path[0] if e.path else e.tag
    if section in _WORLDS:
        if len(e.path) < 2 and (e.attributes or (e.path and section not in ("option", "visual"))):
            given = " ".join(f'{name}="{value}"' for name, value in e.attributes.items())
            yield f"<{' '.join(filter(None, (e.tag, given)))}> in a car's file: {_WORLDS[section]}; {_REMOVE}"
    elif section == "compiler":
        yield from _compiler(e)
    elif section == "custom" and e.path:
        if e.tag != "numeric" or e.name not in NUMBERS:
            yield f"{e.said}: not one of the numbers of a car; {_or_rename(e, absent['numeric'])}"
    elif section == "worldbody" and e.path:
        yield from _body(e)
    elif section in ("actuator", "sensor", "default"):
        yield from _acts(e, absent["actuator"])
    elif section == "asset" and (e.tag == "model" or e.attributes.get("type") == "skybox"):
        yield f"{e.said}: not part of a car; {_REMOVE}"


def _infinite(e: Element) -> Iterator[str]:
    """Numbers of an element that are none, or that no computer can hold."""
    for name, value in e.attributes.items():
        try:
            numbers = [float(part) for part in value.split()]
        except ValueError:
            continue
        if not all(map(isfinite, numbers)):
            yield f'{e.said}: {name}="{value}"; expected finite numbers'


def _compiler(e: Element) -> Iterator[str]:
    if e.path:
        yield f"<{e.tag}> in <compiler>: it would hold for the whole world; {_REMOVE}"
        return
    for name, value in e.attributes.items():
        if name == "angle" and value != "radian":
            yield (
                f'<compiler angle="{value}">: write angle="radian", and all angles (euler, axisangle, ranges '
                "and springrefs of hinges) in radians"
            )
        elif name not in _FOLDERS and value != _COMPILER.get(name):
            yield (
                f'<compiler {name}="{value}">: it would hold for the whole world; {_REMOVE} '
                "(each body has its <inertial>, angles are in radians)"
            )


def _body(e: Element) -> Iterator[str]:
    if len(e.path) == 1 and (e.tag, e.name) != ("body", "chassis"):
        yield (
            f"{e.said} stands in the worldbody itself: a car's file has one body there, 'chassis', with all "
            f"of the car in it; move it there, or {_REMOVE}"
        )
    elif e.tag == "freejoint" or (e.tag == "joint" and e.attributes.get("type") == "free"):
        yield f"{e.said}: {_NOT_IN_BODIES['freejoint']}; {_REMOVE}"
    elif e.tag not in _IN_BODIES:
        yield f"{e.said}: {_NOT_IN_BODIES.get(e.tag, 'not part of a car')}; {_REMOVE}"
    elif e.tag == "body":
        for name, none in (("mocap", ("false",)), ("gravcomp", ("0", "0.0"))):
            if e.attributes.get(name, none[0]) not in none:
                yield f'{e.said}: {name}="{e.attributes[name]}": gravity moves all of a car; {_REMOVE}'
    elif e.tag == "joint" and e.path[-1] == "body" and e.path.count("body") == 1:
        yield f"{e.said}: the chassis has no joint, because the world gives a car its free joint; {_REMOVE}"


def _acts(e: Element, absent: list[str]) -> Iterator[str]:
    """Of actuators and sensors, and of the defaults of both."""
    if e.kind == "actuator" and e.name in _REAR_STEERING:
        yield f"{e.said}: only the front wheels of a car steer; {_REMOVE}, and its joint"
    elif e.kind == "actuator" and e.path and e.name not in _ACTUATORS:
        yield f"{e.said}: an actuator that nothing commands; {_or_rename(e, absent)}"
    if e.kind == "sensor" and e.path:
        if e.tag in _OF_THE_WORLD or "world" in (e.attributes.get("objname"), e.attributes.get("refname")):
            yield f"{e.said}: it reads the world, not the car; {_REMOVE}"
        for name in ("cutoff", "noise"):
            if e.name in SENSORS and name in e.attributes:
                yield f"{e.said}: {name}: what a car measures is the scenario's (mismatch); {_REMOVE}"
    if e.path:
        for name in _DELAYS:
            if name in e.attributes:
                yield f"{e.said}: {name}: delays are the scenario's (mismatch.command_delay_s); {_REMOVE}"


def _or_rename(e: Element, absent: list[str]) -> str:
    """What to do about something that is not known by its name."""
    return f"{_REMOVE}, or rename it: {nearest(e.name, absent)}" if absent else _REMOVE
