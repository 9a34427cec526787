"""Where the shipped models and scenarios are: beside the package in a wheel, above it in a checkout."""

from __future__ import annotations

import os
from pathlib import Path

from mjmerge.errors import ModelError, UnknownNameError

_PACKAGE = Path(__file__).resolve().parents[1]


def folder(kind: str) -> Path:
    """Folder of the shipped ``"models"`` or ``"scenarios"``."""
    packed = _PACKAGE / "_share" / kind
    return packed if packed.is_dir() else _PACKAGE.parent / kind


def scenarios() -> dict[str, Path]:
    """Shipped scenarios, name to file."""
    return {p.stem: p for p in sorted(folder("scenarios").glob("*.yaml"))}


def campaigns() -> dict[str, Path]:
    """Shipped campaigns, name to file."""
    return {p.stem: p for p in sorted((folder("scenarios") / "campaigns").glob("*.yaml"))}


def models() -> dict[str, Path]:
    """Shipped car models, name to folder."""
    return {p.parent.name: p.parent for p in sorted(folder("models").glob("*/datasheet.yaml"))}


def cars() -> tuple[tuple[Path, bytes], ...]:
    """What the shipped car models are made from, every file and its content."""
    files = [p for p in sorted(folder("models").rglob("*")) if p.suffix in (".xml", ".yaml")]
    return tuple((path, path.read_bytes()) for path in files)


def model_folder(name: str, near: Path | None = None) -> Path:
    """Folder of a car model.

    Args:
        name: a shipped model's name, or the path of a folder of the same form.
        near: where a relative path is looked for first, before the current folder.

    Raises:
        ModelError: there is something, but it is no car's folder.
        UnknownNameError: there is neither.
    """
    shipped = models()
    if name in shipped:
        return shipped[name]
    places = ([near / name] if near else []) + [Path(name)]
    for path in places:
        if os.path.isfile(path / "datasheet.yaml"):  # noqa: PTH113 (Path's raises where a name is too long)
            return path.resolve()
    for path in places:
        if os.path.isdir(path):  # noqa: PTH112
            raise ModelError(
                f"{path}: no datasheet.yaml in it, which says what is believed of a car; "
                "`mjmerge new car NAME` writes one to fill in, docs/your-car.md says how"
            )
        if os.path.isfile(path):  # noqa: PTH113
            raise ModelError(f"{path} is a file; a car model is given by its folder, {path.parent}")
    raise UnknownNameError("car model", name, shipped)
