"""Doors: what somebody brings from outside, named in a file that people write.

``mine.py:Name`` is in a file (beside the one that names it, or in the current folder),
``package.module:Name`` is on the import path, and a name without a colon is an entry point of an installed
package. It is code, and is run when it is read: so nothing that comes out of a recording is ever let in here
by itself.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from hashlib import sha256
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic import (
    BaseModel,
    GetJsonSchemaHandler,
    SerializationInfo,
    ValidationError,
    ValidatorFunctionWrapHandler,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from mjmerge.config.meanings import meanings
from mjmerge.errors import MjmergeError, nearest

LARGEST_CODE_BYTES = 1_000_000
"""Of a file of code that is brought."""
_TERMINATED = 128 + signal.SIGTERM
"""What a command exits with that is told to end: by an exception, wherever it is."""
_OURS = "mjmerge."
"""What the modules begin with that are shipped."""
_PYDANTIC = ("model_config", "model_post_init", "_abc_impl", "__init__", "__new__")
"""What pydantic has in each class, or lets it have."""
_SPECIAL = frozenset(
    name for name in dir(BaseModel) if name.startswith("__") and callable(getattr(BaseModel, name, None))
)
"""What it has that Python calls by itself: to compare, to copy, to print."""
_PREFIX = "mjmerge_outside_"
"""Of the modules that files become: the rest is the path, so that worker processes find it again."""


class OrOutside:
    """Says in the JSON Schema of something told apart by its ``kind`` that there is more than is shipped."""

    def __init__(self, what: str) -> None:
        """Args: what it is, in a word."""
        self._what = what

    def __get_pydantic_json_schema__(
        self, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """See pydantic."""
        said = f"A {self._what} from outside: file.py:Name or package.module:Name, and its own keys."
        kind = {"type": "string", "pattern": ":"}
        other = {"description": said, "type": "object", "properties": {"kind": kind}, "required": ["kind"]}
        return {"anyOf": [handler(core), other]}


class DoorError(MjmergeError):
    """What was named is not there, or is not what it must be."""


@dataclass(frozen=True)
class Code:
    """The text that something from outside was read from, as a recording carries it.

    Attributes:
        name: as it was named, with the whole path of a file.
        source: the text of its file, of that alone.
        sha256: digest of that text in UTF-8.
    """

    name: str
    source: str
    sha256: str


def from_outside(name: object) -> bool:
    """Whether a name is one of a file or of a module: has a colon."""
    return isinstance(name, str) and ":" in name


def installed(group: str) -> dict[str, str]:
    """Names of a group's entry points, and what they stand for, ``package.module:Name``."""
    return {point.name: point.value for point in entry_points(group=group)}


def located(name: str, near: Path | None, group: str) -> str:
    """The same name with the whole path of its file, which then means the same everywhere.

    Args:
        name: as somebody wrote it.
        near: folder where a file is looked for first, before the current one.
        group: of entry points, such as ``mjmerge.drivers``.

    Raises:
        DoorError: there is no such file.
    """
    place, colon, what = name.rpartition(":")
    if not colon:
        return installed(group).get(name, name)
    if not place.endswith(".py"):
        return name
    places = [folder / place for folder in (near, Path()) if folder is not None]
    for path in places:
        if os.path.isfile(path):  # noqa: PTH113 (a name may be too long)
            return f"{Path(os.path.abspath(path))}:{what}"  # noqa: PTH100 (resolve() follows links)
    raise DoorError(f"there is no file {place[:200]}, neither beside the file that names it nor here")


def resolve(name: str) -> Any:
    """What a located name stands for.

    Args:
        name: ``/whole/path/mine.py:Name`` or ``package.module:Name``.

    Raises:
        DoorError: there is nothing of that name, or its code does not run.
    """
    place, _, what = name.rpartition(":")
    return _named(what, place, _of_file(Path(place)) if place.endswith(".py") else _of_path(place))


def let_in_before(name: str) -> Any:
    """The same, but nothing is read and nothing is run: only what this process has let in already.

    Raises:
        DoorError: it has not.
    """
    place, _, what = name.rpartition(":")
    module = sys.modules.get(_PREFIX + os.fsencode(place).hex() if place.endswith(".py") else place)
    if module is None:
        raise DoorError(f"{name} has not been let in: load the scenario that names it")
    return _named(what, place, module)


