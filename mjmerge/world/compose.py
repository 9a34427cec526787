"""One MJCF world from a scenario: a road and its cars, composed with ``dm_control.mjcf``.

Only this room knows dm_control. What a car's MJCF must hold, and what it must not, is checked before
(``checks/file.py``) and after it is compiled (``checks/frame.py`` and those beside), and the compiled world
is compared with the one without cars (``checks/options.py``), because dm_control merges a car's options into
it.
"""

from __future__ import annotations

import copy
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import combinations
from math import ceil
from pathlib import Path
from typing import Any

import mujoco

from mjmerge.config import shipped
from mjmerge.errors import ModelError
from mjmerge.roster import WHEELS, paint
from mjmerge.scenario.cars import data_sheet
from mjmerge.scenario.mismatch import Mismatch, Tyre
from mjmerge.scenario.schema import Scenario
from mjmerge.vehicle.datasheet import DataSheet
from mjmerge.vehicle.delay import asked_s, steps_late
from mjmerge.world.checks import controls as car_controls
from mjmerge.world.checks import frame as car_checks
from mjmerge.world.checks import joints as car_joints
from mjmerge.world.checks import names as car_names
from mjmerge.world.checks import sizes as car_sizes
from mjmerge.world.checks.car import Car
from mjmerge.world.checks.file import CarFile
from mjmerge.world.checks.findings import Finding, told
from mjmerge.world.checks.options import differences
from mjmerge.world.checks.parts import BRAKE, DRIVE, STEER
from mjmerge.world.contained import contained
from mjmerge.world.model import HARDEST, IMPRATIO, LONGEST_STEP_S, World, moving
from mjmerge.world.road import Line, mark, markings
from mjmerge.world.stretch import stretched

with warnings.catch_warnings():  # dm_control looks for a window on import, and warns where there is none
    warnings.filterwarnings("ignore", module="glfw")
    from dm_control import mjcf


_CLEARANCE_CUTOFF_M = 100.0
_ROOM_S = 0.1  # delays of several simulations are kept room for in whole ones of these
_LINE = re.compile(r", (id \d+, )?line \d+")


def build(scenario: Scenario, mismatch: Sequence[Mismatch] | None = None) -> World:
    """Composes and compiles the world of a scenario.

    Args:
        scenario: its models, steps and road.
        mismatch: what will be different in the simulations of this world; by default the scenario's.

    One world serves them all: what differs from one to the next is set by the plant. That of several has room
    for some more delay than they ask for, and serves others like them.

    Raises:
        ModelError: a car model lacks something, or the composition lost an option.
    """
    mismatch = mismatch or (scenario.mismatch,)
    delay_s, several = max(m.command_delay_s for m in mismatch), len(set(mismatch)) > 1
    return _made(
        dict(zip(scenario.roster.cars, scenario.car_models, strict=True)),
        tuple(markings(scenario)),
        {"ego": ceil(delay_s / _ROOM_S) * _ROOM_S if several else delay_s},
        sizes=tuple(_sizes(scenario)),
        friction=1.0 if several else mismatch[0].friction,
        tyres="slip" if any(m.tyres == "slip" for m in mismatch) else "ideal",
        physics_step_s=scenario.physics_step_s,
        substeps=scenario.substeps,
    )


def _sizes(scenario: Scenario) -> Iterator[tuple[str, float | None, float | None]]:
    """Length and width that are asked of each car for which they are, m, where cars have their own size."""
    models = scenario.models
    for car in scenario.roster.cars:
        length_m, width_m = models.length_m.of(car), models.width_m.of(car)
        if length_m is not None or width_m is not None:
            size = models.size
            yield car, length_m and length_m / size, width_m and width_m / size


def single(model: str, *, delays_s: Mapping[str, float] | None = None, **options: Any) -> World:
    """One car, called ``ego``, alone on a plane; the options are those of :func:`compose`."""
    return _made({"ego": model}, (), delays_s or {}, **options)


def _made(
    models: Mapping[str, str], lines: tuple[Line, ...], delays_s: Mapping[str, float], **options: Any
) -> World:
    """A world, composed or kept; a car of somebody's own may be of any files, and is read every time."""
    known = set(models.values()) <= set(shipped.models())
    make, files = (_kept, shipped.cars()) if known else (_kept.__wrapped__, ())
    world = make(files, tuple(models.items()), lines, tuple(delays_s.items()), **options)
    return replace(world, model=copy.copy(world.model))  # who gets it may change it


@lru_cache(maxsize=16)  # of 0.2 MB; composing one takes as long as 2 s of driving in it
def _kept(
    files: tuple[tuple[Path, bytes], ...],
    models: tuple[tuple[str, str], ...],
    lines: tuple[Line, ...],
    delays_s: tuple[tuple[str, float], ...],
    **options: Any,
) -> World:
    """The world of all that is given, once; by the content of its files, so that a change is seen."""
    del files
    return compose(dict(models), delays_s=dict(delays_s), draw=lambda root: mark(root, lines), **options)


