"""From a file, a name or a mapping to a valid scenario, or to every reason why it is none."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.representer import SafeRepresenter

from mjmerge.config import shipped
from mjmerge.config.document import UNREADABLE, Document, copied, described, is_text, scalar
from mjmerge.config.doors import Code, DoorError, from_outside, located, same, told
from mjmerge.config.explain import unknown
from mjmerge.config.frozen import Frozen
from mjmerge.config.read import file_of, raise_problems, read, validated, validated_part
from mjmerge.drivers import Absent, kinds
from mjmerge.drivers.outside import GROUP, brought
from mjmerge.errors import MjmergeError, ModelError, ScenarioError, UnknownNameError, nearest
from mjmerge.law import AbsentLaw, Sensed, lacking
from mjmerge.law import kinds as laws
from mjmerge.law.asked import rehearse
from mjmerge.law.outside import GROUP as LAWS
from mjmerge.law.outside import brought as law_brought
from mjmerge.roster import in_order
from mjmerge.scenario.cars import sheet_of
from mjmerge.scenario.checks import check
from mjmerge.scenario.metrics import find
from mjmerge.scenario.mismatch import Mismatch
from mjmerge.scenario.ramp import Ramp
from mjmerge.scenario.schema import Models, Scenario
from mjmerge.state import Cars
from mjmerge.traffic.excerpt import MADE, Excerpt, ExcerptError, excerpt
from mjmerge.vehicle.datasheet import DataSheet

Source = str | Path | Mapping[str, Any]


def load(
    source: Source,
    overrides: Sequence[str] = (),
    sheets: tuple[DataSheet, ...] | None = None,
    *,
    code: bool = True,
) -> Scenario:
    """Read and check a scenario.

    Args:
        source: a shipped scenario's name, a path, or a mapping of plain values.
        overrides: ``"law.k_o=0"``, applied in order before anything is checked; values are YAML. A plant on
            which one of them is without effect will refuse to run the scenario.
        sheets: data sheet of each car at its size, where they are known already, from a recording: no model
            is looked for, and no metric.
        code: whether drivers and a law from outside are let in; otherwise they are
            :class:`~mjmerge.drivers.Absent` and :class:`~mjmerge.law.AbsentLaw`, and metrics are not
            looked for.

    Raises:
        ScenarioError: with every problem found, each with its key and line.
        UnknownNameError: there is no scenario of that name.
    """
    _check_texts(overrides)
    if isinstance(source, Mapping):
        document, where, name, near = copied(source), "scenario", "scenario", None
    elif not isinstance(source, str | os.PathLike) or isinstance(source, bytes):
        raise MjmergeError(
            f"expected a scenario's name, path or mapping of keys, got {described(source)}; what is loaded "
            'already is altered by load(name, ["law.k_o=0"])'
        )
    else:
        path = file_of("scenario", source, shipped.scenarios())
        document, where, name, near = read(path), str(path), path.stem, path.parent
        if not is_text(name):
            document.report("the name of the file is not text in UTF-8; rename it", "")
    if isinstance(document.value, dict):
        for text in overrides:
            document.override(text)
        if code:
            _from_traffic(document, near)
        _let_in(document, near, code)
        _law(document, near, code)

    sections: dict[str, Any] = {}
    scenario = validated(Scenario, document, sections)
    if sheets is not None:
        if "initial" in sections:
            sections["sheets"] = dict(zip(sections["initial"].roster.cars, sheets, strict=False))
    elif "models" in sections and "initial" in sections:
        cars = sections["initial"].roster.cars
        sections["models"], read_sheets = _models(sections["models"], cars, near, document)
        if len(read_sheets) == len(cars):
            sections["sheets"] = read_sheets
    codes: list[Code] = []
    if code and sheets is None and "metrics" in sections:  # what a recording names is not ours to run
        sections["metrics"], codes = _metrics(sections["metrics"], near, document)
    for problem in check(sections):
        document.report(problem.message, problem.key)
    if code and "law" in sections:  # who only reads a recording runs no law
        for message in lacking(sections["law"]):
            document.report(message, "law.kind")
    if code and sheets is None:  # what a recording looks for is nobody's to mend
        _searched(sections, document)
    raise_problems(where, document)
    assert scenario is not None, "what is not valid has problems"
    scenario = scenario.model_copy(update={key: sections[key] for key in ("models", "metrics")})
    if code and from_outside(scenario.law.kind):
        _rehearse(scenario, document)
        raise_problems(where, document)
    loaded = scenario.named(name).giving(document.given).with_metric_codes(tuple(codes))
    return loaded if sheets is None else loaded.with_sheets(sheets)


def _searched(sections: Mapping[str, Any], document: Document) -> None:
    """Reports names of a search that are none: of keys, as far as their section is valid, and of axes."""
    space = sections.get("search")
    if space is None:
        return
    unread = {*Scenario.model_fields} - {*sections}
    changed = {key.removesuffix(".kind") for key in document.given}  # of another kind than in the file
    for key in space.axes:
        if not any(key.startswith(f"{section}.") for section in unread | changed):
            message = unknown(Scenario, key, sections)
            if message is not None:
                document.report(message, f"search.axes.{key}")
    for i, name in enumerate(space.leave_out):
        axis = name.removeprefix("mismatch.")
        if axis not in Mismatch.model_fields:
            message = f"no axis of mismatch called {axis!r}: {nearest(axis, Mismatch.model_fields)}"
            document.report(message, f"search.leave_out.{i}")


def _check_texts(given: object) -> None:
    """Refuses overrides that are no ``KEY=VALUE`` texts.

    Raises:
        MjmergeError: with what to pass.
    """
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise MjmergeError(f'overrides are a list of texts, such as ["law.k_o=0"], got {described(given)}')
    for text in given:
        if not isinstance(text, str):
            raise MjmergeError(f'an override is a text, such as "law.k_o=0", got {described(text)}')


def dump(scenario: Scenario) -> str:
    """The scenario as YAML with every default written out; loading it gives an equal scenario.

    But for metrics, a search, the end of a lane and lengths of cars: they are not named where there are none.
    """
    yaml = YAML(typ="safe", pure=True)
    yaml.Representer = _Representer
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # declared as None
    yaml.width = 2**31
    plain = scenario.model_dump(mode="json")
    for asked in ("length_m", "width_m"):
        if not getattr(scenario.models, asked).said:
            del plain["models"][asked]
    for section in (plain, plain["expect"], *plain["gate"]):
        if not section["metrics"]:
            del section["metrics"]
    if plain["search"] is None:
        del plain["search"]
    if plain["road"]["ends_m"] is None:  # which leaves the others at their defaults
        plain["road"] = {"lane_width_m": plain["road"]["lane_width_m"]}
        del plain["expect"]["min_edge_distance_m"]
    text = io.StringIO()
    yaml.dump(plain, text)
    return text.getvalue()


def json_schema(of: type[Frozen] = Scenario) -> str:
    """JSON Schema of scenario files, for editors; ``scenarios/schema.json`` is this text."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema"} | of.model_json_schema()
    recorded = schema.get("$defs", {}).get("Recorded")
    if recorded is not None:  # its points may be written, or named in a file
        part = Excerpt.model_json_schema()
        own = {key: value for key, value in recorded["properties"].items() if key not in MADE}
        named = {"properties": own | part["properties"], "required": ["kind", *part["required"]]}
        schema["$defs"]["Recorded"] = {"anyOf": [recorded, recorded | named]}
    return json.dumps(schema, indent=2) + "\n"


