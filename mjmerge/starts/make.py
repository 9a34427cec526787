"""What ``mjmerge new`` writes: a working, commented start that the next command takes as it is.

A kind is one entry of :data:`KINDS`; its texts are in ``mjmerge/starts``, with ``{name}`` for the name.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote

from mjmerge.config import shipped
from mjmerge.config.frozen import Frozen
from mjmerge.config.meanings import meanings
from mjmerge.drivers import kinds
from mjmerge.errors import BadNameError, OutputError
from mjmerge.law import kinds as laws
from mjmerge.outputs import cannot_write, put_new
from mjmerge.scenario.cars import data_sheet
from mjmerge.vehicle.datasheet import DataSheet

_STARTS = Path(__file__).resolve().parent
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}")
_LIKE = "rc"
"""The shipped car that a new one has the numbers of."""


@dataclass(frozen=True)
class Start:
    """A kind of thing to begin with.

    Attributes:
        files: texts of a start by their paths, from its name; the first part of each is what is made.
        taken: names that are shipped, and would be found in place of a new one.
        then: commands that take it as it is, from its place and its name.
    """

    files: Callable[[str], Mapping[str, str]]
    taken: Callable[[], Mapping[str, object]]
    then: Callable[[str, str], Sequence[str]]


def make(kind: str, name: str, into: Path) -> Path:
    """Writes a start, whole or not at all, and never in place of anything.

    Args:
        kind: one of :data:`KINDS`.
        name: what it is to be called.
        into: folder to write it into.

    Returns:
        The folder or file that was made.

    Raises:
        BadNameError: the name cannot be one, or is a shipped one's.
        OutputError: there is something of that name, or it cannot be written.
    """
    start = KINDS[kind]
    if not _NAME.fullmatch(name):
        raise BadNameError(
            f"{name!r} cannot be the name of a {kind}: expected a letter, then letters, digits, _ and -, at "
            "most 64 of them"
        )
    if name in start.taken():
        raise BadNameError(f"{name!r} is a {kind} that mjmerge ships: choose another name")
    files = start.files(name)
    made = into / Path(next(iter(files))).parts[0]
    if made.exists() or made.is_symlink():
        raise OutputError(f"{made} exists, and nothing is overwritten: choose another name")
    try:
        into.mkdir(parents=True, exist_ok=True)
        if [*files] == [made.name]:
            put_new(made, files[made.name])
            return made
        partial = Path(tempfile.mkdtemp(prefix=f".{name}-", dir=into))
        try:
            partial.chmod(0o755)
            for path, text in files.items():
                (partial / Path(path).name).write_text(text, encoding="utf-8")
            partial.rename(made)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise cannot_write(made, error) from error
    return made


def sheet_text(sheet: DataSheet) -> str:
    """A data sheet as YAML, every key with its meaning and unit above it."""
    lines = [
        "# What is believed of this car: all that the law and the actuation know of it. README.md says where"
    ]
    lines += ["# each number comes from. Quantities are in SI units, and the unit is in the key."]
    meaning = meanings(DataSheet)
    for name, field in DataSheet.model_fields.items():
        optional = "" if field.is_required() else f" May be left out: {_value(field.default)}."
        lines += ["", *(f"# {line}" for line in meaning.get(name, "").splitlines())]
        lines[-1] += optional
        lines.append(f"{name}: {_value(getattr(sheet, name))}")
    return "\n".join(lines) + "\n"


def _value(value: object) -> str:
    """A value of a data sheet as YAML."""
    if isinstance(value, Frozen):
        inside = (f"{name}: {_value(getattr(value, name))}" for name in type(value).model_fields)
        return "{" + ", ".join(inside) + "}"
    return "null" if value is None else f"{value:.12g}" if isinstance(value, float) else str(value)


def _text(file: str, name: str) -> str:
    text = (_STARTS / file).read_text(encoding="utf-8")
    named = text.replace("{name}", name).replace("{Class}", class_of(name))
    return named.replace("{name_}", _function_of(name))


def class_of(name: str) -> str:
    """The name of a class: ``very_late`` becomes ``VeryLate``."""
    return "".join(part[:1].upper() + part[1:] for part in re.split("[_-]", name))


def _function_of(name: str) -> str:
    return name.replace("-", "_")


def _measures(place: str, name: str) -> list[str]:
    """The command that has a new metric measured."""
    given = f'metrics=["{place}:{_function_of(name)}"]'
    return [f"mjmerge run charge --set {quote(given)}"]


def _drives(place: str, name: str) -> list[str]:
    """The command that lets a new driver drive."""
    given = f'drivers.vehicle_2={{kind: "{place}:{class_of(name)}"}}'
    return [f"mjmerge run charge --set {quote(given)}"]


def _rules(place: str, name: str) -> list[str]:
    """The command that has the ego driven by a new law."""
    given = f'law.kind="{place}:{_function_of(name)}"'
    return [f"mjmerge run charge --set {quote(given)}"]


def _car(name: str) -> dict[str, str]:
    like = data_sheet(_LIKE).model_copy(update={"description": f"{name}, a car of one's own"})
    return {
        f"{name}/README.md": _text("car.md", name),
        f"{name}/datasheet.yaml": sheet_text(like),
        f"{name}/{name}.xml": _text("car.xml", name),
        f"{name}/parts.xml": (shipped.folder("models") / "parts" / "car.xml").read_text(encoding="utf-8"),
    }


KINDS = {
    "car": Start(
        _car,
        shipped.models,
        lambda place, _: [
            f"mjmerge identify {quote(place)}",
            f"mjmerge run paper --set {quote(f'models.ego={place}')}",
        ],
    ),
    "driver": Start(lambda name: {f"{name}.py": _text("driver.txt", name)}, kinds, _drives),
    "law": Start(lambda name: {f"{name}.py": _text("law.txt", name)}, laws, _rules),
    "metric": Start(lambda name: {f"{name}.py": _text("metric.txt", name)}, dict, _measures),
    "scenario": Start(
        lambda name: {f"{name}.yaml": _text("scenario.yaml", name)},
        shipped.scenarios,
        lambda place, _: [f"mjmerge run {quote(place)}", f"mjmerge check {quote(place)} --update"],
    ),
    "campaign": Start(
        lambda name: {f"{name}.yaml": _text("campaign.yaml", name)},
        shipped.campaigns,
        lambda place, _: [f"mjmerge sweep {quote(place)}"],
    ),
}
"""What ``mjmerge new`` can write."""
