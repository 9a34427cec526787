"""The world that is attached to a recording, compiled as what it is: text that anybody may have written.

It opens no file and runs no code: what would is refused before MuJoCo sees it, and so are sizes that nobody
needs. The compiler itself runs in a process of its own, with bounds on time and memory, because what hangs or
aborts it would take this one along.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from xml.parsers import expat

import mujoco

from mjmerge.config.bounds import patience_s
from mjmerge.errors import UnreadableError

MOST_BYTES = 8_000_000
"""Of a world as text; three cars on a long road are 0.3 MB."""
MOST_ELEMENTS, DEEPEST = 50_000, 60
MOST_SECONDS, MOST_MEMORY_BYTES = 4, 2**30
"""What the compiler may take."""

_REFUSED = {
    "include", "plugin", "extension", "model", "attach", "replicate", "composite", "flexcomp", "flex", "skin",
    "hfield", "deformable", "size",
}  # fmt: skip
"""Elements that open files, run code, or make much of little."""
_FILES = {"file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback", "plugin"}
_COUNTS = {
    "nsample", "size", "width", "height", "shadowsize", "offsamples", "offwidth", "offheight", "numslices",
    "numstacks", "numquads", "gridsize", "gridlayout", "maxhullvert", "iterations", "ls_iterations",
    "noslip_iterations", "ccd_iterations", "sdf_iterations", "sdf_initpoints", "octree_maxdepth",
}  # fmt: skip
"""Attributes that are numbers of something: none may be larger than ``MOST_OF_ONE``."""
MOST_OF_ONE = 250_000.0
_PICTURE = {"texture", "quality", "global"}
MOST_PIXELS = 8192.0
"""Of the elements that are pictures, or settings of those: each way."""


def compiled(path: Path, xml: str) -> mujoco.MjModel:
    """The model of an attached world.

    Args:
        path: the recording, to be named in errors.
        xml: its world.

    Raises:
        UnreadableError: there is none, it does not compile, or it is none that this program would compile.
    """
    if not xml.strip():
        raise UnreadableError(path, "there is no world in it")
    why = refusal(xml)
    if why:
        raise UnreadableError(path, f"its world {why}")
    return _loaded(path, _compiled(xml))


def refusal(xml: str) -> str:
    """Why a world is not compiled, as the end of a sentence that it begins; empty if it may be."""
    if len(xml) > MOST_BYTES:
        return f"has {len(xml) / 1e6:.0f} MB of text; the most is {MOST_BYTES / 1e6:.0f} MB"
    walk = _Walk()
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = lambda *_: walk.refuse(
        "declares a document type, which MJCF has none of"
    )
    parser.StartElementHandler = walk.start
    parser.EndElementHandler = walk.end
    try:
        parser.Parse(xml.encode("utf-8", "surrogatepass"), True)
    except expat.ExpatError as error:
        return f"is not well-formed XML, on line {error.lineno}"
    except _RefusedError as refused:
        return str(refused)
    return ""


class _RefusedError(Exception):
    """Ends the walk."""


class _Walk:
    """Looks at every element of a world, once."""

    def __init__(self) -> None:
        self._depth = self._count = 0
        self._pixels = 0.0

    def refuse(self, why: str) -> None:
        raise _RefusedError(why)

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        self._count += 1
        if self._depth == 1 and name != "mujoco":
            self.refuse("is not MJCF")
        if self._depth > DEEPEST:
            self.refuse(f"is nested deeper than {DEEPEST} levels")
        if self._count > MOST_ELEMENTS:
            self.refuse(f"has more than {MOST_ELEMENTS} elements")
        if name in _REFUSED:
            self.refuse(f"has an element <{name}>, which a recording's world does without")
        most = MOST_PIXELS if name in _PICTURE else MOST_OF_ONE
        if name == "texture":
            self._pixels += _number(attributes.get("width", "1")) * _number(attributes.get("height", "1"))
            if not self._pixels <= MOST_PIXELS**2 / 4:
                self.refuse(f"has textures of more than {MOST_PIXELS**2 / 4e6:.0f} megapixels")
        for key, value in attributes.items():
            if key in _FILES:
                self.refuse(f"names a file ({key} of <{name}>), and a recording stands for itself")
            if key in _COUNTS and not _at_most(value, most):
                self.refuse(f"has {key}={value[:20]!r} in <{name}>; the most is {most:.0f}")

    def end(self, name: str) -> None:
        del name
        self._depth -= 1


def _number(text: str) -> float:
    try:
        return abs(float(text))
    except ValueError:
        return 1.0


def _at_most(text: str, most: float) -> bool:
    """Whether every number of an attribute is; what is no number is the compiler's to refuse."""
    for word in text.split():
        with contextlib.suppress(ValueError):
            if not abs(float(word)) <= most:
                return False
    return True


@lru_cache(maxsize=4)  # a command asks for the same world more than once
def _compiled(xml: str) -> bytes | str:
    """The compiled model as bytes, or why there is none; by a process of its own."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MUJOCO_GL": "disable"}
    command = [sys.executable, "-P", str(Path(__file__).with_name("compiler.py"))]
    command += [str(MOST_SECONDS), str(MOST_MEMORY_BYTES)]
    with tempfile.TemporaryDirectory() as empty:
        try:
            done = subprocess.run(
                command,
                input=xml.encode("utf-8", "surrogatepass"),
                capture_output=True,
                cwd=empty,
                env=environment,
                timeout=patience_s(2 * MOST_SECONDS),
                check=False,
            )
        except subprocess.TimeoutExpired:
            return f"takes more than {2 * MOST_SECONDS} s to compile"
    if done.returncode == 0:
        return done.stdout
    if done.returncode == 1:
        said = done.stderr.decode("utf-8", "replace").removeprefix("Error: ")
        return f"does not compile: {' '.join(said.split())[:300]}"
    return (
        f"needs more than {MOST_SECONDS} s or {MOST_MEMORY_BYTES / 1e9:.1f} GB to compile, or breaks MuJoCo"
    )


def _loaded(path: Path, model: bytes | str) -> mujoco.MjModel:
    if isinstance(model, str):
        raise UnreadableError(path, f"its world {model}")
    return mujoco.MjModel.from_binary_path("attached.mjb", {"attached.mjb": model})