def compose(
    models: Mapping[str, str],
    *,
    friction: float = 1.0,
    tyres: Tyre = "slip",
    delays_s: Mapping[str, float] | None = None,
    sizes: Sequence[tuple[str, float | None, float | None]] = (),
    physics_step_s: float = 0.001,
    substeps: int = 1,
    draw: Callable[[mjcf.RootElement], None] | None = None,
) -> World:
    """Composes and compiles a world of cars on a plane.

    Args:
        models: car model of each car, by the car's name.
        friction: between all tyres and the road, 1.
        tyres: whether they slip.
        delays_s: longest dead time of the commands of a car, s, by its name; see ``vehicle/delay.py``.
        sizes: cars that are of another length or width than their models, and both, m, ``None`` for its own.
        physics_step_s: time step, s.
        substeps: time steps of a control step, over which the forces between the cars are kept.
        draw: adds to the picture of the road.

    Raises:
        ModelError: a car model lacks something, the step is too long, or the composition lost an option.
    """
    if tyres == "slip" and physics_step_s > LONGEST_STEP_S:
        raise ModelError(
            f"physics_step_s is {physics_step_s}; tyres that slip need {LONGEST_STEP_S} or less "
            "(mismatch.tyres: ideal needs no such bound)"
        )
    root = mjcf.RootElement(model="mjmerge")
    root.compiler.angle = "radian"
    root.compiler.autolimits = True
    root.option.timestep = physics_step_s
    root.option.integrator = "implicitfast"
    root.option.cone = "elliptic"
    root.option.impratio = IMPRATIO
    root.option.flag.autoreset = "disable"  # an unstable run stops; it does not start again at t = 0
    root.visual.headlight.ambient = (0.35, 0.35, 0.35)
    ground = root.worldbody
    ground.add("light", name="sun", pos=(0, -4, 8), dir=(0, 0.4, -1), type="directional", castshadow=True)
    grey = (0.32, 0.33, 0.35, 1)
    ground.add("geom", name="road", type="plane", size=(0, 0, 1), rgba=grey, contype=0, conaffinity=1)
    sheets = tuple(data_sheet(name) for name in models.values())
    length = max(sheet.length_m for sheet in sheets)
    root.statistic.extent = 7.0 * length
    root.statistic.center = (0.0, 0.0, 0.35 * length)
    without_cars = mujoco.MjModel.from_xml_string(root.to_xml_string())
    if draw is not None:
        draw(root)

    files = {}
    for (car, name), sheet in zip(models.items(), sheets, strict=True):
        delay_s = (delays_s or {}).get(car, 0.0)
        files[car] = _add_car(root, car, shipped.model_folder(name), sheet, friction, delay_s)
    cars = tuple(models)
    for a, b in combinations(cars, 2):
        root.sensor.add(
            "distance",
            name=f"clearance_{a}_{b}",
            geom1=f"{a}/hull",
            geom2=f"{b}/hull",
            cutoff=_CLEARANCE_CUTOFF_M,
        )
        root.sensor.add(
            "contact",
            name=f"contact_{a}_{b}",
            geom1=f"{a}/hull",
            geom2=f"{b}/hull",
            reduce="netforce",
            data="force pos",
            nsample=substeps,
        )

    try:
        xml = contained(root.to_xml_string(), root.get_assets())
        model = mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise ModelError(_why(error, files)) from error
    asked = {
        "timestep": physics_step_s,
        "integrator": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
        "cone": mujoco.mjtCone.mjCONE_ELLIPTIC,
        "impratio": IMPRATIO,
        "disableflags": mujoco.mjtDisableBit.mjDSBL_AUTORESET,
    }
    _check_model(model, list(differences(model, without_cars, asked, cars)), files, sheets)
    if sizes:  # what is stretched has been checked as it comes
        of = dict(zip(cars, sheets, strict=True))
        made = {car: of[car].stretched(length_m, width_m) for car, length_m, width_m in sizes}
        ways = {c: (s.length_m / of[c].length_m, s.width_m / of[c].width_m) for c, s in made.items()}
        xml, sheets = stretched(xml, ways), tuple((of | made).values())
    return World(moving(xml), xml, cars, sheets, tyres)