def admitted(
    value: Any,
    shipped: ValidatorFunctionWrapHandler,
    base: type[BaseModel],
    checked: Callable[[str, Any], type[BaseModel]],
) -> Any:
    """Validates what is told apart by its ``kind``: one from outside by its own class, others as shipped.

    Nothing is run here: what has not been let in by whoever loads a scenario stays outside.

    Args:
        value: what a file or somebody has.
        shipped: validates it if it is shipped.
        base: the class of all of them.
        checked: makes a class of what was found under a located name, or raises a :class:`DoorError`.
    """
    if isinstance(value, base):
        return value
    kind = value.get("kind") if isinstance(value, Mapping) else None
    if not from_outside(kind):
        return shipped(value)
    place, _, _ = str(kind).rpartition(":")
    try:
        model = checked(str(kind), let_in_before(str(kind)))
        with told(Path(place), f"{kind} cannot be made: ", let=(ValidationError,)):
            made = model.model_validate(value)
        return same(made, model, str(kind))
    except DoorError as error:
        raise ValueError(str(error)) from error


def same(made: Any, model: type[BaseModel], kind: str) -> Any:
    """What was made of a class from outside, if it is that.

    Raises:
        DoorError: it is something else, or says that it is of another kind.
    """
    if type(made) is not model or made.__dict__.get("kind") != kind:
        raise DoorError(f"{kind} cannot be made: what comes of its keys is another thing")
    return made


def keeps(kind: str, found: type[BaseModel], base: type[BaseModel], own: frozenset[str]) -> None:
    """Refuses a class from outside that replaces what its base has for others to rely on.

    Args:
        kind: its located name.
        found: the class.
        base: what it is derived from; its fields stay what they are.
        own: what of the base a class is there to say for itself.

    Raises:
        DoorError: it replaces something else.
    """
    what = base.__name__.lower()
    theirs = [
        one for one in found.__mro__[: found.__mro__.index(base)] if not one.__module__.startswith(_OURS)
    ]
    for one in theirs:
        for name in (*vars(one), *vars(one).get("__annotations__", ())):
            ours = name in _SPECIAL if name.startswith("__") else hasattr(base, name)
            if name == "__hash__":  # pydantic gives each class one
                ours = not getattr(one.__hash__, "__module__", "").startswith("pydantic")
            if ours and name not in (*own, *_PYDANTIC, *base.model_fields):
                raise DoorError(f"{kind}: {name} is not for a {what} to say; call it otherwise")
    fields = base.model_fields
    redeclared = {name for one in theirs for name in vars(one).get("__annotations__", ())} & {*fields}
    means, ours_mean = (meanings(found), meanings(base)) if redeclared - {"kind"} else ({}, {})
    for name, field in found.model_fields.items():
        same_text = means.get(name) == ours_mean.get(name)
        if name in fields and name != "kind" and not (same_text and repr(field) == repr(fields[name])):
            raise DoorError(f"{kind}: {name} is a key of every {what}; call it otherwise")
        if name not in fields and hasattr(base, name):
            raise DoorError(f"{kind}: {name} can be no key of a {what}; call it otherwise")


def as_mapping(value: Any, info: SerializationInfo) -> Any:
    """The keys of what has a ``kind``, whatever its class; what is none stays as it is, to be told."""
    return value.model_dump(mode=info.mode, warnings=False) if isinstance(value, BaseModel) else value


def _named(what: str, place: str, module: ModuleType) -> Any:
    """What is called so in a module.

    Raises:
        DoorError: nothing is.
    """
    found: Any = module
    try:
        for part in what.split("."):
            found = getattr(found, part)
    except AttributeError:
        names = [n for n in vars(module) if not n.startswith("_")]
        raise DoorError(f"{place} has no {what!r}: {nearest(what, names)}") from None
    return found


def code_of(name: str) -> Code:
    """The text of the file that a located name stands in.

    Raises:
        DoorError: it cannot be read.
    """
    place, _, _ = name.rpartition(":")
    if place.endswith(".py"):
        path = Path(place)
    else:
        spec = importlib.util.find_spec(place)
        path = Path(spec.origin) if spec is not None and spec.origin else Path(place)
    data = _read(path)
    return Code(name, data.decode("utf-8", errors="replace"), sha256(data).hexdigest())