def _from_traffic(document: Document, near: Path | None) -> None:
    """Puts a road user's motion in the place of the keys that name it in a file; problems are reported."""
    drivers = document.value.get("drivers")
    for car in in_order(drivers)[1:] if isinstance(drivers, dict) else ():
        given, where = drivers.get(car), f"drivers.{car}"
        if not isinstance(given, dict) or given.get("kind") != "recorded" or "file" not in given:
            continue
        part = {key: value for key, value in given.items() if key in Excerpt.model_fields}
        both = [key for key in MADE if key in given]
        for key in both:
            document.report("is made from the file: give one of them", f"{where}.{key}")
        found = None if both else validated_part(Excerpt, part, document, where)
        drivers[car] = UNREADABLE
        if found is None:
            continue
        try:
            made = excerpt(found, near)
        except ScenarioError as error:
            document.problems += [replace(p, source=p.source or error.source) for p in error.problems]
        except ExcerptError as error:
            document.report(str(error), f"{where}.{error.key}")
        else:
            drivers[car] = {key: value for key, value in given.items() if key not in part} | made


def _let_in(document: Document, near: Path | None, code: bool) -> None:
    """Puts drivers from outside in the place of their keys; problems are reported."""
    drivers = document.value.get("drivers")
    for car in in_order(drivers)[1:] if isinstance(drivers, dict) else ():
        given = drivers.get(car)
        kind = given.get("kind") if isinstance(given, dict) else None
        if not isinstance(kind, str) or kind in kinds():
            continue
        where = f"drivers.{car}"
        try:
            found = located(kind, near, GROUP) if code else kind
            if not from_outside(found):
                continue
            model = brought(found) if code else Absent
        except DoorError as error:
            document.report(str(error), f"{where}.kind")
            drivers[car] = UNREADABLE
            continue
        drivers[car] = _made(model, given | {"kind": found}, document, where)


