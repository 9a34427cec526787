"""Whether everything that a car must have is in its file by name, and nothing that a car must not say."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from mjmerge.errors import nearest
from mjmerge.roster import WHEELS
from mjmerge.vehicle.datasheet import DataSheet
from mjmerge.world.checks.file import CarFile
from mjmerge.world.checks.findings import Finding, listed, told
from mjmerge.world.checks.parts import DRIVE, DRIVEN, NUMBERS, names

MOST_MISSING = 8
"""Names that are missing and told one by one; of more, kind by kind."""
CONTRACT = "docs/your-car.md says what each is, and `mjmerge new car NAME` writes a car that has them all"


def problems(file: CarFile, sheet: DataSheet) -> list[str]:
    """Every reason, line by line, why a file is not that of a car.

    Of a file that has less than half of the names, only this is said: it is another thing, or an early draft.
    """
    wanted = names(sheet.drive)
    there = {kind: file.named(kind) for kind, _ in wanted}
    missing = [(kind, name) for kind, name in wanted if name not in there[kind]]
    if 2 * len(missing) > len(wanted):
        return [_not_a_car(file, len(missing), len(wanted))]
    if len(missing) > MOST_MISSING:
        lines = [f"{file.path}: {_by_kind(missing)} are missing; {CONTRACT}"]
    else:
        lines = [
            f"{file.path}: no {k} called {n!r}; {nearest(n, _spare(there[k], wanted))}" for k, n in missing
        ]
    return lines + told([*file.findings(), *_others(file, sheet)])


def _spare(there: Iterable[str], wanted: list[tuple[str, str]]) -> list[str]:
    """Names of what is there and is not wanted as it is: what might be renamed."""
    taken = {name for _, name in wanted}
    return [name for name in there if name not in taken]


def _not_a_car(file: CarFile, missing: int, wanted: int) -> str:
    has = [f"{len(file.named(kind))} {kind}s" for kind in ("joint", "actuator")]
    bodies = listed(file.named("body"))
    return (
        f"{file.path}: not a car that mjmerge can drive: {missing} of the {wanted} names that every car has "
        f"are missing (it has the bodies {bodies or 'that have no name'}, {' and '.join(has)}); {CONTRACT}"
    )


def _by_kind(missing: list[tuple[str, str]]) -> str:
    """``geom tyre_front_left, tyre_rear_left; joint …``."""
    kinds = dict.fromkeys(kind for kind, _ in missing)
    return "; ".join(f"{kind} " + ", ".join(n for k, n in missing if k == kind) for kind in kinds)


def _others(file: CarFile, sheet: DataSheet) -> Iterator[Finding]:
    """What is there, but not as it is expected by name."""
    motors, numbers = file.named("actuator"), file.named("numeric")
    for name in (DRIVE[i] for i in range(len(WHEELS)) if i not in DRIVEN[sheet.drive]):
        if name in motors:
            message = f"there is a motor {name!r}, but datasheet.yaml says drive: {sheet.drive}"
            yield Finding("actuator", name, message, motors[name].place)
    for name, count in NUMBERS.items():
        if name not in numbers:
            continue
        text = numbers[name].attributes.get("data", "")
        given = [_number(part) for part in text.split()]
        if len(given) != count or not all(value >= 0 for value in given):
            expected = "one number that is" if count == 1 else f"{count} numbers that are"
            message = f"numeric {name!r} is {text!r}; expected {expected} not negative"
            yield Finding("numeric", name, message, numbers[name].place)
    for element in file.elements:
        if element.kind == "inertial" and element.within:
            mass = element.attributes.get("mass", "0")
            if not _number(mass) > 0:
                message = f"body {element.within!r} has a mass of {mass}; expected above 0 kg"
                yield Finding("body", element.within, message, element.place)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