def let_in() -> dict[str, str]:
    """Of each file that this process has let in, its text as it was then, by path."""
    ours = [(name, module) for name, module in [*sys.modules.items()] if name.startswith(_PREFIX)]
    return {
        os.fsdecode(bytes.fromhex(name.removeprefix(_PREFIX))): module.__source__.decode(*_TEXT)
        for name, module in ours
        if hasattr(module, "__source__")  # or it is being read at this moment
    }


def carry(texts: Mapping[str, str]) -> None:
    """Brings the text of files that this machine may not have; these count, whatever is there.

    Raises:
        DoorError: it takes the place of another, and does not run.
    """
    for path, text in texts.items():
        data, there = text.encode(*_TEXT), sys.modules.get(_PREFIX + os.fsencode(path).hex())
        if getattr(there, "__source__", None) != data:
            _carried[path] = data
            if there is not None:
                _of_file(Path(path))


_TEXT = ("utf-8", "surrogateescape")
_carried: dict[str, bytes] = {}


def _read(path: Path) -> bytes:
    if str(path) in _carried:
        return _carried[str(path)]
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_CODE_BYTES + 1)
    except OSError as error:
        raise DoorError(f"cannot read {path}: {error.strerror}") from error
    if len(data) > LARGEST_CODE_BYTES:
        raise DoorError(f"{path} has more than {LARGEST_CODE_BYTES / 1e6:g} MB: is it code?")
    return data


def _of_file(path: Path) -> ModuleType:
    """A file as a module; read again if it has changed."""
    name, data = _PREFIX + os.fsencode(path).hex(), _read(path)
    there = sys.modules.get(name)
    if there is not None and getattr(there, "__source__", None) == data:
        return there
    sys.modules.pop(name, None)
    with told(path):
        return importlib.import_module(name)


def _of_path(name: str) -> ModuleType:
    """A module on the import path."""
    try:
        known = importlib.util.find_spec(name) is not None
    except (ImportError, ValueError, AttributeError):
        known = False
    if not known:
        raise DoorError(f"there is no module called {name[:200]!r} on the import path; a file ends with .py")
    with told(None):
        return importlib.import_module(name)


@contextmanager
def told(path: Path | None, what: str = "", let: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Whatever code from outside raises is said with the line of its file where it was raised.

    What it prints goes to standard error: standard output is the command's own.

    Args:
        path: the file; ``None`` where only the error can be said.
        what: the code, as the start of the message.
        let: what it may raise.

    Raises:
        DoorError: it raised something else.
    """
    try:
        with redirect_stdout(sys.stderr):
            yield
    except DoorError:
        raise
    except SyntaxError as error:
        raise DoorError(f"{what}{error.filename}, line {error.lineno}: {error.msg}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        if isinstance(error, let) or (isinstance(error, SystemExit) and error.code == _TERMINATED):
            raise  # the latter is from outside, but not of that code
        spot, trace = "", error.__traceback__
        while trace is not None:
            file = trace.tb_frame.f_code.co_filename
            if path is not None and file == str(path):
                spot = f"{file}, line {trace.tb_lineno}: "
            trace = trace.tb_next
        said = (str(error).splitlines() or [""])[0]
        raise DoorError(f"{what}{spot}{type(error).__name__}" + (f": {said}" if said else "")) from error


class _Files(MetaPathFinder, Loader):
    """Imports the modules that files from outside become, in worker processes too."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """See ``importlib``."""
        del path, target
        if not fullname.startswith(_PREFIX):
            return None
        file = os.fsdecode(bytes.fromhex(fullname.removeprefix(_PREFIX)))
        return ModuleSpec(fullname, self, origin=file)

    def create_module(self, spec: ModuleSpec) -> None:
        """See ``importlib``."""
        del spec

    def exec_module(self, module: ModuleType) -> None:
        """Runs the file; what stands beside it can be imported meanwhile."""
        assert module.__spec__ is not None
        path = Path(str(module.__spec__.origin))
        data = _read(path)
        module.__file__ = str(path)
        module.__dict__["__source__"] = data
        sys.path.insert(0, str(path.parent))
        try:
            exec(compile(data, str(path), "exec"), module.__dict__)
        finally:
            sys.path.remove(str(path.parent))


sys.meta_path.append(_Files())