def attached(model: mujoco.MjModel, xml: str, sheets: Sequence[DataSheet], scenario: Scenario) -> World:
    """The world of a scenario as a recording holds it, compiled: nothing of its cars is read from elsewhere.

    Args:
        model: the compiled world.
        xml: the MJCF it was compiled from.
        sheets: data sheet of each car.
        scenario: who is in it, whether tyres slip, and the time step that it must have.

    Raises:
        ModelError: a car in it is not what its data sheet says, or lacks something.
    """
    cars, physics_step_s = scenario.roster.cars, scenario.physics_step_s
    if model.opt.timestep != physics_step_s:
        raise ModelError(f"its world has time steps of {model.opt.timestep:g} s, not {physics_step_s:g} s")
    findings: list[Finding] = []
    resized = {car for car, _, _ in _sizes(scenario)}
    for car, sheet in zip(cars, sheets, strict=True):
        one = Car(model, car, sheet, stretched=car in resized)
        try:
            for check in (car_checks, car_joints, car_controls, car_sizes):
                findings += check.findings(one)
        except KeyError as error:  # in words of MuJoCo's that list every name there is
            lacks = str(error.args[0]).partition(". ")[0]
            raise ModelError(f"its world lacks something of {car}: {lacks}") from error
    if problems := told(findings):
        raise ModelError("; ".join(problems))
    return World(moving(xml), xml, cars, tuple(sheets), scenario.mismatch.tyres)


def _why(error: ValueError, files: Mapping[str, CarFile]) -> str:
    """Why a world does not compile: the error of a car's own file, with its line, or else the world's."""
    for file in files.values():
        try:
            mujoco.MjModel.from_xml_path(str(file.path))
        except ValueError as own:
            return f"{file.path}: {_one_line(own)}"
    said = _LINE.sub("", _one_line(error))  # a line of the world's own file
    for car, file in files.items():
        if f"'{car}/" in said:
            return f"{file.path}: {said.replace(f'{car}/', '')}"
    return f"the composed world does not compile: {said}"


def _one_line(error: Exception) -> str:
    return "; ".join(line.strip() for line in str(error).splitlines() if line.strip())


def _add_car(
    root: mjcf.RootElement, car: str, folder: Path, sheet: DataSheet, friction: float, delay_s: float
) -> CarFile:
    """Attaches a car under its role's name, paints it, frees it, and lets its tyres touch the road."""
    model, file = _load_car(folder, sheet)
    model.model = car
    model.find("material", "paint").rgba = (*paint(car), 1)
    frame = root.attach(model)
    frame.add("freejoint", name="free")
    for wheel in WHEELS:
        root.contact.add(
            "pair",
            name=f"{car}_road_{wheel}",
            geom1="road",
            geom2=model.find("geom", f"tyre_{wheel}"),
            condim=3,
            friction=(friction, friction, 0.005, 1e-4, 1e-4),
            solref=(0.01, 1.0),
            solreffriction=(-1.0, -1 / root.option.timestep),
            solimp=(HARDEST, HARDEST, 0.001, 0.5, 2.0),
        )
        spin = model.find("joint", f"spin_{wheel}")  # its dry friction is the brake of a car that stands
        spin.solreffriction = (-1.0, -1 / root.option.timestep)
        spin.solimpfriction = (HARDEST, HARDEST, 0.001, 0.5, 2.0)
    late = int(steps_late(delay_s, root.option.timestep))
    if late > 0:
        for name in DRIVE + STEER + BRAKE:
            actuator = model.find("actuator", name)
            if actuator is not None:
                actuator.nsample = late
                if name not in BRAKE:  # a brake is a damper here: the plant delays its torque
                    actuator.delay = float(asked_s(late, root.option.timestep))
    return file


def _load_car(folder: Path, sheet: DataSheet) -> tuple[mjcf.RootElement, CarFile]:
    """A car's MJCF, checked for everything that is asked of it by name and for what it must not say.

    Raises:
        ModelError: it does not parse, or something is missing or too much; all of it is named.
    """
    file = CarFile.of(folder)
    if problems := car_names.problems(file, sheet):
        raise ModelError("\n".join(problems))
    try:
        model = mjcf.from_path(str(file.path))
    except (OSError, ValueError, KeyError, AttributeError, OverflowError, SyntaxError) as error:  # lxml's
        raise ModelError(f"{file.path}: {_one_line(error)}") from error
    return model, file


def _check_model(
    model: mujoco.MjModel, problems: list[str], files: Mapping[str, CarFile], sheets: Sequence[DataSheet]
) -> None:
    """Raises ModelError where the compiled world has problems, or a car in it is not what it must be."""
    findings: list[Finding] = []
    for (car, file), sheet in zip(files.items(), sheets, strict=True):
        one = Car(model, car, sheet)
        for check in (car_checks, car_joints, car_controls, car_sizes):
            findings += [replace(f, place=file.place(f.kind, f.name)) for f in check.findings(one)]
    if problems := [*problems, *told(findings)]:
        raise ModelError("\n".join(problems))