def _law(document: Document, near: Path | None, code: bool) -> None:
    """Puts a law from outside in the place of its keys; problems are reported.

    Where the kind was given beside a file, the file's keys that only another law has are left out.
    """
    given = document.value.get("law")
    kind = given.get("kind") if isinstance(given, dict) else None
    if not isinstance(kind, str):
        return
    shipped = laws()
    try:
        found = kind if kind in shipped or not code else located(kind, near, LAWS)
        if kind not in shipped and not from_outside(found):
            return
        model = shipped[kind] if kind in shipped else law_brought(found) if code else AbsentLaw
    except DoorError as error:
        document.report(str(error), "law.kind")
        document.value["law"] = UNREADABLE
        return
    beside = {key.partition(".")[2] for key in document.given if key.startswith("law.")}
    if "kind" in beside:
        given = {key: value for key, value in given.items() if key in beside or key in model.model_fields}
    document.value["law"] = given | {"kind": found}
    if kind not in shipped:
        document.value["law"] = _made(model, given | {"kind": found}, document, "law")


def _made(model: type[Frozen], given: dict[str, Any], document: Document, where: str) -> object:
    """One from outside, or what stands for one that cannot be made; problems are reported."""
    kind = given["kind"]
    try:
        with told(Path(kind.rpartition(":")[0]), f"{kind} cannot be made: "):
            made = validated_part(model, given, document, where)
        return UNREADABLE if made is None else same(made, model, kind)
    except DoorError as error:
        document.report(str(error), f"{where}.kind")
        return UNREADABLE


def _rehearse(scenario: Scenario, document: Document) -> None:
    """Asks a law from outside what it would do at the start; problems are reported."""
    front_m = np.array([[start.front_m for start in scenario.starts]])
    velocity_mps = np.array([[(start.speed_mps, 0.0) for start in scenario.starts]])
    ramp, none = Ramp.of([scenario]), np.zeros((1, front_m.shape[1]))
    cars = Cars(front_m, velocity_mps, none, none, none, none, none)
    seen = Sensed.of(cars, np.zeros((1, 2)), None if ramp is None else ramp.obstacle)
    try:
        rehearse(scenario.law, seen, scenario.initial.opinion, scenario.control_step_s)
    except DoorError as error:
        document.report(str(error), "law.kind")


def _models(
    models: Models, cars: tuple[str, ...], near: Path | None, document: Document
) -> tuple[Models, dict[str, DataSheet]]:
    """The models with their paths made absolute, and their data sheets; problems are reported."""
    names, sheets = {}, {}
    for car in cars:
        name = models.of(car)
        try:
            folder = str(shipped.model_folder(name, near))
            names[car] = name if name in shipped.models() else folder
            sheets[car] = sheet_of(models.model_copy(update={car: names[car]}), car)
        except (ModelError, UnknownNameError) as error:
            document.report(str(error), f"models.{car}")
        except ScenarioError as error:
            document.problems += [replace(p, source=error.source) for p in error.problems]
    return models.model_copy(update=names), sheets


def _metrics(
    names: tuple[str, ...], near: Path | None, document: Document
) -> tuple[tuple[str, ...], list[Code]]:
    """The metrics with the paths of their files made absolute, and their code; problems are reported."""
    located, codes = list(names), []
    for i, name in enumerate(names):
        try:
            metric = find(name, near)
        except MjmergeError as error:
            document.report(str(error), f"metrics.{i}")
        else:
            located[i] = metric.code.name
            codes.append(metric.code)
    return tuple(located), codes


class _Representer(SafeRepresenter):
    """Puts lists of numbers on one line, quotes around all text but plain words, and null in words."""

    def text(self, value: str) -> Any:
        bare = value.isidentifier() and isinstance(scalar(value), str)
        return self.represent_scalar("tag:yaml.org,2002:str", value, style=None if bare else '"')

    def items(self, value: list[Any]) -> Any:
        short = not any(isinstance(item, dict) for item in value)
        return self.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=short)


_Representer.add_representer(str, _Representer.text)
_Representer.add_representer(list, _Representer.items)
